//! Comparison of reach bounds with an independent exact simulation of members, to the last bit.

use crumple_verify::reach::{
    FollowerModel, NeuralController, PartitionCell, ReachProblem, ReachTube, reach_with_tube,
};
use crumple_verify::{Certificate, Interval, Statement};
use proptest::prelude::*;

use crate::law_follower::any_law;
use crate::leader::unscripted;
use crate::reach::{LATCHED, any_ranges, any_unit, box_member, paper_box, paper_problem};
use crate::support::closed_loop::{ReachPoint, XorShiftRng, simulate};
use crate::support::exact::{FixedPointInterval, TooClose, simulate_exactly};
use crate::support::networks::{any_network, native_network};
use crate::support::policy_bytes;

/// Generates observation errors: each the largest, to one side or the other, or none.
fn random_errors(scene: &ReachProblem<'_>, seed: u64) -> impl Fn(usize) -> [f64; 8] {
    let largest = scene.observation_error;
    move |decision| {
        let mut numbers = XorShiftRng::for_index(seed, decision as u32);
        largest.map(|error| error * (numbers.next_signed() * 1.5).round().clamp(-1.0, 1.0))
    }
}

/// Generates bounded braking: a random rate at each step, or all or nothing for a while.
fn random_braking(limit_mps2: f64, seed: u64) -> impl Fn(u32) -> f64 {
    move |k| {
        let held = if seed.is_multiple_of(2) { 1 } else { 37 };
        let mut numbers = XorShiftRng::for_index(seed, k / held);
        limit_mps2
            * if held == 1 {
                numbers.next_unit()
            } else {
                numbers.next_unit().round()
            }
    }
}

fn simulate_member(
    scene: &ReachProblem<'_>,
    start: ReachPoint,
    seed: u64,
) -> Result<(Vec<[FixedPointInterval; 8]>, [FixedPointInterval; 2]), TooClose> {
    let brake = scene
        .leader_brakes_at_most_mps2
        .map(|limit_mps2| random_braking(limit_mps2, seed));
    simulate_exactly(
        scene,
        start,
        random_errors(scene, seed),
        brake.as_ref().map(|brake| brake as &dyn Fn(u32) -> f64),
    )
}

/// Checks that a run is within the bounds, without tolerance.
fn is_bounded(
    tube: Option<&ReachTube>,
    gaps_m: Option<[f64; 2]>,
    (trace, least): &(Vec<[FixedPointInterval; 8]>, [FixedPointInterval; 2]),
) -> Result<(), String> {
    if let Some(gaps_m) = gaps_m {
        let (actual, [ahead, behind]) = (least.each_ref(), gaps_m);
        if !actual[0].is_at_least(ahead) || !actual[1].is_at_least(behind) {
            return Err(format!("{least:?} below {gaps_m:?}"));
        }
    }
    let Some(tube) = tube else { return Ok(()) };
    assert_eq!(tube.len(), trace.len());
    for (decision, (bounds, seen)) in tube.iter().zip(trace).enumerate() {
        if let Some(i) = (0..8).find(|&i| !seen[i].is_in(bounds[i])) {
            return Err(format!(
                "number {i} at decision {decision}: {:?} not in {:?}",
                seen[i], bounds[i]
            ));
        }
    }
    Ok(())
}

