//! An emergency brake with a free threshold and braking level, for studies.

use super::baseline::Aeb;
use super::{BuiltIn, Controller, ControllerFailure, Ego};
use crate::observation::Observation;
use crate::settings::settings;

settings! {
    /// Settings of the configurable emergency brake.
    EmergencyBrakeSettings {
        /// Time to collision below which the brake fires, in seconds; 0 never fires.
        ttc_s: 1.4, 0.0..=100.0, 0.0..=4.0;
        /// Deceleration of the brake, in m/s², positive; the vehicle's own limit applies, too.
        brake_mps2: 7.5, 0.0..=30.0, 2.0..=9.0;
    }
}

/// A driver that holds its speed, and an emergency brake that holds its braking until the vehicle no longer closes in.
#[derive(Debug, Clone, PartialEq)]
pub struct EmergencyBrake {
    brake: HeldBrake,
}

impl BuiltIn for EmergencyBrake {
    const NAME: &'static str = "emergency-brake";
    const SUMMARY: &'static str = "hold speed; brake at 7.5 m/s² from TTC < 1.4 s until no longer \
        closing in (both numbers are settings)";
    type Settings = EmergencyBrakeSettings;
    type Driver = Self;

    fn start(settings: &EmergencyBrakeSettings, ego: &Ego, _seed: u64) -> Self {
        Self {
            brake: HeldBrake::new(settings.ttc_s, settings.brake_mps2, ego),
        }
    }
}

impl Controller for EmergencyBrake {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        Ok(-self.brake.demand_mps2(observation).unwrap_or(0.0))
    }
}

/// An emergency brake that fires below a time to collision, and holds its braking while the vehicle closes in.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct HeldBrake {
    aeb: Aeb,
    brake_mps2: f64,
    never_fires: bool,
    is_braking: bool,
}

impl HeldBrake {
    pub(super) fn new(ttc_s: f64, brake_mps2: f64, ego: &Ego) -> Self {
        Self {
            aeb: Aeb::new(ttc_s, ego),
            brake_mps2,
            never_fires: ttc_s == 0.0,
            is_braking: false,
        }
    }

    /// Returns the demanded braking, in m/s², positive; `None` while the brake is released.
    #[inline]
    pub(super) fn demand_mps2(&mut self, observation: &Observation) -> Option<f64> {
        if self.never_fires {
            return None;
        }
        let is_closing = observation
            .ahead
            .is_some_and(|ahead| observation.speed_mps > ahead.speed_mps);
        self.is_braking = self.aeb.demands_braking(observation) || self.is_braking && is_closing;
        self.is_braking.then_some(self.brake_mps2)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind};
    use super::*;

    #[test]
    fn brakes_at_its_level_until_the_gap_stops_closing() {
        let settings = EmergencyBrakeSettings {
            ttc_s: 2.0,
            brake_mps2: 4.0,
        };
        let mut driver = EmergencyBrake::start(&settings, &EGO, 0);
        assert_eq!(
            command_behind(&mut driver, 20.0, 20.0, 10.0, 0.0),
            0.0,
            "TTC is exactly 2 s"
        );
        assert_eq!(command_behind(&mut driver, 20.0, 19.99, 10.0, 0.0), -4.0);
        assert_eq!(
            command_behind(&mut driver, 10.1, 50.0, 10.0, 0.0),
            -4.0,
            "still closing in"
        );
        assert_eq!(
            command_behind(&mut driver, 10.0, 50.0, 10.0, 0.0),
            0.0,
            "released"
        );
        let mut never = EmergencyBrake::start(
            &EmergencyBrakeSettings {
                ttc_s: 0.0,
                ..settings
            },
            &EGO,
            0,
        );
        assert_eq!(command_behind(&mut never, 20.0, 0.0, 0.0, 0.0), 0.0);
    }
}
