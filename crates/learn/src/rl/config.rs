//! The training configuration: what a preset file states.

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::config_error::TrainingConfigError;
use super::costs::CostConfig;
use super::f32_serde::deserialize_f32_no_underflow;
use super::observation::ObservationConfig;
use super::replay::TransitionLayout;
use super::source::ScenarioSource;
use super::space_mixture::{self, TrainingSpace};
use crumple_world::observation::EstimatorKind;
use crumple_world::policy::ResidualControl;
use crumple_world::scenario::file;

/// Version of the preset format this release reads.
pub const TRAINING_VERSION: u32 = 1;

/// Everything that decides a training, apart from the seed.
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
    /// Name of the preset, which policies and tables state.
    #[cfg_attr(feature = "schema", schemars(length(min = 1)))]
    pub name: String,
    /// Episodes at most.
    pub episodes: u64,
    /// What the agent lives in.
    pub environment: EnvironmentConfig,
    /// The two networks.
    pub network: NetworkConfig,
    /// How they learn.
    pub learning: LearningConfig,
    /// How actions are tried out.
    pub exploration: ExplorationConfig,
    /// What is remembered.
    pub replay: ReplayConfig,
    /// Twin delayed DDPG (Fujimoto, van Hoof and Meger, 2018): options beside plain DDPG.
    pub td3: Td3Config,
    /// How checkpoints are judged.
    pub evaluation: EvaluationConfig,
    /// Spaces that episodes are drawn from; without any, the paper's distribution.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spaces: Vec<TrainingSpace>,
}

/// The Markov decision process (paper, section "Markov decision process").
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EnvironmentConfig {
    /// Steps of 0.01 s between decisions; 1 in the paper.
    #[serde(rename = "decision_steps")]
    pub action_repeat: u32,
    /// What the ego looks through.
    pub estimator: EstimatorKind,
    /// Reward of a step without contact; 15 in the paper.
    pub step_reward: f64,
    /// Reward of a contact, which ends the episode; -3000 in the paper.
    pub contact_reward: f64,
    /// The learner sees rewards times this. Returns and logs are unscaled.
    pub reward_scale: f64,
    /// What the end of the scenario's time means to the learner.
    pub time_limit: TimeLimit,
    /// Highest acceleration the actor can choose, in m/s²; the lowest is -7.5.
    pub max_accel_mps2: f64,
    /// The law that actions depart from; without one an action is the acceleration itself, between -7.5 m/s² and the highest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "departs_from")]
    pub residual_over: Option<ResidualControl>,
    /// What a step costs beside; nothing in the paper. A policy file that was made without costs states none.
    #[serde(default, skip_serializing_if = "CostConfig::is_free")]
    pub costs: CostConfig,
    /// What the agent sees. A policy file states its scaling anyway, and here only what is not the default.
    #[serde(default, skip_serializing_if = "ObservationConfig::is_default")]
    pub observation: ObservationConfig,
}

/// What the end of an episode's time means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum TimeLimit {
    /// The episode is cut off: life goes on, and the last state has a value.
    Truncation,
    /// Life ends: nothing comes after.
    #[serde(rename = "end")]
    Termination,
}

/// Shapes and first weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct NetworkConfig {
    /// Widths of the hidden layers of both networks.
    pub hidden: Vec<usize>,
    /// Output weights start uniform within plus and minus this; 0 for the fan-in bound that all other layers have.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub final_layer_bound: f32,
}

/// The update.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct LearningConfig {
    /// Adam's step size of the actor.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub actor_rate: f32,
    /// Adam's step size of the critic.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub critic_rate: f32,
    /// Discount a decision.
    pub discount: f64,
    /// Share of the new weights that the targets take on in an update.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    #[serde(rename = "soft_update")]
    pub tau: f32,
    /// Transitions in an update.
    pub batch: usize,
    /// Decisions between updates.
    pub decisions_per_update: u32,
    /// Whether critics know besides what no driver sees: friction, what brakes and delays there are, who drives behind, what the leader's
    /// script does next, and how many times costs count.
    #[serde(default, skip_serializing_if = "is_false")]
    pub privileged_critic: bool,
    /// Weight in the actor's loss of the mean of max(0, |z| - 1)², z being its output before the tanh: an actor that has
    /// saturated gets no gradient back through the tanh, and this leads it out again.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    #[cfg_attr(feature = "schema", schemars(extend("anyOf" = penalty_schema())))]
    pub saturation_penalty: f32,
    /// Weight in the actor's loss of the mean of (π(s) - π(s'))², s' being what is seen at the decision after s unless nothing follows: an actor whose answers
    /// come and go from one decision to the next pays for it, whatever its critics make of that (Mysore, Mabsout, Mancuso and Saenko 2021).
    #[serde(default, skip_serializing_if = "is_zero_weight", deserialize_with = "deserialize_f32_no_underflow")]
    #[cfg_attr(feature = "schema", schemars(extend("anyOf" = penalty_schema())))]
    pub smoothness_penalty: f32,
    /// How Adam's step sizes fall; without it they stay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "rates_fall")]
    pub lr_decay: Option<LrDecay>,
}

