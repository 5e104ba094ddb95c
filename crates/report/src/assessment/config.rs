//! The configuration file of `crumple assess`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::AssessmentGate;
use super::gate::GateConfig;
use super::gate_rules::gate_comments;
use super::planned_suite::SuiteConfig;
use crumple_controllers::Controllers;
use crumple_core::field_error::FieldError;
use crumple_core::text_file::FileError;
use crumple_evidence::drives::DriveSetError;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{AfterCollision, NamedController};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::file::ScenarioFileError;

/// Version of the configuration format that this release reads.
pub const CONFIG_VERSION: u32 = 1;

/// The configuration of an assessment, as its file states it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[cfg_attr(
    feature = "schema",
    schemars(rename = "Assessment", title = "crumple assessment, version 1")
)]
#[non_exhaustive]
pub struct AssessConfig {
    /// Version of the file format: 1.
    pub version: u32,
    /// Controllers to compare, the baseline first: built-in names or policy files. Default: `baseline`, `idm`,
    /// `acc-aeb`, `predictive`, `policy`, `shield:policy` and `road`.
    #[serde(default = "compared_controllers")]
    pub controllers: Vec<String>,
    /// Names of controllers in the report, by their entries in `controllers`. Default: the entries themselves.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub names: BTreeMap<String, String>,
    /// Controller that the safety case is about, one of `controllers`. Default: `road` if it is one of
    /// them, otherwise the first learned one, or the last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    /// Estimator of the vehicles under test. Default: the Kalman filter.
    #[serde(default)]
    pub estimator: EstimatorKind,
    /// Include the paper's scenarios, its leader's worst-case braking and its training. Set it to false for controllers
    /// that are unrelated to the paper. Default true.
    #[serde(default = "default_true")]
    pub paper: bool,
    /// Scenario spaces whose failure rates are measured: built-in names or files relative to the configuration.
    /// Default: `paper`, or `high-risk` without the paper.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distributions: Option<Vec<String>>,
    /// Random scenarios of each of these spaces and, 200 at most, of each resample of a fitted space. Default 1000.
    #[serde(default = "default_draws")]
    pub draws: u64,
    /// Drives of each controller in the space `traffic`, in `high-risk`, and with each of the six kinds of follower
    /// (on average) in `followers` and in `everyday`, and with none; 0 omits all of these. Default 200.
    #[serde(default = "default_everyday_draws")]
    pub everyday_draws: u64,
    /// Seed of the random scenarios. Default 0.
    #[serde(default)]
    pub seed: u64,
    /// Scenario files, and folders of them, relative to the configuration file. Default none.
    #[serde(default)]
    pub scenarios: Vec<PathBuf>,
    /// Traffic recordings, relative to the configuration file. Each braking episode becomes a scenario, as with
    /// `crumple import`. Default none.
    #[serde(default)]
    pub recordings: Vec<PathBuf>,
    /// Folder of recorded drives, as `crumple import --whole` writes it, relative to the configuration file. Each
    /// controller drives each of them once. Default none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drives: Option<PathBuf>,
    /// Suites of tests that are modelled on regulations. Default none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub suites: Vec<SuiteConfig>,
    /// Settings of the search for failures.
    #[serde(default)]
    pub search: SearchConfig,
    /// Settings of the counts for rate certificates of the learned controllers.
    #[serde(default)]
    pub rates: RatesConfig,
    /// Counts collisions ahead and behind and harm in `distributions`, by kind of follower, and writes `runs.csv`.
    /// Default: not counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub harm: Option<HarmConfig>,
    /// Certificates to check, relative to the configuration file. Default: those shipped about the reference policy, if
    /// it is among the controllers and the paper is included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certificates: Option<Vec<PathBuf>>,
    /// Conditions of the assessment; `crumple assess` ends with exit code 1 if one does not hold. Default none.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<AssessmentGate>"))]
    pub gates: Vec<GateConfig>,
    /// Opens the controllers that scenarios, spaces and suites name as files; not part of the file.
    #[serde(skip)]
    pub controllers_of_files: Controllers,
}

/// Settings of the search for failures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct SearchConfig {
    /// Scenario spaces: built-in names or files relative to the configuration file. Default: `paper` and `high-risk`,
    /// or only `high-risk` without the paper.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spaces: Option<Vec<String>>,
    /// Simulations of the search, and of each reference search. Default 400.
    pub budget: u64,
}

impl Default for SearchConfig {
    fn default() -> Self {
        Self {
            spaces: None,
            budget: 400,
        }
    }
}

/// Settings of the counts for rate certificates, which sample each of `distributions` with a separate seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct RatesConfig {
    /// Runs of each learned controller; 0 omits the count. Default 4000.
    pub runs: u64,
    /// Confidence level of each bound, above 1/2 and below 1. Default 0.999.
    pub confidence: f64,
}

impl Default for RatesConfig {
    fn default() -> Self {
        Self {
            runs: 4000,
            confidence: 0.999,
        }
    }
}

/// Settings of the count of harm.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct HarmConfig {
    /// Emergencies per hour of driving that the random scenarios stand for: an assumption, at most 3600.
    pub emergencies_per_hour: f64,
    /// Random scenarios of each space for which crumple decides whether a collision is avoidable. Default 0.
    #[serde(default)]
    pub avoid_draws: u64,
    /// Motion of a vehicle under test, or of another vehicle with a controller, after it has hit its leader: `hold` or
    /// `coast`. Default `hold`.
    #[serde(default)]
    pub after_collision: BrakeAfterCollision,
}

/// Brake of a vehicle that has hit its leader.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum BrakeAfterCollision {
    /// Brakes at 6 m/s² to standstill.
    #[default]
    Hold,
    /// Neither brakes nor accelerates.
    Coast,
}

