//! What to assess: the configuration file of `crumple assess`.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::estimate::EstimatorKind;
use crate::scenario::file::{self, FileError};
use crate::scenario::{ControllerSpec, Scenario, built_in_names};
use crate::sim::Contender;

/// The version of the configuration format this release reads.
pub const CONFIG_VERSION: u32 = 1;

/// Most draws a configuration may ask for.
const MOST_DRAWS: u64 = 10_000_000;

/// The configuration as a file states it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Assessment", title = "crumple assessment, version 1")]
pub struct AssessConfig {
    /// Version of the file format: 1.
    pub version: u32,
    /// Controllers to compare, built-in names or policy files, the baseline first. Default: all built-in ones.
    #[serde(default = "all_controllers")]
    pub controllers: Vec<String>,
    /// What the vehicles under test look through. Default: the Kalman filter.
    #[serde(default)]
    pub estimator: EstimatorKind,
    /// Draws of the paper's distribution for each controller. Default 1000.
    #[serde(default = "default_draws")]
    pub draws: u64,
    /// Seed of the draws. Default 0.
    #[serde(default)]
    pub seed: u64,
    /// Scenario files, and folders of them, relative to the configuration file. Default none.
    #[serde(default)]
    pub scenarios: Vec<PathBuf>,
}

fn all_controllers() -> Vec<String> {
    ControllerSpec::built_in().iter().map(|controller| controller.name().to_owned()).collect()
}

fn default_draws() -> u64 {
    1000
}

impl Default for AssessConfig {
    fn default() -> Self {
        Self {
            version: CONFIG_VERSION,
            controllers: all_controllers(),
            estimator: EstimatorKind::default(),
            draws: default_draws(),
            seed: 0,
            scenarios: Vec::new(),
        }
    }
}

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
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

/// A configuration that was found valid, with everything it names.
#[derive(Debug, Clone)]
pub struct Plan {
    pub(super) config: AssessConfig,
    pub(super) controllers: Vec<Contender>,
    /// Scenarios from files, in order of their paths, with the path as the configuration reaches it.
    pub(super) traffic: Vec<(PathBuf, Scenario)>,
}

impl Plan {
    /// The built-in assessment.
    #[must_use]
    pub fn built_in() -> Self {
        Self { config: AssessConfig::default(), controllers: Contender::built_in(), traffic: Vec::new() }
    }

    /// Reads a configuration file and the scenarios it names.
    ///
    /// # Errors
    /// [`ConfigError`] for a file that cannot be read, parsed or accepted.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = file::read(path)?;
        let config: AssessConfig = file::parse_toml(&text, path)?;
        let wrong = |field: &str, problem: String| ConfigError::Field {
            path: path.to_owned(),
            line: file::line_in_toml(&text, field),
            field: field.to_owned(),
            problem,
        };
        if config.version != CONFIG_VERSION {
            let problem = format!("version {} is not supported: this release reads {CONFIG_VERSION}", config.version);
            return Err(wrong("version", problem));
        }
        if config.draws > MOST_DRAWS {
            return Err(wrong("draws", format!("must be at most {MOST_DRAWS}, found {}", config.draws)));
        }
        if config.controllers.is_empty() {
            return Err(wrong("controllers", "must name at least one controller".to_owned()));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut controllers = Vec::new();
        for (index, name) in config.controllers.iter().enumerate() {
            let field = format!("controllers[{index}]");
            let controller = Contender::find(name, folder).map_err(|error| wrong(&field, error.to_string()))?;
            if controllers.iter().any(|known: &Contender| known.name == controller.name) {
                return Err(wrong(&field, format!("`{name}` is named twice")));
            }
            controllers.push(controller);
        }
        let mut traffic = Vec::new();
        for (index, named) in config.scenarios.iter().enumerate() {
            let field = format!("scenarios[{index}]");
            let at = folder.join(named);
            if !at.exists() {
                return Err(wrong(&field, format!("there is no {}", at.display())));
            }
            let found = file::load_all(&at)?;
            if found.is_empty() {
                let problem = format!("the folder {} holds no scenario file", named.display());
                return Err(wrong(&field, problem));
            }
            let untested = found.iter().find(|(_, scenario)| !scenario.has_vehicle_under_test());
            if let Some((path, _)) = untested {
                return Err(wrong(&field, format!("{}: no vehicle is under test", path.display())));
            }
            traffic.extend(found);
        }
        let mut names: Vec<_> = built_in_names().iter().map(|(name, _)| (*name).to_owned()).collect();
        for (found_at, scenario) in &traffic {
            let name = &scenario.spec().name;
            if names.contains(name) {
                let problem = format!("{}: the name `{name}` is taken by another scenario", found_at.display());
                return Err(wrong("scenarios", problem));
            }
            names.push(name.clone());
        }
        Ok(Self { config, controllers, traffic })
    }
}

impl Plan {
    /// The options that make `crumple simulate` run a scenario as this plan does.
    pub(super) fn simulate_options(&self) -> String {
        match self.config.estimator {
            EstimatorKind::Kalman => String::new(),
            EstimatorKind::Truth => " --estimator truth".to_owned(),
        }
    }
}
