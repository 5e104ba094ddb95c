//! Bounds of leaders with bounded braking hold for any braking.

use crumple_verify::reach::{
    BoxDimension, InitialRanges, NeuralController, PartitionCell, ReachClaim, ReachProblem, reach,
    reach_with_tube,
};
use crumple_verify::{
    Assumption, Certificate, Interval, ProvedClaim, Rejection, WorkLimit, check_with,
};
use proptest::prelude::*;

use crate::reach::{
    LATCHED, any_ranges, any_unit, box_member, claim, is_bounded, paper_box, paper_problem,
};
use crate::support::closed_loop::{XorShiftRng, simulate_with_leader};
use crate::support::networks::{any_network, native_network};
use crate::support::{policy_bytes, reach_certificate};

/// A share of the braking limit for each step. `Observed` brakes in the step before a decision, or in all others.
#[derive(Debug, Clone)]
enum BrakingPattern {
    Constant(f64),
    FullFrom(u32),
    Random(u64),
    Pulses(u32),
    Observed { every: u32, is_shown: bool },
}

impl BrakingPattern {
    fn share(&self, k: u32) -> f64 {
        let yes = |it: bool| f64::from(u8::from(it));
        match self {
            Self::Constant(share) => *share,
            Self::FullFrom(first) => yes(k >= *first),
            Self::Random(seed) => XorShiftRng::for_index(*seed, k).next_unit(),
            Self::Pulses(steps) => yes((k / steps).is_multiple_of(2)),
            Self::Observed { every, is_shown } => yes((k % every == every - 1) == *is_shown),
        }
    }
}

fn any_braking_pattern() -> impl Strategy<Value = BrakingPattern> {
    prop_oneof![
        (0.0..=1.0_f64).prop_map(BrakingPattern::Constant),
        (0..400_u32).prop_map(BrakingPattern::FullFrom),
        any::<u64>().prop_map(BrakingPattern::Random),
        (1..60_u32).prop_map(BrakingPattern::Pulses),
        (prop::sample::select(vec![1_u32, 2, 5, 10]), any::<bool>())
            .prop_map(|(every, is_shown)| BrakingPattern::Observed { every, is_shown }),
    ]
}

pub fn unscripted(ranges: InitialRanges) -> InitialRanges {
    InitialRanges {
        leader_brake_mps2: Interval::ZERO,
        onset_steps: Interval::ZERO,
        ..ranges
    }
}

fn with_bounded_leader<'a>(
    controller: &'a NeuralController,
    ranges: InitialRanges,
    limit_mps2: f64,
) -> ReachProblem<'a> {
    ReachProblem {
        leader_brakes_at_most_mps2: Some(limit_mps2),
        ..paper_problem(controller, unscripted(ranges))
    }
}

fn any_limit() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), 0.0..0.2_f64, 0.0..9.0_f64]
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(300))]

    /// Every observation is inside the bounds at every decision, and every gap above its bound, through stops, firings
    /// and collisions.
    #[test]
    fn bounds_hold_however_the_leader_brakes(
        ranges in any_ranges(), limit_mps2 in any_limit(), seed: u64, gain in prop::option::of(0.2..1.2_f64),
        has_follower: bool, every in prop::sample::select(vec![1_u32, 2, 5, 10]),
        members in prop::collection::vec((any_unit(), any_braking_pattern()), 12),
    ) {
        let controller = gain.map_or_else(|| any_network(seed), |gain| native_network(&[12, 9], gain, seed));
        let scene = ReachProblem {
            follower: has_follower.then_some(LATCHED), stop_when_undecided: false, steps: 400, decision_steps: every,
            ..with_bounded_leader(&controller, ranges, limit_mps2)
        };
        let bounded = reach_with_tube(&scene);
        for (place, habit) in members {
            let start = box_member(&scene.ranges, place);
            let run = simulate_with_leader(&scene, start, |k| limit_mps2 * habit.share(k));
            is_bounded(&scene, &bounded, run, &(start, habit))?;
        }
    }

    #[test]
    fn a_zero_limit_equals_an_empty_script(ranges in any_ranges(), seed: u64, has_follower: bool) {
        let controller = any_network(seed);
        let follower = has_follower.then_some(LATCHED);
        let whole = paper_problem(&controller, unscripted(ranges));
        let scripted = ReachProblem { follower, steps: 300, stop_when_undecided: false, ..whole };
        let within = ReachProblem { leader_brakes_at_most_mps2: Some(0.0), ..scripted.clone() };
        prop_assert_eq!(reach_with_tube(&scripted), reach_with_tube(&within));
        let nearly = reach(&ReachProblem { leader_brakes_at_most_mps2: Some(1e-13), ..scripted.clone() });
        let exactly = reach(&scripted);
        if exactly.undecided.is_none() && nearly.undecided.is_none() {
            let is_near = |(a, b): (&f64, &f64)| a == b || (a - b).abs() < 1e-3;
            prop_assert!(nearly.gaps_m.iter().zip(&exactly.gaps_m).all(is_near), "{nearly:?} {exactly:?}");
        }
    }

    #[test]
    fn a_larger_limit_proves_no_more(ranges in any_ranges(), seed: u64, limits in prop::array::uniform2(any_limit())) {
        let controller = native_network(&[12, 9], 0.3, seed);
        let [less, more] = [limits[0].min(limits[1]), limits[0].max(limits[1])]
            .map(|limit| reach(&ReachProblem { steps: 300, ..with_bounded_leader(&controller, ranges, limit) }));
        if more.undecided.is_none() {
            prop_assert!(less.undecided.is_none(), "{less:?} {more:?}");
            for (less, more) in less.gaps_m.into_iter().zip(more.gaps_m) {
                prop_assert!(more <= less + 1e-6, "{less} {more}");
            }
        }
    }
}

