//! Reach statements about a box hold for each of its members.

use crumple_verify::reach::controller::network_output;
use crumple_verify::reach::form::AffineForm;
use std::fmt::Debug;

use crumple_verify::reach::{
    BoxDimension, FollowerModel, InitialRanges, LinearLayer, NetworkLayer, NeuralController,
    PartitionCell, ReachClaim, ReachProblem, ReachResult, ReachTube, Undecided, reach,
    reach_with_tube,
};
use crumple_verify::{
    Certificate, Interval, ProvedClaim, Rejection, Statement, WorkLimit, check, check_with,
};
use proptest::prelude::*;

use crate::support::closed_loop::{
    ReachPoint, XorShiftRng, network_outputs, scripted_braking, simulate, simulate_with_errors,
};
use crate::support::mutants::mutants;
use crate::support::networks::{any_network, native_network};
use crate::support::{policy_bytes, reach_certificate, sha256};

pub const LATCHED: FollowerModel = FollowerModel::Latched { ttc_s: 1.4 };

fn between(low: f64, high: f64) -> Interval {
    Interval::new(low, high).unwrap()
}

pub fn paper_box(gap_m: f64, brake_mps2: f64) -> InitialRanges {
    let at = Interval::point;
    InitialRanges {
        gap_ahead_m: between(16.0 - gap_m, 16.0 + gap_m),
        gap_behind_m: between(16.0 - gap_m, 16.0 + gap_m),
        leader_speed_mps: at(25.0),
        ego_speed_mps: at(25.0),
        follower_speed_mps: at(25.0),
        leader_brake_mps2: between(3.0 - brake_mps2, 3.0 + brake_mps2),
        follower_brake_mps2: at(6.0),
        onset_steps: at(100.0),
    }
}

pub fn point_box(start: ReachPoint) -> InitialRanges {
    let mut ranges = paper_box(0.0, 0.0);
    for (dimension, value) in BoxDimension::ALL.into_iter().zip(start) {
        *ranges.get_mut(dimension) = Interval::point(value);
    }
    ranges
}

pub fn paper_problem<'a>(
    controller: &'a NeuralController,
    ranges: InitialRanges,
) -> ReachProblem<'a> {
    ReachProblem {
        controller,
        ranges,
        follower: Some(LATCHED),
        leader_brakes_at_most_mps2: None,
        observation_error: [1e-9; 8],
        step_s: 0.01,
        steps: 1500,
        decision_steps: 10,
        stop_when_undecided: true,
    }
}

pub fn box_member(ranges: &InitialRanges, point: [f64; 8]) -> ReachPoint {
    std::array::from_fn(|i| {
        let range = ranges.get(BoxDimension::ALL[i]);
        (range.low() + point[i] * (range.high() - range.low())).clamp(range.low(), range.high())
    })
}

fn widen_network(controller: &NeuralController, copies: usize) -> NeuralController {
    let last = controller
        .layers
        .iter()
        .rposition(|step| matches!(step, NetworkLayer::Linear(_)));
    let widen = |(index, step): (usize, &NetworkLayer)| {
        let NetworkLayer::Linear(layer) = step else {
            return step.clone();
        };
        let (in_copies, out_copies) = (
            if index == 0 { 1 } else { copies },
            if Some(index) == last { 1 } else { copies },
        );
        let (inputs, outputs) = (layer.inputs * in_copies, layer.outputs * out_copies);
        let weight = |i: usize, o: usize| {
            layer.weights[i / in_copies * layer.outputs + o / out_copies] / in_copies as f64
        };
        let weights = (0..inputs * outputs)
            .map(|index| weight(index / outputs, index % outputs))
            .collect();
        let biases = (0..outputs).map(|o| layer.biases[o / out_copies]).collect();
        NetworkLayer::Linear(LinearLayer {
            inputs,
            outputs,
            weights,
            biases,
        })
    };
    NeuralController {
        layers: controller.layers.iter().enumerate().map(widen).collect(),
        ..controller.clone()
    }
}

