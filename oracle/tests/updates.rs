//! Compares the updates of the learner with those of the oracle.
#![allow(clippy::unwrap_used, reason = "everything here is a test")]

use crumple_learn::rl::{Batch, Learner, Td3Config, TrainingConfig, Transition};
use crumple_oracle::ReferenceLearner;
use crumple_sim::policy::Network;
use crumple_sim::random::{Purpose, stream};
use proptest::prelude::*;

#[path = "../../crates/learn/src/rl/tests/update/fixture.rs"]
mod fixture;

use fixture::{OBSERVATION_SIZE, batch, config};

proptest! {
    #![proptest_config(crumple_cases::with_cases(12))]

    /// Compares gradients and, over several updates, parameters, targets and losses: DDPG, and TD3 with any of its
    /// options.
    #[test]
    fn updates_agree_with_candle(
        seed: u64,
        hidden in proptest::collection::vec(1..70_usize, 1..4),
        count in 1..70_usize,
        twin_critic: bool,
        actor_every in 1..4_u32,
        target_noise in prop_oneof![Just(0.0_f32), 0.05..0.5_f32],
    ) {
        let mut config = config(&hidden);
        config.td3 = Td3Config { twin_critic, actor_every, target_noise, target_noise_limit: 0.3 };
        let mut learner = Learner::new(&config, seed);
        let mut oracle = ReferenceLearner::new(&learner, &config.learning, &config.td3).unwrap();
        let noises = || [0; 2].map(|_| stream(seed, Purpose::TargetNoise, 0));
        let close = |found: &[f32], expected: &[f32], tolerance: f32| {
            let largest = expected.iter().fold(1e-3_f32, |largest, value| largest.max(value.abs()));
            found.len() == expected.len()
                && found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= tolerance * largest)
        };
        // A critic's inputs are the observation, privileged numbers and the action.
        let privileged = learner.critics[0].network.sizes()[0] - OBSERVATION_SIZE - 1;
        let first = batch(seed, count, privileged);
        let [mut noise, mut oracle_noise] = noises();
        let (critics, actor) = learner.gradients(&first, &mut noise);
        let (oracle_critics, oracle_actor) = oracle.gradients(&first, &mut oracle_noise).unwrap();
        prop_assert_eq!((critics.len(), oracle_critics.len()), (1 + usize::from(twin_critic), critics.len()));
        prop_assert!(critics.iter().zip(&oracle_critics).all(|(found, expected)| close(found, expected, 1e-4)));
        prop_assert!(close(&actor, &oracle_actor, 1e-4));
        let [mut noise, mut oracle_noise] = noises();
        for index in 0..6 {
            let batch = batch(seed ^ index, count, privileged);
            let losses = learner.update(&batch, &mut noise);
            let expected = oracle.update(&batch, &mut oracle_noise).unwrap();
            prop_assert!((losses.critic_loss - expected.critic_loss).abs() <= 2e-2 * expected.critic_loss.max(0.01));
        }
        let expected = oracle.parameters().unwrap();
        let parts = std::iter::once(&learner.actor).chain(&learner.critics);
        let networks: Vec<&Network> = parts.flat_map(|part| [&part.network, &part.target]).collect();
        prop_assert_eq!(networks.len(), expected.len());
        for (found, expected) in networks.into_iter().map(Network::parameters).zip(expected) {
            // Adam divides by the gradient's size, so a gradient near 0 may step either way by the rate.
            let apart = found.iter().zip(&expected).filter(|(a, b)| (*a - *b).abs() > 1e-4).count();
            prop_assert!(apart * 20 <= expected.len().max(20), "{} of {}", apart, expected.len());
        }
    }
}
