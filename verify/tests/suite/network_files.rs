//! Files of imported networks: reading, rejection, and claims about them.

use crumple_verify::reach::{
    NetworkFileFormat, NetworkFileSource, NeuralController, PartitionCell, ReachClaim,
    controller_file_name,
};
use crumple_verify::{Assumption, ProvedClaim, Rejection, WorkLimit, check_with};
use serde_json::{Value, json};

use crate::reach::point_box;
use crate::support::networks::{any_network_with_file, encode_file};
use crate::support::{reach_certificate, sha256};

#[test]
fn written_files_are_read() {
    for seed in 0..500 {
        let (controller, file) = any_network_with_file(seed);
        assert_eq!(
            NeuralController::from_bytes(&file),
            Ok(controller),
            "{seed}"
        );
    }
}

fn with_text(file: &[u8], change: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
    let length = u64::from_le_bytes(*file.first_chunk().unwrap()) as usize;
    let mut header: serde_json::Value = serde_json::from_slice(&file[8..8 + length]).unwrap();
    let text = header["__metadata__"]["crumple_network"].as_str().unwrap();
    let mut text: serde_json::Value = serde_json::from_str(text).unwrap();
    change(&mut text);
    header["__metadata__"]["crumple_network"] = text.to_string().into();
    let header = header.to_string();
    [
        &(header.len() as u64).to_le_bytes(),
        header.as_bytes(),
        &file[8 + length..],
    ]
    .concat()
}

#[test]
fn meaningless_values_are_refused() {
    let (_, file) = any_network_with_file(1);
    assert!(NeuralController::from_bytes(&with_text(&file, |_| ())).is_ok());
    type NetworkTextMutation = fn(&mut Value);
    let changes: [(&str, NetworkTextMutation); 14] = [
        ("version 2 is not supported: this release reads 1", |text| {
            text["version"] = json!(2)
        }),
        ("unknown field `note`", |text| text["note"] = json!("")),
        ("missing field `empty_gap_m`", |text| {
            drop(text.as_object_mut().unwrap().remove("empty_gap_m"))
        }),
        ("unknown variant `matlab`", |text| {
            text["source"]["format"] = json!("matlab")
        }),
        ("is not a SHA-256", |text| {
            text["source"]["sha256"] = json!("abc")
        }),
        ("unknown variant `time_gap_ahead_s`", |text| {
            text["inputs"][0]["quantity"] = json!("time_gap_ahead_s")
        }),
        ("inputs[0]: contains numbers outside their ranges", |text| {
            text["inputs"][0]["scale"] = json!(0.0)
        }),
        ("inputs[0]: contains numbers outside their ranges", |text| {
            text["inputs"][0]["low"] = json!(1e7)
        }),
        ("inputs[0]: must be a quantity or a constant", |text| {
            text["inputs"][0] = json!({ "offset": 0.0, "scale": 1.0, "low": 0.0, "high": 1.0 });
        }),
        ("unknown variant `cosine`", |text| {
            text["steps"][0] = json!("cosine")
        }),
        ("has a wrong type or shape", |text| {
            text["steps"][0] = json!({ "linear": 4000 })
        }),
        ("there is no output 4000", |text| {
            text["output"]["answer"] = json!(4000)
        }),
        ("not finite and in order", |text| {
            text["output"]["low_mps2"] = json!(5.0)
        }),
        ("must be positive", |text| {
            text["decision_interval_s"] = json!(0.0)
        }),
    ];
    for (message, change) in changes {
        let error = NeuralController::from_bytes(&with_text(&file, change)).unwrap_err();
        assert!(error.contains(message), "{message}: {error}");
    }
    // One product less leaves its tensors unused.
    let fewer = with_text(&file, |text| {
        drop(text["steps"].as_array_mut().unwrap().remove(0))
    });
    assert!(NeuralController::from_bytes(&fewer).is_err());
}

/// Returns a claim without interaction: the leader is far away and does not brake.
fn claim(file: &[u8]) -> ReachClaim {
    ReachClaim {
        policy_file: controller_file_name(&sha256(file), true),
        policy_sha256: sha256(file),
        source: Some(NetworkFileSource {
            format: NetworkFileFormat::Onnx,
            sha256: "0".repeat(64),
        }),
        steps: 100,
        follower_ttc_s: None,
        ranges: point_box([100.0, 0.0, 20.0, 20.0, 0.0, 0.0, 0.0, 0.0]),
        partition: vec![PartitionCell::Verified],
        verified_share_at_least: 1.0,
        falsified_share_at_least: 0.0,
        min_gap_m_at_least: 50.0,
        ..crate::reach::claim()
    }
}