pub fn any_unit() -> impl Strategy<Value = [f64; 8]> {
    prop::array::uniform8(0.0..=1.0_f64)
}

prop_compose! {
    /// Generates a box with a single number in some dimensions.
    pub fn any_ranges()(
        low in prop::array::uniform8(0.0..1.0_f64), width in prop::array::uniform8(-0.5..1.0_f64),
        size in 0.001..0.1_f64,
    ) -> InitialRanges {
        let scales = [30.0, 30.0, 30.0, 30.0, 30.0, 6.0, 7.0, 150.0];
        let mut ranges = paper_box(0.0, 0.0);
        for (i, dimension) in BoxDimension::ALL.into_iter().enumerate() {
            let from = scales[i] * low[i];
            *ranges.get_mut(dimension) = between(from, from + size * scales[i] * width[i].max(0.0));
        }
        if width[7] < 0.0 {
            ranges.onset_steps = between(ranges.onset_steps.low().round(), ranges.onset_steps.low().round());
        }
        ranges
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(1000))]

    /// Checks the output of random networks and inputs against the affine form.
    #[test]
    fn network_outputs_are_within_the_bounds(
        seed: u64, radii in prop::array::uniform8(0.0..0.5_f64),
        at in prop::collection::vec(prop::array::uniform8(-1.0..=1.0_f64), 10),
    ) {
        let mut numbers = XorShiftRng(seed | 1);
        let controller = any_network(seed);
        let inputs = controller.inputs.len();
        let centre: Vec<f64> = (0..inputs).map(|_| numbers.next_signed()).collect();
        let share: Vec<[f64; 8]> =
            (0..inputs).map(|i| std::array::from_fn(|_| radii[i % 8] * numbers.next_signed())).collect();
        let forms: Vec<AffineForm> = (0..inputs).map(|i| {
            let constant = AffineForm::constant(Interval::point(centre[i]));
            share[i].iter().enumerate().fold(constant, |mut form, (symbol, &share)| {
                form.add_scaled(&AffineForm::symbol(symbol, between(-1.0, 1.0)), Interval::point(share));
                form
            })
        }).collect();
        let answer = network_output(&controller.layers, &forms);
        for at in at {
            let coordinate = |i: usize| centre[i] + share[i].iter().zip(&at).map(|(s, at)| s * at).sum::<f64>();
            // Inputs are in single precision: their rounding is not part of these forms.
            let seen: Vec<f64> = (0..inputs).map(coordinate).collect();
            let exact = network_outputs(&controller.layers, seen)[0];
            let expected = answer.centre() + answer.terms().iter().zip(&at).map(|(term, at)| term * at).sum::<f64>();
            prop_assert!((exact - expected).abs() <= answer.rest() + 1e-9, "{exact} {expected} {}", answer.rest());
        }
    }
}

