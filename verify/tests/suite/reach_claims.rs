//! Invalid reach statements are rejected with the name of the invalid field.

use crumple_verify::reach::{
    AccAebLaw, BoxDimension, FollowerLaw, IdmLaw, InitialRanges, NeuralController, PartitionCell,
    ReachClaim,
};
use crumple_verify::{Interval, Rejection};

use crate::law_follower::{ACC_AEB, ACC_AEB_LAW, IDM, IDM_LAW};
use crate::reach::paper_box;
use crate::support::networks::native_network;
use crate::support::policy_bytes;

fn claim() -> ReachClaim {
    ReachClaim {
        observation_error: [0.0; 8],
        ranges: InitialRanges {
            onset_steps: Interval::ZERO,
            ..paper_box(0.0, 0.0)
        },
        partition: vec![PartitionCell::Undecided],
        verified_share_at_least: 0.0,
        falsified_share_at_least: 0.0,
        min_gap_m_at_least: 0.0,
        ..crate::reach::claim()
    }
}

#[test]
fn meaningless_values_are_named() {
    let scene = claim()
        .problem(&native_network(&[], 0.0, 0))
        .map(|scene| (scene.steps, scene.decision_steps));
    assert_eq!(scene, Ok((300, 10)));
    assert!(
        ReachClaim {
            steps: 10,
            ..claim()
        }
        .problem(&native_network(&[], 0.0, 0))
        .is_ok(),
        "one decision"
    );
    assert!(
        ReachClaim {
            follower_ttc_s: Some(0.0),
            ..claim()
        }
        .problem(&native_network(&[], 0.0, 0))
        .is_ok(),
        "a brake for contact alone"
    );

    let followed = |law| ReachClaim {
        follower_ttc_s: None,
        follower_law: Some(Box::new(law)),
        ..claim()
    };
    assert!(
        followed(ACC_AEB)
            .problem(&native_network(&[], 0.0, 0))
            .is_ok()
    );
    let backwards = Interval::point(-1.0);
    let wrong: Vec<(&str, ReachClaim)> = [
        (
            "step_s",
            ReachClaim {
                step_s: 0.0,
                ..claim()
            },
        ),
        (
            "step_s",
            ReachClaim {
                step_s: -0.01,
                ..claim()
            },
        ),
        (
            "step_s",
            ReachClaim {
                step_s: f64::INFINITY,
                ..claim()
            },
        ),
        // Not a whole number of steps, and more than the time between decisions.
        (
            "step_s",
            ReachClaim {
                step_s: 0.03,
                ..claim()
            },
        ),
        (
            "step_s",
            ReachClaim {
                step_s: 0.3,
                ..claim()
            },
        ),
        (
            "steps",
            ReachClaim {
                steps: 0,
                ..claim()
            },
        ),
        (
            "steps",
            ReachClaim {
                steps: 9,
                ..claim()
            },
        ),
        (
            "steps",
            ReachClaim {
                steps: 305,
                ..claim()
            },
        ),
        (
            "steps",
            ReachClaim {
                steps: 100_010,
                ..claim()
            },
        ),
        (
            "ranges.ego_speed_mps",
            ReachClaim {
                ranges: InitialRanges {
                    ego_speed_mps: backwards,
                    ..claim().ranges
                },
                ..claim()
            },
        ),
        (
            "follower_ttc_s",
            ReachClaim {
                follower_ttc_s: Some(-0.1),
                ..claim()
            },
        ),
        (
            "follower_ttc_s",
            ReachClaim {
                follower_ttc_s: Some(f64::NAN),
                ..claim()
            },
        ),
        (
            "follower_law",
            ReachClaim {
                follower_law: Some(Box::new(IDM)),
                ..claim()
            },
        ),
        (
            "follower_law",
            followed(FollowerLaw::Idm(IdmLaw {
                accel_mps2: 0.0,
                ..IDM_LAW
            })),
        ),
        (
            "follower_law",
            followed(FollowerLaw::Idm(IdmLaw {
                time_headway_s: -0.1,
                ..IDM_LAW
            })),
        ),
        (
            "follower_law",
            followed(FollowerLaw::AccAeb(AccAebLaw {
                ttc_s: f64::INFINITY,
                ..ACC_AEB_LAW
            })),
        ),
    ]
    .into_iter()
    .chain([-1e-9, f64::INFINITY].map(|error| {
        let observation_error = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, error];
        (
            "observation_error",
            ReachClaim {
                observation_error,
                ..claim()
            },
        )
    }))
    .collect();
    for (name, wrong) in wrong {
        match wrong.problem(&native_network(&[], 0.0, 0)) {
            Err(Rejection::Invalid { field, .. }) => assert_eq!(field, name, "{wrong:?}"),
            other => panic!("{name}: {other:?}"),
        }
    }
}

/// A dead unit with near-maximal weights: zero in real numbers, infinity times zero in the engine.
#[test]
fn a_network_that_can_overflow_is_refused() {
    let mut bytes = policy_bytes("reference");
    assert!(NeuralController::from_bytes(&bytes).is_ok());
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let listing: serde_json::Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    for tensor in ["actor.0.weight", "actor.0.bias"] {
        let from = listing[tensor]["data_offsets"][0].as_u64().unwrap() as usize;
        bytes[8 + length + from..][..4].copy_from_slice(&3e38_f32.to_le_bytes());
    }
    assert_eq!(
        NeuralController::from_bytes(&bytes).unwrap_err(),
        "can exceed single precision in layer 0"
    );
}

