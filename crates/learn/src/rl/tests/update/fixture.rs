//! Configurations and random batches, also for the tests of the workspace member `oracle`.

use super::{Batch, TrainingConfig, Transition};
use crumple_sim::policy::STATE_LEN;
use crumple_sim::random::Stream;
use rand::{RngExt, SeedableRng};

/// Length of an observation with one earlier decision.
pub(super) const OBSERVATION_SIZE: usize = 2 * STATE_LEN;

pub(super) fn config(hidden: &[usize]) -> TrainingConfig {
    let mut config = TrainingConfig::preset("fast").unwrap();
    config.network.hidden = hidden.to_vec();
    // Large output weights keep every gradient well above rounding.
    config.network.final_layer_bound = 1.0;
    config.environment.observation.history = 2;
    config.learning.privileged_critic = true;
    config.learning.smoothness_penalty = 0.7;
    config
}

pub(super) fn batch(seed: u64, count: usize, privileged: usize) -> Batch {
    let mut stream = Stream::seed_from_u64(seed);
    let mut batch = Batch::default();
    for _ in 0..count {
        let mut numbers =
            |count| -> Vec<f32> { (0..count).map(|_| stream.random_range(-1.5..1.5)).collect() };
        let (state, next_state, privileged) = (
            numbers(OBSERVATION_SIZE),
            numbers(OBSERVATION_SIZE),
            numbers(2 * privileged),
        );
        batch.push(&Transition {
            state: &state,
            next_state: &next_state,
            privileged: &privileged,
            action: stream.random_range(-1.0..1.0),
            reward: stream.random_range(-2.0..1.0),
            continues: stream.random_bool(0.8),
            collision: false,
            expert_action: None,
        });
    }
    batch
}