impl LearningConfig {
    /// Numbers that critics know besides what the actor sees.
    pub(super) fn privileged_width(&self) -> usize {
        if self.privileged_critic { PRIVILEGED_WIDTH } else { 0 }
    }
}

/// Numbers that a privileged critic sees beside the observation.
pub(super) const PRIVILEGED_WIDTH: usize = 10;

/// Range of the weight of a penalty that is not 0. Less is lost in the rounding of the loss that it is added to.
pub(super) const PENALTY_RANGE: [f64; 2] = [1e-6, 1e3];

/// Of the schema: a penalty is none, or one that does something.
#[cfg(feature = "schema")]
fn penalty_schema() -> serde_json::Value {
    let [least, most] = PENALTY_RANGE;
    serde_json::json!([{ "minimum": 0, "maximum": 0 }, { "minimum": least, "maximum": most }])
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
fn is_false(flag: &bool) -> bool {
    !*flag
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
fn is_zero_weight(weight: &f32) -> bool {
    *weight == 0.0
}

/// Step sizes that fall in a straight line from the end of the random episodes on: a training that goes to and fro around what is
/// good comes to rest there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LrDecay {
    /// Episode from which on they fall no further. It does not depend on how many episodes there are, so that a training that goes on
    /// with more of them goes on as it began.
    pub until_episode: u64,
    /// Share of them that is left then.
    #[serde(rename = "to_share")]
    pub final_factor: f64,
}

impl LrDecay {
    /// Share of the step sizes in an episode, counted from 0, of a training that began with so many random ones.
    pub(super) fn factor(&self, episode: u64, random_episodes: u64) -> f64 {
        let falling = self.until_episode.saturating_sub(random_episodes).max(1);
        let progress = episode.saturating_sub(random_episodes) as f64 / falling as f64;
        1.0 + (self.final_factor - 1.0) * progress.min(1.0)
    }
}

/// Noise on actions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ExplorationConfig {
    /// Episodes of uniformly random actions before learning begins: the stage rich in collisions.
    #[serde(rename = "random_episodes")]
    pub learning_starts_episode: u64,
    /// Steps of 0.01 s for which a random action is held; at least until the next decision. Held longer, random actions
    /// average out less, and more episodes end in contact.
    pub random_hold_steps: u32,
    /// Standard deviation of the noise on actions between -1 and 1, after that stage.
    pub noise: f64,
    /// Factor on it after each episode; 0.9995 in the paper.
    pub noise_decay: f64,
}

/// The memory of transitions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ReplayConfig {
    /// Transitions kept; 10 000 in the paper.
    pub capacity: usize,
    /// Share of a batch drawn among transitions that ended in contact, once there are any; 0 draws all alike.
    #[serde(rename = "contact_share")]
    pub collision_fraction: f64,
}

/// TD3's three changes to DDPG.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Td3Config {
    /// Two critics, the smaller of which is believed.
    pub twin_critic: bool,
    /// Critic updates for each update of the actor and the targets.
    pub actor_every: u32,
    /// Standard deviation of the noise on target actions; 0 for none.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub target_noise: f32,
    /// Cut of that noise.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub target_noise_limit: f32,
}

/// Held-out scenarios and when training is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EvaluationConfig {
    /// Episodes between evaluations, and between checkpoints.
    pub every_episodes: u64,
    /// Held-out draws that every evaluation drives, beside the paper's three scenarios.
    pub screening_draws: u64,
    /// Held-out draws that rank a policy which survives all of those; without any, no policy counts as having mastered the task.
    pub ranking_draws: u64,
    /// Held-out draws of the built-in space `traffic`, in which a policy that is ranked must be of use besides; 0 for none.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[serde(rename = "useful_draws")]
    pub usefulness_draws: u64,
    /// Training ends once a policy survives all of these too and keeps this distance everywhere, in metres; 0 never ends it.
    pub master_gap_m: f64,
    /// Updates over which the policy that is judged and kept is the mean of the actor's weights, the last ones counting most (Polyak
    /// and Juditsky 1992); 0 for the actor as it is. What it tries out and learns from is the actor as it is in any case.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[serde(rename = "mean_over_updates")]
    pub weight_average_updates: u64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// JSON Schema of a training configuration.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(TrainingConfig).to_value()
}

