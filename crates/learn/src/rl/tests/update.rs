//! The update compared with other formulations, and on a problem with a known optimum.

use rand::{RngExt, SeedableRng};

use crate::rl::config::PRIVILEGED_WIDTH;
use crate::rl::*;
use crumple_sim::policy::STATE_LEN;
use crumple_sim::random::{Purpose, Stream, stream};

mod fixture;

use fixture::{OBSERVATION_SIZE, batch, config};

/// Returns the output of a network in double precision, from the definition.
fn forward(sizes: &[usize], parameters: &[f64], input: &[f64]) -> f64 {
    let (mut value, mut rest) = (input.to_vec(), parameters);
    for (index, pair) in sizes.windows(2).enumerate() {
        let (weights, after) = rest.split_at(pair[0] * pair[1]);
        let (biases, after) = after.split_at(pair[1]);
        rest = after;
        value = (0..pair[1])
            .map(|j| {
                let sum = biases[j]
                    + (0..pair[0])
                        .map(|i| value[i] * weights[i * pair[1] + j])
                        .sum::<f64>();
                if index + 2 < sizes.len() {
                    sum.max(0.0)
                } else {
                    sum
                }
            })
            .collect();
    }
    value[0]
}

fn to_f64(values: &[f32]) -> Vec<f64> {
    values.iter().copied().map(f64::from).collect()
}

fn rows(values: &[f32]) -> impl Iterator<Item = Vec<f64>> {
    values.chunks_exact(OBSERVATION_SIZE).map(to_f64)
}

fn central_differences(parameters: &[f64], loss: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    (0..parameters.len())
        .map(|index| {
            let at = |shift: f64| {
                let mut shifted = parameters.to_vec();
                shifted[index] += shift;
                loss(&shifted)
            };
            (at(1e-6) - at(-1e-6)) / 2e-6
        })
        .collect()
}

fn assert_close(actual: &[f32], expected: &[f64], tolerance: f64) {
    let largest = expected
        .iter()
        .fold(0.0_f64, |largest, value| largest.max(value.abs()));
    assert!(largest > 1e-4, "nothing to compare");
    for (index, (&actual, &expected)) in actual.iter().zip(expected).enumerate() {
        let error = (f64::from(actual) - expected).abs();
        assert!(error <= tolerance * largest, "{index}: {actual} {expected}");
    }
}

#[test]
fn gradients_agree_with_finite_differences_in_double_precision() {
    let config = config(&[12, 7]);
    let mut learner = Learner::new(&config, 3);
    // Two updates separate networks and targets.
    for seed in 0..2 {
        learner.update(
            &batch(seed, 16, PRIVILEGED_WIDTH),
            &mut stream(0, Purpose::TargetNoise, 0),
        );
    }
    let batch = batch(9, 24, PRIVILEGED_WIDTH);
    let (critics_found, actor_found) =
        learner.gradients(&batch, &mut stream(0, Purpose::TargetNoise, 0));
    let critic = &learner.critics[0];
    let (actor_sizes, critic_sizes) = (learner.actor.network.sizes(), critic.network.sizes());
    let [actor, actor_target] =
        [&learner.actor.network, &learner.actor.target].map(|n| to_f64(n.parameters()));
    let [critic, critic_target] = [&critic.network, &critic.target].map(|n| to_f64(n.parameters()));
    let (discount, penalty) = (
        config.learning.discount,
        f64::from(config.learning.saturation_penalty),
    );
    let smoothness = f64::from(config.learning.smoothness_penalty);
    let value = |parameters: &[f64], state: &[f64], besides: &[f32], action: f64| {
        forward(
            critic_sizes,
            parameters,
            &[state, &to_f64(besides), &[action]].concat(),
        )
    };
    let [besides, next_besides] =
        [&batch.privileged, &batch.next_privileged].map(|all| all.chunks_exact(PRIVILEGED_WIDTH));
    let td_targets: Vec<f64> = rows(&batch.next_states)
        .zip(next_besides)
        .zip(batch.rewards.iter().zip(&batch.continues))
        .map(|((next, besides), (&reward, &continues))| {
            let action = forward(actor_sizes, &actor_target, &next).tanh();
            f64::from(reward)
                + discount * f64::from(continues) * value(&critic_target, &next, besides, action)
        })
        .collect();
    let n = batch.len() as f64;
    let critic_loss = |parameters: &[f64]| {
        let errors = rows(&batch.states)
            .zip(besides.clone())
            .zip(batch.actions.iter().zip(&td_targets))
            .map(|((state, besides), (&action, goal))| {
                (value(parameters, &state, besides, f64::from(action)) - goal).powi(2)
            });
        errors.sum::<f64>() / n
    };
    let actor_loss = |parameters: &[f64]| {
        let states = rows(&batch.states).zip(rows(&batch.next_states).zip(&batch.continues));
        let each = states
            .zip(besides.clone())
            .map(|((state, (next, &continues)), besides)| {
                let [raw, next_raw] =
                    [&state, &next].map(|seen| forward(actor_sizes, parameters, seen));
                let change = f64::from(continues) * (raw.tanh() - next_raw.tanh()).powi(2);
                let penalties = penalty * (raw.abs() - 1.0).max(0.0).powi(2) + smoothness * change;
                penalties - value(&critic, &state, besides, raw.tanh())
            });
        each.sum::<f64>() / n
    };
    assert_close(
        &critics_found[0],
        &central_differences(&critic, critic_loss),
        2e-4,
    );
    assert_close(&actor_found, &central_differences(&actor, actor_loss), 2e-4);
}

