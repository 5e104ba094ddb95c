//! Training configuration: the content of a preset file.

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::config_error::TrainingConfigError;
use super::costs::CostConfig;
use super::imitation::ImitationConfig;
use super::observation::ObservationConfig;
use super::replay::TransitionLayout;
use super::serde_helpers::deserialize_f32_no_underflow;
use super::source::{PaperSource, ScenarioSource};
use super::space_mixture::{SpaceMixture, TrainingSpace};
use crumple_controllers::Controllers;
use crumple_core::old_names;
use crumple_core::text_file::{self, is_default};
use crumple_sim::observation::EstimatorKind;

/// Version of the preset format that this release reads.
pub const TRAINING_VERSION: u32 = 1;

/// Everything that determines a training, apart from the seed.
///
/// ```
/// use crumple_learn::rl::TrainingConfig;
///
/// let fast = TrainingConfig::preset("fast").unwrap();
/// assert_eq!(fast.network.hidden, [64, 64, 64]);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct TrainingConfig {
    /// Version of the format: 1.
    pub version: u32,
    /// Name of the preset; policies and tables state it.
    #[cfg_attr(feature = "schema", schemars(length(min = 1)))]
    pub name: String,
    /// Maximum number of episodes.
    pub episodes: u64,
    /// Environment of the agent.
    pub environment: EnvironmentConfig,
    /// Shapes and initial weights of the networks.
    pub network: NetworkConfig,
    /// Parameters of the update.
    pub learning: LearningConfig,
    /// Imitation of a controller before reinforcement learning; none without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imitation: Option<ImitationConfig>,
    /// Noise on actions.
    pub exploration: ExplorationConfig,
    /// Parameters of the replay memory.
    pub replay: ReplayConfig,
    /// Options of TD3 (Fujimoto, van Hoof and Meger, 2018).
    pub td3: Td3Config,
    /// Evaluation scenarios, and the criterion that ends the training.
    pub evaluation: EvaluationConfig,
    /// Scenario spaces that episodes are drawn from; if empty, the paper's distribution.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spaces: Vec<TrainingSpace>,
    /// Opens the drivers that spaces name as files; not part of the file.
    #[serde(skip)]
    pub controllers: Controllers,
}

/// The Markov decision process (paper, section "Markov decision process").
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EnvironmentConfig {
    /// Steps of 0.01 s between decisions; 1 in the paper.
    #[serde(alias = "decision_steps")]
    pub action_repeat: u32,
    /// Estimator of the ego vehicle.
    pub estimator: EstimatorKind,
    /// Reward of a step without a collision; 15 in the paper.
    pub step_reward: f64,
    /// Reward of a collision, which ends the episode; -3000 in the paper.
    #[serde(alias = "contact_reward")]
    pub collision_reward: f64,
    /// Reward of a collision in addition, times its harm: the expected number of seriously injured drivers. Default 0.
    #[serde(default, skip_serializing_if = "is_default")]
    pub harm_reward: f64,
    /// Factor on the rewards that the learner receives. Returns and logs are unscaled.
    pub reward_scale: f64,
    /// Meaning of the time limit to the learner.
    pub time_limit: TimeLimit,
    /// Highest acceleration of an action, in m/s²; the lowest is -7.5.
    pub max_accel_mps2: f64,
    /// Costs of a step; none in the paper. A policy file without costs omits the field.
    #[serde(default, skip_serializing_if = "CostConfig::is_free")]
    pub costs: CostConfig,
    /// Observation of the agent. A policy file omits the default, because it states the scaling separately.
    #[serde(default, skip_serializing_if = "is_default")]
    pub observation: ObservationConfig,
}

/// Meaning of the time limit of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum TimeLimit {
    /// Truncation: the value of the last state is bootstrapped.
    Truncation,
    /// Termination: the last state has no value.
    #[serde(alias = "end")]
    Termination,
}

/// Shapes and initial weights of the networks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct NetworkConfig {
    /// Widths of the hidden layers of both networks.
    pub hidden: Vec<usize>,
    /// Bound of the uniform initial weights of the output layer; 0 for the fan-in bound, as in all other layers.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub final_layer_bound: f32,
}

