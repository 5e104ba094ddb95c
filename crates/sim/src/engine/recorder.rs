//! Data that a run records.

use super::motion::Motion;
use super::platoon::PlatoonState;
use super::{
    FailedController, Impact, Intervention, Outcome, SimulationResult, Trace, Track, VehicleSummary,
};

#[derive(Debug, Clone, Copy)]
pub(super) struct VehicleExtremes {
    pub(super) min_ttc_s: f64,
    pub(super) max_brake_mps2: f64,
}

impl VehicleExtremes {
    pub(super) const INITIAL: Self = Self {
        min_ttc_s: f64::INFINITY,
        max_brake_mps2: 0.0,
    };
}

/// Returns the maximum deceleration, updated with `acceleration_mps2`.
///
/// Plain comparison: for 0 and -0, `f64::max` may return either, so that separately compiled engines could differ.
#[inline(always)]
pub(super) fn raise_max_brake(so_far_mps2: f64, acceleration_mps2: f64) -> f64 {
    if -acceleration_mps2 > so_far_mps2 {
        -acceleration_mps2
    } else {
        so_far_mps2
    }
}

/// Returns the time to collision in seconds; infinite for a gap that does not close, 0 for a negative gap.
#[inline]
#[must_use]
pub fn ttc_s(gap_m: f64, closing_mps: f64) -> f64 {
    if closing_mps > 0.0 {
        gap_m.max(0.0) / closing_mps
    } else {
        f64::INFINITY
    }
}

pub(super) fn summarize_vehicle(
    min_gap_m: f64,
    tally: VehicleExtremes,
    speed_mps: f64,
) -> VehicleSummary {
    // The gap may be slightly negative if another collision ends the run at the same instant as that of this pair.
    let min_gap_m = min_gap_m.max(0.0);
    // Samples lie on either side of a collision; at the collision itself time to collision is 0.
    let min_ttc_s = if min_gap_m == 0.0 {
        0.0
    } else {
        tally.min_ttc_s
    };
    VehicleSummary {
        min_gap_m: min_gap_m.is_finite().then_some(min_gap_m),
        min_ttc_s: min_ttc_s.is_finite().then_some(min_ttc_s),
        max_brake_mps2: tally.max_brake_mps2,
        stopped: speed_mps == 0.0,
    }
}

impl VehicleExtremes {
    /// Lowers the minimum TTC to that of a gap and its closing speed.
    #[inline]
    pub(super) fn update_min_ttc(&mut self, gap_m: f64, closing_mps: f64) {
        let ttc_s = ttc_s(gap_m, closing_mps);
        // Plain comparison: `f64::min` also handles NaN, which cannot occur here.
        if ttc_s < self.min_ttc_s {
            self.min_ttc_s = ttc_s;
        }
    }
}

pub(super) fn assemble_result(
    impacts: Vec<Impact>,
    vehicles: Vec<VehicleSummary>,
    interventions: Vec<Intervention>,
    trace: Option<Trace>,
    failed: Option<FailedController>,
) -> SimulationResult {
    let outcome = match (failed, impacts.first()) {
        (Some(failed), _) => Outcome::ControllerFailed(failed),
        (None, Some(impact)) => Outcome::Collision(impact.collision),
        (None, None) => Outcome::NoCollision,
    };
    SimulationResult {
        outcome,
        impacts,
        vehicles,
        interventions,
        trace,
    }
}

/// Amount of data that a run records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordingLevel {
    /// Outcome, impacts and summaries only.
    Summary,
    /// A trace, too.
    Trace,
}

impl Trace {
    /// Creates an empty trace for the vehicles of a platoon; `None` if no trace is recorded.
    pub(super) fn begin(
        keep: RecordingLevel,
        platoon: &PlatoonState,
        samples: usize,
    ) -> Option<Self> {
        let vehicles = platoon.length_m.iter().zip(&platoon.mass_kg);
        (keep == RecordingLevel::Trace).then(|| Self {
            time_s: Vec::with_capacity(samples),
            vehicles: vehicles
                .map(|(&length_m, &mass_kg)| Track {
                    length_m,
                    mass_kg,
                    position_m: Vec::with_capacity(samples),
                    speed_mps: Vec::with_capacity(samples),
                    acceleration_mps2: Vec::with_capacity(samples),
                    in_lane_s: Track::THROUGHOUT_S,
                })
                .collect(),
        })
    }

    pub(super) fn push_sample(&mut self, time_s: f64, motion: impl Iterator<Item = Motion>) {
        self.time_s.push(time_s);
        for (track, motion) in self.vehicles.iter_mut().zip(motion) {
            track.position_m.push(motion.position_m);
            track.speed_mps.push(motion.speed_mps);
            track.acceleration_mps2.push(motion.acceleration_mps2);
        }
    }
}
