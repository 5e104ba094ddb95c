//! Validation of training configurations: the range of each number, and constraints between fields.

use super::config::{
    EnvironmentConfig, EvaluationConfig, LearningConfig, NetworkConfig, PENALTY_RANGE,
    TRAINING_VERSION, TrainingConfig,
};
use super::config_error::{TrainingConfigError, check_range};
use super::space_mixture;
use crumple_core::format_version::check_version;

const MAX_LAYERS: usize = 16;

/// Memory limit of a training with one seed, in bytes. Several seeds in parallel take a multiple.
const MAX_MEMORY_BYTES: u64 = 4 << 30;
/// Copies of all weights: networks, targets, moments, gradients, means, checkpoints, evaluated policy.
const NETWORK_COPIES: u64 = 34;
/// Copies of all layer outputs of a batch: activations, gradients and packed factors of both networks.
const BATCH_COPIES: u64 = 8;
/// Bytes of a validation scenario with its run; measured: 2200 to 2700.
const SCENARIO_BYTES: u64 = 2600;

/// Path, value and range of a number.
type NumberRange = (&'static str, fn(&TrainingConfig) -> f64, [f64; 2]);

macro_rules! ranges {
    ($($part:ident.$number:ident: $range:expr,)*) => {
        &[$((
            concat!(stringify!($part), ".", stringify!($number)),
            |config| config.$part.$number as f64,
            $range,
        ),)*]
    };
}

/// Numbers whose range depends on no other field.
const RANGES: &[NumberRange] = ranges! {
    environment.action_repeat: [1.0, 1500.0],
    environment.step_reward: [0.0, 1e6],
    environment.collision_reward: [-1e9, 0.0],
    environment.harm_reward: [-1e9, 0.0],
    environment.reward_scale: [1e-9, 1e3],
    environment.max_accel_mps2: [0.1, 30.0],
    network.final_layer_bound: [0.0, 1.0],
    learning.actor_rate: [0.0, 1.0],
    learning.critic_rate: [0.0, 1.0],
    learning.discount: [0.0, 0.999_999_9],
    learning.tau: [0.0, 1.0],
    learning.batch: [1.0, 65_536.0],
    learning.decisions_per_update: [1.0, 1e6],
    exploration.learning_starts_episode: [0.0, 1e7],
    exploration.random_hold_steps: [1.0, 1500.0],
    exploration.noise: [0.0, 10.0],
    exploration.noise_decay: [0.0, 1.0],
    replay.capacity: [1.0, 1e8],
    replay.collision_fraction: [0.0, 1.0],
    td3.actor_every: [1.0, 1e6],
    td3.target_noise: [0.0, 10.0],
    td3.target_noise_limit: [0.0, 10.0],
    evaluation.every_episodes: [1.0, 1e9],
    evaluation.screening_draws: [1.0, 1e6],
    evaluation.ranking_draws: [0.0, 1e6],
    evaluation.usefulness_draws: [0.0, 1e4],
    evaluation.master_gap_m: [0.0, 16.0],
    evaluation.weight_average_updates: [0.0, 1e9],
};

fn check_penalty(field: &str, weight: f32) -> Result<(), TrainingConfigError> {
    let weight = f64::from(weight);
    let [least, most] = PENALTY_RANGE;
    // Compare with the f32 rounding of the minimum, so that the minimum itself passes.
    if 0.0 < weight && weight < f64::from(least as f32) {
        let problem = format!("must be 0, for none, or between {least} and {most}");
        return Err(TrainingConfigError::field(field, problem));
    }
    check_range(field, weight, [0.0, most])
}

impl TrainingConfig {
    /// Checks the configuration.
    ///
    /// # Errors
    /// [`TrainingConfigError::Range`] and [`TrainingConfigError::Field`] name the first invalid field.
    pub fn check(&self) -> Result<(), TrainingConfigError> {
        self.check_header()?;
        RANGES
            .iter()
            .try_for_each(|(field, value, range)| check_range(field, value(self), *range))?;
        self.environment.check_terms()?;
        self.network.check_layers()?;
        if let Some(imitation) = &self.imitation {
            imitation.check()?;
        }
        self.learning.check_decay_and_penalties()?;
        self.evaluation.check_drives()?;
        self.check_decay_after_start()?;
        self.check_capacity()?;
        space_mixture::check_spaces(&self.spaces)?;
        self.check_memory()
    }

    fn check_header(&self) -> Result<(), TrainingConfigError> {
        check_version(self.version, TRAINING_VERSION).map_err(|unsupported| {
            TrainingConfigError::field("version", unsupported.to_string())
        })?;
        if self.name.trim().is_empty() {
            return Err(TrainingConfigError::field("name", "must not be empty"));
        }
        // An imitation needs no reinforcement learning.
        let least = if self.imitation.is_some() { 0.0 } else { 1.0 };
        check_range("episodes", self.episodes as f64, [least, 1e7])
    }

    fn check_decay_after_start(&self) -> Result<(), TrainingConfigError> {
        let random = self.exploration.learning_starts_episode;
        let decay = self.learning.lr_decay.as_ref();
        let Some(decay) = decay.filter(|decay| decay.until_episode <= random) else {
            return Ok(());
        };
        let problem = format!(
            "must be above exploration.learning_starts_episode, after which learning starts: above {random}, found {}",
            decay.until_episode
        );
        let field = "learning.lr_decay.until_episode";
        Err(TrainingConfigError::field(field, problem))
    }

    fn check_capacity(&self) -> Result<(), TrainingConfigError> {
        let capacity = self.replay.capacity;
        if capacity < self.learning.batch {
            let problem = format!("holds {capacity} transitions, less than learning.batch");
            return Err(TrainingConfigError::field("replay.capacity", problem));
        }
        Ok(())
    }

    /// Refuses a training that needs more than [`MAX_MEMORY_BYTES`], and names the field with the largest share.
    fn check_memory(&self) -> Result<(), TrainingConfigError> {
        let parts = self.memory_by_field();
        let bytes = parts
            .iter()
            .fold(0, |sum: u64, (_, bytes)| sum.saturating_add(*bytes));
        let largest = parts.iter().max_by_key(|(_, bytes)| *bytes);
        let Some((field, _)) = largest.filter(|_| bytes > MAX_MEMORY_BYTES) else {
            return Ok(());
        };
        let problem = format!(
            "training takes about {} MiB of memory, and at most {} MiB are allowed",
            bytes >> 20,
            MAX_MEMORY_BYTES >> 20
        );
        Err(TrainingConfigError::field(*field, problem))
    }

    /// Returns an upper bound of the bytes of each part of a training, with the field that determines it.
    fn memory_by_field(&self) -> [(&'static str, u64); 5] {
        let widths = self.layer_widths();
        let parameters: u64 = widths.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum();
        let outputs = self.learning.batch as u64 * widths.iter().sum::<u64>();
        let draws = self.evaluation.screening_draws
            + self.evaluation.ranking_draws
            + self.evaluation.usefulness_draws;
        [
            ("network.hidden", float_bytes(NETWORK_COPIES * parameters)),
            ("learning.batch", float_bytes(BATCH_COPIES * outputs)),
            ("replay.capacity", float_bytes(self.replay_numbers())),
            ("evaluation.ranking_draws", draws * SCENARIO_BYTES),
            ("imitation.rows", float_bytes(self.imitation_numbers())),
        ]
    }

    /// Returns the widths of the critic's layers, inputs and output included. The actor's are at most as large.
    fn layer_widths(&self) -> Vec<u64> {
        let inputs = self.environment.observation.width() + self.learning.privileged_width() + 1;
        let hidden = self.network.hidden.iter().copied();
        std::iter::once(inputs)
            .chain(hidden)
            .chain([1])
            .map(|width| width as u64)
            .collect()
    }

    /// Returns how many numbers the replay memory and its checkpoint hold.
    fn replay_numbers(&self) -> u64 {
        // Without episodes the memory stays empty.
        let capacity = if self.episodes > 0 {
            self.replay.capacity as u64
        } else {
            0
        };
        2 * (self.transition_layout().width() as u64 + 1) * capacity
    }

    /// Returns how many numbers the rows of all rounds of an imitation hold.
    fn imitation_numbers(&self) -> u64 {
        let Some(imitation) = &self.imitation else {
            return 0;
        };
        // Observation, action, weight, end of the episode, and place in the order of a pass.
        let row = self.environment.observation.width() as u64 + 5;
        imitation
            .rows
            .saturating_mul(u64::from(imitation.rounds))
            .saturating_mul(row)
    }
}

fn float_bytes(count: u64) -> u64 {
    count.saturating_mul(size_of::<f32>() as u64)
}

impl EnvironmentConfig {
    fn check_terms(&self) -> Result<(), TrainingConfigError> {
        let mut terms = self.costs.ranges().chain(self.observation.ranges());
        terms.try_for_each(|(field, value, range)| check_range(&field, value, range))?;
        self.observation.check()
    }
}

impl NetworkConfig {
    fn check_layers(&self) -> Result<(), TrainingConfigError> {
        let layers = self.hidden.len();
        if !(1..=MAX_LAYERS).contains(&layers) {
            let problem = format!("must have 1 to {MAX_LAYERS} layers, found {layers}");
            return Err(TrainingConfigError::field("network.hidden", problem));
        }
        self.hidden
            .iter()
            .enumerate()
            .try_for_each(|(layer, &width)| {
                check_range(
                    &format!("network.hidden[{layer}]"),
                    width as f64,
                    [1.0, 4096.0],
                )
            })
    }
}

impl EvaluationConfig {
    /// Recorded drives are evaluated where drives of everyday traffic are.
    fn check_drives(&self) -> Result<(), TrainingConfigError> {
        let (field, problem) = match (&self.drives, &self.drives_sha256) {
            (Some(_), _) if self.usefulness_draws == 0 => (
                "evaluation.drives",
                "needs evaluation.usefulness_draws of at least 1",
            ),
            (None, Some(_)) => ("evaluation.drives_sha256", "needs evaluation.drives"),
            _ => return Ok(()),
        };
        Err(TrainingConfigError::field(field, problem))
    }
}

impl LearningConfig {
    fn check_decay_and_penalties(&self) -> Result<(), TrainingConfigError> {
        if let Some(decay) = &self.lr_decay {
            let until = decay.until_episode as f64;
            check_range("learning.lr_decay.until_episode", until, [1.0, 1e7])?;
            let factor = decay.final_factor;
            check_range("learning.lr_decay.final_factor", factor, [0.0, 1.0])?;
        }
        check_penalty("learning.saturation_penalty", self.saturation_penalty)?;
        check_penalty("learning.smoothness_penalty", self.smoothness_penalty)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::config::PRESETS;

    #[test]
    fn trainings_that_do_not_fit_in_memory_are_refused() {
        for (name, _) in PRESETS {
            let preset = TrainingConfig::preset(name).unwrap();
            let bytes = preset.memory_by_field().map(|(_, bytes)| bytes);
            // The rows of an imitation take more than transitions.
            let share = if preset.imitation.is_some() { 2 } else { 16 };
            assert!(
                bytes.iter().sum::<u64>() < MAX_MEMORY_BYTES / share,
                "{name}: {bytes:?}"
            );
        }
        let mut large = TrainingConfig::preset("paper").unwrap();
        large.network.hidden = vec![1024; 4];
        large.check().unwrap();
        let refused = |field: &str, change: &dyn Fn(&mut TrainingConfig)| {
            let mut config = TrainingConfig::preset("paper").unwrap();
            change(&mut config);
            let error = config.check().unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("{field}: training takes about ")),
                "{error}"
            );
            assert!(
                error.ends_with(" MiB of memory, and at most 4096 MiB are allowed"),
                "{error}"
            );
        };
        refused("network.hidden", &|config| {
            config.network.hidden = vec![4096; 16]
        });
        refused("replay.capacity", &|config| {
            config.replay.capacity = 100_000_000
        });
        refused("evaluation.ranking_draws", &|config| {
            (
                config.evaluation.screening_draws,
                config.evaluation.ranking_draws,
            ) = (900_000, 1_000_000);
        });
        refused("learning.batch", &|config| {
            (
                config.network.hidden,
                config.learning.batch,
                config.replay.capacity,
            ) = (vec![2048; 8], 65_536, 65_536);
        });
    }
}