/// Searches for the braking with the smallest gap by hill climbing; returns the gap.
fn min_gap_under_attack(scene: &ReachProblem<'_>, rounds: usize, seed: u64) -> f64 {
    const PIECES: usize = 30;
    let limit_mps2 = scene.leader_brakes_at_most_mps2.unwrap();
    let mut numbers = XorShiftRng(seed);
    let gap = |place: [f64; 8], pieces: &[f64; PIECES]| {
        let share = |k: u32| pieces[(k as usize * PIECES / scene.steps as usize).min(PIECES - 1)];
        let (_, least) = simulate_with_leader(scene, box_member(&scene.ranges, place), |k| {
            limit_mps2 * share(k)
        });
        least[0].min(least[1])
    };
    let mut best_m = f64::INFINITY;
    for begin in 0..4 {
        let pieces = std::array::from_fn(|piece| {
            [
                1.0,
                0.0,
                f64::from(u8::from(piece < 15)),
                numbers.next_unit(),
            ][begin]
        });
        let mut best = ([0.5; 8], pieces, gap([0.5; 8], &pieces));
        for round in 0..rounds {
            let size = 0.99_f64.powi(round as i32 % 300);
            let index = best
                .0
                .map(|at: f64| (at + 0.5 * size * numbers.next_signed()).clamp(0.0, 1.0));
            let mut pieces = best.1;
            for _ in 0..1 + (numbers.next_unit() * 3.0) as usize {
                pieces[(numbers.next_unit() * PIECES as f64) as usize] =
                    numbers.next_unit().round();
            }
            let found_m = gap(index, &pieces);
            if found_m < best.2 {
                best = (index, pieces, found_m);
            }
        }
        best_m = best_m.min(best.2);
    }
    best_m
}

mod tier_2 {
    use super::*;

    /// No braking that a search finds falsifies the verified box, and the bounds are close to the gaps found.
    #[test]
    #[ignore = "tier 2: four searches"]
    fn verified_boxes_survive_the_worst_leader_that_is_found() {
        let controller = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
        for limit_mps2 in [0.05, 0.2, 0.35, 0.55] {
            let scene = with_bounded_leader(&controller, paper_box(0.1, 0.0), limit_mps2);
            let reached = reach(&scene);
            assert_eq!(reached.undecided, None, "{limit_mps2}");
            let proved_m = reached.gaps_m[0].min(reached.gaps_m[1]);
            let found_m = min_gap_under_attack(&scene, 500, 7);
            println!("{limit_mps2} m/s²: proved {proved_m:.3} m, found {found_m:.3} m");
            assert!(
                found_m >= proved_m && proved_m > found_m - 1.5,
                "{found_m} {reached:?}"
            );
        }
    }
}

/// Measures the search without a proof: `cargo test -p crumple-verify --release -- --ignored --nocapture
/// worst_leader_at`.
#[test]
#[ignore = "takes a minute; for the table of corpora/boxes/README.md"]
fn worst_leader_at_each_limit() {
    let controller = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
    for limit_mps2 in [0.1, 0.2, 0.3, 0.4, 0.46, 0.5, 1.0, 2.0, 3.0, 3.5, 4.0] {
        let scene = with_bounded_leader(&controller, paper_box(0.7, 0.0), limit_mps2);
        println!(
            "{limit_mps2} m/s²: {:.3} m",
            min_gap_under_attack(&scene, 1000, 7)
        );
    }
}

fn bounded_leader_claim() -> ReachClaim {
    ReachClaim {
        leader_brakes_at_most_mps2: Some(0.05),
        ranges: unscripted(claim().ranges),
        partition: vec![PartitionCell::Verified],
        verified_share_at_least: 1.0,
        falsified_share_at_least: 0.0,
        min_gap_m_at_least: 3.0,
        ..claim()
    }
}

fn check_claim(claim: ReachClaim) -> Result<ProvedClaim, Rejection> {
    check_with(
        &reach_certificate(claim),
        Some(&policy_bytes("reference")),
        WorkLimit::default(),
    )
}