/// Checks that observations and smallest gaps of a run are within the bounds; `whose` names it.
pub fn is_bounded(
    scene: &ReachProblem<'_>,
    (reached, tube): &(ReachResult, Option<ReachTube>),
    (trace, least): (Vec<[f64; 8]>, [f64; 2]),
    whose: &impl Debug,
) -> Result<(), TestCaseError> {
    if reached.undecided.is_none() {
        prop_assert!(
            least[0] >= reached.gaps_m[0] - 1e-8,
            "{whose:?} {least:?} {reached:?}"
        );
        let is_behind = scene.follower.is_none() || least[1] >= reached.gaps_m[1] - 1e-8;
        prop_assert!(is_behind, "{whose:?} {least:?} {reached:?}");
    }
    if reached.surely_collides {
        prop_assert!(least[0] < 1e-8 || least[1] < 1e-8, "{whose:?} {least:?}");
        return Ok(());
    }
    let Some(tube) = tube else { return Ok(()) };
    prop_assert_eq!(tube.len(), trace.len());
    for (decision, (bounds, seen)) in tube.iter().zip(&trace).enumerate() {
        for (i, (bound, seen)) in bounds.iter().zip(seen).enumerate() {
            let inside = bound.low() - 1e-8 <= *seen && *seen <= bound.high() + 1e-8;
            prop_assert!(
                inside,
                "number {i} at decision {decision}: {seen} not in {bound:?}; {whose:?}"
            );
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(200))]

    /// Every observation is inside the bounds at every decision, and every gap above its bound, through stops, firings
    /// and collisions.
    #[test]
    fn bounds_hold_for_any_motion(
        ranges in any_ranges(), seed: u64, gain in prop::option::of(0.2..1.2_f64), has_follower: bool,
        places in prop::collection::vec(any_unit(), 12), every in prop::sample::select(vec![1_u32, 2, 5, 10]),
    ) {
        let controller = gain.map_or_else(|| any_network(seed), |gain| native_network(&[12, 9], gain, seed));
        let scene = ReachProblem {
            follower: has_follower.then_some(LATCHED), stop_when_undecided: false, steps: 400, decision_steps: every,
            ..paper_problem(&controller, ranges)
        };
        let bounded = reach_with_tube(&scene);
        let corner = |i: usize| std::array::from_fn(|j| f64::from(u8::from(i >> j & 1 == 1)));
        for point in places.into_iter().chain([corner(0), corner(255), corner(0b0101_1010)]) {
            let start = box_member(&ranges, point);
            is_bounded(&scene, &bounded, simulate(&scene, start), &start)?;
        }
    }
}

/// An ego that stands from the start may trigger the follower's brake: here the follower rolls up to two millimetres
/// from it.
#[test]
fn standing_members_are_kept() {
    let controller = native_network(&[12, 9], 0.2, 0);
    let ranges = point_box([0.004, 21.59, 18.6, 0.0, 5.397, 0.0, 0.0, 0.0]);
    let scene = ReachProblem {
        steps: 400,
        decision_steps: 1,
        stop_when_undecided: false,
        ..paper_problem(&controller, ranges)
    };
    let (_, least) = simulate(&scene, box_member(&ranges, [0.0; 8]));
    assert!(least[1] > 0.0 && least[1] < 0.01, "{least:?}");
    assert!(!reach(&scene).surely_collides);
}

/// Searches for the initial state with the smallest gap by hill climbing; returns the gap.
pub fn min_gap_under_attack(
    scene: &ReachProblem<'_>,
    random: usize,
    adversarial: usize,
    seed: u64,
) -> f64 {
    let mut numbers = XorShiftRng(seed);
    let gap = |place: [f64; 8]| {
        let start = box_member(&scene.ranges, place);
        let (_, least) = simulate(scene, start);
        least[0].min(least[1])
    };
    let mut best = ([0.5; 8], gap([0.5; 8]));
    for _ in 0..random {
        let point = std::array::from_fn(|_| numbers.next_unit());
        let actual = gap(point);
        if actual < best.1 {
            best = (point, actual);
        }
    }
    for round in 0..adversarial {
        let size = 0.5 * 0.995_f64.powi(round as i32);
        let point = best
            .0
            .map(|at: f64| (at + size * numbers.next_signed()).clamp(0.0, 1.0));
        let actual = gap(point);
        if actual < best.1 {
            best = (point, actual);
        }
    }
    best.1
}

/// Returns the proved and the smallest found gap of a box that must be verified, in metres.
pub fn prove_and_attack(
    scene: &ReachProblem<'_>,
    random: usize,
    adversarial: usize,
    seed: u64,
) -> [f64; 2] {
    let reached = reach(scene);
    let found_m = min_gap_under_attack(scene, random, adversarial, seed);
    let proved_m = reached.gaps_m[0].min(reached.gaps_m[1]);
    println!("proved {proved_m:.3} m, found {found_m:.3} m {reached:?}");
    assert_eq!(reached.undecided, None);
    assert!(found_m >= proved_m, "{found_m} {reached:?}");
    [proved_m, found_m]
}

