//! The emergency brake of Autoware, reimplemented from its published equation and parameters.
//!
//! Source: repository autowarefoundation/autoware.universe, `control/autoware_autonomous_emergency_braking`, README,
//! section 5 (commit 0917045), and `config/autonomous_emergency_braking.param.yaml` (commit 19940d5). The README states
//! other values for `a_obj_min` (-3 m/s²) and the offset (2 m); the parameter file is what the module loads.
//!
//! Not modelled: paths, point clouds and clustering, the speed that the module estimates from them, its rate of 10 Hz,
//! its obstacle memory of 1 s, and the diagnosis that stops the vehicle. The stop is modelled as braking at `a_ego_min`
//! with the module's hold time of 2 s. The published module limits its path to 10 m (IMU) or 4.5 s (MPC).

use super::reaction::whole_steps;
use super::{BuiltIn, Controller, ControllerFailure, Ego};
use crate::observation::Observation;
use crate::settings::settings;

/// Speed below which the module does not act, in m/s (README, section 1).
const MIN_SPEED_MPS: f64 = 0.1;

settings! {
    /// Settings of Autoware's emergency brake. The names in parentheses are Autoware's.
    AutowareAebSettings {
        /// Response time, in seconds (t_response).
        response_s: 1.0, 0.0..=10.0, 0.0..=2.0;
        /// Own deceleration, in m/s², positive (-a_ego_min).
        brake_mps2: 3.0, 0.1..=30.0, 1.0..=9.0;
        /// Deceleration expected of the object, in m/s², positive (-a_obj_min).
        object_brake_mps2: 1.0, 0.1..=30.0, 0.5..=9.0;
        /// Distance added, in metres (longitudinal_offset_margin).
        offset_m: 1.0, 0.0..=100.0, 0.0..=5.0;
        /// Time for which a detected collision is kept, in seconds (collision_keeping_sec).
        hold_s: 2.0, 0.0..=60.0, 0.0..=5.0;
    }
}

impl AutowareAebSettings {
    /// Returns the distance below which the brake fires: v t + v²/(2 a) - v_o²/(2 a_o) + offset, in metres.
    fn rss_distance_m(&self, speed_mps: f64, object_mps: f64) -> f64 {
        let Self {
            response_s,
            brake_mps2,
            object_brake_mps2,
            offset_m,
            ..
        } = *self;
        speed_mps * response_s + speed_mps * speed_mps / (2.0 * brake_mps2)
            - object_mps * object_mps.abs() / (2.0 * object_brake_mps2)
            + offset_m
    }
}

/// A driver that holds its speed, and Autoware's emergency brake.
#[derive(Debug, Clone, PartialEq)]
pub struct AutowareAeb {
    settings: AutowareAebSettings,
    hold_steps: u32,
    steps_left: u32,
}

impl BuiltIn for AutowareAeb {
    const NAME: &'static str = "autoware-aeb";
    const SUMMARY: &'static str = "hold speed; brake at 3 m/s² below Autoware's RSS distance (not modelled: paths, \
    point clouds, estimated speeds, rate of 10 Hz)";
    type Settings = AutowareAebSettings;
    type Driver = Self;

    fn start(settings: &AutowareAebSettings, ego: &Ego, _seed: u64) -> Self {
        Self {
            settings: settings.clone(),
            hold_steps: whole_steps(settings.hold_s, ego.step_s),
            steps_left: 0,
        }
    }
}

impl Controller for AutowareAeb {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let fires = observation.speed_mps >= MIN_SPEED_MPS
            && observation.ahead.is_some_and(|ahead| {
                ahead.gap_m
                    < self
                        .settings
                        .rss_distance_m(observation.speed_mps, ahead.speed_mps)
            });
        self.steps_left = if fires {
            self.hold_steps.saturating_add(1)
        } else {
            self.steps_left.saturating_sub(1)
        };
        Ok(if self.steps_left > 0 {
            -self.settings.brake_mps2
        } else {
            0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind};
    use super::*;

    /// 15 m/s behind 10 m/s: 15 + 225/6 - 100/2 + 1 = 3.5 m. Behind a standing object: 53.5 m.
    #[test]
    fn fires_below_the_distance_computed_by_hand_and_holds() {
        let start = || AutowareAeb::start(&AutowareAebSettings::default(), &EGO, 0);
        for (ahead_mps, by_hand_m) in [(10.0, 3.5), (0.0, 53.5)] {
            assert_eq!(
                command_behind(&mut start(), 15.0, by_hand_m, ahead_mps, 0.0),
                0.0
            );
            let mut driver = start();
            assert_eq!(
                command_behind(&mut driver, 15.0, by_hand_m - 0.01, ahead_mps, 0.0),
                -3.0
            );
            let braking_steps = (0..300)
                .filter(|_| command_behind(&mut driver, 15.0, 500.0, 15.0, 0.0) < 0.0)
                .count();
            assert_eq!(braking_steps, 200, "kept for 2 s");
        }
        assert_eq!(
            command_behind(&mut start(), 0.05, 0.1, 0.0, 0.0),
            0.0,
            "not below 0.1 m/s"
        );
    }
}
