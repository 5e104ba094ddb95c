//! Reach statements that make no sense are refused, each with the name of what is wrong.
#![allow(clippy::unwrap_used, clippy::panic)]

use crumple_verify::reach::{Actor, Cell, Layer, Ranges, Reach};
use crumple_verify::{Interval, Rejection};

fn actor() -> Actor {
    Actor {
        layers: vec![Layer { inputs: 8, outputs: 1, weights: vec![0.0; 8], biases: vec![0.0] }],
        offset: [0.0; 8],
        scale: [1.0; 8],
        limit: 1.5,
        empty_gap_m: 80.0,
        action_mps2: [-7.5, 3.0],
        decision_interval_s: 0.1,
    }
}

fn claim() -> Reach {
    let at = Interval::point;
    Reach {
        policy_file: "policy.safetensors".to_owned(),
        policy_sha256: String::new(),
        step_s: 0.01,
        steps: 300,
        follower_ttc_s: Some(1.4),
        observation_error: [0.0; 8],
        ranges: Ranges {
            gap_ahead_m: at(16.0),
            gap_behind_m: at(16.0),
            leader_speed_mps: at(25.0),
            ego_speed_mps: at(25.0),
            follower_speed_mps: at(25.0),
            leader_brake_mps2: at(3.0),
            follower_brake_mps2: at(6.0),
            onset_steps: at(0.0),
        },
        partition: vec![Cell::Undecided],
        verified_share_at_least: 0.0,
        falsified_share_at_least: 0.0,
        min_gap_m_at_least: 0.0,
    }
}

#[test]
fn what_makes_no_sense_is_named() {
    let scene = claim().scene(&actor()).map(|scene| (scene.steps, scene.decision_steps));
    assert_eq!(scene, Ok((300, 10)));
    assert!(Reach { steps: 10, ..claim() }.scene(&actor()).is_ok(), "one decision");
    assert!(Reach { follower_ttc_s: Some(0.0), ..claim() }.scene(&actor()).is_ok(), "a brake for contact alone");
    let backwards = Interval::point(-1.0);
    let wrong: Vec<(&str, Reach)> = [
        ("step_s", Reach { step_s: 0.0, ..claim() }),
        ("step_s", Reach { step_s: -0.01, ..claim() }),
        ("step_s", Reach { step_s: f64::INFINITY, ..claim() }),
        // Not a whole number of steps, and more than the time between decisions.
        ("step_s", Reach { step_s: 0.03, ..claim() }),
        ("step_s", Reach { step_s: 0.3, ..claim() }),
        ("steps", Reach { steps: 0, ..claim() }),
        ("steps", Reach { steps: 9, ..claim() }),
        ("steps", Reach { steps: 305, ..claim() }),
        ("steps", Reach { steps: 100_010, ..claim() }),
        ("ranges.EgoSpeedMps", Reach { ranges: Ranges { ego_speed_mps: backwards, ..claim().ranges }, ..claim() }),
        ("follower_ttc_s", Reach { follower_ttc_s: Some(-0.1), ..claim() }),
        ("follower_ttc_s", Reach { follower_ttc_s: Some(f64::NAN), ..claim() }),
    ]
    .into_iter()
    .chain([-1e-9, f64::INFINITY].map(|error| {
        let observation_error = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, error];
        ("observation_error", Reach { observation_error, ..claim() })
    }))
    .collect();
    for (name, wrong) in wrong {
        match wrong.scene(&actor()) {
            Err(Rejection::Invalid { field, .. }) => assert_eq!(field, name, "{wrong:?}"),
            other => panic!("{name}: {other:?}"),
        }
    }
}

/// A dead unit with weights near the end of single precision: nothing in real numbers, infinity times nothing in the engine.
#[test]
fn a_network_that_can_overflow_is_refused() {
    let mut bytes =
        std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../corpora/policy/reference.safetensors")).unwrap();
    assert!(Actor::from_bytes(&bytes).is_ok());
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let listing: serde_json::Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    for tensor in ["actor.0.weight", "actor.0.bias"] {
        let from = listing[tensor]["data_offsets"][0].as_u64().unwrap() as usize;
        bytes[8 + length + from..][..4].copy_from_slice(&3e38_f32.to_le_bytes());
    }
    assert_eq!(Actor::from_bytes(&bytes).unwrap_err(), "can leave single precision in layer 0");
}
