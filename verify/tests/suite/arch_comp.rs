//! The adaptive cruise control benchmark of ARCH-COMP, category AINNCS; see [`crumple_verify::cruise`].
//!
//! The benchmark's network is not ours to distribute. A network of five hidden layers of twenty ReLUs is fitted here
//! instead, by least squares on its last layer, to a = 0.05 (D_rel - 30 - 1.4 v_ego) + 0.7 v_rel between -3 and 1.

use crumple_verify::cruise::{CruiseBoundsError, compute_bounds};
use crumple_verify::reach::controller::interleave_relu;
use crumple_verify::reach::{
    Activation, ControllerInput, LinearLayer, NetworkFileFormat, NetworkFileSource, NetworkLayer, NeuralController,
};

use crumple_verify::{
    Certificate, CertificateProvenance, CruiseClaim, ProvedClaim, Rejection, Statement, WorkLimit, check_with,
};
use serde_json::{Value, json};

use crate::support::closed_loop::{XorShiftRng, network_outputs};
use crate::support::networks::{any_layers, encode_file};
use crate::support::sha256;

const DRAG: f64 = 1e-4;

fn target_acceleration(v_ego: f64, d_rel: f64, v_rel: f64) -> f64 {
    (0.05 * (d_rel - 30.0 - 1.4 * v_ego) + 0.7 * v_rel).clamp(-3.0, 1.0)
}

