//! Invariant sets: attacks from certified states, forged certificates, and networks in the relative model.

use std::fs;
use std::sync::Arc;

use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_evidence::{
    InvariantOptions, InvariantPlan, InvariantSet, InvariantSpec, check_binding,
};
use crumple_sim::control::{BuiltInController, ControllerSource, IntoSource};
use crumple_sim::scenario::built_in_scenario;
use crumple_verify::invariant::MotionModel;
use crumple_verify::{Certificate, InvariantClaim, ProvedClaim, Statement, WorkLimit, check_with};
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};

use crate::command_line::temp_folder;
use crate::forgery::genuine::set_certificate;
use crate::forgery::sets::{attack_boundary, set_claim};
use crate::forgery::{Verdict, change_statement};
use crate::onnx_bytes::{TestOnnxNode, model_bytes};

fn spec(motion: MotionModel, own: [f64; 2], leader: [f64; 2]) -> InvariantSpec {
    InvariantSpec {
        version: 1,
        scenario: "paper-1".to_owned(),
        motion,
        leader_mps2: if motion == MotionModel::Absolute {
            [-7.5, 3.0]
        } else {
            [0.0; 2]
        },
        observation_error: [1e-9; 3],
        region_gap_m: 100.0,
        ends_beyond_gap_m: None,
        region_own_mps: own,
        region_leader_mps: leader,
        controller: None,
    }
}

fn plan(controller: impl IntoSource, spec: InvariantSpec) -> InvariantPlan {
    InvariantPlan::new(controller, &built_in_scenario("paper-1").unwrap(), spec).unwrap()
}

fn search(plan: &InvariantPlan, cells: u32) -> (InvariantSet, f64) {
    let options = InvariantOptions {
        cells,
        splits: 1,
        smallest_gap_m: 0.0,
    };
    let set = plan.search(options, &Quiet).unwrap().expect("a set");
    check_binding(
        &set.certificate,
        plan.policy_bytes(),
        Controllers::default(),
    )
    .unwrap();
    match check_with(&set.certificate, plan.policy_bytes(), WorkLimit::UNLIMITED).unwrap() {
        ProvedClaim::Invariant {
            share, min_gap_m, ..
        } => {
            assert!(min_gap_m > 0.0);
            (set, share)
        }
        other => panic!("{other:?}"),
    }
}

fn idm_set(mps: f64, cells: u32) -> (InvariantPlan, InvariantSet, f64) {
    let idm = BuiltInController::from_name("idm").unwrap();
    let plan = plan(idm, spec(MotionModel::Absolute, [0.0, mps], [0.0, mps]));
    let (set, share) = search(&plan, cells);
    (plan, set, share)
}

fn claim(certificate: &Certificate) -> &InvariantClaim {
    let Statement::Invariant(claim) = &certificate.statement else {
        panic!("a set")
    };
    claim
}

#[test]
fn no_attack_from_a_certified_state_causes_a_collision() {
    let mps = 15.0;
    let (plan, set, share) = idm_set(mps, 60);
    let smallest = attack_boundary(&set.table, mps, 300);
    assert!(
        smallest >= claim(&set.certificate).min_gap_m_at_least,
        "{smallest}"
    );
    // No follower that brakes at 7.5 m/s² is safe from less than (v² - w²)/15.
    let kernel = 1.0 - mps * mps / 90.0 / 100.0;
    assert!(
        share >= 0.95 * kernel && share <= kernel,
        "{share} of {kernel}"
    );
    // A leader defeats the controller from below the boundary.
    let defeat = plan.defeat(&set.table).unwrap().expect("a leader");
    assert!(plan.collides(&defeat).unwrap());
}

/// 10 000 attacks in the whole region: `cargo test -- --ignored ten_thousand_attacks`.
#[test]
#[ignore = "takes a minute"]
fn ten_thousand_attacks_cause_no_collision() {
    let (_, set, share) = idm_set(35.0, 140);
    let smallest = attack_boundary(&set.table, 35.0, 10_000);
    println!("share {share}, smallest gap {smallest} m");
    assert!(smallest >= claim(&set.certificate).min_gap_m_at_least && share > 0.85);
}

