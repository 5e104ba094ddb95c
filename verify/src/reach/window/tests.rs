use proptest::prelude::*;

use super::super::fixtures::{constant_controller, default_problem, point_box, point_form};
use super::*;

const DEFAULT_POINT: [f64; 8] = [20.0; 8];

fn egos_of_mode(mode: MotionMode) -> EgoSet {
    let mut members = EgoSet::from_speed(point_form(10.0), 9);
    members.mode = mode;
    members
}

fn firing_window(k: u32, every: u32, fire: &[MotionMode]) -> FiringWindow {
    let mut window = FiringWindow::new(k);
    fire.iter()
        .for_each(|&mode| window.record_firing(mode, [f64::from(k), f64::from(k + every - 1)]));
    window.members = MotionMode::ALL.map(|mode| Some(egos_of_mode(mode)));
    window
}

/// Returns the first decision and the first and last instant of each merged window.
fn merged_spans(step_s: f64, every: u32, ks: impl Iterator<Item = u32>) -> Vec<(u32, [f64; 2])> {
    let controller = constant_controller(0.0);
    let scene = ReachProblem {
        step_s,
        decision_steps: every,
        ..default_problem(&controller, point_box(DEFAULT_POINT))
    };
    let windows = ks
        .map(|k| firing_window(k, every, &[MotionMode::Moving]))
        .collect();
    merge_windows(windows, &scene)
        .iter()
        .map(|window| (window.k, window.instants))
        .collect()
}

/// Checks the length of merged windows of D steps, at most a tenth of a second.
#[test]
fn merged_windows_are_few_and_at_most_a_tenth_of_a_second_long() {
    let cases = [
        (0.01, 1, 10, 1),
        (0.01, 1, 11, 2),
        (0.01, 1, 20, 2),
        (0.01, 1, 25, 3),
        (0.01, 1, 300, 10),
        (0.01, 2, 25, 6),
        (0.01, 3, 25, 9),
        (0.01, 5, 25, 10),
        (0.01, 10, 300, 10),
        (0.05, 1, 300, 2),
        (0.05, 1, 12, 2),
        // The step is longer than the longest window: unchanged.
        (0.3, 1, 300, 1),
    ];
    for (step_s, every, count, length) in cases {
        let actual = merged_spans(step_s, every, (0..count).map(|i| 7 + i * every));
        let end = 7 + count * every;
        let expected: Vec<(u32, [f64; 2])> = (7..end)
            .step_by(length)
            .map(|k| {
                (
                    k,
                    [f64::from(k), f64::from((k + length as u32).min(end) - 1)],
                )
            })
            .collect();
        assert_eq!(actual, expected, "{step_s} {every} {count}");
    }
}

/// The length of a window counts from its first decision, gaps included.
#[test]
fn a_pause_ends_a_window_if_it_is_long() {
    let ks = [0, 1, 4, 5, 6, 7, 20, 22, 23, 24, 25].into_iter();
    let actual: Vec<u32> = merged_spans(0.01, 1, ks)
        .into_iter()
        .map(|(k, _)| k)
        .collect();
    assert_eq!(actual, [0, 4, 6, 20, 22, 24]);
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// Each instant of each window remains in a window whose decision is no later.
    #[test]
    fn every_instant_is_in_a_window(
        every in 1..12_u32, step_s in prop::sample::select(vec![0.01, 0.02, 0.05]),
        skipped in prop::collection::vec(0..3_u32, 1..120),
    ) {
        let ks: Vec<u32> = skipped.iter().scan(0, |k, skip| { *k += every * (1 + skip); Some(*k) }).collect();
        let actual = merged_spans(step_s, every, ks.iter().copied());
        prop_assert!(actual.windows(2).all(|pair| pair[0].0 < pair[1].0));
        for k in ks {
            let (from, instants) = actual.iter().rev().find(|(from, _)| *from <= k).unwrap();
            prop_assert!(instants[0] <= f64::from(k) && f64::from(k + every - 1) <= instants[1], "{from} {instants:?}");
        }
    }
}

/// Moving members of a later interval moved before; others may have been in any mode.
#[test]
fn later_firing_includes_the_possible_earlier_modes() {
    let controller = constant_controller(0.0);
    let scene = ReachProblem {
        step_s: 0.01,
        ..default_problem(&controller, point_box(DEFAULT_POINT))
    };
    for (later, expected) in [
        (&[MotionMode::Moving][..], [true, false, false]),
        (&[MotionMode::Standing], [true; 3]),
        (&[MotionMode::Restarted], [true; 3]),
        (&[MotionMode::Moving, MotionMode::Standing], [true; 3]),
    ] {
        // Eleven windows, so that pairs merge; the first one to fire moves.
        let windows = (0..11)
            .map(|k| firing_window(k, 1, if k == 1 { later } else { &[MotionMode::Moving] }))
            .collect();
        let first = merge_windows(windows, &scene).remove(0);
        assert!(first.may_fire() && first.instants == [0.0, 1.0]);
        assert_eq!(
            first.into_firing_sets().map(|members| members.is_some()),
            expected,
            "{later:?}"
        );
    }
    assert!(!FiringWindow::new(3).may_fire());
}
