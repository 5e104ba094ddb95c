//! Plan of a tuning: everything that determines its results, as a file.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::objective::ScoringSet;
use super::{SettingSearch, TuneError, TuningObjective, TuningSpace};
use crate::rl::TrafficBenchmark;
use crumple_core::digest::sha256;
use crumple_evidence::drives::DriveSet;
use crumple_search::falsify::Method;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::random::derived_seed;
use crumple_store::run_folder::RunFolderError;

/// Version of the files `tune.toml` and `report.json`.
pub(super) const TUNE_VERSION: u32 = 1;

/// Everything that determines the results of a tuning.
#[derive(Debug, Clone)]
pub struct TuningPlan {
    /// Controller, and its settings to search.
    pub search: SettingSearch,
    /// Spaces in which collisions count, with distinct names; at least one.
    pub spaces: Vec<TuningSpace>,
    /// Recorded drives in which every candidate must be useful; the same in all three sets. None without them.
    pub drives: Option<Arc<DriveSet>>,
    /// Settings of the search, and sizes of the sets of scenarios.
    pub config: TuningConfig,
}

/// Settings of the search, and sizes of the sets of scenarios.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TuningConfig {
    /// Number to minimise.
    pub objective: TuningObjective,
    /// Search method.
    pub method: Method,
    /// Seed of the search and of all scenarios.
    pub seed: u64,
    /// Number of candidates, with the initial settings.
    pub evaluations: u64,
    /// Random scenarios of each space in the tuning set, and in the selection set.
    pub runs: u64,
    /// Random scenarios of each space in the test set.
    pub test_runs: u64,
    /// Estimator of the vehicles under test.
    pub estimator: EstimatorKind,
}

#[derive(Serialize)]
struct TuningFile<'a> {
    version: u32,
    crumple: &'a str,
    controller: String,
    #[serde(flatten)]
    config: &'a TuningConfig,
    #[serde(skip_serializing_if = "Option::is_none")]
    drives_sha256: Option<&'a str>,
    settings: Vec<SettingRecord>,
    spaces: Vec<SpaceRecord<'a>>,
}

#[derive(Serialize)]
struct SettingRecord {
    name: &'static str,
    range: [f64; 2],
}

#[derive(Serialize)]
struct SpaceRecord<'a> {
    space: &'a str,
    weight: f64,
    sha256: String,
}

/// Set of scenarios. Its number is the index of its derived seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SetKind {
    /// Scenarios of all candidates.
    Tuning = 1,
    /// Scenarios that select one of the best candidates.
    Selection = 2,
    /// Scenarios of the report.
    Test = 3,
}

/// Offset of the derived seeds of a tuning. Derived seeds keep all its scenarios apart from each other, and from every
/// seed that a user may assess with.
const SEED_BASE: u64 = 3 << 32;

const WEIGHT_RANGE: std::ops::RangeInclusive<f64> = 1e-6..=1e6;

pub(super) const PLAN: &str = "tune.toml";
pub(super) const CANDIDATES: &str = "candidates.jsonl";
pub(super) const REPORT_JSON: &str = "report.json";
pub(super) const REPORT_MARKDOWN: &str = "report.md";

impl TuningPlan {
    pub(super) fn search_seed(&self) -> u64 {
        derived_seed(self.config.seed, SEED_BASE)
    }

    /// Samples a set of scenarios. The test set always measures both sides.
    pub(super) fn scoring_set(&self, kind: SetKind) -> Result<ScoringSet, TuneError> {
        let config = &self.config;
        let is_test = kind == SetKind::Test;
        let runs = if is_test {
            config.test_runs
        } else {
            config.runs
        };
        let seed = derived_seed(config.seed, SEED_BASE + kind as u64);
        let traffic = || {
            TrafficBenchmark::new(seed, runs, config.estimator)?.with_drives(self.drives.clone())
        };
        let with_traffic = is_test || config.objective == TuningObjective::Both;
        ScoringSet::new(
            (config.objective, &self.spaces),
            (seed, runs),
            config.estimator,
            with_traffic.then(traffic).transpose()?,
        )
    }

    /// Returns the number of simulations that one candidate needs.
    pub(super) fn runs_per_candidate(&self) -> u64 {
        let [traffic, drives] = match self.config.objective {
            TuningObjective::Both => [1, self.drive_count()],
            TuningObjective::Safety => [0, 0],
        };
        let spaces = self.spaces.len() as u64 + traffic;
        self.config.runs.saturating_mul(spaces) + drives
    }

    pub(super) fn drive_count(&self) -> u64 {
        let drives = self.drives.as_ref();
        drives.map_or(0, |drives| drives.drives().len() as u64)
    }

    /// Checks everything that would fail later, before any file is written.
    pub(super) fn check_spaces(&self) -> Result<(), TuneError> {
        if self.spaces.is_empty() {
            return Err(space_error("", "at least one scenario space is needed"));
        }
        for (index, TuningSpace { space, weight }) in self.spaces.iter().enumerate() {
            if !WEIGHT_RANGE.contains(weight) {
                return Err(space_error(
                    space.name(),
                    "the weight must be between 0.000001 and 1000000",
                ));
            }
            if self
                .spaces
                .iter()
                .take(index)
                .any(|other| other.space.name() == space.name())
            {
                return Err(space_error(
                    space.name(),
                    "occurs twice: give it one weight",
                ));
            }
            if !space.draw(0, 0)?.has_vehicle_under_test() {
                return Err(space_error(space.name(), "has no vehicle under test"));
            }
        }
        Ok(())
    }

    /// Returns the text of `tune.toml`.
    ///
    /// # Errors
    /// [`RunFolderError::Encoding`] in principle, if the writer fails.
    pub fn to_toml(&self) -> Result<String, TuneError> {
        let searched = self.search.searched().iter();
        let file = TuningFile {
            version: TUNE_VERSION,
            crumple: env!("CARGO_PKG_VERSION"),
            controller: self.search.initial().to_arg(),
            config: &self.config,
            drives_sha256: self.drives.as_ref().map(|drives| drives.identity()),
            settings: searched
                .map(|setting| SettingRecord {
                    name: setting.field.name,
                    range: setting.range,
                })
                .collect(),
            spaces: self
                .spaces
                .iter()
                .map(SpaceRecord::new)
                .collect::<Result<_, _>>()?,
        };
        Ok(toml::to_string(&file).map_err(encoding_error)?)
    }
}

impl<'a> SpaceRecord<'a> {
    fn new(TuningSpace { space, weight }: &'a TuningSpace) -> Result<Self, RunFolderError> {
        let json = crumple_spaces::file::to_identity_json(space).map_err(encoding_error)?;
        Ok(Self {
            space: space.name(),
            weight: *weight,
            sha256: sha256(json),
        })
    }
}

fn encoding_error(problem: impl std::fmt::Display) -> RunFolderError {
    RunFolderError::encoding(PLAN, problem)
}

fn space_error(space: &str, problem: &'static str) -> TuneError {
    TuneError::Space {
        space: space.to_owned(),
        problem,
    }
}
