//! Report of a retraining as JSON and Markdown.

mod markdown;

use serde::{Deserialize, Serialize};

use super::files::{POLICY, SELECTION_SET, TEST_SET, TRAINING_CASES, VALIDATION_SET};
use super::plan::{RETRAIN_VERSION, RetrainingPlan, RetrainingSettings};
use super::round::Round;
use super::search::RoundFindings;
use super::test_set::{ControllerTally, PairedOutcomes, TestSetResults};
use super::{RegressionResults, RetrainError};
use crumple_core::digest::sha256;
use crumple_store::run_folder::RunFolder;

/// Reason why a retraining ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum RetrainingEnding {
    /// All rounds are done.
    #[serde(alias = "rounds-spent")]
    RoundsExhausted,
    /// A search found no avoidable counterexample.
    NothingFound {
        /// Results of that search.
        search: Box<RoundFindings>,
    },
}

/// A file and its hash.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileHash {
    /// Name in the folder.
    pub file: String,
    /// SHA-256.
    pub sha256: String,
}

/// The file `report.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RetrainingReport {
    /// Version of the format: 1.
    pub version: u32,
    /// Version of crumple.
    pub crumple: String,
    /// SHA-256 of `retrain.toml`.
    pub plan_sha256: String,
    /// Name or path of the initial policy.
    pub first: String,
    /// SHA-256 of the initial policy.
    pub first_sha256: String,
    /// SHA-256 of the final policy.
    pub retrained_sha256: String,
    /// Name of the space, or names of the spaces.
    pub space: String,
    /// Name of the training configuration.
    pub preset: String,
    /// Name of the search method.
    pub method: String,
    /// Seed.
    pub seed: u64,
    /// Sizes of all parts.
    pub settings: RetrainingSettings,
    /// Records of the rounds.
    pub rounds: Vec<Round>,
    /// Reason of the end.
    pub ending: RetrainingEnding,
    /// Results of the initial policy.
    #[serde(alias = "first_standing")]
    pub first_results: RegressionResults,
    /// Results of the retrained policy.
    #[serde(alias = "retrained_standing")]
    pub retrained_results: RegressionResults,
    /// Avoidable random scenarios of the test set.
    #[serde(alias = "judged_draws")]
    pub test_draws: u64,
    /// Results of each controller in the test set.
    pub tallies: Vec<ControllerTally>,
    /// Paired results of the two policies.
    pub pairs: PairedOutcomes,
    /// Hashes of the policy and the corpora.
    pub files: Vec<FileHash>,
}

impl FileHash {
    fn new(run_folder: &RunFolder, name: &str) -> Result<Self, RetrainError> {
        Ok(Self {
            file: name.to_owned(),
            sha256: sha256(run_folder.read_required(name)?),
        })
    }
}

impl RetrainingReport {
    pub(super) fn new(
        plan: &RetrainingPlan,
        work: &RunFolder,
        (first_standing, retrained_standing): (RegressionResults, RegressionResults),
        rounds: Vec<Round>,
        ending: RetrainingEnding,
        evaluated: TestSetResults,
    ) -> Result<Self, RetrainError> {
        let files = [
            POLICY,
            TRAINING_CASES,
            SELECTION_SET,
            VALIDATION_SET,
            TEST_SET,
        ]
        .into_iter()
        .map(|name| FileHash::new(work, name))
        .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            version: RETRAIN_VERSION,
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            plan_sha256: sha256(plan.to_toml()?),
            first: plan.initial_policy_name.clone(),
            first_sha256: plan.initial_policy.digest(),
            retrained_sha256: FileHash::new(work, POLICY)?.sha256,
            space: plan.spaces.name(),
            preset: plan.training.name.clone(),
            method: plan.method.name().to_owned(),
            seed: plan.seed,
            settings: plan.settings,
            rounds,
            ending,
            first_results: first_standing,
            retrained_results: retrained_standing,
            test_draws: evaluated.corpus.avoidable,
            tallies: evaluated.tallies,
            pairs: evaluated.pairs,
            files,
        })
    }

    /// True if any round was accepted.
    #[must_use]
    pub fn is_retrained(&self) -> bool {
        self.rounds
            .iter()
            .any(|round| round.acceptance.is_accepted())
    }

    /// Returns a lower bound of the factor by which the collision rate decreased: the lower end of the initial policy's
    /// interval over the upper end of the retrained policy's. Each end is wrong with a probability of at most 2.5 %, so
    /// the bound has a confidence level of 95 %.
    pub(crate) fn min_improvement_factor(&self) -> Option<f64> {
        let [first, retrained, ..] = self.tallies.as_slice() else {
            return None;
        };
        Some(first.interval(self.test_draws).lower / retrained.interval(self.test_draws).upper)
    }
}