/// Parameters of the update.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct LearningConfig {
    /// Learning rate of the actor (Adam).
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub actor_rate: f32,
    /// Learning rate of the critic (Adam).
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub critic_rate: f32,
    /// Discount factor per decision.
    pub discount: f64,
    /// Weight of the trained network in an update of its target network.
    #[serde(
        deserialize_with = "deserialize_f32_no_underflow",
        alias = "soft_update"
    )]
    pub tau: f32,
    /// Transitions per update.
    pub batch: usize,
    /// Decisions between updates.
    pub decisions_per_update: u32,
    /// True if critics also receive privileged information: friction, braking capabilities, delays, the vehicle behind,
    /// the leader's next accelerations and the cost multiplier.
    #[serde(default, skip_serializing_if = "is_default")]
    pub privileged_critic: bool,
    /// Weight of the mean of max(0, |z| - 1)² in the actor's loss; z is the output before the tanh. Gives a saturated
    /// actor a gradient.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    #[cfg_attr(feature = "schema", schemars(extend("anyOf" = penalty_schema())))]
    pub saturation_penalty: f32,
    /// Weight of the mean of (π(s) - π(s'))² in the actor's loss; s' is the observation after s, unless nothing follows
    /// (Mysore, Mabsout, Mancuso and Saenko 2021).
    #[serde(
        default,
        skip_serializing_if = "is_default",
        deserialize_with = "deserialize_f32_no_underflow"
    )]
    #[cfg_attr(feature = "schema", schemars(extend("anyOf" = penalty_schema())))]
    pub smoothness_penalty: f32,
    /// Decay of the learning rates; without it they are constant.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "rates_fall")]
    pub lr_decay: Option<LrDecay>,
}

impl LearningConfig {
    pub(super) fn privileged_width(&self) -> usize {
        if self.privileged_critic {
            PRIVILEGED_WIDTH
        } else {
            0
        }
    }
}

pub(super) const PRIVILEGED_WIDTH: usize = 10;

/// Range of a non-zero penalty weight. A smaller weight vanishes in the rounding of the loss.
pub(super) const PENALTY_RANGE: [f64; 2] = [1e-6, 1e3];

/// Returns the schema of a penalty: 0, or a weight in [`PENALTY_RANGE`].
#[cfg(feature = "schema")]
fn penalty_schema() -> serde_json::Value {
    let [least, most] = PENALTY_RANGE;
    serde_json::json!([{ "minimum": 0, "maximum": 0 }, { "minimum": least, "maximum": most }])
}

/// Linear decay of the learning rates after the random episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LrDecay {
    /// Episode at which the decay ends. Independent of the number of episodes, so that a training can be extended.
    pub until_episode: u64,
    /// Factor on the learning rates at the end of the decay.
    #[serde(alias = "to_share")]
    pub final_factor: f64,
}

impl LrDecay {
    /// Returns the factor in an episode, counted from 0, of a training with `learning_starts_episode` random episodes.
    pub(super) fn factor(&self, episode: u64, learning_starts_episode: u64) -> f64 {
        let falling = self
            .until_episode
            .saturating_sub(learning_starts_episode)
            .max(1);
        let progress = episode.saturating_sub(learning_starts_episode) as f64 / falling as f64;
        1.0 + (self.final_factor - 1.0) * progress.min(1.0)
    }
}

/// Noise on actions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ExplorationConfig {
    /// Episodes of uniformly random actions before learning starts; many of them end in a collision. After an
    /// imitation the policy drives them, with noise, and only the critics learn.
    #[serde(alias = "random_episodes")]
    pub learning_starts_episode: u64,
    /// Steps of 0.01 s for which a random action is held, at least until the next decision.
    pub random_hold_steps: u32,
    /// Standard deviation of the noise on actions in `[-1, 1]` after the random episodes.
    pub noise: f64,
    /// Factor on the standard deviation after each episode; 0.9995 in the paper.
    pub noise_decay: f64,
}

/// Parameters of the replay memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ReplayConfig {
    /// Maximum number of transitions; 10 000 in the paper.
    pub capacity: usize,
    /// Share of a batch sampled from transitions that ended in a collision, if any; 0 for uniform sampling.
    #[serde(alias = "contact_share")]
    pub collision_fraction: f64,
}

/// TD3's three changes to DDPG.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Td3Config {
    /// True for two critics, of which the smaller value counts.
    pub twin_critic: bool,
    /// Critic updates per update of the actor and the targets.
    pub actor_every: u32,
    /// Standard deviation of the noise on target actions; 0 for none.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub target_noise: f32,
    /// Clipping limit of that noise.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub target_noise_limit: f32,
}