#[test]
fn shares_are_volumes_and_not_counts_of_cuts() {
    let ulps = |n: u64| f64::from_bits(16.0_f64.to_bits() + n);
    let cut = PartitionCell::Cut(BoxDimension::GapAheadM);
    let shares = |gap_ahead_m: Interval, partition: Vec<PartitionCell>| -> Vec<f64> {
        let claim = ReachClaim {
            ranges: InitialRanges {
                gap_ahead_m,
                ..claim().ranges
            },
            partition,
            ..claim()
        };
        claim
            .leaves()
            .unwrap()
            .into_iter()
            .map(|(_, _, share)| share)
            .collect()
    };
    // Three numbers apart: the middle is one or two of them away from the lower end.
    let thirds = shares(
        Interval::new(16.0, ulps(3)).unwrap(),
        vec![cut, PartitionCell::Verified, PartitionCell::Undecided],
    );
    let mut sorted = thirds.clone();
    sorted.sort_by(f64::total_cmp);
    assert!(
        sorted[0] <= 1.0 / 3.0 && sorted[0] > 0.333 && sorted[1] <= 2.0 / 3.0 && sorted[1] > 0.666,
        "{thirds:?}"
    );
    let halves = shares(
        Interval::new(2.0, 18.0).unwrap(),
        vec![
            cut,
            cut,
            PartitionCell::Verified,
            PartitionCell::Undecided,
            PartitionCell::Verified,
        ],
    );
    assert_eq!(halves, [0.25, 0.25, 0.5], "equal halves are exact");
    let rounded = shares(
        Interval::new(15.3, 16.7).unwrap(),
        vec![cut, PartitionCell::Verified, PartitionCell::Undecided],
    );
    assert!(
        rounded.iter().all(|share| (share - 0.5).abs() < 1e-12)
            && rounded.iter().sum::<f64>() <= 1.0,
        "{rounded:?}"
    );
}

fn with_header(change: impl Fn(&mut String, &mut String)) -> Vec<u8> {
    let bytes = policy_bytes("reference");
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let listing = std::str::from_utf8(&bytes[8..8 + length])
        .unwrap()
        .trim_end()
        .to_owned();
    let value: serde_json::Value = serde_json::from_str(&listing).unwrap();
    let written = value["__metadata__"]["crumple_policy"]
        .as_str()
        .unwrap()
        .to_owned();
    let (mut description, mut header) = (written.clone(), listing);
    change(&mut description, &mut header);
    let quoted = |text: &str| serde_json::to_string(text).unwrap();
    let header = header.replacen(&quoted(&written), &quoted(&description), 1);
    [
        &(header.len() as u64).to_le_bytes(),
        header.as_bytes(),
        &bytes[8 + length..],
    ]
    .concat()
}

fn replace(text: &mut String, from: &str, to: &str) {
    assert!(text.contains(from), "{from} in {text}");
    *text = text.replacen(from, to, 1);
}

#[test]
fn controllers_that_the_simulator_rejects_are_refused() {
    assert!(NeuralController::from_bytes(&with_header(|_, _| ())).is_ok());
    type PolicyTextMutation = fn(&mut String, &mut String);
    let changes: [(&str, PolicyTextMutation); 14] = [
        (
            "version 2 is not supported: this release reads 1",
            |text, _| replace(text, "\"version\":1", "\"version\":2"),
        ),
        ("missing field `version`", |text, _| {
            replace(text, "\"version\":1,", "")
        }),
        ("unknown field `colour`", |text, _| {
            replace(text, "\"version\":1", "\"version\":1,\"colour\":3")
        }),
        ("duplicate field `limit`", |text, _| {
            replace(text, "\"limit\":", "\"limit\":1,\"limit\":")
        }),
        ("duplicate key", |text, _| {
            replace(text, "\"training\":{", "\"training\":{\"a\":1,\"a\":2,")
        }),
        ("estimator: \"lidar\" is not known", |text, _| {
            replace(text, "\"kalman\"", "\"lidar\"")
        }),
        ("finite and in order", |text, _| {
            replace(text, "\"low_mps2\":-7.5", "\"low_mps2\":7.5")
        }),
        ("only a network without history", |text, _| {
            replace(text, "\"limit\":", "\"history\":2,\"limit\":")
        }),
        ("residual policies were removed", |text, _| {
            let law = "\"low_mps2\":-7.5,\"departs_from\":{\"dead_zone\":0.3,\"rate_per_s\":200}";
            replace(text, "\"low_mps2\":-7.5", law);
        }),
        ("unknown field `note`", |_, header| {
            replace(
                header,
                "\"crumple_policy\"",
                "\"note\":\"\",\"crumple_policy\"",
            )
        }),
        ("duplicate key \"actor.0.bias\"", |_, header| {
            let doubled = "\"actor.0.bias\":{\"dtype\":\"F32\",\"shape\":[0],\"data_offsets\":[0,0]},\"actor.0.bias\"";
            replace(header, "\"actor.0.bias\"", doubled);
        }),
        ("tensor \"more\" is not part", |_, header| {
            let more = "\"more\":{\"dtype\":\"F32\",\"shape\":[0],\"data_offsets\":[0,0]},\"actor.0.bias\"";
            replace(header, "\"actor.0.bias\"", more);
        }),
        ("unknown field `sparse`", |_, header| {
            replace(header, "\"dtype\"", "\"sparse\":true,\"dtype\"")
        }),
        ("bytes outside all tensors", |_, header| {
            replace(header, "\"data_offsets\":[0,", "\"data_offsets\":[4,")
        }),
    ];
    for (message, change) in changes {
        let error = NeuralController::from_bytes(&with_header(change)).unwrap_err();
        assert!(error.contains(message), "{message}: {error}");
    }
    let longer = [with_header(|_, _| ()), vec![0; 4]].concat();
    assert!(
        NeuralController::from_bytes(&longer)
            .unwrap_err()
            .contains("bytes outside all tensors")
    );
}
