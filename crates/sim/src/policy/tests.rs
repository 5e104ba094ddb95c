//! Tests of policies: reading and rejecting files, and bit-identical evaluation of one state and many.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};

use super::*;
use crate::observation::{EstimatorKind, Neighbour};

pub(crate) fn policy(hidden: &[usize], decision_interval_s: f64, seed: u64) -> Policy {
    policy_with_history([1, 1], hidden, decision_interval_s, seed)
}

fn policy_with_history(
    [history, history_every]: [usize; 2],
    hidden: &[usize],
    decision_interval_s: f64,
    seed: u64,
) -> Policy {
    let mut stream = crate::random::Stream::seed_from_u64(seed);
    let header = PolicyHeader {
        version: POLICY_VERSION,
        crumple: "test".to_owned(),
        hidden: hidden.to_vec(),
        observation: ObservationScaling {
            history,
            history_every,
            ..ObservationScaling::default()
        },
        action: ActionBounds::default(),
        decision_interval_s,
        estimator: EstimatorKind::Kalman,
        seed,
        episode: 3,
        training: serde_json::json!({ "preset": "none", "rate": 0.1 }),
    };
    let mut network = Network::zeros(&file::layer_sizes(&header));
    for parameter in network.parameters_mut() {
        *parameter = stream.random_range(-0.3..0.3);
    }
    Policy::new(header, network).expect("valid")
}

fn any_observation() -> impl Strategy<Value = Observation> {
    let neighbour = || {
        proptest::option::of((-1.0..90.0, 0.0..40.0, -9.0..4.0)).prop_map(|numbers| {
            numbers.map(|(gap_m, speed_mps, acceleration_mps2)| Neighbour {
                gap_m,
                speed_mps,
                acceleration_mps2,
            })
        })
    };
    (0.0..40.0, -9.0..4.0, neighbour(), neighbour()).prop_map(
        |(speed_mps, acceleration_mps2, ahead, behind)| Observation {
            speed_mps,
            acceleration_mps2,
            ahead,
            behind,
        },
    )
}

fn first_acceleration_mps2(policy: &Policy, observation: &Observation) -> f64 {
    let mut action = HeldAction::default();
    action.set(policy.choose(
        policy.observe(observation, 0.0, &mut FrameStack::default()),
        &mut Workspace::default(),
    ));
    action.acceleration_mps2(&policy.header().action)
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(64))]

    #[test]
    fn a_batch_of_states_has_the_answers_of_single_states(
        observations in proptest::collection::vec(any_observation(), 1..40),
        history in [1..5_usize, 1..5_usize],
        seed: u64,
    ) {
        let policy = policy_with_history(history, &[33, 16], 0.1, seed);
        let mut space = Workspace::default();
        let mut past = FrameStack::default();
        let rows: Vec<_> = observations
            .iter()
            .map(|observation| policy.observe(observation, 0.0, &mut past).to_vec())
            .collect();
        let mut together = vec![0.0; observations.len()];
        policy.choose_batch(&rows.concat(), &mut space, &mut together);
        for ((observation, row), together) in observations.iter().zip(&rows).zip(together) {
            prop_assert_eq!(policy.choose(row, &mut space).to_bits(), together.to_bits());
            prop_assert!((-7.5..=3.0).contains(&first_acceleration_mps2(&policy, observation)));
        }
    }

    /// A truncated or changed file is rejected, or is a policy that works; reading never panics.
    #[test]
    fn damaged_files_never_panic(cut in 0..4000_usize, at in 0..4000_usize, flip in 1..=255_u8) {
        let bytes = policy(&[5, 3], 0.1, 1).to_bytes().unwrap();
        if cut < bytes.len() {
            prop_assert!(Policy::from_bytes(&bytes[..cut]).is_err());
        }
        let mut changed = bytes.clone();
        if let Some(byte) = changed.get_mut(at) {
            *byte ^= flip;
        }
        if let Ok(policy) = Policy::from_bytes(&changed) {
            let alone = Observation { speed_mps: 20.0, acceleration_mps2: 0.0, ahead: None, behind: None };
            prop_assert!(first_acceleration_mps2(&policy, &alone).is_finite());
        }
    }
}

#[test]
fn the_network_equals_its_definition() {
    let policy = policy(&[5, 3], 0.1, 7);
    let observation = Observation {
        speed_mps: 20.0,
        acceleration_mps2: -1.0,
        ahead: Some(Neighbour {
            gap_m: 12.0,
            speed_mps: 18.0,
            acceleration_mps2: -3.0,
        }),
        behind: None,
    };
    let mut h: Vec<f64> = [-0.25, 4.0, 0.44, 0.6, 0.6, -0.6, -0.2, 0.0].to_vec();
    let network = policy.network();
    for (index, layer) in network.layers().enumerate() {
        let (w, b) = (
            &network.parameters()[layer.weights()],
            &network.parameters()[layer.biases()],
        );
        h = (0..layer.outputs)
            .map(|j| {
                let sum: f64 = h
                    .iter()
                    .enumerate()
                    .map(|(i, h)| h * f64::from(w[i * layer.outputs + j]))
                    .sum::<f64>()
                    + f64::from(b[j]);
                if index < 2 { sum.max(0.0) } else { sum }
            })
            .collect();
    }
    let expected = -2.25 + 5.25 * h[0].tanh();
    assert!((first_acceleration_mps2(&policy, &observation) - expected).abs() < 1e-5);
}