/// Evaluation scenarios, and the criterion that ends a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EvaluationConfig {
    /// Episodes between evaluations.
    pub every_episodes: u64,
    /// Random validation scenarios of every evaluation, besides the paper's three scenarios.
    pub screening_draws: u64,
    /// Random validation scenarios that rank a policy that passes the screening. With 0, no policy masters the task.
    pub ranking_draws: u64,
    /// Random scenarios of the built-in space `traffic`, in which a ranked policy must also be useful; 0 for none.
    #[serde(default, skip_serializing_if = "is_default", alias = "useful_draws")]
    pub usefulness_draws: u64,
    /// Folder of recorded drives (`crumple import --whole`), relative to the working directory, in which a ranked
    /// policy must also be useful. Needs `usefulness_draws`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drives: Option<String>,
    /// SHA-256 of these drives. crumple adds it, and refuses other drives.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drives_sha256: Option<String>,
    /// Smallest gap, in metres, with which a policy must pass all of these to end the training; 0 never ends it.
    pub master_gap_m: f64,
    /// Updates over which the evaluated policy averages the actor's weights, recent ones most (Polyak and Juditsky
    /// 1992); 0 for the actor itself. Exploration and learning always use the actor itself.
    #[serde(
        default,
        skip_serializing_if = "is_default",
        alias = "mean_over_updates"
    )]
    pub weight_average_updates: u64,
}

/// Returns the JSON Schema of a training configuration.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(TrainingConfig).to_value()
}

/// Presets by name.
pub const PRESETS: [(&str, &str); 4] = [
    ("fast", include_str!("presets/fast.toml")),
    ("paper", include_str!("presets/paper.toml")),
    ("paper-net", include_str!("presets/paper-net.toml")),
    ("road", include_str!("presets/road.toml")),
];

impl TrainingConfig {
    /// Returns a built-in preset.
    ///
    /// # Errors
    /// [`TrainingConfigError::UnknownPreset`] for any other name.
    pub fn preset(name: &str) -> Result<Self, TrainingConfigError> {
        Self::parse(Self::preset_text(name)?, Path::new(name))
    }

    /// Returns the text of a preset file.
    ///
    /// # Errors
    /// [`TrainingConfigError::UnknownPreset`] for any other name.
    pub fn preset_text(name: &str) -> Result<&'static str, TrainingConfigError> {
        let built_in = PRESETS.iter().find(|(built_in, _)| *built_in == name);
        built_in
            .map(|(_, text)| *text)
            .ok_or_else(|| TrainingConfigError::UnknownPreset(name.to_owned()))
    }

    /// Parses a configuration from TOML; `path` only names it in errors.
    ///
    /// # Errors
    /// [`TrainingConfigError::Located`], with line and field, if it does not parse or a field is out of range.
    pub fn parse(text: &str, path: &Path) -> Result<Self, TrainingConfigError> {
        let config: Self = text_file::parse_toml(text, path)
            .map_err(|error| TrainingConfigError::Located(error.to_string()))?;
        old_names::TRAINING.warn(text, path);
        config
            .check()
            .map_err(|error| error.with_location(text, path))?;
        Ok(config)
    }

    /// Returns the configuration for the header of a policy, with the names of version 1: the bytes of a policy
    /// identify it, also in certificates.
    ///
    /// # Errors
    /// [`serde_json::Error`] in principle, if a number is not finite.
    pub fn to_header_value(&self) -> Result<serde_json::Value, serde_json::Error> {
        let mut value = serde_json::to_value(self)?;
        old_names::TRAINING.restore_in_value(&mut value);
        Ok(value)
    }

    pub(super) fn transition_layout(&self) -> TransitionLayout {
        TransitionLayout {
            state_width: self.environment.observation.width(),
            privileged_width: self.learning.privileged_width(),
        }
    }

    /// Returns the source of the episodes' scenarios; without spaces, the paper's distribution.
    ///
    /// # Errors
    /// [`TrainingConfigError`] if a space cannot be found, read, or trained on.
    pub fn scenario_source(&self) -> Result<Arc<dyn ScenarioSource>, TrainingConfigError> {
        if self.spaces.is_empty() {
            Ok(Arc::new(PaperSource))
        } else {
            Ok(Arc::new(SpaceMixture::new(&self.spaces, self.controllers)?))
        }
    }
}

#[cfg(test)]
mod tests;
