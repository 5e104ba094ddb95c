//! Comfort: peak braking and jerk.

use std::collections::VecDeque;

use crumple_sim::engine::Track;

/// Time window of [`peak_jerk_mps3`], in seconds.
///
/// Project-specific: longer than the steps of a simulation, so that noise of one step does not count in full, and
/// shorter than the few tenths of a second of a gradual brake build-up.
pub const JERK_WINDOW_S: f64 = 0.1;

/// Returns the hardest deceleration in m/s², positive; 0 without braking, `None` for less than two samples.
///
/// Expects one acceleration for each sample, which is held until the next sample. The last one is therefore ignored.
#[must_use]
pub fn peak_brake_mps2(acceleration_mps2: impl ExactSizeIterator<Item = f64>) -> Option<f64> {
    let samples = acceleration_mps2.len().checked_sub(1)?;
    acceleration_mps2
        .take(samples)
        .map(|a| -a)
        .reduce(f64::max)
        .map(|brake_mps2| brake_mps2.max(0.0))
}

/// Returns the peak jerk in m/s³: the largest change of acceleration within `window_s` seconds, divided by `window_s`.
/// `None` for less than two samples, or if the window is not positive.
///
/// Accelerations are constant over steps, so their derivative does not exist, and the jump divided by the step grows as
/// the step shrinks. The change within a fixed window depends on the motion alone. A jump of `Δa` yields `Δa /
/// window_s`, a ramp longer than the window its slope. Stops count, since passengers feel them; impacts do not.
///
/// `time_s` and `track.acceleration_mps2` have one entry for each sample; the last acceleration is held for no time.
#[must_use]
pub fn peak_jerk_mps3(time_s: &[f64], track: &Track, window_s: f64) -> Option<f64> {
    // Times are sums of steps: jumps exactly one window apart must not depend on rounding.
    let within_s = window_s * (1.0 - 1e-6);
    let mut lowest = SlidingExtreme::new(|new, old| new <= old);
    let mut highest = SlidingExtreme::new(|new, old| new >= old);
    let steps = time_s
        .iter()
        .zip(time_s.iter().skip(1))
        .zip(&track.acceleration_mps2);
    let changes_mps2 = steps.map(|((&from_s, &to_s), &acceleration_mps2)| {
        let low = lowest.push(acceleration_mps2, to_s, from_s - within_s);
        let high = highest.push(acceleration_mps2, to_s, from_s - within_s);
        (acceleration_mps2 - low).max(high - acceleration_mps2)
    });
    let peak_mps2 = changes_mps2.reduce(f64::max)?;
    (window_s > 0.0).then(|| peak_mps2 / window_s)
}

/// The minimum or maximum of a sliding time window, in amortised constant time.
///
/// Keeps only values that may still become the extremum.
pub(super) struct SlidingExtreme {
    beats: fn(f64, f64) -> bool,
    /// Values, and the time until which each was held.
    candidates: VecDeque<(f64, f64)>,
}

impl SlidingExtreme {
    pub(super) fn new(beats: fn(f64, f64) -> bool) -> Self {
        Self {
            beats,
            candidates: VecDeque::new(),
        }
    }

    /// Adds a value that is held until `until_s`. Returns the extremum of the values held after `since_s`.
    pub(super) fn push(&mut self, value: f64, until_s: f64, since_s: f64) -> f64 {
        while self
            .candidates
            .front()
            .is_some_and(|&(_, held_until_s)| held_until_s <= since_s)
        {
            self.candidates.pop_front();
        }
        while self
            .candidates
            .back()
            .is_some_and(|&(old, _)| (self.beats)(value, old))
        {
            self.candidates.pop_back();
        }
        self.candidates.push_back((value, until_s));
        self.candidates
            .front()
            .map_or(value, |&(extreme, _)| extreme)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::{driven_track, trace};

    fn jerk_of(pieces: &[(f64, f64)], step_s: f64, window_s: f64) -> f64 {
        let trace = trace(vec![driven_track(4.0, 0.0, 100.0, pieces, step_s)], step_s);
        peak_jerk_mps3(&trace.time_s, &trace.vehicles[0], window_s).unwrap()
    }

    #[test]
    fn peak_braking_by_hand() {
        assert_eq!(
            peak_brake_mps2([1.0, -3.0, -7.5, 2.0].into_iter()),
            Some(7.5)
        );
        assert_eq!(
            peak_brake_mps2([1.0, 2.0, -9.0].into_iter()),
            Some(0.0),
            "the last is held for no time"
        );
        assert_eq!(peak_brake_mps2([-9.0].into_iter()), None);
        assert_eq!(peak_brake_mps2([].into_iter()), None);
    }

    #[test]
    fn jerk_by_hand() {
        // A jump from 0 to -6 m/s² in a window of 0.1 s: 60 m/s³.
        assert!((jerk_of(&[(1.0, 0.0), (1.0, -6.0)], 0.01, 0.1) - 60.0).abs() < 1e-9);
        // Two jumps of 2 m/s², 0.05 s apart, share a window: 4 / 0.1; a window apart they do not: 2 / 0.1.
        let two_jumps = |apart_s| [(1.0, 0.0), (apart_s, -2.0), (1.0, -4.0)];
        assert!((jerk_of(&two_jumps(0.05), 0.01, 0.1) - 40.0).abs() < 1e-9);
        assert!((jerk_of(&two_jumps(0.1), 0.01, 0.1) - 20.0).abs() < 1e-9);
        // 5 m/s² built up over 0.5 s in a hundred stairs: 10 m/s³, up to one stair of 0.05 m/s² in the window.
        let stairs: Vec<_> = (1..=100).map(|k| (0.005, -0.05 * f64::from(k))).collect();
        assert!((jerk_of(&stairs, 0.005, 0.1) - 10.0).abs() <= 0.05 / 0.1 + 1e-9);
        assert_eq!(jerk_of(&[(1.0, -3.0)], 0.01, 0.1), 0.0, "constant");
    }

    #[test]
    fn jerk_is_undefined_without_a_step_or_a_window() {
        let track = driven_track(4.0, 0.0, 10.0, &[(1.0, -1.0)], 0.5);
        assert_eq!(peak_jerk_mps3(&[], &track, 0.1), None);
        assert_eq!(peak_jerk_mps3(&[0.0], &track, 0.1), None);
        assert_eq!(peak_jerk_mps3(&[0.0, 0.5, 1.0], &track, 0.0), None);
        assert_eq!(peak_jerk_mps3(&[0.0, 0.5, 1.0], &track, f64::NAN), None);
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// Ten times finer sampling of a motion yields equal jerk, as does a search of all pairs.
        #[test]
        fn jerk_does_not_depend_on_the_sampling(accelerations in prop::collection::vec(-8.0..3.0f64, 2..30)) {
            let pieces: Vec<_> = accelerations.iter().map(|&a| (0.02, a)).collect();
            let coarse = jerk_of(&pieces, 0.02, 0.1);
            prop_assert!((coarse - jerk_of(&pieces, 0.002, 0.1)).abs() < 1e-9);

            // Pieces j < k are within 0.1 s of each other if fewer than five pieces lie between them.
            let change = |j: usize, k: usize| (accelerations[j] - accelerations[k]).abs();
            let pairs = (0..pieces.len()).flat_map(|j| (j + 1..pieces.len().min(j + 6)).map(move |k| (j, k)));
            let by_search = pairs.map(|(j, k)| change(j, k)).fold(0.0, f64::max) / 0.1;
            prop_assert!((coarse - by_search).abs() < 1e-9, "{coarse} against {by_search}");
        }
    }
}
