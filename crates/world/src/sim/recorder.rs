//! What is kept of a run while it goes on.

use super::motion::Motion;
use super::platoon::PlatoonState;
use super::{FailedController, Impact, Intervention, Outcome, SimulationResult, Trace, Track, VehicleSummary};

/// Smallest time to collision and hardest braking of one vehicle so far.
#[derive(Debug, Clone, Copy)]
pub(super) struct VehicleExtremes {
    pub(super) min_ttc_s: f64,
    pub(super) max_brake_mps2: f64,
}

impl VehicleExtremes {
    pub(super) const INITIAL: Self = Self { min_ttc_s: f64::INFINITY, max_brake_mps2: 0.0 };
}

/// The hardest braking once a vehicle has had `acceleration_mps2`.
///
/// By hand, since of 0 and -0 `f64::max` may give either, and then engines that are compiled apart differ.
#[inline(always)]
pub(super) fn hardest_brake_mps2(so_far_mps2: f64, acceleration_mps2: f64) -> f64 {
    if -acceleration_mps2 > so_far_mps2 { -acceleration_mps2 } else { so_far_mps2 }
}

/// Time to collision in seconds; infinite for a gap that does not close. A gap that is negative by rounding counts as 0.
#[inline]
pub(crate) fn ttc_s(gap_m: f64, closing_mps: f64) -> f64 {
    if closing_mps > 0.0 { gap_m.max(0.0) / closing_mps } else { f64::INFINITY }
}

/// What a run kept of one vehicle.
pub(super) fn summarize_vehicle(min_gap_m: f64, tally: VehicleExtremes, speed_mps: f64) -> VehicleSummary {
    // A pair that touches at the instant at which the run ends with another contact may be apart by less than nothing.
    let min_gap_m = min_gap_m.max(0.0);
    // Samples may lie on either side of a contact; at the contact itself time to collision is 0.
    let min_ttc_s = if min_gap_m == 0.0 { 0.0 } else { tally.min_ttc_s };
    VehicleSummary {
        min_gap_m: min_gap_m.is_finite().then_some(min_gap_m),
        min_ttc_s: min_ttc_s.is_finite().then_some(min_ttc_s),
        max_brake_mps2: tally.max_brake_mps2,
        stopped: speed_mps == 0.0,
    }
}

/// A finished run.
pub(super) fn assemble_result(
    impacts: Vec<Impact>,
    vehicles: Vec<VehicleSummary>,
    interventions: Vec<Intervention>,
    trace: Option<Trace>,
    failed: Option<FailedController>,
) -> SimulationResult {
    let touched = || impacts.first().map_or(Outcome::NoCollision, |impact| Outcome::Collision(impact.contact));
    let outcome = failed.map_or_else(touched, Outcome::ControllerFailed);
    SimulationResult { outcome, impacts, vehicles, interventions, trace }
}

/// Whether a run keeps the motion of all vehicles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordingLevel {
    /// Only outcome, impacts and summaries.
    Summary,
    /// A trace as well.
    Trace,
}

impl Trace {
    /// An empty trace for the vehicles of a platoon, or none if it is not to be kept.
    pub(super) fn begin(keep: RecordingLevel, platoon: &PlatoonState, samples: usize) -> Option<Self> {
        let track = |(&length_m, &mass_kg): (&f64, &f64)| Track {
            length_m,
            mass_kg,
            position_m: Vec::with_capacity(samples),
            speed_mps: Vec::with_capacity(samples),
            acceleration_mps2: Vec::with_capacity(samples),
            in_lane_s: Track::THROUGHOUT_S,
        };
        (keep == RecordingLevel::Trace).then(|| Self {
            time_s: Vec::with_capacity(samples),
            vehicles: platoon.length_m.iter().zip(&platoon.mass_kg).map(track).collect(),
        })
    }

    /// Adds a sample; `motion` yields one entry a vehicle.
    pub(super) fn push_sample(&mut self, time_s: f64, motion: impl Iterator<Item = Motion>) {
        self.time_s.push(time_s);
        for (track, motion) in self.vehicles.iter_mut().zip(motion) {
            track.position_m.push(motion.position_m);
            track.speed_mps.push(motion.speed_mps);
            track.acceleration_mps2.push(motion.acceleration_mps2);
        }
    }
}
