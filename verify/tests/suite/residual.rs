//! Bounds of an ego with a residual policy hold for each member.

use crumple_verify::reach::{
    FollowerLaw, FollowerModel, IdmLaw, NetworkLayer, NeuralController, PartitionCell, ReachClaim, ReachProblem,
    ResidualPolicy, reach, reach_with_tube,
};
use crumple_verify::{Interval, ProvedClaim, WorkLimit, check_with};
use proptest::prelude::*;

use crate::law_follower::{IDM_LAW, any_law};
use crate::leader::unscripted;
use crate::reach::{
    LATCHED, any_ranges, any_unit, box_member, claim, is_bounded, min_gap_under_attack, paper_box, paper_problem,
    point_box, prove_and_attack,
};
use crate::support::closed_loop::{XorShiftRng, scripted_braking, simulate, simulate_with_errors};
use crate::support::networks::residual_network;
use crate::support::{policy_bytes, reach_certificate, sha256};

/// Generates residual policies over any `idm`, some with a slow rate.
pub fn any_residual_policy() -> impl Strategy<Value = ResidualPolicy> {
    let law = any_law().prop_map(|law| match law {
        FollowerLaw::Idm(idm) => idm,
        FollowerLaw::AccAeb(_) => IDM_LAW,
    });
    let zone = prop_oneof![1 => Just(0.0), 4 => 0.0..0.6_f64, 1 => 0.9..0.99_f64];
    let rate = prop_oneof![4 => Just(1000.0), 2 => 200.0..1000.0_f64, 1 => 0.1..200.0_f64];
    (law, zone, rate).prop_map(|(idm, dead_zone, rate_per_s)| ResidualPolicy {
        dead_zone,
        rate_per_s,
        idm: IdmLaw { max_accel_mps2: 3.0, ..idm },
    })
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(300))]

    /// Every observation is inside the bounds at every decision, and every gap above its bound, through stops and
    /// collisions.
    #[test]
    fn bounds_hold_however_an_ego_departs(
        ranges in any_ranges(), residual in any_residual_policy(), seed: u64, gain in 0.2..3.0_f64,
        follower in prop::option::of(prop_oneof![Just(LATCHED), any_law().prop_map(FollowerModel::ByLaw)]),
        limit_mps2 in prop::option::of(0.0..6.0_f64), largest in prop::sample::select(vec![1e-9, 0.02]),
        places in prop::collection::vec(any_unit(), 12), every in prop::sample::select(vec![1_u32, 2, 5, 10]),
        step_s in prop::sample::select(vec![0.01, 0.01, 0.1, 0.5]),
    ) {
        let controller = residual_network(&[12, 9], gain, seed, Some(residual));
        let ranges = if limit_mps2.is_some() { unscripted(ranges) } else { ranges };
        let scene = ReachProblem {
            follower, leader_brakes_at_most_mps2: limit_mps2, observation_error: [largest; 8],
            stop_when_undecided: false, steps: if step_s < 0.1 { 400 } else { 100 }, step_s, decision_steps: every,
            ..paper_problem(&controller, ranges)
        };
        let bounded = reach_with_tube(&scene);
        for (run, place) in places.into_iter().enumerate() {
            let start = box_member(&ranges, place);
            let error = |decision| {
                let mut numbers = XorShiftRng::for_index(seed + run as u64, decision);
                std::array::from_fn(|_| largest * numbers.next_signed().signum() * f64::from(u8::from(run > 0)))
            };
            let brakes = |k| limit_mps2.map(|most| most * XorShiftRng::for_index(seed, k / 20).next_unit().round());
            let run = simulate_with_errors(&scene, start, |k| brakes(k).unwrap_or(scripted_braking(&start)(k)), error);
            is_bounded(&scene, &bounded, run, &(start, residual))?;
        }
    }
}

fn constant_action_controller(action: f64, residual: ResidualPolicy) -> NeuralController {
    let mut controller = residual_network(&[], 0.0, 1, Some(residual));
    let Some(NetworkLayer::Linear(layer)) = controller.layers.first_mut() else { panic!("a layer") };
    layer.weights.fill(0.0);
    layer.biases.fill(f64::from(action.atanh() as f32));
    controller
}

/// Non-vacuous bounds around scenario 1, behind a leader that brakes at 0.7 m/s².
#[test]
fn verified_boxes_survive_search() {
    let residual = ResidualPolicy { dead_zone: 0.4, rate_per_s: 1000.0, idm: IDM_LAW };
    let mut ranges = paper_box(0.5, 0.0);
    ranges.leader_brake_mps2 = Interval::new(0.6, 0.8).unwrap();
    // The law alone, and a third and all of the way to full braking.
    for (action, beyond_m) in [(0.39, 0.5), (-0.6, 0.5), (-0.999, 0.5)] {
        let controller = constant_action_controller(action, residual);
        let scene = ReachProblem { follower: None, ..paper_problem(&controller, ranges) };
        let reached = reach(&scene);
        let found_m = min_gap_under_attack(&scene, 1000, 200, 9);
        println!("{action}: proved {:.3} m, found {found_m:.3} m", reached.gaps_m[0]);
        assert_eq!(reached.undecided, None);
        assert!(found_m >= reached.gaps_m[0] && reached.gaps_m[0] > found_m - beyond_m, "{found_m} {reached:?}");
    }
}

