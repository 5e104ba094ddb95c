//! A controller that brakes at a constant rate as soon as the leader brakes.

use super::reaction::{ReactionTimer, whole_steps};
use super::{BuiltIn, Controller, ControllerFailure, Ego};
use crate::observation::Observation;
use crate::settings::settings;

settings! {
    /// Settings of the controller that brakes at a constant rate.
    ConstantBrakeSettings {
        /// Deceleration held to standstill, in m/s², positive.
        rate_mps2: 3.25, 0.0..=30.0, 0.0..=9.0;
        /// Observed deceleration of the leader that starts the braking, in m/s², positive.
        trigger_mps2: 1.5, 0.0..=30.0, 0.0..=4.0;
        /// Time between that observation and braking, in seconds.
        delay_s: 0.05, 0.0..=10.0, 0.0..=1.0;
    }
}

/// A controller that, a fixed delay after its leader first brakes, brakes at a constant rate to standstill.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstantBrake {
    rate_mps2: f64,
    trigger_mps2: f64,
    delay_steps: u32,
    trigger_timer: ReactionTimer,
}

impl BuiltIn for ConstantBrake {
    const NAME: &'static str = "constant-brake";
    const SUMMARY: &'static str =
        "brakes at 3.25 m/s² from 0.05 s after it observes that the vehicle ahead brakes";
    type Settings = ConstantBrakeSettings;
    type Driver = Self;

    fn start(settings: &ConstantBrakeSettings, ego: &Ego, _seed: u64) -> Self {
        Self {
            rate_mps2: settings.rate_mps2,
            trigger_mps2: settings.trigger_mps2,
            delay_steps: whole_steps(settings.delay_s, ego.step_s),
            trigger_timer: ReactionTimer::default(),
        }
    }
}

impl Controller for ConstantBrake {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let is_braking = observation
            .ahead
            .is_some_and(|ahead| ahead.acceleration_mps2 < -self.trigger_mps2);
        Ok(
            if self.trigger_timer.tick(is_braking) >= Some(self.delay_steps) {
                -self.rate_mps2
            } else {
                0.0
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind};
    use super::*;

    #[test]
    fn brakes_five_steps_after_the_leader_brakes() {
        let mut controller = ConstantBrake::start(&ConstantBrakeSettings::default(), &EGO, 0);
        assert_eq!(
            command_behind(&mut controller, 25.0, 16.0, 25.0, -1.0),
            0.0,
            "below the trigger"
        );
        let commands = [0; 7].map(|_| command_behind(&mut controller, 25.0, 16.0, 25.0, -3.0));
        assert_eq!(commands, [0.0, 0.0, 0.0, 0.0, 0.0, -3.25, -3.25]);
        assert_eq!(
            command_behind(&mut controller, 25.0, 16.0, 25.0, 0.0),
            -3.25,
            "to standstill"
        );
    }
}