/// Two states, distinguished by the sign of the first number; each action leads to the other state. In state ±1 the
/// reward is 1 - (a ∓ ½)². The optimum is a = ±½ with value 1 / (1 - γ) everywhere.
#[test]
fn the_optimum_of_a_two_state_problem_is_found() {
    for td3 in [false, true] {
        let mut config = config(&[32, 32]);
        config.network.final_layer_bound = 3e-3;
        config.environment.observation.history = 1;
        (
            config.learning.privileged_critic,
            config.learning.smoothness_penalty,
        ) = (false, 0.0);
        (config.learning.discount, config.learning.tau) = (0.8, 0.02);
        (config.learning.actor_rate, config.learning.critic_rate) = (1e-3, 3e-3);
        if td3 {
            config.td3 = Td3Config {
                twin_critic: true,
                actor_every: 2,
                target_noise: 0.05,
                target_noise_limit: 0.1,
            };
        }
        let mut learner = Learner::new(&config, 4);
        let mut test_cases = Stream::seed_from_u64(5);
        let mut noise = stream(4, Purpose::TargetNoise, 0);
        let state = |sign: f32| -> [f32; STATE_LEN] {
            std::array::from_fn(|i| if i == 0 { sign } else { 0.0 })
        };
        let mut batch = Batch::default();
        for _ in 0..3000 {
            batch = Batch::default();
            for _ in 0..32 {
                let sign = if test_cases.random::<bool>() {
                    1.0_f32
                } else {
                    -1.0
                };
                let action: f32 = test_cases.random_range(-1.0..1.0);
                let reward = 1.0 - (action - 0.5 * sign).powi(2);
                batch.push(&Transition {
                    state: &state(sign),
                    next_state: &state(-sign),
                    privileged: &[],
                    action,
                    reward,
                    continues: true,
                    collision: false,
                    expert_action: None,
                });
            }
            learner.update(&batch, &mut noise);
        }
        let actions = learner.act(&[state(1.0), state(-1.0)].concat()).to_vec();
        assert!(
            (actions[0] - 0.5).abs() < 0.05 && (actions[1] + 0.5).abs() < 0.05,
            "td3 {td3}: {actions:?}"
        );
        let value = learner.update(&batch, &mut noise).mean_value;
        // Random actions have a mean reward of 1 - E(a - ½)² = 1 - (1/3 + 1/4); later actions are optimal.
        let expected = 1.0 - (1.0 / 3.0 + 0.25) + 0.8 / 0.2;
        assert!(
            (value - expected).abs() < 0.4,
            "td3 {td3}: {value} {expected}"
        );
    }
}

/// Updates of wide networks use several threads.
#[test]
fn an_update_is_the_same_on_any_number_of_threads() {
    let (config, batch) = (config(&[192, 224]), batch(1, 400, PRIVILEGED_WIDTH));
    let networks = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let (mut learner, mut noise) =
            (Learner::new(&config, 2), stream(2, Purpose::TargetNoise, 0));
        pool.install(|| (0..5).for_each(|_| _ = learner.update(&batch, &mut noise)));
        learner.networks().cloned().collect::<Vec<_>>()
    };
    let alone = networks(1);
    assert!(alone == networks(2));
    assert!(alone == networks(3));
}
