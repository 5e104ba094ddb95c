//! What to assess: the configuration file of `crumple assess`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::gate::AssessmentGate;
use super::planned_suite::SuiteConfig;
use crumple_world::control::{ControllerSpec, Role};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::file::FileError;

/// The version of the configuration format this release reads.
pub const CONFIG_VERSION: u32 = 1;

/// The configuration as a file states it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "schema", schemars(rename = "Assessment", title = "crumple assessment, version 1"))]
#[non_exhaustive]
pub struct AssessConfig {
    /// Version of the file format: 1.
    pub version: u32,
    /// Controllers to compare, built-in names or policy files, the baseline first. Default: all built-in ones, the policy
    /// behind a shield, and the retrained policy.
    #[serde(default = "all_controllers")]
    pub controllers: Vec<String>,
    /// The controller that the argument is about, one of those. Default: the first learned one, or else the last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    /// What the vehicles under test look through. Default: the Kalman filter.
    #[serde(default)]
    pub estimator: EstimatorKind,
    /// Whether the paper's scenarios, its leader's worst braking, failure maps and its training are parts of the report.
    /// Default true; set it to false for controllers that have nothing to do with the paper.
    #[serde(default = "default_true")]
    pub paper: bool,
    /// Spaces by whose law failures are counted, built-in names or files relative to the configuration. Default: `paper`, or
    /// `high-risk` if the paper is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distributions: Option<Vec<String>>,
    /// Draws of each of these spaces for each controller, and, 200 at most, of each resample of a space that was fitted. Default 1000.
    #[serde(default = "default_draws")]
    pub draws: u64,
    /// Drives of each controller in everyday traffic (the space `traffic`), and as many in `high-risk`, where something threatens;
    /// none leaves usefulness out. Default 200.
    #[serde(default = "default_everyday_draws")]
    pub everyday_draws: u64,
    /// Seed of the draws. Default 0.
    #[serde(default)]
    pub seed: u64,
    /// Scenario files, and folders of them, relative to the configuration file. Default none.
    #[serde(default)]
    pub scenarios: Vec<PathBuf>,
    /// Recordings of traffic, relative to the configuration file: each braking episode in them is one scenario more, as
    /// `crumple import` makes it. Default none.
    #[serde(default)]
    pub recordings: Vec<PathBuf>,
    /// Suites of tests after regulations. Default none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub suites: Vec<SuiteConfig>,
    /// How failures are searched for.
    #[serde(default)]
    pub search: SearchConfig,
    /// How failures of the learned controllers are counted for a certificate.
    #[serde(default)]
    pub rates: RatesConfig,
    /// Certificates to check, relative to the configuration file. Default: those shipped about the reference policy, if it is
    /// among the controllers and the paper is not left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certificates: Option<Vec<PathBuf>>,
    /// What must hold; `crumple assess` ends with exit code 1 if something does not. Default none.
    #[serde(default)]
    pub gates: Vec<AssessmentGate>,
}

/// How failures are searched for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct SearchConfig {
    /// Spaces, built-in names or files relative to the configuration file. Default: `paper` and `high-risk`, or the latter
    /// alone if the paper is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spaces: Option<Vec<String>>,
    /// Evaluations of the search, and of each reference search. Default 400.
    pub budget: u64,
    /// What must hold besides that nobody touches, each searched for by itself with that budget: rules of conduct or formulas, as
    /// `crumple falsify --spec` takes them. Default none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[serde(rename = "rules")]
    pub specifications: Vec<String>,
}

impl Default for SearchConfig {
    fn default() -> Self {
        Self { spaces: None, budget: 400, specifications: Vec::new() }
    }
}

/// How failures are counted for a certificate: on draws of each of `distributions`, with a seed of their own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct RatesConfig {
    /// Runs of each learned controller; none for no count. Default 4000.
    pub runs: u64,
    /// Confidence of each bound, above 1/2 and below 1. Default 0.999.
    pub confidence: f64,
}

impl Default for RatesConfig {
    fn default() -> Self {
        Self { runs: 4000, confidence: 0.999 }
    }
}

fn all_controllers() -> Vec<String> {
    let compared = ControllerSpec::all().into_iter().filter(|spec| matches!(spec.role(), Role::Rule | Role::Learned));
    let mut names: Vec<_> = compared.map(|spec| spec.name().to_owned()).collect();
    // The shield stands beside the policy that it shields.
    let place = names.iter().position(|name| name == "policy").map_or(names.len(), |place| place + 1);
    names.insert(place, "shield:policy".to_owned());
    names
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
    /// The spaces by whose law failures are counted, as they are named.
    #[must_use]
    pub fn distributions(&self) -> Vec<String> {
        let unless_named = || vec![if self.paper { "paper" } else { "high-risk" }.to_owned()];
        self.distributions.clone().unwrap_or_else(unless_named)
    }

    /// The spaces that are searched for failures, as they are named.
    #[must_use]
    pub fn search_spaces(&self) -> Vec<String> {
        let of_the_paper = self.paper.then(|| "paper".to_owned());
        let unless_named = || of_the_paper.into_iter().chain(["high-risk".to_owned()]).collect();
        self.search.spaces.clone().unwrap_or_else(unless_named)
    }
}

impl Default for AssessConfig {
    fn default() -> Self {
        let (baseline, policy) = ("baseline".to_owned(), "policy".to_owned());
        Self {
            version: CONFIG_VERSION,
            controllers: all_controllers(),
            subject: None,
            estimator: EstimatorKind::default(),
            paper: default_true(),
            distributions: None,
            draws: default_draws(),
            everyday_draws: default_everyday_draws(),
            seed: 0,
            scenarios: Vec::new(),
            recordings: Vec::new(),
            suites: Vec::new(),
            search: SearchConfig::default(),
            rates: RatesConfig::default(),
            certificates: None,
            gates: vec![
                AssessmentGate::NoContactInPaperScenarios { controller: policy.clone() },
                AssessmentGate::RateNotAbove { controller: policy, than: baseline, space: None },
                AssessmentGate::ProofsAccepted {},
            ],
        }
    }
}

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AssessConfigError {
    /// The configuration, or a scenario file it names, cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// A field is out of range.
    #[error("{}:{line}: {field}: {problem}", path.display())]
    Field {
        /// The configuration file.
        path: PathBuf,
        /// Line of the field, from 1.
        line: usize,
        /// Path of the field.
        field: String,
        /// What is wrong.
        problem: String,
    },
}
