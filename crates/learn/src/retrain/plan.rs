//! Plan of a retraining: everything that determines its results, as a file.

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::files::{PLAN, scenarios_sha256, space_sha256};
use super::{RetrainError, SearchedSpaces};
use crumple_store::run_folder::RunFolderError;

use crate::rl::{TrainingConfig, TrainingConfigError, action_bounds};
use crumple_core::text_file::is_default;
use crumple_search::falsify::Method;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::random::derived_seed;
use crumple_sim::scenario::{PAPER_STEP_S, Scenario};
use crumple_spaces::{ScenarioSpace, SpaceSpec};

/// Version of the file `retrain.toml`.
pub(super) const RETRAIN_VERSION: u32 = 1;

/// Everything that determines the results of a retraining.
#[derive(Debug, Clone)]
pub struct RetrainingPlan {
    /// Policy at the start.
    pub initial_policy: Arc<Policy>,
    /// Built-in name or path of the policy.
    pub initial_policy_name: String,
    /// Scenario spaces that are searched for counterexamples.
    pub spaces: SearchedSpaces,
    /// Further scenarios that each round attacks, as they are and with the leader's worst-case braking. A policy must
    /// be trainable on each ([`unsuitability`](crate::rl::unsuitability)).
    pub attacked: Vec<Scenario>,
    /// Spaces in which no round may make the policy worse, with distinct names.
    pub regression_spaces: Vec<ScenarioSpace>,
    /// Configuration of the learner. The settings replace its number of episodes, and avoidable random scenarios of the
    /// searched spaces replace its ranking scenarios.
    pub training: TrainingConfig,
    /// Search method.
    pub method: Method,
    /// Seed of searches and trainings.
    pub seed: u64,
    /// Sizes of all parts.
    pub settings: RetrainingSettings,
}

/// Sizes of the parts of a retraining.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RetrainingSettings {
    /// Maximum number of rounds.
    pub rounds: u64,
    /// Episodes of reinforcement learning per round.
    pub episodes: u64,
    /// Evaluations of the search method per round and space, and of each reference search.
    pub budget: u64,
    /// Random scenarios of each space that a round simulates besides.
    pub draws: u64,
    /// Avoidable random scenarios of the validation set, which accepts or rejects a round, per space.
    #[serde(alias = "kept_aside")]
    pub validation_draws: u64,
    /// Random scenarios of the paper's distribution for acceptance.
    pub nominal: u64,
    /// Random scenarios of each regression space for acceptance.
    #[serde(default, skip_serializing_if = "is_default")]
    pub regression: u64,
    /// Avoidable random scenarios of the test set, per space.
    #[serde(alias = "judged")]
    pub test_draws: u64,
    /// Share of the training episodes from the paper's distribution, unless the preset has spaces of its own.
    pub nominal_share: f64,
    /// Share of the other episodes that use a case; the rest are random scenarios of the spaces.
    pub case_share: f64,
}

impl RetrainingSettings {
    /// Sizes by default.
    pub const DEFAULT: Self = Self {
        rounds: 3,
        episodes: 1000,
        budget: 1000,
        draws: 1000,
        validation_draws: 2000,
        nominal: 10_000,
        regression: 1000,
        test_draws: 10_000,
        nominal_share: 0.2,
        case_share: 0.2,
    };
}

/// Text of the training preset of a retraining.
pub const TRAINING_PRESET_TEXT: &str = include_str!("preset.toml");

/// Returns the default configuration of the learner.
///
/// # Errors
/// None: a test reads it.
pub fn training_preset() -> Result<TrainingConfig, TrainingConfigError> {
    TrainingConfig::parse(TRAINING_PRESET_TEXT, Path::new("retrain"))
}

#[derive(Serialize)]
struct PlanFile<'a> {
    version: u32,
    crumple: &'a str,
    policy: &'a str,
    policy_sha256: String,
    method: &'a str,
    seed: u64,
    settings: RetrainingSettings,
    training: &'a TrainingConfig,
    #[serde(skip_serializing_if = "Option::is_none")]
    space: Option<&'a SpaceSpec>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    spaces: Vec<SpaceHash<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    attacked_sha256: Option<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    regression: Vec<SpaceHash<'a>>,
}

#[derive(Serialize)]
struct SpaceHash<'a> {
    space: &'a str,
    sha256: String,
}