mod tier_2 {
    use super::*;

    #[test]
    #[ignore = "tier 2: three searches"]
    fn verified_boxes_survive_search() {
        let controller = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
        let mut light = paper_box(0.4, 0.1);
        light.follower_brake_mps2 = between(7.3, 7.7);
        let mut other = paper_box(0.1, 0.05);
        (other.gap_ahead_m, other.gap_behind_m) = (between(18.0, 18.3), between(17.0, 17.2));
        (other.follower_speed_mps, other.onset_steps) =
            (between(25.0, 25.1), between(120.0, 123.5));
        for (ranges, least_m) in [(paper_box(0.5, 0.1), 1.8), (light, 2.7), (other, 1.2)] {
            let scene = paper_problem(&controller, ranges);
            let [proved_m, found_m] = prove_and_attack(&scene, 10_000, 1000, 9);
            assert!(
                proved_m > least_m,
                "the bound is not idle: {found_m} {proved_m}"
            );
        }
    }
}

/// Returns a claim about a leader that brakes at up to 30 m/s², too hard for half of the box.
pub fn claim() -> ReachClaim {
    let mut ranges = paper_box(0.05, 0.0);
    (ranges.gap_behind_m, ranges.leader_brake_mps2) = (between(16.0, 16.0), between(2.95, 29.95));
    let cuts = [PartitionCell::Cut(BoxDimension::LeaderBrakeMps2); 6];
    let point = [16.0, 16.0, 25.0, 25.0, 25.0, 28.0, 6.0, 100.0];

    let bytes = policy_bytes("reference");
    ReachClaim {
        policy_file: "reference.safetensors".to_owned(),
        policy_sha256: sha256(&bytes),
        source: None,
        step_s: 0.01,
        steps: 300,
        follower_ttc_s: Some(1.4),
        follower_law: None,
        leader_brakes_at_most_mps2: None,
        observation_error: [1e-9; 8],
        ranges,
        partition: [
            &cuts[..],
            &[PartitionCell::Verified],
            &[PartitionCell::Undecided; 5],
            &[PartitionCell::Falsified(point)],
        ]
        .concat(),
        verified_share_at_least: 0.015625,
        falsified_share_at_least: 0.5,
        min_gap_m_at_least: 3.0,
    }
}

#[test]
fn a_claim_is_derived_again() {
    let bytes = policy_bytes("reference");
    match check_with(
        &reach_certificate(claim()),
        Some(&bytes),
        WorkLimit::default(),
    ) {
        Ok(ProvedClaim::Reach {
            verified_share,
            falsified_share,
            min_gap_m: smallest_gap_m,
            ..
        }) => {
            // The middle of a range is rounded.
            assert!(
                (0.0..1e-12).contains(&(1.0 / 64.0 - verified_share))
                    && (0.0..1e-12).contains(&(0.5 - falsified_share))
            );
            assert!(smallest_gap_m > 3.0);
        }
        other => panic!("{other:?}"),
    }
    assert!(
        matches!(
            check(&reach_certificate(claim())),
            Err(Rejection::Policy { .. })
        ),
        "no policy"
    );
    let text = serde_json::to_string(&reach_certificate(claim())).unwrap();
    assert_eq!(
        Certificate::from_json(&text).unwrap(),
        reach_certificate(claim())
    );
}