prop_compose! {
    /// Generates error bounds: none, 1e-9 of a unit, or centimetres.
    fn any_errors()(
        size in prop::sample::select(vec![0.0, 1e-9, 0.02]), shares in prop::array::uniform8(0.0..1.0_f64),
    ) -> [f64; 8] {
        shares.map(|share| size * share)
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(96))]

    /// Checks observations at every decision and gaps at every half step, for boxes and for single initial states,
    /// whose bounds are tightest.
    #[test]
    fn bounds_hold_to_the_last_bit(
        ranges in any_ranges(), seed: u64, gain in prop::option::of(0.2..1.2_f64), is_point: bool,
        follower in prop::option::of(prop_oneof![Just(LATCHED), any_law().prop_map(FollowerModel::ByLaw)]),
        limit_mps2 in prop::option::of(0.0..6.0_f64), observation_error in any_errors(),
        every in prop::sample::select(vec![1_u32, 2, 5, 10]),
        places in prop::collection::vec((any_unit(), any::<u64>()), 4),
        (step_s, steps) in prop::sample::select(vec![(0.01, 300), (0.01, 300), (0.1, 100), (0.5, 40)]),
    ) {
        let controller = gain.map_or_else(|| any_network(seed), |g| native_network(&[12, 9], g, seed));
        let ranges = if limit_mps2.is_some() { unscripted(ranges) } else { ranges };
        let whole = ReachProblem {
            follower, leader_brakes_at_most_mps2: limit_mps2, observation_error,
            stop_when_undecided: false, step_s, steps, decision_steps: every, ..paper_problem(&controller, ranges)
        };
        let bounds = (!is_point).then(|| reach_with_tube(&whole));
        for (place, seed) in places {
            let start = box_member(&ranges, place);
            let Ok(run) = simulate_member(&whole, start, seed) else { continue };
            let point = || ReachProblem { ranges: ranges.at_point(&start).unwrap(), ..whole.clone() };
            let of_point = bounds.is_none().then(|| reach_with_tube(&point()));
            let Some((reached, tube)) = bounds.as_ref().or(of_point.as_ref()) else { continue };
            let is_clear = run.1[0].is_at_least(0.0) && (follower.is_none() || run.1[1].is_at_least(0.0));
            prop_assert!(!(reached.surely_collides && is_clear), "{start:?}");
            let mut gaps_m = reached.gaps_m;
            if follower.is_none() { gaps_m[1] = f64::NEG_INFINITY; }
            let is_bounded = is_bounded(tube.as_ref(), reached.undecided.is_none().then_some(gaps_m), &run);
            prop_assert!(is_bounded.is_ok(), "{start:?} {seed}: {is_bounded:?}");
        }
    }
}

/// Checks the gaps of members of paper-1 and paper-2 at any half step.
#[test]
fn committed_claims_are_true_of_their_members() {
    let mut numbers = XorShiftRng(77);
    let controller = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
    for name in ["reach-paper-1", "reach-paper-2"] {
        let path = format!(
            "{}/../corpora/certificates/{name}.json",
            env!("CARGO_MANIFEST_DIR")
        );
        let certificate = Certificate::from_json(&std::fs::read_to_string(path).unwrap()).unwrap();
        let Statement::Reach(claim) = certificate.statement else {
            panic!("{name}")
        };
        let leaves: Vec<_> = claim
            .leaves()
            .unwrap()
            .into_iter()
            .filter(|(cell, ..)| *cell == PartitionCell::Verified)
            .collect();
        for _ in 0..12 {
            let (_, ranges, _) = leaves[(numbers.next_unit() * leaves.len() as f64) as usize];
            let scene = ReachProblem {
                ranges,
                ..claim.problem(&controller).unwrap()
            };
            let start = box_member(&ranges, std::array::from_fn(|_| numbers.next_unit()));
            let run = simulate_member(&scene, start, numbers.0).unwrap();
            is_bounded(None, Some([claim.min_gap_m_at_least; 2]), &run).unwrap();
            assert!(
                !run.1[0]
                    .min(&run.1[1])
                    .is_at_least(claim.min_gap_m_at_least + 10.0)
            );
        }
    }
}

#[test]
fn two_derivations_agree() {
    let controller = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
    let scene = ReachProblem {
        observation_error: [0.0; 8],
        ..paper_problem(&controller, paper_box(0.5, 0.1))
    };
    for share in [0.0, 0.3, 1.0] {
        let start = box_member(&scene.ranges, [share; 8]);
        let ((exact, _), (plain, _)) = (
            simulate_member(&scene, start, 1).unwrap(),
            simulate(&scene, start),
        );
        for (exact, plain) in exact.iter().zip(plain) {
            let near = |x: &FixedPointInterval, plain: f64| {
                x.is_in(Interval::new(plain - 1e-3, plain + 1e-3).unwrap())
            };
            assert!(
                exact.iter().zip(plain).all(|(x, plain)| near(x, plain)),
                "{exact:?} {plain:?}"
            );
        }
    }
}