#[test]
fn a_statement_about_a_network_names_its_source_and_assumptions() {
    let (_, file) = any_network_with_file(3);
    let genuine = reach_certificate(claim(&file));
    let accepted = check_with(&genuine, Some(&file), WorkLimit::default());
    assert!(
        matches!(accepted, Ok(ProvedClaim::Reach { .. })),
        "{accepted:?}"
    );
    assert!(genuine.assumptions.contains(&Assumption::NetworkAsRead));
    assert!(
        genuine
            .scope()
            .to_string()
            .contains("read from a file in the format ONNX")
    );
    let mut silent = genuine.clone();
    silent
        .assumptions
        .retain(|assumption| *assumption != Assumption::NetworkAsRead);
    assert!(matches!(
        check_with(&silent, Some(&file), WorkLimit::default()),
        Err(Rejection::Assumptions { .. })
    ));
    let mut sources = [
        None,
        Some(NetworkFileSource {
            format: NetworkFileFormat::StableBaselines,
            sha256: "0".repeat(64),
        }),
    ]
    .to_vec();
    sources.push(Some(NetworkFileSource {
        format: NetworkFileFormat::Onnx,
        sha256: "1".repeat(64),
    }));
    for source in sources {
        let other = reach_certificate(ReachClaim {
            source,
            ..claim(&file)
        });
        let refused = check_with(&other, Some(&file), WorkLimit::default());
        assert!(
            matches!(refused, Err(Rejection::Policy { .. })),
            "{refused:?}"
        );
    }
    for offset in (0..file.len()).step_by(7) {
        let mut changed = file.clone();
        changed[offset] ^= 1;
        assert!(matches!(
            check_with(&genuine, Some(&changed), WorkLimit::default()),
            Err(Rejection::Policy { .. })
        ));
    }
}

fn constant_network(
    constants: usize,
    steps: Value,
    tensors: &[(String, Vec<usize>, &[f64])],
) -> Result<NeuralController, String> {
    let input = json!({ "constant": 1.0, "offset": 0.0, "scale": 1.0, "low": -1.0, "high": 1.0 });
    let text = with_inputs(vec![input; constants], steps);
    NeuralController::from_bytes(&encode_file(&text, tensors))
}

fn with_inputs(inputs: Vec<Value>, steps: Value) -> Value {
    json!({
        "version": 1, "source": { "format": "onnx", "sha256": "0".repeat(64) }, "inputs": inputs, "steps": steps,
        "output": { "answer": 0, "scale_mps2": 2.0, "offset_mps2": 1.0, "low_mps2": -1.0, "high_mps2": 3.0 },
        "empty_gap_m": 80.0, "decision_interval_s": 0.1,
    })
}

#[test]
fn limits_of_the_network_size_are_exact() {
    let too_large = Err("describes too large a network".to_owned());
    let relus = |count: usize| json!(vec!["relu"; count]);
    for (inputs, steps) in [(1, 0), (1, 256), (4096, 0), (4096, 1), (31, 256)] {
        assert!(
            constant_network(inputs, relus(steps), &[]).is_ok(),
            "{inputs} {steps}"
        );
    }
    for (inputs, steps) in [
        (0, 0),
        (4097, 0),
        (1, 257),
        (1, 258),
        (4096, 2),
        (32, 256),
        (33, 256),
    ] {
        assert_eq!(
            constant_network(inputs, relus(steps), &[]).map(|_| ()),
            too_large,
            "{inputs} {steps}"
        );
    }
    // The widest product, as inputs and as outputs.
    let zeros = vec![0.0; 4096];
    let product = |inputs: usize, outputs: usize| {
        let weight = (
            "steps.0.weight".to_owned(),
            vec![inputs, outputs],
            &zeros[..inputs * outputs],
        );
        constant_network(
            inputs,
            json!([{ "linear": outputs }]),
            &[
                weight,
                ("steps.0.bias".to_owned(), vec![outputs], &zeros[..outputs]),
            ],
        )
        .map(|_| ())
    };
    assert_eq!((product(4096, 1), product(1, 4096)), (Ok(()), Ok(())));
    for outputs in [0, 4097, usize::MAX] {
        let wide = constant_network(1, json!([{ "linear": outputs }]), &[]).map(|_| ());
        assert_eq!(
            wide,
            Err("crumple_network: steps[0]: is too wide".to_owned()),
            "{outputs}"
        );
    }
}

