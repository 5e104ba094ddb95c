//! Configuration of a campaign: everything that decides its results, and its file.

use serde::{Deserialize, Serialize};

use super::{CampaignError, SearchObjective};
use crate::falsify::evaluator::Evaluator;
use crate::falsify::{FailureCriterion, FailureCriterionRecord, Method};
use crumple_measure::Specification;
use crumple_spaces::{ScenarioSpace, SpaceSpec};
use crumple_world::observation::EstimatorKind;
use crumple_world::sim::NamedController;

/// Version of the campaign file that this release reads and writes.
pub const CAMPAIGN_VERSION: u32 = 2;

/// Maximum number of evaluations of a search method.
pub const MAX_BUDGET: u64 = 1_000_000_000;

/// Maximum seed: TOML has no larger numbers.
pub const MAX_SEED: u64 = i64::MAX as u64;

/// Everything that decides a campaign's results.
///
/// ```
/// use crumple_core::observer::Quiet;
/// use crumple_search::falsify::campaign::{Campaign, CampaignOptions};
/// use crumple_world::control::BuiltInController;
/// use crumple_spaces::built_in_space;
///
/// let campaign = Campaign {
///     budget: 50,
///     ..Campaign::new(BuiltInController::from_name("match-leader").unwrap(), built_in_space("high-risk").unwrap())
/// };
/// let folder = tempfile::tempdir().unwrap();
/// let summary = campaign.run(&folder.path().join("campaign"), CampaignOptions::default(), &Quiet).unwrap();
/// assert!(summary.falsified);
/// ```
#[derive(Debug, Clone)]
pub struct Campaign {
    /// Controller under test.
    pub controller: NamedController,
    /// Estimator of the vehicles under test.
    pub estimator: EstimatorKind,
    /// Scenario space of the search.
    pub space: ScenarioSpace,
    /// Requirement of each simulation.
    pub specification: Specification,
    /// Additional condition for a failure to count; `None` if every failure counts.
    pub failure_criterion: Option<FailureCriterion>,
    /// The search method.
    pub method: Method,
    /// Objective of the search after the first failure. The reference searches ignore it.
    pub objective: SearchObjective,
    /// Evaluations of the method, and of each reference search: 1 to [`MAX_BUDGET`].
    pub budget: u64,
    /// Seed of the search and of all noise, at most [`MAX_SEED`].
    pub seed: u64,
}

/// Options of a campaign in its folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CampaignOptions {
    /// Record of the evaluations.
    pub log: EvaluationLog,
    /// True to continue the campaign that the folder holds, if there is one. If false, such a folder is refused.
    pub resume: bool,
}

/// Record of the evaluations of a campaign: all or none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum EvaluationLog {
    /// Every evaluation, as a row of a compressed CSV file.
    #[default]
    Full,
    /// No evaluations, only the summary and the counterexamples.
    Summary,
}

impl EvaluationLog {
    fn is_full(&self) -> bool {
        *self == Self::Full
    }
}

/// The file `campaign.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::falsify) struct CampaignRecord {
    pub(in crate::falsify) version: u32,
    pub(in crate::falsify) crumple: String,
    pub(in crate::falsify) controller: String,
    pub(in crate::falsify) policy_sha256: Option<String>,
    /// Identity of the controller, if its name does not determine it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(in crate::falsify) controller_sha256: Option<String>,
    pub(in crate::falsify) estimator: EstimatorKind,
    pub(in crate::falsify) specification: String,
    pub(in crate::falsify) method: Method,
    #[serde(rename = "aim")]
    pub(in crate::falsify) objective: SearchObjective,
    pub(in crate::falsify) budget: u64,
    pub(in crate::falsify) seed: u64,
    #[serde(default, skip_serializing_if = "EvaluationLog::is_full")]
    pub(in crate::falsify) log: EvaluationLog,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "contrast")]
    pub(in crate::falsify) failure_criterion: Option<FailureCriterionRecord>,
    pub(in crate::falsify) space: SpaceSpec,
}

impl CampaignRecord {
    pub(in crate::falsify) fn from_campaign(campaign: &Campaign, log: EvaluationLog) -> Self {
        Self {
            version: CAMPAIGN_VERSION,
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            controller: campaign.controller.name.clone(),
            policy_sha256: campaign.policy_sha256(),
            controller_sha256: campaign.controller.disambiguating_hash(),
            estimator: campaign.estimator,
            specification: campaign.specification.to_string(),
            method: campaign.method.clone(),
            objective: campaign.objective,
            budget: campaign.budget,
            seed: campaign.seed,
            log,
            failure_criterion: campaign
                .failure_criterion
                .as_ref()
                .map(FailureCriterion::to_record),
            space: campaign.space.spec().clone(),
        }
    }

    pub(in crate::falsify) fn to_toml(&self) -> Result<String, CampaignError> {
        toml::to_string(self).map_err(CampaignError::from_encoding_error)
    }
}

pub(in crate::falsify) fn with_reference_methods(requested: &Method) -> Vec<Method> {
    let mut methods = vec![requested.clone()];
    methods.extend(
        [Method::Uniform, Method::Halton]
            .into_iter()
            .filter(|method| method != requested),
    );
    methods
}

impl Campaign {
    #[cfg(test)]
    pub(in crate::falsify) fn of_match_leader(
        space: &str,
        method: Method,
        budget: u64,
        seed: u64,
    ) -> Self {
        use crumple_spaces::built_in_space;
        use crumple_world::control::BuiltInController;
        let controller = BuiltInController::from_name("match-leader").unwrap();
        let campaign = Self::new(controller, built_in_space(space).unwrap());
        Self {
            estimator: EstimatorKind::Truth,
            method,
            budget,
            seed,
            ..campaign
        }
    }

    /// Creates the default campaign: a search for collisions by `auto`, 2000 evaluations, Kalman filter, seed 0.
    #[must_use]
    pub fn new(controller: impl Into<NamedController>, space: ScenarioSpace) -> Self {
        Self {
            controller: controller.into(),
            estimator: EstimatorKind::Kalman,
            space,
            specification: Specification::NoContact,
            failure_criterion: None,
            method: Method::Auto,
            objective: SearchObjective::Severest,
            budget: 2000,
            seed: 0,
        }
    }

    /// Returns the hash of the policy under test; `None` for other controllers.
    #[must_use]
    pub fn policy_sha256(&self) -> Option<String> {
        self.controller.policy().map(|policy| policy.digest())
    }

    /// Returns the methods in the order in which they run: the requested one, then the reference searches.
    #[must_use]
    pub fn methods(&self) -> Vec<Method> {
        with_reference_methods(&self.method)
    }

    pub(in crate::falsify) fn evaluator(&self) -> Evaluator<'_> {
        Evaluator {
            specification: &self.specification,
            controller: &self.controller,
            estimator: self.estimator,
            failure_criterion: self.failure_criterion.as_ref(),
        }
    }

    /// Returns the controller under test, and the partner controller of a differential criterion.
    pub(in crate::falsify) fn controllers(&self) -> impl Iterator<Item = &NamedController> {
        let other = self
            .failure_criterion
            .as_ref()
            .map(FailureCriterion::partner_controller);
        std::iter::once(&self.controller).chain(other)
    }

    /// Returns the text of `campaign.toml`.
    ///
    /// # Errors
    /// [`CampaignError::Encoding`] in principle, if the writer fails.
    pub fn to_toml(&self) -> Result<String, CampaignError> {
        CampaignRecord::from_campaign(self, EvaluationLog::Full).to_toml()
    }
}