/// Five cuts of five ranges of three numbers each: a 32nd of the box by cuts, 3.12 %, and a 243rd of its volume, 0.41
/// %.
#[test]
fn a_32nd_of_the_cuts_that_is_a_243rd_of_the_volume_is_not_accepted_for_a_32nd() {
    let bytes = policy_bytes("reference");
    let mut ranges = paper_box(0.0, 0.0);
    let cut = [
        BoxDimension::GapAheadM,
        BoxDimension::GapBehindM,
        BoxDimension::LeaderSpeedMps,
        BoxDimension::EgoSpeedMps,
        BoxDimension::FollowerSpeedMps,
    ];
    for dimension in cut {
        let low = ranges.get(dimension).low();
        *ranges.get_mut(dimension) = between(low, low.next_up().next_up().next_up());
    }
    // The middle rounds to one side or the other; this names the smaller part.
    let partition = |is_low_smaller: [bool; 5]| {
        let after = is_low_smaller
            .iter()
            .rev()
            .filter(|is_low| **is_low)
            .map(|_| PartitionCell::Undecided);
        let (mut cells, after): (Vec<PartitionCell>, Vec<PartitionCell>) =
            (Vec::new(), after.collect());
        for (dimension, is_low) in cut.into_iter().zip(is_low_smaller) {
            cells.push(PartitionCell::Cut(dimension));
            cells.extend((!is_low).then_some(PartitionCell::Undecided));
        }
        cells.push(PartitionCell::Verified);
        cells.extend(after);
        cells
    };
    let claims = (0..32_u32).map(|places| ReachClaim {
        ranges,
        partition: partition(std::array::from_fn(|i| places >> i & 1 == 1)),
        verified_share_at_least: 1.0 / 32.0,
        falsified_share_at_least: 0.0,
        min_gap_m_at_least: 0.0,
        ..claim()
    });
    let share = |claim: &ReachClaim| claim.volume_shares().unwrap()[0];
    let stated = claims
        .min_by(|one, other| share(one).total_cmp(&share(other)))
        .unwrap();
    assert!(
        share(&stated) <= 1.0 / 243.0 && share(&stated) > 0.0041,
        "{}",
        share(&stated)
    );
    let refused = check_with(
        &reach_certificate(stated.clone()),
        Some(&bytes),
        WorkLimit::default(),
    )
    .unwrap_err()
    .to_string();
    assert!(refused.contains("verified_share_at_least"), "{refused}");
    let measured = ReachClaim {
        verified_share_at_least: share(&stated),
        ..stated
    };
    let shown = check_with(
        &reach_certificate(measured),
        Some(&bytes),
        WorkLimit::default(),
    )
    .unwrap()
    .to_string();
    assert!(
        shown.starts_with("reach: in 0.41 % of the box's volume"),
        "{shown}"
    );
}

#[test]
fn one_changed_weight_is_another_policy() {
    let mut bytes = policy_bytes("reference");
    let last = bytes.len() - 7;
    bytes[last] ^= 1;
    let changed = check_with(
        &reach_certificate(claim()),
        Some(&bytes),
        WorkLimit::default(),
    );
    assert!(
        matches!(changed, Err(Rejection::Policy { .. })),
        "{changed:?}"
    );
    // With its own digest the claim is checked for the changed network: false if the change is large.
    let controller = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
    let Some(NetworkLayer::Linear(last)) = controller
        .layers
        .iter()
        .rfind(|step| matches!(step, NetworkLayer::Linear(_)))
    else {
        panic!()
    };
    let bias = (last.biases[0] as f32).to_le_bytes();
    let offset = bytes.windows(4).rposition(|four| four == bias).unwrap();
    bytes[offset..offset + 4].copy_from_slice(&5.0_f32.to_le_bytes());
    let changed = ReachClaim {
        policy_sha256: sha256(&bytes),
        ..claim()
    };
    assert!(matches!(
        check_with(
            &reach_certificate(changed),
            Some(&bytes),
            WorkLimit::default()
        ),
        Err(Rejection::Leaf { leaf: 0, .. })
    ));
}

