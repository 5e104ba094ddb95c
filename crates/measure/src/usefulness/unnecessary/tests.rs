use proptest::prelude::*;

use super::*;
use crate::testing::{driven_track, impact, trace};

/// Creates a trace of a vehicle at 20 m/s, 200 m behind a leader of that speed.
fn steady_leader_trace(pieces: &[(f64, f64)]) -> Trace {
    let total_s = pieces.iter().map(|(held_s, _)| held_s).sum();
    let front = driven_track(4.0, 204.0, 20.0, &[(total_s, 0.0)], 0.05);
    trace(
        vec![front, driven_track(4.0, 0.0, 20.0, pieces, 0.05)],
        0.05,
    )
}

/// Demand of the reference driver at the start: (2 + 1.6 * 20)² / 200² of 0.73 m/s².
const JUSTIFIED_MPS2: f64 = 0.73 * 34.0 * 34.0 / (200.0 * 200.0);

#[test]
fn unnecessary_braking_by_hand() {
    let unnecessary = |pieces: &[(f64, f64)]| {
        UnnecessaryBraking::from_trace(&steady_leader_trace(pieces), &[], 1).unwrap()
    };
    let braking = unnecessary(&[(1.0, 0.0), (0.5, -5.0), (1.0, 0.0), (0.3, -2.5), (0.5, 0.0)]);
    let hardest = braking.hardest.unwrap();
    assert!(
        (braking.time_s - 0.8).abs() < 1e-9 && braking.count == 2,
        "{braking:?}"
    );
    assert_eq!((hardest.brake_mps2, hardest.time_s), (5.0, 1.0));
    assert!((hardest.justified_mps2 - JUSTIFIED_MPS2).abs() < 1e-12);
    assert!(unnecessary(&[(1.0, -2.0)]).is_empty(), "within the margin");
    assert!(
        unnecessary(&[(0.5, 0.0), (0.15, -7.0), (0.5, 0.0)]).is_empty(),
        "too short"
    );
    let bursts = unnecessary(&[(0.5, 0.0), (0.1, -7.0), (0.1, 0.0), (0.1, -7.0), (0.5, 0.0)]);
    assert!(
        (bursts.time_s - 0.2).abs() < 1e-9 && bursts.count == 1,
        "{bursts:?}"
    );
    assert_eq!(
        UnnecessaryBraking::from_trace(&steady_leader_trace(&[(1.0, 0.0)]), &[], 2),
        None
    );
}

#[test]
fn unnecessary_braking_above_a_limit_by_hand() {
    let harder = |limit_mps2: f64, pieces: &[(f64, f64)]| {
        UnnecessaryBraking::from_trace_above_limit(limit_mps2, &steady_leader_trace(pieces), &[], 1)
            .unwrap()
            .count
    };
    assert_eq!(
        harder(2.0, &[(0.5, 0.0), (0.5, -2.1), (1.0, 0.0), (0.5, -5.0)]),
        2,
        "no margin"
    );
    assert_eq!(harder(2.0, &[(0.5, 0.0), (0.5, -2.0)]), 0, "no harder");
    assert_eq!(
        harder(2.0, &[(0.5, 0.0), (0.15, -7.0), (0.5, 0.0)]),
        0,
        "too short"
    );
    assert_eq!(
        harder(0.9 * JUSTIFIED_MPS2, &[(0.5, -0.1)]),
        0,
        "that much had a cause"
    );
    assert_eq!(
        UnnecessaryBraking::from_trace_above_limit(
            2.0,
            &steady_leader_trace(&[(1.0, 0.0)]),
            &[],
            2
        ),
        None
    );
}

#[test]
fn an_emergency_justifies_braking_and_motion_after_an_impact_is_ignored() {
    // Half a second behind a leader that brakes at 8 m/s², less suffices: 20² / (2 * (10 + 25)) = 5.7 m/s².
    let front = driven_track(4.0, 14.0, 20.0, &[(3.0, -8.0)], 0.05);
    let rear = driven_track(4.0, 0.0, 20.0, &[(3.0, -7.6)], 0.05);
    assert!(
        UnnecessaryBraking::from_trace(&trace(vec![front, rear], 0.05), &[], 1)
            .unwrap()
            .is_empty()
    );
    let mut hit = impact(1.0, 1, 20.0, 25.0);
    (hit.first_involved, hit.last_involved) = (1, 2);
    let braking = steady_leader_trace(&[(1.0, 0.0), (2.0, -7.0)]);
    let is_empty = |impacts: &[Impact]| {
        UnnecessaryBraking::from_trace(&braking, impacts, 1)
            .unwrap()
            .is_empty()
    };
    assert!(
        is_empty(&[hit]) && !is_empty(&[]),
        "hit from behind before it braked"
    );
}

#[test]
fn without_a_leader_no_braking_is_justified() {
    let alone = trace(
        vec![driven_track(4.0, 0.0, 20.0, &[(1.0, -3.0)], 0.05)],
        0.05,
    );
    let UnnecessaryBraking {
        time_s,
        count,
        hardest,
    } = UnnecessaryBraking::from_trace(&alone, &[], 0).unwrap();
    assert!((time_s - 1.0).abs() < 1e-9 && count == 1);
    assert_eq!(
        hardest,
        Some(BrakeInstant {
            time_s: 0.0,
            brake_mps2: 3.0,
            justified_mps2: 0.0
        })
    );
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// A vehicle that does not brake does not brake unnecessarily. The measured time is at most the time for which
    /// braking exceeds the margin. Finer steps give the same time, up to one coarse step at each change of
    /// acceleration and a few brakings near the minimum duration.
    #[test]
    fn unnecessary_braking_is_braking(
        gap_m in 20.0..90.0f64,
        own in prop::collection::vec(-7.0..2.0f64, 6),
        front in prop::collection::vec(-4.0..2.0f64, 6),
    ) {
        let pieces = |a: &[f64]| a.iter().map(|&a| (0.5, a)).collect::<Vec<_>>();
        let line = |own: &[f64], step_s: f64| {
            let front = driven_track(4.0, gap_m + 4.0, 25.0, &pieces(&front), step_s);
            trace(vec![front, driven_track(4.0, 0.0, 25.0, &pieces(own), step_s)], step_s)
        };
        let unnecessary = |own: &[f64], step_s| UnnecessaryBraking::from_trace(&line(own, step_s), &[], 1).unwrap();
        let coasting: Vec<f64> = own.iter().map(|a| a.max(0.0)).collect();
        prop_assert!(unnecessary(&coasting, 0.05).is_empty());
        let (rough, fine) = (unnecessary(&own, 0.05), unnecessary(&own, 0.01));
        let beyond_s = 0.5 * own.iter().filter(|a| **a < -UNNECESSARY_MARGIN_MPS2).count() as f64;
        prop_assert!(rough.time_s <= beyond_s + 1e-9);
        prop_assert!((rough.time_s - fine.time_s).abs() <= 6.0 * 0.05 + 3.0 * MIN_BRAKING_S, "{rough:?} {fine:?}");
        if let Some(hardest) = rough.hardest {
            prop_assert!(hardest.brake_mps2 - hardest.justified_mps2 > UNNECESSARY_MARGIN_MPS2);
            prop_assert!(hardest.justified_mps2 >= 0.0);
        }
    }
}