#[test]
fn numbers_of_functions_are_of_single_precision() {
    for name in ["leaky-relu", "elu"] {
        for number in [0.125, 0.0, f64::from(0.1_f32), f64::from(f32::MAX)] {
            // The value at 1 must stay in single precision as well.
            let read = constant_network(1, json!([{ (name): number }]), &[]).map(|_| ());
            let expected = if number > 1.0 {
                Err("can exceed single precision in layer 0".to_owned())
            } else {
                Ok(())
            };
            assert_eq!(read, expected, "{name} {number}");
        }
        for number in [0.1, 1e300, -1e39, 1e-46] {
            let read = constant_network(1, json!([{ (name): number }]), &[]).map(|_| ());
            let message =
                "crumple_network: steps[0]: is not a number in single precision".to_owned();
            assert_eq!(read, Err(message), "{name} {number}");
        }
    }
}

/// Only inputs about the follower may have a substitute: a leader is always present.
#[test]
fn substitutes_are_for_vehicles_that_may_be_absent() {
    let read = |described: Value| {
        let mut input = json!({ "offset": 0.5, "scale": 2.0, "low": -1.0, "high": 1.0 });
        input
            .as_object_mut()
            .unwrap()
            .extend(described.as_object().unwrap().clone());
        let controller =
            NeuralController::from_bytes(&encode_file(&with_inputs(vec![input], json!([])), &[]))?;
        Ok::<_, String>((
            controller.inputs[0].constant,
            controller.inputs[0].absent_value,
        ))
    };
    let refused = "crumple_network: inputs[0]: must be a quantity or a constant; `absent` is only for \
                   quantities of another vehicle";
    let refused = Err(refused.to_owned());
    for quantity in ["gap", "speed", "relative_speed", "acceleration"] {
        let unit = match quantity {
            "gap" => "m",
            "acceleration" => "mps2",
            _ => "mps",
        };
        let [ahead, behind] = ["ahead", "behind"].map(|side| format!("{quantity}_{side}_{unit}"));
        assert_eq!(read(json!({ "quantity": ahead })), Ok((0.0, None)));
        assert_eq!(
            read(json!({ "quantity": ahead, "absent": 7.0 })),
            Ok((0.0, None)),
            "never absent"
        );
        assert_eq!(read(json!({ "quantity": behind })), Ok((0.0, None)));
        assert_eq!(
            read(json!({ "quantity": behind, "absent": 7.0 })),
            Ok((0.0, Some(7.0)))
        );
    }
    for quantity in ["speed_mps", "acceleration_mps2"] {
        assert_eq!(read(json!({ "quantity": quantity })), Ok((0.0, None)));
        assert_eq!(
            read(json!({ "quantity": quantity, "absent": 7.0 })),
            refused,
            "{quantity}"
        );
    }
    for (quantity, absent) in [("is_ahead", None), ("is_behind", Some(0.0))] {
        assert_eq!(read(json!({ "quantity": quantity })), Ok((1.0, absent)));
        assert_eq!(
            read(json!({ "quantity": quantity, "absent": 0.0 })),
            refused,
            "{quantity}"
        );
    }
    assert_eq!(read(json!({ "constant": 1.25 })), Ok((1.25, None)));
    assert_eq!(read(json!({ "constant": 1.25, "absent": 0.0 })), refused);
    assert_eq!(
        read(json!({ "constant": 1.25, "quantity": "speed_mps" })),
        refused
    );
}