impl From<BrakeAfterCollision> for AfterCollision {
    fn from(brake: BrakeAfterCollision) -> Self {
        match brake {
            BrakeAfterCollision::Hold => Self::Hold,
            BrakeAfterCollision::Coast => Self::Coast,
        }
    }
}

/// The built-in space of everyday traffic.
pub(super) const TRAFFIC_SPACE: &str = "traffic";
/// The built-in spaces of everyday traffic and of dangerous scenarios.
pub(super) const EVERYDAY_SPACES: [&str; 2] = [TRAFFIC_SPACE, "high-risk"];

/// The built-in space of everyday driving with every kind of follower.
pub(super) const EVERYDAY_SPACE: &str = "everyday";
/// The built-in spaces with every kind of follower: emergencies, and everyday driving.
pub(super) const FOLLOWER_SPACES: [&str; 2] = ["followers", EVERYDAY_SPACE];

/// Largest share of drives in [`EVERYDAY_SPACE`], in percent, in which a controller may fall behind by the default
/// gates.
const MAX_LEFT_BEHIND_PERCENT: f64 = 5.0;

/// Line of the built-in configuration in whose place the gates are listed.
const GATES_LINE: &str = "#   GATES\n";

/// Returns the built-in configuration as a file, with a comment for each field, and a list of all gates.
#[must_use]
pub fn default_configuration() -> String {
    include_str!("built_in/assessment.toml").replace(GATES_LINE, &gate_comments())
}

/// Controller with which an own controller is compared.
const REFERENCE: &str = "idm";
/// Controller with which that one is compared.
const OTHER_REFERENCE: &str = "baseline";

/// Controllers of the built-in report, the baseline first.
const COMPARED: [&str; 7] = [
    "baseline",
    "idm",
    "acc-aeb",
    "predictive",
    "policy",
    "shield:policy",
    "road",
];

fn compared_controllers() -> Vec<String> {
    COMPARED.map(str::to_owned).into()
}

fn default_true() -> bool {
    true
}

fn default_draws() -> u64 {
    1000
}

fn default_everyday_draws() -> u64 {
    200
}

impl AssessConfig {
    /// Returns the names of the scenario spaces whose failure rates are measured.
    #[must_use]
    pub fn rate_spaces(&self) -> Vec<String> {
        self.distributions.clone().unwrap_or_else(|| {
            let default = if self.paper { "paper" } else { "high-risk" };
            vec![default.to_owned()]
        })
    }

    /// Returns the built-in configuration for an own controller, in the place of `road`: it is compared with `idm`, or,
    /// if it is `idm`, whatever its name, with `baseline`. The controller itself is not among `controllers`, because
    /// [`AssessmentPlan::new`](super::AssessmentPlan::new) adds it.
    #[must_use]
    pub fn for_own_controller(own: &NamedController) -> Self {
        let built_in = BuiltInController::from_name(REFERENCE).map(NamedController::from);
        let is_reference = built_in.is_some_and(|built_in| {
            own.name == built_in.name || own.source.identity() == built_in.source.identity()
        });
        let name = &own.name;
        let reference = if is_reference {
            OTHER_REFERENCE
        } else {
            REFERENCE
        };
        Self {
            controllers: vec![reference.to_owned()],
            gates: default_gates(name, reference),
            ..Self::default()
        }
    }

    /// Returns the names of the scenario spaces that are searched for failures.
    #[must_use]
    pub fn search_spaces(&self) -> Vec<String> {
        self.search.spaces.clone().unwrap_or_else(|| {
            let paper = self.paper.then(|| "paper".to_owned());
            paper.into_iter().chain(["high-risk".to_owned()]).collect()
        })
    }
}

impl Default for AssessConfig {
    fn default() -> Self {
        Self {
            version: CONFIG_VERSION,
            controllers: compared_controllers(),
            names: BTreeMap::new(),
            subject: None,
            estimator: EstimatorKind::default(),
            paper: default_true(),
            distributions: None,
            draws: default_draws(),
            everyday_draws: default_everyday_draws(),
            seed: 0,
            scenarios: Vec::new(),
            recordings: Vec::new(),
            drives: None,
            suites: Vec::new(),
            search: SearchConfig::default(),
            rates: RatesConfig::default(),
            harm: None,
            certificates: None,
            gates: default_gates("road", OTHER_REFERENCE),
            controllers_of_files: Controllers::default(),
        }
    }
}

/// Returns the gates of the built-in configuration for a controller and the one that it is compared with.
fn default_gates(controller: &str, than: &str) -> Vec<GateConfig> {
    [
        AssessmentGate::NoCollisionInPaperScenarios {
            controller: controller.to_owned(),
        },
        AssessmentGate::RateNotAbove {
            controller: controller.to_owned(),
            than: than.to_owned(),
            space: None,
        },
        AssessmentGate::LeftBehindAtMost {
            controller: controller.to_owned(),
            percent: MAX_LEFT_BEHIND_PERCENT,
            space: Some(EVERYDAY_SPACE.to_owned()),
        },
        AssessmentGate::ProofsAccepted {},
    ]
    .map(GateConfig::from)
    .into()
}

/// An error of a configuration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AssessConfigError {
    /// The configuration cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// A scenario file that the configuration names cannot be read.
    #[error(transparent)]
    Scenario(#[from] ScenarioFileError),
    /// A folder that holds no recorded drives.
    #[error("drives: {0}")]
    Drives(#[from] DriveSetError),
    /// A field is out of range.
    #[error("{}:{line}: {invalid}", path.display())]
    Field {
        /// Configuration file.
        path: PathBuf,
        /// Line of the field, from 1.
        line: usize,
        /// Field and problem.
        invalid: FieldError,
    },
}