impl<'a> SpaceHash<'a> {
    fn all(spaces: &'a [ScenarioSpace]) -> Result<Vec<Self>, RunFolderError> {
        let mut hashes = Vec::new();
        for space in spaces {
            hashes.push(Self {
                space: space.name(),
                sha256: space_sha256(space)?,
            });
        }
        Ok(hashes)
    }
}

/// Seeds of the sets that are equal for all retrainings in a space, so that results can be compared.
pub(super) const SELECTION_SEED: u64 = 0x0073_656c_6563_7465;
pub(super) const VALIDATION_SET_SEED: u64 = 0x006b_6570_7461_7364;
pub(super) const TEST_SET_SEED: u64 = 0x006a_7564_6765_6420;
pub(super) const NOMINAL_SEED: u64 = 0x006e_6f6d_696e_616c;
pub(super) const REGRESSION_SEED: u64 = 0x0072_6567_7265_7373;

/// Factor on the learning rate of an imitation.
const IMITATION_RATE_FACTOR: f32 = 0.1;

/// Least factor on rows of the paper's distribution. Acceptance checks unnecessary braking there, and only a factor
/// above 1 gives hard braking its weight.
const PAPER_COSTS: f64 = 30.0;

/// Offsets of the derived seeds of searches and of trainings.
const SEARCH_SEED_BASE: u64 = 1 << 32;
const TRAINING_SEED_BASE: u64 = 2 << 32;

impl RetrainingPlan {
    /// Returns the estimator of the vehicles under test.
    #[must_use]
    pub fn estimator(&self) -> EstimatorKind {
        self.training.environment.estimator
    }

    /// Returns the configuration up to `episodes`. An imitation continues with one round at a low rate, so that the
    /// policy keeps its other answers.
    pub(super) fn training_until(&self, episodes: u64) -> TrainingConfig {
        let mut training = TrainingConfig {
            episodes,
            ..self.training.clone()
        };
        if let Some(imitation) = &mut training.imitation {
            imitation.rounds = 1;
            imitation.rate *= IMITATION_RATE_FACTOR;
            for space in training
                .spaces
                .iter_mut()
                .filter(|space| space.space == "paper")
            {
                space.cost_multiplier = space.cost_multiplier.max(PAPER_COSTS);
            }
        }
        training
    }

    pub(super) fn search_seed(&self, round: u64) -> u64 {
        derived_seed(self.seed, SEARCH_SEED_BASE + round)
    }

    pub(super) fn training_seed(&self, round: u64) -> u64 {
        derived_seed(self.seed, TRAINING_SEED_BASE + round)
    }

    /// Returns the text of `retrain.toml`.
    ///
    /// # Errors
    /// [`RunFolderError::Encoding`] in principle, if the writer fails.
    pub fn to_toml(&self) -> Result<String, RetrainError> {
        let only_space = match self.spaces.as_slice() {
            [space] => Some(space),
            _ => None,
        };
        let several_spaces = match self.spaces.as_slice() {
            [_] => &[],
            spaces => spaces,
        };
        let attacked_sha256 = match self.attacked.as_slice() {
            [] => None,
            attacked => Some(scenarios_sha256(attacked)?),
        };
        let file = PlanFile {
            version: RETRAIN_VERSION,
            crumple: env!("CARGO_PKG_VERSION"),
            policy: &self.initial_policy_name,
            policy_sha256: self.initial_policy.digest(),
            method: self.method.name(),
            seed: self.seed,
            settings: self.settings,
            training: &self.training_until(self.training.episodes),
            space: only_space.map(ScenarioSpace::spec),
            spaces: SpaceHash::all(several_spaces)?,
            attacked_sha256,
            regression: SpaceHash::all(&self.regression_spaces)?,
        };
        Ok(toml::to_string(&file).map_err(|error| RunFolderError::encoding(PLAN, error))?)
    }

    /// Checks that the preset and the policy agree on observation, action and decision interval.
    pub(super) fn check_policy(&self) -> Result<(), RetrainError> {
        let header = self.initial_policy.header();
        let environment = &self.training.environment;
        let interval_s = f64::from(environment.action_repeat) * PAPER_STEP_S;
        let what = if header.observation != environment.observation.scaling() {
            "the observation or its scaling"
        } else if header.action != action_bounds(environment) {
            "the bounds of the acceleration"
        } else if header.decision_interval_s != interval_s {
            "the decision interval"
        } else {
            return Ok(());
        };
        Err(RetrainError::PolicyMismatch {
            policy: self.initial_policy_name.clone(),
            preset: self.training.name.clone(),
            what,
        })
    }
}