#[test]
fn accepted_changed_certificates_are_true() {
    let bytes = policy_bytes("reference");
    let controller = NeuralController::from_bytes(&bytes).unwrap();
    let original = serde_json::to_value(reach_certificate(claim())).unwrap();
    let (mut accepted, mut rejected) = (0, 0);
    for (change, mutant) in mutants(&original) {
        let Ok(certificate) = Certificate::from_json(&mutant.to_string()) else {
            rejected += 1;
            continue;
        };
        if check_with(&certificate, Some(&bytes), WorkLimit::default()).is_err() {
            rejected += 1;
            continue;
        }
        accepted += 1;
        let Statement::Reach(claim) = certificate.statement else {
            panic!("another statement")
        };
        let (mut verified, mut falsified) = (0.0, 0.0);
        for (cell, ranges, share) in claim.leaves().unwrap() {
            let scene = ReachProblem {
                ranges,
                ..claim.problem(&controller).unwrap()
            };
            match cell {
                PartitionCell::Verified => {
                    verified += share;
                    let found_m = min_gap_under_attack(&scene, 100, 50, 3);
                    assert!(found_m >= claim.min_gap_m_at_least, "{change}: {found_m}");
                }
                PartitionCell::Falsified(point) => {
                    falsified += share;
                    let least = simulate(&scene, point).1;
                    assert!(
                        ranges.at_point(&point).is_some() && (least[0] < 0.0 || least[1] < 0.0),
                        "{change}: {least:?}"
                    );
                }
                _ => {}
            }
        }
        // Version 1 took every cut for one in equal halves.
        let is_enough = |actual: f64, stated: f64| actual + 1e-9 >= stated;
        assert!(
            is_enough(verified, claim.verified_share_at_least),
            "{change}"
        );
        assert!(
            is_enough(falsified, claim.falsified_share_at_least),
            "{change}"
        );
    }
    println!("{accepted} accepted, {rejected} rejected");
    assert!(
        accepted > 10 && rejected > accepted,
        "{accepted} accepted, {rejected} rejected"
    );
}

#[test]
fn the_reason_of_an_undecided_box_is_reported() {
    let controller = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
    let mut wide = paper_box(3.0, 1.0);
    let reached = reach(&paper_problem(&controller, wide));
    assert!(
        matches!(reached.undecided, Some(Undecided::MayCollide { .. })) && !reached.surely_collides,
        "{reached:?}"
    );
    assert!(
        reached.sensitivity[0] > 0.0 && reached.sensitivity[2] == 0.0,
        "{reached:?}"
    );
    wide.ego_speed_mps = between(0.0, 100.0);
    assert!(matches!(
        reach(&paper_problem(&controller, wide)).undecided,
        Some(Undecided::TooWide { step: 0 })
    ));
}

