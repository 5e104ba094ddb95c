//! Braking at one rate as soon as the vehicle ahead brakes: the other trivial controller.

use super::{Controller, Ego};
use crate::estimate::Observation;
use crate::scenario::ConstantBrakeSettings;

/// Holds speed; from a set delay after the vehicle ahead is first seen to brake, brakes at a constant rate to standstill.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstantBrake {
    rate_mps2: f64,
    trigger_mps2: f64,
    delay_steps: u32,
    /// Steps since the vehicle ahead was first seen to brake.
    seen_for_steps: Option<u32>,
}

impl ConstantBrake {
    /// The controller for a vehicle.
    #[must_use]
    pub fn new(settings: &ConstantBrakeSettings, ego: &Ego) -> Self {
        Self {
            rate_mps2: settings.rate_mps2,
            trigger_mps2: settings.trigger_mps2,
            delay_steps: (settings.delay_s / ego.step_s).round() as u32,
            seen_for_steps: None,
        }
    }
}

impl Controller for ConstantBrake {
    #[inline]
    fn act(&mut self, seen: &Observation) -> f64 {
        let seen_braking = || seen.ahead.is_some_and(|ahead| ahead.acceleration_mps2 < -self.trigger_mps2);
        self.seen_for_steps = match self.seen_for_steps {
            Some(steps) => Some(steps.saturating_add(1)),
            None => seen_braking().then_some(0),
        };
        if self.seen_for_steps >= Some(self.delay_steps) { -self.rate_mps2 } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, behind};
    use super::*;

    #[test]
    fn brakes_five_steps_after_it_sees_braking() {
        let mut controller = ConstantBrake::new(&ConstantBrakeSettings::default(), &EGO);
        assert_eq!(controller.act(&behind(25.0, 16.0, 25.0, -1.0)), 0.0, "below the trigger");
        let commands = [0; 7].map(|_| controller.act(&behind(25.0, 16.0, 25.0, -3.0)));
        assert_eq!(commands, [0.0, 0.0, 0.0, 0.0, 0.0, -3.25, -3.25]);
        assert_eq!(controller.act(&behind(25.0, 16.0, 25.0, 0.0)), -3.25, "to standstill");
    }
}