#[test]
fn an_input_has_a_scale_and_limits_in_order() {
    let read = |scale: f64, [low, high]: [f64; 2]| {
        let input = json!({ "quantity": "speed_mps", "offset": 0.5, "scale": scale, "low": low, "high": high });
        NeuralController::from_bytes(&encode_file(&with_inputs(vec![input], json!([])), &[]))
            .map(|controller| controller.inputs[0].low)
    };
    for (scale, limits) in [
        (2.0, [1.0, 1.0]),
        (-2.0, [-1.0, 1.0]),
        (f64::MIN_POSITIVE, [0.0, 0.0]),
    ] {
        assert_eq!(read(scale, limits), Ok(limits[0]), "{scale} {limits:?}");
    }
    for (scale, limits) in [
        (2.0, [1.0_f64.next_up(), 1.0]),
        (0.0, [-1.0, 1.0]),
        (-0.0, [-1.0, 1.0]),
    ] {
        let refused =
            Err("crumple_network: inputs[0]: contains numbers outside their ranges".to_owned());
        assert_eq!(read(scale, limits), refused, "{scale} {limits:?}");
    }
}

/// Checks an output in [-0.5, 0.25], scaled to 1 m/s² to either side of an offset.
#[test]
fn an_output_is_clipped_where_it_could_exceed_its_bounds() {
    let numbers = [-0.5, 0.25];
    let is_cut = |scale: f64, [low, high]: [f64; 2], steps: Value| {
        let input =
            json!({ "constant": 1.0, "offset": 0.0, "scale": 1.0, "low": -1.0, "high": 1.0 });
        let mut text = with_inputs(vec![input], steps);
        for (field, value) in [
            ("scale_mps2", scale),
            ("offset_mps2", 3.0),
            ("low_mps2", low),
            ("high_mps2", high),
        ] {
            text["output"][field] = json!(value);
        }
        let steps = text["steps"].as_array().unwrap().clone();
        let clips = (0..steps.len()).filter(|&index| steps[index] == "clip");
        let tensors: Vec<_> = clips
            .flat_map(|index| {
                let bound = |name: &str, at: usize| {
                    (format!("steps.{index}.{name}"), vec![1], &numbers[at..=at])
                };
                [bound("low", 0), bound("high", 1)]
            })
            .collect();
        NeuralController::from_bytes(&encode_file(&text, &tensors))
            .map(|controller| controller.is_clipped)
    };
    for scale in [2.0, -2.0] {
        assert_eq!(
            is_cut(scale, [2.0, 4.0], json!(["clip"])),
            Ok(false),
            "{scale}"
        );
        assert_eq!(
            is_cut(scale, [2.0, 4.0_f64.next_down()], json!(["clip"])),
            Ok(true),
            "{scale}"
        );
        assert_eq!(
            is_cut(scale, [2.0_f64.next_up(), 4.0], json!(["clip"])),
            Ok(true),
            "{scale}"
        );
        assert_eq!(
            is_cut(scale, [-9.0, 9.0], json!(["clip", "relu"])),
            Ok(true),
            "{scale}"
        );
    }
    for bounded in ["tanh", "sigmoid"] {
        assert_eq!(
            is_cut(1.0, [2.0, 4.0], json!([bounded])),
            Ok(false),
            "{bounded}"
        );
        assert_eq!(
            is_cut(1.0, [2.0, 4.0_f64.next_down()], json!([bounded])),
            Ok(true),
            "{bounded}"
        );
        assert_eq!(
            is_cut(1.0_f64.next_up(), [2.0, 4.0], json!([bounded])),
            Ok(true),
            "{bounded}"
        );
    }
    for bounds in [[4.0, 4.0], [4.0, 2.0]] {
        let message =
            "crumple_network: output: numbers that are not finite and in order".to_owned();
        assert_eq!(
            is_cut(1.0, bounds, json!(["clip"])),
            Err(message),
            "{bounds:?}"
        );
    }
}

#[test]
fn the_limit_of_the_header_size_is_exact() {
    let (controller, file) = any_network_with_file(5);
    let length = u64::from_le_bytes(*file.first_chunk().unwrap()) as usize;
    let padded = |to: usize| {
        let spaces = " ".repeat(to - length);
        let parts = [
            &(to as u64).to_le_bytes()[..],
            &file[8..8 + length],
            spaces.as_bytes(),
            &file[8 + length..],
        ];
        NeuralController::from_bytes(&parts.concat())
    };
    assert_eq!(padded(1 << 20), Ok(controller));
    for longer in [1, 2, 1 << 20] {
        assert_eq!(
            padded((1 << 20) + longer).map(|_| ()),
            Err("has a header that is too long".to_owned()),
            "{longer}"
        );
    }
}