/// `INVARIANT_FORGERIES` is the number of attempts.
#[test]
fn forged_sets_are_accepted_only_if_their_claim_is_true() {
    let wanted: u64 = std::env::var("INVARIANT_FORGERIES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(100);
    let genuine = set_certificate();
    let mut accepted = 0;
    for index in 0..wanted {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(index);
        let forged = genuine.with_changed_set(&mut random);
        match genuine.verdict(&forged) {
            Verdict::Refused => continue,
            Verdict::Implied => accepted += 1,
            other => panic!("forgery {index}: {other:?}: {}", forged.change),
        }
    }
    println!("{accepted} of {wanted} forgeries were accepted, with true claims");
    assert!(accepted < wanted);
}

/// Returns a network with the gap and another quantity as inputs.
fn network_controller(
    network: &[u8],
    second_input: &str,
    high_mps2: f64,
) -> Arc<dyn ControllerSource> {
    let folder = temp_folder();
    fs::write(folder.path().join("two.onnx"), network).unwrap();
    let mapping = format!(
        "version = 1\nnetwork = \"two.onnx\"\ndecision_interval_s = 0.1\n\
        [[inputs]]\nquantity = \"gap_ahead_m\"\nabsent = 100.0\n\
        [[inputs]]\nquantity = \"{second_input}\n\
        [output]\nlow_mps2 = -7.5\nhigh_mps2 = {high_mps2:?}\n"
    );
    fs::write(folder.path().join("two.toml"), mapping).unwrap();
    Controllers::default()
        .find("two.toml", folder.path())
        .unwrap_or_else(|error| panic!("{error}"))
        .source
}

/// A network of the shape that the N3V benchmark uses: gap and relative speed, two layers of 64 ReLUs. It brakes fully
/// if the gap is below 5 m + 2 s times the closing speed; all other weights are small random numbers.
#[test]
fn a_network_with_two_inputs_has_a_certified_set() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(0);
    let mut small = |count: usize| -> Vec<f32> {
        (0..count)
            .map(|_| random.random_range(-0.01..0.01_f32))
            .collect()
    };
    let (mut first, mut second, mut last) = (small(2 * 64), small(64 * 64), small(64));
    let (mut bias, zeros) = (small(64), small(64));
    (first[0], first[64], bias[0]) = (-1.0, -2.0, 5.0);
    second
        .iter_mut()
        .take(64)
        .for_each(|weight| *weight *= 0.01);
    (second[0], last[0]) = (1.0, -3.0);
    let network = model_bytes(
        2,
        &[
            TestOnnxNode::Gemm(2, 64, first, bias),
            TestOnnxNode::Unary("Relu", vec![]),
            TestOnnxNode::Gemm(64, 64, second, zeros),
            TestOnnxNode::Unary("Relu", vec![]),
            TestOnnxNode::Gemm(64, 1, last, vec![1.5]),
        ],
    );
    let controller = network_controller(&network, "relative_speed_ahead_mps\"\nabsent = 0.0", 1.5);
    let plan = plan(
        controller,
        spec(MotionModel::Relative, [-20.0, 20.0], [0.0; 2]),
    );
    let begin = std::time::Instant::now();
    let (set, share) = search(&plan, 160);
    println!(
        "share {share}, {} passes, {:.1} s",
        set.passes,
        begin.elapsed().as_secs_f64()
    );
    // Full braking needs q²/15 behind a leader at constant speed.
    let kernel = 1.0 - 400.0 / 45.0 / 2.0 / 100.0;
    assert!(share > 0.9 * kernel && share < kernel, "{share}");
    let forged = change_statement(&set.certificate, |statement| {
        set_claim(statement).motion = MotionModel::Absolute;
    });
    assert!(check_with(&forged, plan.policy_bytes(), WorkLimit::UNLIMITED).is_err());
}

/// A network may observe the follower. The claim is for driving without one.
#[test]
fn a_network_that_observes_the_follower_has_a_claim_without_one() {
    // Brakes fully behind the gap of 200 m that stands for an absent follower, and accelerates before a close one.
    let network = model_bytes(2, &[TestOnnxNode::Gemm(2, 1, vec![0.0, -0.1], vec![3.0])]);
    let controller = network_controller(&network, "gap_behind_m\"\nabsent = 200.0", 3.0);
    let (set, share) = search(
        &plan(
            controller,
            spec(MotionModel::Absolute, [0.0, 5.0], [0.0, 5.0]),
        ),
        20,
    );
    assert!(share > 0.9, "{share}");
    assert_eq!(
        set.certificate.scope().behind.as_deref(),
        Some("behind: no vehicle")
    );
}
