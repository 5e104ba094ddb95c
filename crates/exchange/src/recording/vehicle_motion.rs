//! Recorded speeds of a vehicle of a scenario.

use super::MAX_PLAUSIBLE_ACCEL_MPS2;
use super::dropped::EpisodeProblem;
use super::motion::SpeedSample;
use super::series::round_to_milli;
use crumple_sim::scenario::{Driver, LeadProfile, RecordedSpeeds, VehicleSpec};

/// Recorded speeds of a vehicle, and the hardest accelerations between two samples. Times count from the start of the
/// scenario.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VehicleMotion {
    /// Time of each sample, in seconds, to the millisecond.
    pub time_s: Vec<f64>,
    /// Speed at each of them, in m/s, to three decimals.
    pub speed_mps: Vec<f64>,
    /// Hardest braking between two samples, in m/s², positive.
    pub hardest_brake_mps2: f64,
    /// Hardest acceleration between two samples, in m/s².
    pub hardest_accel_mps2: f64,
}

impl VehicleMotion {
    /// Describes samples. The error is an acceleration that no vehicle has.
    pub(super) fn new(samples: &[SpeedSample]) -> Result<Self, EpisodeProblem> {
        let start_ms = samples.first().map_or(0, |first| first.time_ms);
        let mut motion = Self::default();
        let mut before: Option<&SpeedSample> = None;
        for sample in samples {
            if let Some(before) = before {
                motion.add_acceleration(before, sample)?;
            }
            motion
                .time_s
                .push((sample.time_ms - start_ms) as f64 / 1000.0);
            motion.speed_mps.push(sample.speed_mps);
            before = Some(sample);
        }
        Ok(motion)
    }

    /// Describes samples up to the first acceleration that no vehicle has.
    pub(super) fn until_jump(samples: &[SpeedSample]) -> Self {
        let jump = samples.windows(2).position(|pair| match pair {
            [from, to] => acceleration_mps2(from, to).abs() > MAX_PLAUSIBLE_ACCEL_MPS2,
            _ => false,
        });
        let end = jump.map_or(samples.len(), |index| index + 1);
        Self::new(samples.get(..end).unwrap_or_default()).unwrap_or_default()
    }

    fn add_acceleration(
        &mut self,
        from: &SpeedSample,
        to: &SpeedSample,
    ) -> Result<(), EpisodeProblem> {
        let found_mps2 = acceleration_mps2(from, to);
        if found_mps2.abs() > MAX_PLAUSIBLE_ACCEL_MPS2 {
            return Err(EpisodeProblem::SpeedJump {
                at_s: to.time_ms as f64 / 1000.0,
                found_mps2,
            });
        }
        self.hardest_brake_mps2 = self.hardest_brake_mps2.max(-found_mps2);
        self.hardest_accel_mps2 = self.hardest_accel_mps2.max(found_mps2);
        Ok(())
    }

    /// Makes a vehicle repeat these speeds, and raises its limits where the recording exceeds them.
    pub(super) fn script(&self, vehicle: &mut VehicleSpec) {
        vehicle.driver = Driver::Profile(LeadProfile::Recorded(RecordedSpeeds {
            time_s: self.time_s.clone(),
            speed_mps: self.speed_mps.clone(),
        }));
        vehicle.max_brake_mps2 = raise_limit(vehicle.max_brake_mps2(), self.hardest_brake_mps2);
        vehicle.max_accel_mps2 = raise_limit(vehicle.max_accel_mps2(), self.hardest_accel_mps2);
    }

    /// States that the recording ends before the scenario, if it does.
    pub(super) fn describe_end(&self, whose: &str, duration_s: f64) -> Option<String> {
        let end_s = self.time_s.last().filter(|end_s| **end_s < duration_s)?;
        Some(format!(
            "The recording of {whose} speed ends after {end_s:.1} s; it then holds the last one."
        ))
    }
}

fn acceleration_mps2(from: &SpeedSample, to: &SpeedSample) -> f64 {
    1000.0 * (to.speed_mps - from.speed_mps) / (to.time_ms - from.time_ms) as f64
}

/// Returns the limit, rounded up to a tenth, if the recording exceeds the class.
fn raise_limit(class_mps2: f64, recorded_mps2: f64) -> Option<f64> {
    (recorded_mps2 > class_mps2)
        .then(|| (recorded_mps2 * 10.0).floor() / 10.0 + 0.1)
        .map(round_to_milli)
}
