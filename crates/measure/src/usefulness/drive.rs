//! Steps of a vehicle until its first impact.

use crate::approach::PairState;
use crate::severity::impacts_of;
use crumple_sim::engine::{Impact, TIME_TOLERANCE_S, Trace};

/// A step of a drive.
#[derive(Debug, Clone, Copy)]
pub struct DriveStep {
    /// Start, in seconds.
    pub time_s: f64,
    /// Duration, in seconds.
    pub duration_s: f64,
    /// Speed at the start, in m/s.
    pub speed_mps: f64,
    /// Acceleration over the step, in m/s².
    pub acceleration_mps2: f64,
    /// State relative to the leader at the start; `None` without a leader.
    pub ahead: Option<PairState>,
}

impl DriveStep {
    /// Returns the deceleration over the step, in m/s², negative when the vehicle speeds up.
    pub(super) fn brake_mps2(&self) -> f64 {
        -self.acceleration_mps2
    }
}

/// Returns the steps of vehicle `index` before its first impact; `None` if there is no such vehicle.
///
/// From an impact on, the motion is not that of the driver. If tracks have unequal lengths, the end of the shortest is
/// the end for all.
pub(super) fn drive_steps<'a>(
    trace: &'a Trace,
    impacts: &[Impact],
    index: usize,
) -> Option<impl Iterator<Item = DriveStep> + use<'a>> {
    let track = trace.vehicles.get(index)?;
    let collisions = impacts_of(impacts, index).map(|impact| impact.collision.time_s);
    let until_s = collisions.fold(f64::INFINITY, f64::min) - TIME_TOLERANCE_S;
    let ahead = trace
        .leaders(index)
        .enumerate()
        .map(|(sample, front)| PairState::from_sample(&trace.time_s, [front?, track], sample));
    let spans = trace.time_s.iter().zip(trace.time_s.iter().skip(1));
    let own = track.speed_mps.iter().zip(&track.acceleration_mps2);
    let steps = spans.zip(own).zip(ahead).map(
        |(((&time_s, &to_s), (&speed_mps, &acceleration_mps2)), ahead)| DriveStep {
            time_s,
            duration_s: to_s - time_s,
            speed_mps,
            acceleration_mps2,
            ahead,
        },
    );
    Some(steps.take_while(move |step| step.time_s < until_s))
}