#[test]
fn a_claim_about_any_braking_is_derived_again_and_forgeries_of_it_are_refused() {
    let genuine = bounded_leader_claim();
    match check_claim(genuine.clone()) {
        Ok(ProvedClaim::Reach {
            verified_share,
            leader_brakes_at_most_mps2,
            ..
        }) => {
            assert_eq!(
                (verified_share, leader_brakes_at_most_mps2),
                (1.0, Some(0.05))
            );
        }
        other => panic!("{other:?}"),
    }
    let message = check_claim(genuine.clone()).unwrap().to_string();
    assert!(
        message.contains("however the leader brakes at up to 0.05 m/s²"),
        "{message}"
    );
    let scope = reach_certificate(genuine.clone()).scope().to_string();
    assert!(
        scope.contains("never speeds up, and brakes as it likes: over each step at another rate from 0 to 0.05 m/s²"),
        "{scope}"
    );
    let text = serde_json::to_string(&reach_certificate(genuine.clone())).unwrap();
    assert_eq!(
        Certificate::from_json(&text).unwrap(),
        reach_certificate(genuine.clone())
    );

    for limit_mps2 in [4.0, 30.0, 1e9, 1e300] {
        let forged = ReachClaim {
            leader_brakes_at_most_mps2: Some(limit_mps2),
            ..genuine.clone()
        };
        assert!(
            matches!(check_claim(forged), Err(Rejection::Leaf { leaf: 0, .. })),
            "{limit_mps2}"
        );
    }
    for limit_mps2 in [-0.0001, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let forged = ReachClaim {
            leader_brakes_at_most_mps2: Some(limit_mps2),
            ..genuine.clone()
        };
        let field = "leader_brakes_at_most_mps2".to_owned();
        assert_eq!(
            check_claim(forged),
            Err(Rejection::Invalid {
                field,
                problem: "is negative or infinite"
            }),
            "{limit_mps2}"
        );
    }
    for dimension in [BoxDimension::LeaderBrakeMps2, BoxDimension::OnsetSteps] {
        let mut forged = genuine.clone();
        *forged.ranges.get_mut(dimension) = Interval::new(0.0, 0.05).unwrap();
        let field = format!("ranges.{}", dimension.field_name());
        assert!(
            matches!(check_claim(forged), Err(Rejection::Invalid { field: actual, .. }) if actual == field)
        );
    }
    // The assumption missing, doubled, or exchanged with that of a script.
    let with = |claim: &ReachClaim, assumptions: Vec<Assumption>| {
        check_with(
            &Certificate {
                assumptions,
                ..reach_certificate(claim.clone())
            },
            Some(&policy_bytes("reference")),
            WorkLimit::default(),
        )
    };
    let needed = reach_certificate(genuine.clone()).assumptions;
    assert!(
        needed.contains(&Assumption::LeaderWithinLimit)
            && !needed.contains(&Assumption::ScriptedLeader)
    );
    let index = needed
        .iter()
        .position(|assumption| *assumption == Assumption::LeaderWithinLimit)
        .unwrap();
    let mut without = needed.clone();
    without.remove(index);
    let mut doubled = needed.clone();
    doubled.insert(index, Assumption::LeaderWithinLimit);
    let mut scripted = needed.clone();
    scripted[index] = Assumption::ScriptedLeader;
    for assumptions in [without, doubled, scripted.clone()] {
        assert!(matches!(
            with(&genuine, assumptions),
            Err(Rejection::Assumptions { .. })
        ));
    }
    assert!(matches!(
        with(&claim(), needed),
        Err(Rejection::Assumptions { .. })
    ));
    let plain = ReachClaim {
        leader_brakes_at_most_mps2: None,
        ..genuine
    };
    assert!(
        with(&plain, scripted).is_ok(),
        "that of a leader that holds its speed is another claim, and true"
    );
}

#[test]
fn a_collision_with_a_leader_within_the_limit_falsifies() {
    let ranges = unscripted(InitialRanges {
        gap_behind_m: Interval::point(16.0),
        ..paper_box(0.05, 0.0)
    });
    let falsified = |limit_mps2: f64, rate_mps2: f64, onset: f64| ReachClaim {
        leader_brakes_at_most_mps2: Some(limit_mps2),
        ranges,
        partition: vec![PartitionCell::Falsified([
            16.0, 16.0, 25.0, 25.0, 25.0, rate_mps2, 6.0, onset,
        ])],
        verified_share_at_least: 0.0,
        falsified_share_at_least: 1.0,
        min_gap_m_at_least: 0.0,
        ..claim()
    };
    assert!(matches!(
        check_claim(falsified(29.0, 28.0, 100.0)),
        Ok(ProvedClaim::Reach {
            falsified_share: 1.0,
            ..
        })
    ));
    for outside in [
        falsified(27.0, 28.0, 100.0),
        falsified(29.0, 28.0, -1.0),
        falsified(29.0, 28.0, 301.0),
    ] {
        let Err(Rejection::Leaf { problem, .. }) = check_claim(outside) else {
            panic!("not a leaf")
        };
        assert_eq!(problem, "the point is outside the cell");
    }
    assert!(
        matches!(
            check_claim(falsified(29.0, 0.0, 0.0)),
            Err(Rejection::Leaf { .. })
        ),
        "that one does not touch"
    );
}
