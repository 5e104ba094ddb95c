//! Recorded speeds of a vehicle as piecewise linear motion, and its braking events.
//!
//! Times are whole milliseconds and speeds whole millimetres per second, as in scenario files, so that written
//! scenarios contain the detected braking.

use super::RecordedPlatoon;
use super::series::round_to_milli;

/// Longest hole that is bridged linearly, in milliseconds. Within half a second a car's acceleration changes little; a
/// longer hole could hide a brake application.
pub(super) const MAX_HOLE_MS: i64 = 500;
/// Time window of a loss of speed that counts as braking, in milliseconds.
pub(super) const BRAKING_WINDOW_MS: i64 = 1000;
/// Largest time between braking phases of one episode, in milliseconds: followers still react to the first phase.
const MERGE_WITHIN_MS: i64 = 5_000;
/// Margin above the threshold against rounding errors, in m/s.
const ROUNDING_MARGIN_MPS: f64 = 1e-9;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SpeedSample {
    /// Index in the time base of the platoon.
    pub(super) index: usize,
    pub(super) time_ms: i64,
    pub(super) speed_mps: f64,
}

/// Merged braking phases.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BrakingEvent {
    /// Start of the first second with enough loss of speed.
    pub(super) onset_ms: i64,
    /// End of the last such second.
    pub(super) end_ms: i64,
    /// Largest loss of speed within one second, in m/s.
    pub(super) largest_drop_mps: f64,
    /// Start of that second.
    pub(super) hardest_ms: i64,
}

/// Returns the known speeds of a vehicle of a platoon, from a sample on.
pub(super) fn platoon_samples(
    platoon: &RecordedPlatoon,
    vehicle: usize,
    from: usize,
) -> impl Iterator<Item = SpeedSample> {
    let speeds = platoon
        .vehicles
        .get(vehicle)
        .map_or(&[][..], |vehicle| &vehicle.speed_mps);
    let samples = platoon.time_s.iter().zip(speeds).enumerate().skip(from);
    samples.filter_map(|(index, (&time_s, &speed_mps))| {
        Some(SpeedSample {
            index,
            time_ms: (time_s * 1000.0).round() as i64,
            speed_mps: round_to_milli(speed_mps?),
        })
    })
}

/// Splits samples at holes longer than half a second.
pub(super) fn split_at_holes(samples: impl Iterator<Item = SpeedSample>) -> Vec<Vec<SpeedSample>> {
    let mut runs: Vec<Vec<SpeedSample>> = Vec::new();
    for sample in samples {
        match runs.last_mut() {
            Some(run)
                if run
                    .last()
                    .is_some_and(|last| sample.time_ms - last.time_ms <= MAX_HOLE_MS) =>
            {
                run.push(sample);
            }
            _ => runs.push(vec![sample]),
        }
    }
    runs
}

/// Finds where `v(t) - v(t + 1 s)` exceeds the threshold, for t at each sample, in order of time.
pub(super) fn find_brakings(run: &[SpeedSample], min_brake_mps2: f64) -> Vec<BrakingEvent> {
    let mut brakings: Vec<BrakingEvent> = Vec::new();
    let mut ahead = run.windows(2).peekable();
    for sample in run {
        let end_ms = sample.time_ms + BRAKING_WINDOW_MS;
        while ahead
            .next_if(|pair| matches!(**pair, [_, next] if next.time_ms < end_ms))
            .is_some()
        {}
        let Some([before, after]) = ahead.peek().copied() else {
            break;
        };
        let share = (end_ms - before.time_ms) as f64 / (after.time_ms - before.time_ms) as f64;
        let drop_mps =
            sample.speed_mps - (before.speed_mps + (after.speed_mps - before.speed_mps) * share);
        if drop_mps <= min_brake_mps2 + ROUNDING_MARGIN_MPS {
            continue;
        }
        match brakings.last_mut() {
            Some(last) if sample.time_ms - last.end_ms <= MERGE_WITHIN_MS => {
                last.end_ms = end_ms;
                if drop_mps > last.largest_drop_mps {
                    last.largest_drop_mps = drop_mps;
                    last.hardest_ms = sample.time_ms;
                }
            }
            _ => {
                let hardest_ms = sample.time_ms;
                brakings.push(BrakingEvent {
                    onset_ms: hardest_ms,
                    end_ms,
                    largest_drop_mps: drop_mps,
                    hardest_ms,
                });
            }
        }
    }
    brakings
}

/// Returns the speed at a time of the run, linear between samples, constant outside.
pub(super) fn speed_at_mps(run: &[SpeedSample], at_ms: i64) -> f64 {
    let next = run.partition_point(|sample| sample.time_ms <= at_ms);
    let before = next.checked_sub(1).and_then(|index| run.get(index));
    match (before, run.get(next)) {
        (Some(a), Some(b)) => {
            let share = (at_ms - a.time_ms) as f64 / (b.time_ms - a.time_ms) as f64;
            a.speed_mps + (b.speed_mps - a.speed_mps) * share
        }
        (Some(only), None) | (None, Some(only)) => only.speed_mps,
        (None, None) => 0.0,
    }
}