/// The check reads the base controller, which the statement omits, and adds it to the scope.
#[test]
fn the_base_controller_is_printed_with_the_scope() {
    let bytes = policy_bytes("residual");
    let residual = NeuralController::from_bytes(&bytes).unwrap().residual_over.unwrap();
    let claim = ReachClaim {
        policy_sha256: sha256(&bytes),
        partition: vec![PartitionCell::Undecided],
        verified_share_at_least: 0.0,
        falsified_share_at_least: 0.0,
        ..claim()
    };
    let certificate = reach_certificate(claim);
    let accepted = check_with(&certificate, Some(&bytes), WorkLimit::default()).unwrap();
    assert!(matches!(accepted, ProvedClaim::Reach { residual_over: Some(found), .. } if found == residual));
    let ResidualPolicy { dead_zone, rate_per_s, idm } = residual;
    let (scope, plain) = (certificate.scope_with_result(&accepted).to_string(), certificate.scope().to_string());
    for text in [
        format!(
            "; it drives idm towards {} m/s with a time headway of {} s",
            idm.desired_speed_mps, idm.time_headway_s
        ),
        format!("where the network's action is beyond {dead_zone}; departures come and go at {rate_per_s} 1/s"),
    ] {
        assert!(scope.contains(&text) && !plain.contains(&text), "{text}: {scope}");
    }
    // The digest rejects another policy with this claim.
    assert!(check_with(&certificate, Some(&policy_bytes("reference")), WorkLimit::default()).is_err());
}

/// Non-vacuous bounds for a committed policy over `idm`, through the leader's onset, the follower's brake and all
/// stops.
#[test]
fn a_box_of_a_learned_policy_survives_search() {
    let controller = NeuralController::from_bytes(&policy_bytes("residual")).unwrap();
    let mut ranges = paper_box(0.007, 0.002);
    ranges.follower_brake_mps2 = Interval::new(5.998, 6.002).unwrap();
    ranges.onset_steps = Interval::new(124.75, 125.25).unwrap();
    let scene = paper_problem(&controller, ranges);
    let [proved_m, found_m] = prove_and_attack(&scene, 300, 100, 3);
    assert!(proved_m > found_m - 0.1, "{found_m} {proved_m}");
}

/// An ego that restarts within a decision interval and brakes again is not standing from then on.
#[test]
fn members_that_start_within_an_interval_are_propagated() {
    let residual = ResidualPolicy { dead_zone: 0.0, rate_per_s: 1000.0, idm: IDM_LAW };
    let controller = residual_network(&[12, 9], 1.760_118_541_084_301_7, 15_521_200_961_166_277_192, Some(residual));
    let start = [28.457_4, 0.0, 12.064_57, 0.0, 0.0, 4.290_4, 0.0, 72.658];
    let ranges = point_box(start);
    let whole = paper_problem(&controller, ranges);
    let scene = ReachProblem {
        follower: None,
        stop_when_undecided: false,
        step_s: 0.5,
        steps: 100,
        decision_steps: 2,
        ..whole
    };
    let run = simulate(&scene, start);
    let starts_and_brakes = run.0.windows(2).any(|pair| pair[0][3] == 0.0 && pair[1][3] > 1.0 && pair[1][6] > 0.0);
    assert!(starts_and_brakes, "the case is still one");
    is_bounded(&scene, &reach_with_tube(&scene), run, &start).unwrap();
}

/// The law uses an observed own speed below 0 unclipped.
#[test]
fn a_speed_that_is_seen_below_0_counts_as_it_is() {
    let residual = ResidualPolicy { dead_zone: 0.4, rate_per_s: 1000.0, idm: IDM_LAW };
    let controller = constant_action_controller(0.0, residual);
    let ranges = point_box([4.0, 0.0, 25.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let observation_error = [0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.0];
    let whole = paper_problem(&controller, ranges);
    let scene = ReachProblem { follower: None, observation_error, stop_when_undecided: false, steps: 10, ..whole };
    let start = box_member(&ranges, [0.0; 8]);
    let error = |_| std::array::from_fn(|i| if i == 3 { -0.02 } else { 0.0 });
    let run = simulate_with_errors(&scene, start, scripted_braking(&start), error);
    // The leader is so much faster that the law keeps farther away at a speed below 0.
    assert!(run.0[1][3] < simulate(&scene, start).0[1][3] - 1e-4);
    is_bounded(&scene, &reach_with_tube(&scene), run, &start).unwrap();
}
