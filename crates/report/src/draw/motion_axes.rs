//! The axes of the diagrams, for one run or for several that are compared.

use super::axis::Axis;
use super::motion::vehicle_pairs;
use super::scale::{extent, pad_interval};
use crumple_sim::engine::{Trace, Track};

/// Largest time to collision that figures show, in seconds.
pub(super) const MAX_TTC_S: f64 = 10.0;

/// The ranges of the axes of time, position, speed, gap and acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionAxes {
    time_s: (f64, f64),
    position_m: (f64, f64),
    speed_mps: (f64, f64),
    gap_m: (f64, f64),
    acceleration_mps2: (f64, f64),
}

impl MotionAxes {
    /// Creates axes that hold one run.
    #[must_use]
    pub fn from_trace(trace: &Trace) -> Self {
        Self::from_traces([trace])
    }

    /// Creates axes that hold all of these runs.
    #[must_use]
    pub fn from_traces<'a>(traces: impl IntoIterator<Item = &'a Trace>) -> Self {
        let traces: Vec<&Trace> = traces.into_iter().collect();
        let tracks: Vec<&Track> = traces.iter().flat_map(|trace| &trace.vehicles).collect();
        let positions_m = tracks.iter().flat_map(|track| {
            let (low, high) = extent(track.position_m.iter().copied());
            [low - track.length_m, high]
        });
        let (first_s, last_s) =
            extent(traces.iter().flat_map(|trace| trace.time_s.iter().copied()));
        let speeds_mps = tracks
            .iter()
            .flat_map(|track| track.speed_mps.iter().copied());
        let fastest_mps = extent(speeds_mps).1;
        let accelerations_mps2 = tracks
            .iter()
            .flat_map(|track| track.acceleration_mps2.iter().copied());
        let (hardest_mps2, largest_mps2) = extent(accelerations_mps2);
        let pairs = traces.iter().flat_map(|trace| vehicle_pairs(trace));
        let gaps_m =
            pairs.flat_map(|(_, pair)| pair.gaps_m().map(|(_, gap_m)| gap_m).collect::<Vec<_>>());
        let (least_m, most_m) = extent(gaps_m);
        Self {
            // Extend beyond the last sample, so that the marker of a final collision is not cut off.
            time_s: (first_s, last_s + 0.02 * (last_s - first_s)),
            position_m: pad_interval(extent(positions_m), 0.03),
            speed_mps: pad_interval((0.0, fastest_mps.max(1.0)), 0.04),
            gap_m: pad_interval((least_m.min(0.0), most_m.max(1.0)), 0.05),
            acceleration_mps2: pad_interval((hardest_mps2.min(-1.0), largest_mps2.max(1.0)), 0.05),
        }
    }

    pub(super) fn time(&self) -> Axis {
        Axis::numeric("Time (s)", self.time_s, 6)
    }

    pub(super) fn position(&self) -> Axis {
        Axis::numeric("", self.position_m, 7)
    }

    pub(super) fn speed(&self) -> Axis {
        Axis::numeric("", self.speed_mps, 6)
    }

    pub(super) fn acceleration(&self) -> Axis {
        Axis::numeric("", self.acceleration_mps2, 6)
    }

    pub(super) fn ttc(&self) -> Axis {
        Axis::numeric("", (0.0, MAX_TTC_S), 6)
    }

    pub(super) fn gap(&self) -> Axis {
        Axis::numeric("", self.gap_m, 6)
    }
}
