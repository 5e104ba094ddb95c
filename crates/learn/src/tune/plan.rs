//! Plan of a tuning: everything that determines its results, as a file.

use std::path::Path;

use serde::Serialize;

use super::objective::ScoringSet;
use super::{SettingSearch, TuneError, TuningObjective, TuningSpace};
use crumple_core::digest::sha256;
use crumple_search::falsify::Method;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::random::derived_seed;
use crumple_store::run_folder::{RunFolder, RunFolderOptions};

/// Version of the files `tune.toml` and `report.json`.
pub(super) const TUNE_VERSION: u32 = 1;

/// Everything that determines the results of a tuning.
#[derive(Debug, Clone)]
pub struct TuningPlan {
    /// Controller, and its settings to search.
    pub search: SettingSearch,
    /// Spaces in which collisions count, with distinct names; at least one.
    pub spaces: Vec<TuningSpace>,
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
    objective: TuningObjective,
    method: &'a str,
    seed: u64,
    evaluations: u64,
    runs: u64,
    test_runs: u64,
    estimator: EstimatorKind,
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
        derived_seed(self.seed, SEED_BASE)
    }

    /// Samples a set of scenarios. The test set always measures both sides.
    pub(super) fn scoring_set(&self, kind: SetKind) -> Result<ScoringSet, TuneError> {
        let runs = if kind == SetKind::Test {
            self.test_runs
        } else {
            self.runs
        };
        let seed = derived_seed(self.seed, SEED_BASE + kind as u64);
        let with_traffic = kind == SetKind::Test || self.objective == TuningObjective::Both;
        ScoringSet::new(
            (self.objective, &self.spaces),
            (seed, runs),
            self.estimator,
            with_traffic,
        )
    }

    /// Returns the number of simulations that one candidate needs.
    pub(super) fn runs_per_candidate(&self) -> u64 {
        let traffic = u64::from(self.objective == TuningObjective::Both);
        self.runs.saturating_mul(self.spaces.len() as u64 + traffic)
    }

    /// Checks everything that would fail later, before any file is written.
    pub(super) fn check(&self) -> Result<(), TuneError> {
        let error = |space: &str, problem| {
            Err(TuneError::Space {
                space: space.to_owned(),
                problem,
            })
        };
        if self.spaces.is_empty() {
            return error("", "at least one scenario space is needed");
        }
        for (index, TuningSpace { space, weight }) in self.spaces.iter().enumerate() {
            if !WEIGHT_RANGE.contains(weight) {
                return error(
                    space.name(),
                    "the weight must be between 0.000001 and 1000000",
                );
            }
            if self
                .spaces
                .iter()
                .take(index)
                .any(|other| other.space.name() == space.name())
            {
                return error(space.name(), "occurs twice: give it one weight");
            }
            if !space.draw(0, 0)?.has_vehicle_under_test() {
                return error(space.name(), "has no vehicle under test");
            }
        }
        Ok(())
    }

    /// Returns the text of `tune.toml`.
    ///
    /// # Errors
    /// [`TuneError::Encoding`] in principle, if the writer fails.
    pub fn to_toml(&self) -> Result<String, TuneError> {
        let space = |TuningSpace { space, weight }: &'_ TuningSpace| {
            serde_json::to_string(space.spec())
                .map(|json| (sha256(json), *weight))
                .map_err(TuneError::encoding)
        };
        let hashes = self
            .spaces
            .iter()
            .map(space)
            .collect::<Result<Vec<_>, _>>()?;
        let names = self.spaces.iter().map(|one| one.space.name());
        let searched = self.search.searched().iter();
        let file = TuningFile {
            version: TUNE_VERSION,
            crumple: env!("CARGO_PKG_VERSION"),
            controller: self.search.initial().to_arg(),
            objective: self.objective,
            method: self.method.name(),
            seed: self.seed,
            evaluations: self.evaluations,
            runs: self.runs,
            test_runs: self.test_runs,
            estimator: self.estimator,
            settings: searched
                .map(|one| SettingRecord {
                    name: one.field.name,
                    range: one.range,
                })
                .collect(),
            spaces: names
                .zip(hashes)
                .map(|(space, (sha256, weight))| SpaceRecord {
                    space,
                    weight,
                    sha256,
                })
                .collect(),
        };
        toml::to_string(&file).map_err(TuneError::encoding)
    }

    /// Opens the folder if it is empty or belongs to this plan; otherwise the error names the first difference.
    pub(super) fn open_run_folder(
        &self,
        folder: &Path,
        resume: bool,
    ) -> Result<RunFolder, TuneError> {
        let configuration = self.to_toml()?;
        let options = RunFolderOptions {
            kind: "tuning",
            configuration: &configuration,
            configuration_file: PLAN,
            resume,
            outputs: &[PLAN, CANDIDATES, REPORT_JSON, REPORT_MARKDOWN],
        };
        Ok(RunFolder::open(folder, options)?)
    }
}