/// A policy that decides at every step stops at hundreds of instants, none of which may add a set.
#[test]
fn a_decision_at_every_step_is_bounded_as_well() {
    let reference = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
    let wide = widen_network(&reference, 4);
    for (controller, ranges) in [
        (&reference, paper_box(0.1, 0.02)),
        (&wide, paper_box(0.02, 0.0)),
    ] {
        let scene = ReachProblem {
            decision_steps: 1,
            stop_when_undecided: false,
            ..paper_problem(controller, ranges)
        };
        let begin = std::time::Instant::now();
        let (reached, tube) = reach_with_tube(&scene);
        println!("{:?}, {:?}", begin.elapsed(), reached.gaps_m);
        assert_eq!(reached.undecided, None);
        let (tube, mut numbers) = (tube.unwrap(), XorShiftRng(5));
        assert_eq!(tube.len(), 1501);
        let mut found_m = [f64::INFINITY; 2];
        for start in 0..40 {
            let point = std::array::from_fn(|_| {
                if start % 2 == 0 {
                    numbers.next_unit()
                } else {
                    numbers.next_unit().round()
                }
            });
            let (trace, least) = simulate(&scene, box_member(&ranges, point));
            found_m = std::array::from_fn(|pair| found_m[pair].min(least[pair]));
            for (bounds, seen) in tube.iter().zip(&trace) {
                assert!(bounds.iter().zip(seen).all(
                    |(bound, seen)| bound.low() - 1e-8 <= *seen && *seen <= bound.high() + 1e-8
                ));
            }
        }
        for (proved, actual) in reached.gaps_m.into_iter().zip(found_m) {
            assert!(
                proved <= actual && actual < proved + 0.5,
                "{proved} {actual}"
            );
        }
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn functions_of_forms_contain_the_values(
        centre in -6.0..6.0_f64, radii in prop::array::uniform3(0.0..2.0_f64),
        at in prop::array::uniform3(-1.0..=1.0_f64),
    ) {
        use crumple_verify::reach::relax;
        let mut form = AffineForm::constant(Interval::point(centre));
        let mut value = centre;
        for (symbol, (radius, at)) in radii.into_iter().zip(at).enumerate() {
            form.add_scaled(&AffineForm::symbol(symbol, between(-1.0, 1.0)), Interval::point(radius));
            value += radius * at;
        }
        let holds = |f: &AffineForm, expected: f64| {
            let terms: f64 = f.terms().iter().zip(at).map(|(term, at)| term * at).sum();
            (f.centre() + terms - expected).abs() <= f.rest() + 1e-9 * (1.0 + expected.abs())
        };
        prop_assert!(holds(&form, value));
        prop_assert!(holds(&relax::hyperbolic_tangent(&form), value.tanh()));
        prop_assert!(holds(&relax::relu(&form), value.max(0.0)));
        prop_assert!(holds(&relax::relu_squared(&form), value.max(0.0).powi(2)));
        prop_assert!(holds(&relax::reciprocal(&form), 1.0 / value));
        prop_assert!(holds(&form.times(&form), value * value));
    }
}

/// Measures the search without a proof: `cargo test -p crumple-verify --release -- --ignored --nocapture
/// worst_errors_at`.
#[test]
#[ignore = "takes minutes; for the table of corpora/boxes/README.md"]
fn worst_errors_at_each_size() {
    const BLOCK: u32 = 5;
    let controller = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
    // Output of `cargo run -p crumple-experiments -- filter_errors paper-1`.
    let filter = [
        0.058374, 0.058374, 0.42603, 0.23632, 0.42603, 1.7211, 0.95469, 1.7211,
    ];
    let mut ranges = paper_box(0.7, 0.2);
    (ranges.follower_brake_mps2, ranges.onset_steps) = (between(5.8, 6.2), between(100.0, 150.0));
    for factor in [0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0] {
        let scene = paper_problem(&controller, ranges);
        let mut numbers = XorShiftRng(3);
        let gap = |place: [f64; 8], signs: &[[f64; 8]]| {
            let start = box_member(&ranges, place);
            let error = |decision: u32| {
                std::array::from_fn(|i| {
                    factor * filter[i] * signs[(decision / BLOCK) as usize % signs.len()][i]
                })
            };
            let (_, least) = simulate_with_errors(&scene, start, scripted_braking(&start), error);
            least[0].min(least[1])
        };
        // First constant errors, then changes of each half second.
        let mut best = ([0.5; 8], vec![[1.0; 8]; 30], f64::INFINITY);
        for pattern in 0..256_u32 {
            let signs =
                vec![std::array::from_fn(|i| if pattern >> i & 1 == 1 { 1.0 } else { -1.0 }); 30];
            let found_m = gap(best.0, &signs);
            if found_m < best.2 {
                best = (best.0, signs, found_m);
            }
        }
        let lasting_m = best.2;
        for round in 0..4000 {
            let size = 0.999_f64.powi(round % 1000);
            let point = best
                .0
                .map(|at: f64| (at + 0.5 * size * numbers.next_signed()).clamp(0.0, 1.0));
            let mut signs = best.1.clone();
            for _ in 0..1 + (numbers.next_unit() * 4.0) as usize {
                signs[(numbers.next_unit() * 30.0) as usize % 30]
                    [(numbers.next_unit() * 8.0) as usize % 8] *= -1.0;
            }
            let found_m = gap(point, &signs);
            if found_m < best.2 {
                best = (point, signs, found_m);
            }
        }
        println!(
            "{factor} of six deviations: {lasting_m:.3} m by errors that last, {:.3} m",
            best.2
        );
    }
}
