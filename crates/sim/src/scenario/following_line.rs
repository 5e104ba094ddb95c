//! Lines of vehicles under test behind a leader of constant or oscillating speed.

use super::{
    Driver, InvalidField, LeadProfile, RecordedSpeeds, Scenario, ScenarioSpec, VehicleClass,
    VehicleSpec,
};

/// Distance between the speeds that describe an oscillation, in steps.
const STEPS_PER_SAMPLE: usize = 10;

/// An oscillation of the leader's speed around its mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedOscillation {
    /// Amplitude, in m/s.
    pub amplitude_mps: f64,
    /// Frequency, in rad/s.
    pub frequency_rad_per_s: f64,
    /// Time in which the amplitude grows linearly from 0, in seconds.
    pub build_up_s: f64,
}

/// Initial state of a line of vehicles.
#[derive(Debug, Clone, PartialEq)]
pub struct FollowingLine {
    /// Speed of the leader, in m/s.
    pub mean_speed_mps: f64,
    /// Additional speed of the vehicles under test, in m/s.
    pub closing_mps: f64,
    /// Gap of each vehicle under test to the vehicle ahead, in metres, front to rear.
    pub gaps_m: Vec<f64>,
}

impl FollowingLine {
    /// Creates the scenario of `steps` steps. Without an oscillation the leader keeps its speed.
    ///
    /// # Errors
    /// [`InvalidField`] for no vehicles under test, too many, gaps that leave no room, or impossible speeds.
    pub fn scenario(
        &self,
        oscillation: Option<SpeedOscillation>,
        steps: usize,
    ) -> Result<Scenario, InvalidField> {
        let empty = ScenarioSpec::new("following-line".to_owned(), 1.0, Vec::new());
        let duration_s = steps as f64 * empty.step_s;
        let profile = oscillation.map_or(LeadProfile::ConstantSpeed, |oscillation| {
            LeadProfile::Recorded(oscillation.speeds(self.mean_speed_mps, steps, empty.step_s))
        });
        let class = VehicleClass::Light;
        let mut vehicles = vec![VehicleSpec::new(
            class,
            0.0,
            self.mean_speed_mps,
            Driver::Profile(profile),
        )];
        let mut position_m = 0.0;
        for gap_m in &self.gaps_m {
            position_m -= class.length_m() + gap_m;
            let speed_mps = self.mean_speed_mps + self.closing_mps;
            vehicles.push(VehicleSpec::new(
                class,
                position_m,
                speed_mps,
                Driver::UnderTest,
            ));
        }
        Scenario::new(ScenarioSpec {
            duration_s,
            vehicles,
            ..empty
        })
    }
}

impl SpeedOscillation {
    fn speeds(self, mean_speed_mps: f64, steps: usize, step_s: f64) -> RecordedSpeeds {
        let sample_s = STEPS_PER_SAMPLE as f64 * step_s;
        let samples = steps.div_ceil(STEPS_PER_SAMPLE) + 1;
        let time_s: Vec<f64> = (0..samples)
            .map(|sample| sample as f64 * sample_s)
            .collect();
        let speed_mps = time_s
            .iter()
            .map(|&time_s| self.speed_mps(mean_speed_mps, time_s))
            .collect();
        RecordedSpeeds { time_s, speed_mps }
    }

    fn speed_mps(self, mean_speed_mps: f64, time_s: f64) -> f64 {
        let grown = if time_s < self.build_up_s {
            time_s / self.build_up_s
        } else {
            1.0
        };
        mean_speed_mps + grown * self.amplitude_mps * (self.frequency_rad_per_s * time_s).sin()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_leader_oscillates_after_it_has_built_up() {
        let line = FollowingLine {
            mean_speed_mps: 8.0,
            closing_mps: 2.0,
            gaps_m: vec![12.0, 13.0],
        };
        let oscillation = SpeedOscillation {
            amplitude_mps: 0.5,
            frequency_rad_per_s: 1.0,
            build_up_s: 4.0,
        };
        let scenario = line.scenario(Some(oscillation), 1234).unwrap();
        let Driver::Profile(LeadProfile::Recorded(recorded)) = &scenario.vehicles()[0].driver
        else {
            panic!("an oscillation is a record of speeds");
        };
        assert_eq!((scenario.steps(), recorded.time_s.len()), (1234, 125));
        assert!((recorded.speed_at_mps(2.0) - (8.0 + 0.25 * 2.0_f64.sin())).abs() < 1e-12);
        assert!((recorded.speed_at_mps(10.0) - (8.0 + 0.5 * 10.0_f64.sin())).abs() < 1e-12);
        assert_eq!(
            (scenario.initial_gap_m(1), scenario.initial_gap_m(2)),
            (Some(12.0), Some(13.0))
        );
        assert!(
            (1..3).all(|index| scenario.is_under_test(index)
                && scenario.vehicles()[index].speed_mps == 10.0)
        );
        assert!(
            FollowingLine {
                gaps_m: vec![],
                ..line.clone()
            }
            .scenario(None, 10)
            .is_err()
        );
        assert!(
            FollowingLine {
                gaps_m: vec![f64::NAN],
                ..line
            }
            .scenario(None, 10)
            .is_err()
        );
    }
}