fn random(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

fn observation(v_ego: f64, d_rel: f64, v_rel: f64) -> Vec<f64> {
    vec![30.0, 1.4, v_ego, d_rel, v_rel]
}

fn fit_network() -> Vec<NetworkLayer> {
    let mut state = 7;
    let scales = [30.0, 1.4, 30.0, 60.0, 10.0];
    let mut layers: Vec<LinearLayer> = (0..5)
        .map(|index| {
            let inputs = if index == 0 { 5 } else { 20 };
            let weight = |i: usize, state: &mut u64| {
                let scale = if index == 0 { scales[i % 5] * 1.3 } else { 2.0 };
                f64::from((random(state) / scale) as f32)
            };
            let weights = (0..inputs * 20).map(|k| weight(k / 20, &mut state)).collect();
            LinearLayer {
                inputs,
                outputs: 20,
                weights,
                biases: (0..20).map(|_| f64::from((0.3 * random(&mut state)) as f32)).collect(),
            }
        })
        .collect();
    let hidden: Vec<NetworkLayer> =
        interleave_relu(layers.clone()).chain([NetworkLayer::Activation(Activation::Relu)]).collect();
    // Normal equations with a little damping, by Gauss and Jordan.
    let mut rows = vec![[0.0; 22]; 21];
    for _ in 0..4000 {
        let (v_ego, d_rel, v_rel) =
            (25.0 + 8.0 * random(&mut state), 65.0 + 45.0 * random(&mut state), -4.0 + 8.0 * random(&mut state));
        let h = [network_outputs(&hidden, observation(v_ego, d_rel, v_rel)), vec![1.0]].concat();
        let target = target_acceleration(v_ego, d_rel, v_rel);
        for (row, own) in rows.iter_mut().zip(&h) {
            row.iter_mut().zip(&h).for_each(|(to, other)| *to += own * other);
            row[21] += own * target;
        }
    }
    rows.iter_mut().enumerate().for_each(|(i, row)| row[i] += 1e-3);
    for i in 0..21 {
        let pivot = rows[i];
        for (j, row) in rows.iter_mut().enumerate() {
            let factor = if j == i { 1.0 - 1.0 / pivot[i] } else { row[i] / pivot[i] };
            row.iter_mut().zip(pivot).for_each(|(to, from)| *to -= factor * from);
        }
    }
    let solved: Vec<f64> = rows.iter().map(|row| f64::from(row[21] as f32)).collect();
    layers.push(LinearLayer { inputs: 20, outputs: 1, weights: solved[..20].to_vec(), biases: vec![solved[20]] });
    interleave_relu(layers).collect()
}

fn controller(steps: Vec<NetworkLayer>) -> NeuralController {
    let input = |of, constant| ControllerInput {
        coefficients: of,
        constant,
        absent_value: None,
        offset: 0.0,
        scale: 1.0,
        low: -1e6,
        high: 1e6,
    };
    NeuralController {
        inputs: vec![
            input([0.0; 8], 30.0),
            input([0.0; 8], 1.4),
            input([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 0.0),
            input([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.0),
            input([0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0], 0.0),
        ],
        layers: steps,
        output_index: 0,
        scale_mps2: 1.0,
        offset_mps2: 0.0,
        action_bounds_mps2: [-1e6, 1e6],
        is_clipped: true,
        residual_over: None,
        empty_gap_m: 80.0,
        decision_interval_s: 0.1,
        source: Some(NetworkFileSource { format: NetworkFileFormat::Onnx, sha256: "0".repeat(64) }),
    }
}

fn simulate(steps: &[NetworkLayer], [x_lead, v_lead, x_ego, v_ego]: [f64; 4]) -> (f64, f64) {
    let (mut lead, mut ego) = ([x_lead, v_lead, 0.0], [x_ego, v_ego, 0.0]);
    let margin = |lead: [f64; 3], ego: [f64; 3]| lead[0] - ego[0] - 10.0 - 1.4 * ego[1];
    let (mut least, mut a) = (margin(lead, ego), 0.0);
    for step in 0..5000 {
        if step % 100 == 0 {
            a = network_outputs(steps, observation(ego[1], lead[0] - ego[0], lead[1] - ego[1]))[0];
        }
        for (car, a) in [(&mut lead, -2.0), (&mut ego, a)] {
            let rate = |[_, v, gamma]: [f64; 3]| [v, gamma, -2.0 * gamma + 2.0 * a - DRAG * v * v];
            let half = rate(*car);
            let middle: [f64; 3] = std::array::from_fn(|i| car[i] + 5e-4 * half[i]);
            let rate = rate(middle);
            *car = std::array::from_fn(|i| car[i] + 1e-3 * rate[i]);
        }
        least = least.min(margin(lead, ego));
    }
    (least, ego[0])
}

fn initial_states(numbers: &mut XorShiftRng) -> Vec<[f64; 4]> {
    let ends = [[90.0, 110.0], [32.0, 32.2], [10.0, 11.0], [30.0, 30.2]];
    let corners = (0..16_usize).map(|corner| std::array::from_fn(|i| ends[i][corner >> i & 1]));
    let inside = (0..4).map(|_| ends.map(|[low, high]| low + (high - low) * numbers.next_unit()));
    corners.chain(inside.collect::<Vec<_>>()).collect()
}

#[test]
fn the_whole_box_is_safe() {
    let steps = fit_network();
    let begin = std::time::Instant::now();
    let found = compute_bounds(&controller(steps.clone()), 16).unwrap();
    let took = begin.elapsed();
    let driven = initial_states(&mut XorShiftRng(3)).into_iter().map(|start| simulate(&steps, start).0);
    let least = driven.fold(f64::INFINITY, f64::min);
    println!("margin at least {:.2} m, {least:.2} m found, in {took:?}", found.margin_m);
    assert!(found.margin_m > 0.0 && found.margin_m <= least && least - found.margin_m < 4.0, "{found:?} {least}");
}

#[test]
fn bounds_hold_for_any_network() {
    let mut bounded = 0;
    for seed in 0..60 {
        let steps = any_layers(5, seed);
        let Ok(found) = compute_bounds(&controller(steps.clone()), 3) else { continue };
        bounded += 1;
        for start in initial_states(&mut XorShiftRng(seed | 1)) {
            let (margin_m, x_ego_m) = simulate(&steps, start);
            assert!(margin_m >= found.margin_m - 1e-5, "{seed}: {start:?} {margin_m} {found:?}");
            let [low, high] = found.x_ego_m;
            assert!(low - 1e-5 <= x_ego_m && x_ego_m <= high + 1e-5, "{seed}: {start:?} {x_ego_m} {found:?}");
        }
    }
    assert!(bounded > 20, "{bounded}");
}

#[test]
fn other_problems_are_refused() {
    let steps = fit_network();
    let changed = |change: fn(&mut NeuralController)| {
        let mut controller = controller(steps.clone());
        change(&mut controller);
        compute_bounds(&controller, 1)
    };
    for change in [
        (|controller| controller.inputs[0].constant = 31.0) as fn(&mut NeuralController),
        |controller| controller.inputs[3].high = 95.0,
        |controller| controller.inputs.swap(2, 3),
        |controller| controller.scale_mps2 = 0.5,
        |controller| controller.action_bounds_mps2 = [-3.0, 2.0],
        |controller| controller.decision_interval_s = 0.05,
    ] {
        assert_eq!(changed(change), Err(CruiseBoundsError::ProblemMismatch));
    }
    assert!(changed(|_| ()).is_ok());
}

fn braking_network_file() -> Vec<u8> {
    let input = |of: &str, what: Value| json!({ (of): what, "offset": 0.0, "scale": 1.0, "low": -1e6, "high": 1e6 });
    let text = json!({
        "version": 1, "source": { "format": "onnx", "sha256": "0".repeat(64) },
        "inputs": [
            input("constant", json!(30.0)), input("constant", json!(1.4)), input("quantity", json!("speed_mps")),
            input("quantity", json!("gap_ahead_m")), input("quantity", json!("relative_speed_ahead_mps")),
        ],
        "steps": [{ "linear": 1 }],
        "output": { "answer": 0, "scale_mps2": 1.0, "offset_mps2": 0.0, "low_mps2": -1e6, "high_mps2": 1e6 },
        "empty_gap_m": 80.0, "decision_interval_s": 0.1,
    });
    let weight = ("steps.0.weight".to_owned(), vec![5, 1], &[0.0; 5][..]);
    encode_file(&text, &[weight, ("steps.0.bias".to_owned(), vec![1], &[-3.0])])
}

fn certificate_for(file: &[u8], change: impl FnOnce(&mut CruiseClaim)) -> Certificate {
    let digest = sha256(file);
    let found = compute_bounds(&NeuralController::from_bytes(file).unwrap(), 3).unwrap();
    let mut claim = CruiseClaim {
        policy_file: format!("network-{}.safetensors", &digest[..12]),
        policy_sha256: digest,
        source: NetworkFileSource { format: NetworkFileFormat::Onnx, sha256: "0".repeat(64) },
        cells: 3,
        margin_m_at_least: found.margin_m,
        x_ego_width_m_at_most: found.x_ego_width_m(),
    };
    change(&mut claim);
    let statement = Statement::AdaptiveCruise(claim);
    Certificate {
        version: 2,
        provenance: CertificateProvenance::default(),
        assumptions: statement.assumptions(),
        statement,
    }
}

#[test]
fn a_certificate_states_only_proved_bounds() {
    let file = braking_network_file();
    let found = compute_bounds(&NeuralController::from_bytes(&file).unwrap(), 3).unwrap();
    let (margin_m, x_ego_width_m) = (found.margin_m, found.x_ego_width_m());
    let accepted = Ok(ProvedClaim::Cruise { margin_m, x_ego_width_m });
    let checked =
        |change: fn(&mut CruiseClaim)| check_with(&certificate_for(&file, change), Some(&file), WorkLimit::default());
    assert_eq!(checked(|_| ()), accepted);
    assert_eq!(checked(|claim| claim.margin_m_at_least = f64::NEG_INFINITY), accepted);
    assert_eq!(checked(|claim| claim.x_ego_width_m_at_most = 1e9), accepted);
    type CruiseClaimMutation = fn(&mut CruiseClaim);
    let more: [(CruiseClaimMutation, &str); 7] = [
        (
            |claim| claim.margin_m_at_least = claim.margin_m_at_least.next_up(),
            "`margin_m_at_least` exceeds the proved value",
        ),
        (|claim| claim.margin_m_at_least = f64::NAN, "`margin_m_at_least` exceeds the proved value"),
        (
            |claim| claim.x_ego_width_m_at_most = claim.x_ego_width_m_at_most.next_down(),
            "`x_ego_width_m_at_most` is below the proved value",
        ),
        (|claim| claim.x_ego_width_m_at_most = f64::NAN, "`x_ego_width_m_at_most` is below the proved value"),
        (|claim| claim.cells = 0, "`cells` must be 1 to 10 000"),
        (|claim| claim.cells = 10_001, "`cells` must be 1 to 10 000"),
        (|claim| claim.source.sha256 = "1".repeat(64), "the policy file was read from another file than `source`"),
    ];
    for (change, message) in more {
        assert_eq!(checked(change).unwrap_err().to_string(), message);
    }
    // The maximum number of cells exceeds this limit but is valid.
    let limit = WorkLimit::from_operations(1_000_000);
    let most = certificate_for(&file, |claim| claim.cells = 10_000);
    assert_eq!(check_with(&most, Some(&file), limit), Err(Rejection::BudgetExceeded { limit }));
}

#[test]
fn the_program_takes_network_and_limit_as_arguments() {
    let (file, folder) =
        (braking_network_file(), std::env::temp_dir().join(format!("crumple-verify-told-{}", std::process::id())));
    std::fs::create_dir_all(&folder).unwrap();
    let certificate = certificate_for(&file, |_| ());
    let (path, network) = (folder.join("certificate.json"), folder.join("elsewhere"));
    std::fs::write(&path, certificate.to_canonical_json()).unwrap();
    std::fs::write(&network, &file).unwrap();
    let run = |options: &[&str]| {
        let program =
            std::process::Command::new(env!("CARGO_BIN_EXE_crumple-verify")).args(options).arg(&path).output();
        let output = program.unwrap();
        (output.status.code().unwrap(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
    };
    let elsewhere = network.to_str().unwrap();
    let (code, text) = run(&[]);
    assert!(code == 1 && text.contains("rejected: the policy file is not there"), "{text}");
    for options in [&["--policy", elsewhere][..], &["--work-limit", "1", "--policy", elsewhere]] {
        let (code, text) = run(options);
        assert!(code == 0 && text.contains("accepted: adaptive cruise"), "{text}");
        let digest = certificate.digest();
        assert!(text.contains(&format!("version 2, SHA-256 of its canonical form {digest}\n")), "{text}");
        assert!(text.contains("  about the benchmark of adaptive cruise control"), "{text}");
        assert!(text.ends_with("as crumple read it, with the mapping stated\n"), "{text}");
    }
    let (code, text) = run(&["--policy", elsewhere, "--work-limit", "0"]);
    assert!(code == 1 && text.contains("rejected: the check takes more than the allowed 0 operations"), "{text}");
    for value in ["many", "-1", "1.5"] {
        let (code, text) = run(&["--work-limit", value]);
        assert!(code == 2 && text.starts_with("usage: crumple-verify"), "{text}");
    }
    std::fs::write(folder.join(certificate.policy_reference().unwrap().0), &file).unwrap();
    assert_eq!(run(&[]).0, 0, "beside it");
    std::fs::remove_dir_all(folder).unwrap();
}
