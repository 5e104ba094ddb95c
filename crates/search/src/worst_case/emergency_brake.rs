//! Emergency brakes behind the vehicles under test, read from a replay.

use crumple_sim::control::{AccAebSettings, AebSettings, BuiltInController};
use crumple_sim::engine::Trace;
use crumple_sim::scenario::{Driver, Scenario};

/// Emergency brakes behind the vehicles under test in a replay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EmergencyBrake {
    /// The first brake that fires.
    Fires {
        /// Index of its vehicle.
        vehicle: usize,
        /// Time of firing, in seconds.
        time_s: f64,
    },
    /// No brake fires, or there is none.
    NeverFires,
    /// Some controller behind may have a brake with unknown threshold, and no known brake fires.
    Unknown,
}

impl EmergencyBrake {
    /// Reads a replay, from vehicle `behind` on.
    pub(super) fn from_trace(scenario: &Scenario, behind: usize, trace: &Trace) -> Self {
        let mut first = None::<(f64, usize)>;
        let mut all_known = true;
        for (vehicle, spec) in scenario.vehicles().iter().enumerate().skip(behind) {
            match Threshold::from_driver(&spec.driver) {
                Threshold::None => {}
                Threshold::Unknown => all_known = false,
                Threshold::TimeToCollision(ttc_s) => {
                    let fires =
                        firing_time_s(trace, vehicle, ttc_s).map(|time_s| (time_s, vehicle));
                    first = first
                        .into_iter()
                        .chain(fires)
                        .min_by(|a, b| a.0.total_cmp(&b.0));
                }
            }
        }
        match first {
            Some((time_s, vehicle)) => Self::Fires { vehicle, time_s },
            None if all_known => Self::NeverFires,
            None => Self::Unknown,
        }
    }
}

enum Threshold {
    None,
    /// Time to collision below which it fires, in seconds.
    TimeToCollision(f64),
    Unknown,
}

impl Threshold {
    fn from_driver(driver: &Driver) -> Self {
        match driver {
            Driver::Controller(
                BuiltInController::Baseline(AebSettings { ttc_s })
                | BuiltInController::BaselineUnlatched(AebSettings { ttc_s })
                | BuiltInController::AccAeb(AccAebSettings { ttc_s, .. }),
            ) => Self::TimeToCollision(*ttc_s),
            Driver::Profile(_)
            | Driver::Controller(BuiltInController::Idm(_) | BuiltInController::MatchLeader(_)) => {
                Self::None
            }
            Driver::UnderTest | Driver::Controller(_) | Driver::File(_) => Self::Unknown,
        }
    }
}

/// Returns the time of the first decision at which the time to collision of a vehicle is below a threshold.
fn firing_time_s(trace: &Trace, vehicle: usize, ttc_s: f64) -> Option<f64> {
    let decisions = trace.len().saturating_sub(1);
    trace.pairs(vehicle).iter().find_map(|pair| {
        let first = pair
            .gaps_m()
            .take_while(|(sample, _)| *sample < decisions)
            .find(|&(sample, gap_m)| {
                let rear_mps = sample_or_nan(&pair.rear.speed_mps, sample);
                let front_mps = sample_or_nan(&pair.front.speed_mps, sample);
                gap_m - ttc_s * (rear_mps - front_mps) < 0.0
            })?;
        trace.time_s.get(first.0).copied()
    })
}

fn sample_or_nan(values: &[f64], sample: usize) -> f64 {
    values.get(sample).copied().unwrap_or(f64::NAN)
}
