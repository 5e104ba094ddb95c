//! What a campaign is: everything that decides its results, as a file.

use serde::{Deserialize, Serialize};

use super::{Aim, CampaignError};
use crate::falsify::Method;
use crumple_world::measure::Specification;
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::space::{Space, SpaceSpec};
use crumple_world::sim::{NamedController, RunOptions};

/// The version of the campaign file this release reads and writes.
pub const CAMPAIGN_VERSION: u32 = 2;

/// Everything that decides a campaign's results.
///
/// ```
/// use crumple_search::falsify::Method;
/// use crumple_search::falsify::campaign::{Aim, Campaign};
/// use crumple_world::control::ControllerSpec;
/// use crumple_world::measure::Specification;
/// use crumple_world::observation::EstimatorKind;
/// use crumple_world::scenario::space::built_in_space;
///
/// let campaign = Campaign {
///     controller: ControllerSpec::named("match-leader").unwrap().into(),
///     estimator: EstimatorKind::Kalman,
///     space: built_in_space("high-risk").unwrap(),
///     specification: Specification::NoContact,
///     method: Method::Auto,
///     aim: Aim::Severest,
///     budget: 50,
///     seed: 0,
/// };
/// let folder = tempfile::tempdir().unwrap();
/// let summary = campaign.run(&folder.path().join("campaign"), false, &mut |_| {}).unwrap();
/// assert!(summary.falsified);
/// ```
#[derive(Debug, Clone)]
pub struct Campaign {
    /// What is put under test.
    pub controller: NamedController,
    /// What the vehicles under test look through.
    pub estimator: EstimatorKind,
    /// Where failures are looked for.
    pub space: Space,
    /// What must hold.
    pub specification: Specification,
    /// The search method.
    pub method: Method,
    /// What the search is after once it knows failures. The reference searches do not look.
    pub aim: Aim,
    /// Evaluations of the method, and of each reference search.
    pub budget: u64,
    /// Seed of the search and of all noise.
    pub seed: u64,
}

/// The file `campaign.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CampaignFile {
    version: u32,
    crumple: String,
    controller: String,
    policy_sha256: Option<String>,
    /// Identity of a controller whose name does not say what it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    controller_sha256: Option<String>,
    estimator: EstimatorKind,
    specification: String,
    method: String,
    aim: String,
    budget: u64,
    seed: u64,
    space: SpaceSpec,
}

impl Campaign {
    /// Hash of the policy under test; none for other controllers.
    #[must_use]
    pub fn policy_sha256(&self) -> Option<String> {
        self.controller.policy().map(|policy| policy.digest())
    }

    /// The methods in the order in which they run: the one asked for, then the reference searches.
    #[must_use]
    pub fn methods(&self) -> Vec<Method> {
        let mut methods = vec![self.method];
        methods.extend([Method::Uniform, Method::Halton].into_iter().filter(|method| *method != self.method));
        methods
    }

    /// How scenarios are run to be judged.
    #[must_use]
    pub fn options(&self) -> RunOptions {
        RunOptions::new(self.controller.kind.clone())
            .with_estimator(self.estimator)
            .with_after_contact(self.specification.after_contact())
    }

    /// The text of `campaign.toml`.
    ///
    /// # Errors
    /// [`CampaignError::Encoding`] in principle, if the writer fails.
    pub fn to_toml(&self) -> Result<String, CampaignError> {
        let file = CampaignFile {
            version: CAMPAIGN_VERSION,
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            controller: self.controller.name.clone(),
            policy_sha256: self.policy_sha256(),
            controller_sha256: self.controller.identity_beside_name(),
            estimator: self.estimator,
            specification: self.specification.to_string(),
            method: self.method.name().to_owned(),
            aim: self.aim.name().to_owned(),
            budget: self.budget,
            seed: self.seed,
            space: self.space.spec().clone(),
        };
        toml::to_string(&file).map_err(CampaignError::encoding)
    }
}
