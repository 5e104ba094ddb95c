//! Configuration of a campaign: everything that decides its results, and its file.

use serde::{Deserialize, Serialize};

use super::{CampaignError, SearchObjective};
use crate::StudySubject;
use crate::falsify::evaluator::Evaluator;
use crate::falsify::{FailureCriterion, FailureCriterionRecord, Method};
use crumple_measure::Specification;
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_spaces::{ScenarioSpace, SpaceSpec};

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
/// use crumple_search::falsify::campaign::Campaign;
/// use crumple_sim::control::BuiltInController;
/// use crumple_spaces::built_in_space;
/// use crumple_store::study::Study;
///
/// let controller = BuiltInController::from_name("match-leader").unwrap();
/// let campaign = Campaign::new(controller, built_in_space("high-risk").unwrap()).with_budget(50);
/// let folder = tempfile::tempdir().unwrap();
/// let summary = campaign.run(&folder.path().join("campaign"), false, &Quiet).unwrap();
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
    /// Seed of the search and of all noise, at most [`MAX_SEED`].
    pub seed: u64,
    /// Settings of the search.
    pub search: SearchSettings,
}

/// Settings of a search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SearchSettings {
    /// The search method.
    pub method: Method,
    /// Objective of the search after the first failure. The reference searches ignore it.
    #[serde(alias = "aim")]
    pub objective: SearchObjective,
    /// Evaluations of the method, and of each reference search: 1 to [`MAX_BUDGET`].
    pub budget: u64,
    /// Record of the evaluations.
    #[serde(default, skip_serializing_if = "EvaluationLog::is_full")]
    pub log: EvaluationLog,
}

impl Default for SearchSettings {
    /// A search for the severest failure by `auto`, with 2000 evaluations, all of which are recorded.
    fn default() -> Self {
        Self {
            method: Method::Auto,
            objective: SearchObjective::Severest,
            budget: 2000,
            log: EvaluationLog::Full,
        }
    }
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
pub(in crate::falsify) struct CampaignRecord {
    pub(in crate::falsify) version: u32,
    #[serde(flatten)]
    pub(in crate::falsify) search: SearchSettings,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "contrast")]
    pub(in crate::falsify) failure_criterion: Option<FailureCriterionRecord>,
    #[serde(flatten)]
    pub(in crate::falsify) subject: StudySubject<SpaceSpec>,
}

impl CampaignRecord {
    pub(in crate::falsify) fn from_campaign(campaign: &Campaign) -> Result<Self, CampaignError> {
        let criterion = campaign.failure_criterion.as_ref();
        Ok(Self {
            version: CAMPAIGN_VERSION,
            search: campaign.search.clone(),
            failure_criterion: criterion.map(FailureCriterion::to_record),
            subject: campaign
                .subject()?
                .with_space(campaign.space.spec().clone()),
        })
    }

    /// Returns true if a campaign of another version of crumple has the same configuration.
    pub(in crate::falsify) fn has_results_of(&self, mut other: Self) -> bool {
        other.subject.crumple.clone_from(&self.subject.crumple);
        *self == other
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
        use crumple_sim::control::BuiltInController;
        use crumple_spaces::built_in_space;
        let controller = BuiltInController::from_name("match-leader").unwrap();
        let campaign = Self::new(controller, built_in_space(space).unwrap())
            .with_method(method)
            .with_budget(budget);
        Self {
            estimator: EstimatorKind::Truth,
            seed,
            ..campaign
        }
    }

    /// Creates the default campaign: a search for collisions, Kalman filter, seed 0, default settings of the search.
    #[must_use]
    pub fn new(controller: impl Into<NamedController>, space: ScenarioSpace) -> Self {
        Self {
            controller: controller.into(),
            estimator: EstimatorKind::Kalman,
            space,
            specification: Specification::NoCollision,
            failure_criterion: None,
            seed: 0,
            search: SearchSettings::default(),
        }
    }

    /// Sets the search method.
    #[must_use]
    pub fn with_method(mut self, method: Method) -> Self {
        self.search.method = method;
        self
    }

    /// Sets the evaluations of the method, and of each reference search.
    #[must_use]
    pub fn with_budget(mut self, budget: u64) -> Self {
        self.search.budget = budget;
        self
    }

    /// Sets the objective of the search after the first failure.
    #[must_use]
    pub fn with_objective(mut self, objective: SearchObjective) -> Self {
        self.search.objective = objective;
        self
    }

    /// Returns the methods in the order in which they run: the requested one, then the reference searches.
    #[must_use]
    pub fn methods(&self) -> Vec<Method> {
        with_reference_methods(&self.search.method)
    }

    pub(in crate::falsify) fn subject(&self) -> Result<StudySubject, CampaignError> {
        let subject = StudySubject::new(
            &self.controller,
            self.estimator,
            self.specification.to_string(),
            self.seed,
            &self.space,
        )
        .map_err(CampaignError::from_encoding_error)?;
        let is_deterministic = self
            .controllers()
            .all(|controller| controller.source.is_deterministic());
        Ok(StudySubject {
            nondeterministic: !is_deterministic,
            ..subject
        })
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
        let partner = self
            .failure_criterion
            .as_ref()
            .map(FailureCriterion::partner_controller);
        std::iter::once(&self.controller).chain(partner)
    }

    /// Returns the text of `campaign.toml`.
    ///
    /// # Errors
    /// [`CampaignError::Encoding`] in principle, if the writer fails.
    pub fn to_toml(&self) -> Result<String, CampaignError> {
        CampaignRecord::from_campaign(self)?.to_toml()
    }
}