#[test]
fn policy_files_read_back_and_equal_policies_have_equal_bytes() {
    let policy = policy(&[6, 4], 0.1, 2);
    let bytes = policy.to_bytes().unwrap();
    let again = Policy::from_bytes(&bytes).unwrap();
    assert_eq!(again, policy);
    assert_eq!(again.to_bytes().unwrap(), bytes);
    assert_eq!(policy.digest().len(), 64);
}

#[test]
fn refusals_name_the_reason() {
    let refused = |change: &dyn Fn(&mut Policy)| {
        let mut policy = policy(&[6, 4], 0.1, 2);
        change(&mut policy);
        Policy::from_bytes(&policy.to_bytes().unwrap())
            .expect_err("refused")
            .to_string()
    };
    let says = |message: String, words: &str| assert!(message.contains(words), "{message}");
    says(
        refused(&|p| p.header.version = 9),
        "version 9 is not supported",
    );
    says(
        refused(&|p| p.header.hidden = vec![6, 5]),
        "must have shape [6, 5], found [6, 4]",
    );
    says(
        refused(&|p| p.header.hidden = vec![6]),
        "is not part of the network",
    );
    says(
        refused(&|p| p.header.hidden = vec![6, 4, 4]),
        "actor.2.weight",
    );
    says(
        refused(&|p| p.header.hidden = vec![usize::MAX]),
        "1 to 4096 wide",
    );
    says(
        refused(&|p| p.header.decision_interval_s = 0.0),
        "decision_interval_s",
    );
    says(
        refused(&|p| p.header.action.low_mps2 = 5.0),
        "low_mps2 must be below",
    );
    says(
        refused(&|p| p.header.observation.scale[3] = 0.0),
        "observation: every scale",
    );
    says(
        refused(&|p| p.network.parameters_mut()[0] = f32::NAN),
        "not finite",
    );
    says(
        refused(&|p| (p.header.action.low_mps2, p.header.action.high_mps2) = (f64::MIN, f64::MAX)),
        "the bounds must be finite",
    );
    says(
        refused(&|p| p.header.observation.limit = 1e39),
        "layer 0 can overflow",
    );
    says(
        refused(&|p| p.network.parameters_mut()[8 * 6 + 6..].fill(-1e38)),
        "layer 1 can overflow",
    );
    says(
        Policy::from_bytes(b"not a policy")
            .expect_err("refused")
            .to_string(),
        "safetensors",
    );
    let mut residual = policy(&[6, 4], 0.1, 2);
    residual.header.action.low_mps2 = -7.25;
    // A field of the same length takes the place of the bound.
    let bytes = residual.to_bytes().unwrap();
    let at = bytes
        .windows(8)
        .position(|window| window == b"low_mps2")
        .unwrap();
    let bytes = [&bytes[..at], br#"departs_from\":0"#, &bytes[at + 16..]].concat();
    let removed = "action.departs_from: residual policies were removed in crumple 0.3.0";
    says(
        Policy::from_bytes(&bytes).expect_err("refused").to_string(),
        removed,
    );
    let missing = Policy::load(std::path::Path::new("no/such.safetensors")).expect_err("refused");
    says(missing.to_string(), "no/such.safetensors");
}

#[test]
fn a_nan_answer_means_full_braking() {
    let meant = |raw| {
        let mut action = HeldAction::default();
        action.set(ActionBounds::squash(raw));
        action.acceleration_mps2(&ActionBounds::default())
    };
    assert_eq!([f32::NAN, f32::INFINITY].map(meant), [-7.5, 3.0]);
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn accepted_policies_output_a_number(
        observation in any_observation(), seed: u64, exp in 0..39_i32, layer in 0..3_usize,
    ) {
        let Policy { header, mut network, .. } = policy(&[6, 4], 0.1, seed);
        let layer = network.layers().nth(layer).unwrap();
        let factor = 10.0_f32.powi(exp);
        network.parameters_mut()[layer.offset..layer.biases().end].iter_mut().for_each(|value| *value *= factor);
        match Policy::new(header, network) {
            Ok(valid) => {
                let mut state = vec![0.0; valid.header.observation.width()];
                valid.header.observation.write_state(&observation, 0.0, &mut state);
                let raw = valid.packed.forward(&state, 1, &mut Workspace::default())[0];
                prop_assert!(raw.is_finite());
            }
            Err(error) => prop_assert!(exp > 30 && error.to_string().contains("overflow"), "{}", error),
        }
    }
}