/// The presets by name.
pub const PRESETS: [(&str, &str); 4] = [
    ("fast", include_str!("presets/fast.toml")),
    ("paper", include_str!("presets/paper.toml")),
    ("paper-net", include_str!("presets/paper-net.toml")),
    ("road", include_str!("presets/road.toml")),
];

impl TrainingConfig {
    /// A committed preset.
    ///
    /// # Errors
    /// [`ConfigError::Unknown`] for any other name.
    pub fn preset(name: &str) -> Result<Self, TrainingConfigError> {
        Self::parse(Self::preset_text(name)?, Path::new(name))
    }

    /// The text of a preset, as a file would hold it.
    ///
    /// # Errors
    /// [`ConfigError::Unknown`] if there is none of that name.
    pub fn preset_text(name: &str) -> Result<&'static str, TrainingConfigError> {
        let known = PRESETS.iter().find(|(known, _)| *known == name);
        known.map(|(_, text)| *text).ok_or_else(|| TrainingConfigError::UnknownPreset(name.to_owned()))
    }

    /// A configuration from TOML; `path` only names it in errors.
    ///
    /// # Errors
    /// [`ConfigError::Text`], with line and field, if it does not parse or a field is out of range.
    pub fn parse(text: &str, path: &Path) -> Result<Self, TrainingConfigError> {
        let config: Self =
            file::parse_toml(text, path).map_err(|error| TrainingConfigError::Located(error.to_string()))?;
        config.check().map_err(|error| error.with_location(text, path))?;
        Ok(config)
    }

    /// What is remembered of a decision.
    pub(super) fn transition_layout(&self) -> TransitionLayout {
        TransitionLayout {
            state_width: self.environment.observation.width(),
            privileged_width: self.learning.privileged_width(),
        }
    }

    /// What its episodes are drawn from.
    ///
    /// # Errors
    /// [`ConfigError`] if a space cannot be found, read, or trained on.
    pub fn scenario_source(&self) -> Result<Arc<dyn ScenarioSource>, TrainingConfigError> {
        space_mixture::scenario_source(&self.spaces)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_valid_and_called_by_its_name() {
        for (name, _) in PRESETS {
            assert_eq!(TrainingConfig::preset(name).unwrap().name, name);
        }
        assert!(TrainingConfig::preset("slow").is_err());
    }

    #[test]
    fn steps_become_smaller_from_the_end_of_the_random_episodes_on() {
        let fall = LrDecay { until_episode: 300, final_factor: 0.2 };
        for (episode, share) in [(0, 1.0), (100, 1.0), (150, 0.8), (200, 0.6), (300, 0.2), (9000, 0.2)] {
            assert!((fall.factor(episode, 100) - share).abs() < 1e-12, "{episode}");
        }
        assert_eq!(LrDecay { until_episode: 50, final_factor: 0.5 }.factor(101, 100), 0.5);
    }

    #[test]
    fn the_paper_preset_is_the_papers() {
        let paper = TrainingConfig::preset("paper").unwrap();
        assert_eq!(paper.network.hidden, [256; 3]);
        let LearningConfig { actor_rate, critic_rate, discount, tau: soft_update, batch, .. } = paper.learning;
        assert_eq!((actor_rate, critic_rate, discount, soft_update, batch), (0.001, 0.002, 0.99999, 0.005, 512));
        assert_eq!((paper.replay.capacity, paper.exploration.noise_decay), (10_000, 0.9995));
        assert_eq!((paper.environment.step_reward, paper.environment.contact_reward), (15.0, -3000.0));
        assert_eq!((paper.environment.action_repeat, paper.environment.reward_scale), (1, 1.0));
    }

    #[test]
    fn a_field_out_of_range_is_named() {
        let text = PRESETS[0].1.replace("soft_update = 0.005", "soft_update = 1.5");
        let error = TrainingConfig::parse(&text, Path::new("fast.toml")).expect_err("refused").to_string();
        let line = text.lines().position(|line| line.starts_with("soft_update")).unwrap() + 1;
        let expected = format!("fast.toml:{line}: learning.soft_update: must be between 0 and 1");
        assert!(error.starts_with(&expected), "{error}");
    }
}
