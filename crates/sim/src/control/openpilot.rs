//! The longitudinal limits of openpilot, reimplemented from its published equations and parameters.
//!
//! Source: repository commaai/openpilot, `selfdrive/controls/lib/longitudinal_mpc_lib/long_mpc.py` (commit 007bc41):
//! `MIN_ACCEL` -3.5 m/s², `COMFORT_BRAKE` 2.5 m/s², `STOP_DISTANCE` 6 m, `T_FOLLOW` 1.45 s; an obstacle at
//! gap + v_lead²/(2 b) is to be v²/(2 b) + t_follow v + 6 m away, with at least three quarters of that as the boundary
//! of its danger zone.
//!
//! Not modelled: the model predictive controller, with its costs of jerk and its horizon of 10 s; radar and vision; the
//! limits of each car, its actuators and the driver's alerts. This controller brakes at the constant deceleration
//! that stops at the stop distance before the place where the lead stops at its comfort braking. Openpilot's cost would
//! brake earlier and softer.

use super::set_speed::{self, NO_SET_SPEED_MPS};
use super::{BuiltIn, Controller, ControllerFailure, Ego};
use crate::observation::Observation;
use crate::settings::settings;

settings! {
    /// Settings of openpilot's longitudinal limits.
    OpenpilotSettings {
        /// Largest deceleration, in m/s², positive (-MIN_ACCEL).
        max_brake_mps2: 3.5, 0.1..=30.0, 1.0..=9.0;
        /// Deceleration of the equations of distance, in m/s², positive (COMFORT_BRAKE).
        comfort_brake_mps2: 2.5, 0.1..=30.0, 1.0..=9.0;
        /// Distance at standstill, in metres (STOP_DISTANCE).
        stop_distance_m: 6.0, 0.0..=100.0, 0.0..=10.0;
        /// Time gap, in seconds (T_FOLLOW).
        follow_s: 1.45, 0.0..=10.0, 0.0..=3.0;
        /// Largest acceleration, in m/s²; chosen.
        max_accel_mps2: 1.2, 0.0..=30.0, 0.5..=2.0;
        /// Set speed, in m/s, which the controller does not exceed and drives on an empty road. 100, the default,
        /// stands for none: it follows its leader at any speed, and holds its speed on an empty road.
        set_speed_mps: NO_SET_SPEED_MPS, 0.1..=100.0, 5.0..=100.0, none NO_SET_SPEED_MPS;
    }
}

impl OpenpilotSettings {
    /// Returns v²/(2 b) + t_follow v + stop distance - v_lead²/(2 b), in metres.
    fn desired_distance_m(&self, speed_mps: f64, lead_mps: f64) -> f64 {
        let Self {
            comfort_brake_mps2,
            stop_distance_m,
            follow_s,
            ..
        } = *self;
        (speed_mps * speed_mps - lead_mps * lead_mps) / (2.0 * comfort_brake_mps2)
            + follow_s * speed_mps
            + stop_distance_m
    }
}

/// Acceleration per m/s below the speed limit, in 1/s; chosen.
const SPEED_GAIN_PER_S: f64 = 1.0;

/// A controller that keeps openpilot's follow distance within its limits of acceleration.
#[derive(Debug, Clone, PartialEq)]
pub struct Openpilot {
    settings: OpenpilotSettings,
}

impl BuiltIn for Openpilot {
    const NAME: &'static str = "openpilot";
    const SUMMARY: &'static str = "follow at openpilot's published distance, brake at most at 3.5 m/s² (not modelled: \
    its predictive controller, radar, vision, actuators)";
    type Settings = OpenpilotSettings;
    type Driver = Self;

    fn start(settings: &OpenpilotSettings, _ego: &Ego, _seed: u64) -> Self {
        Self {
            settings: settings.clone(),
        }
    }
}

impl Controller for Openpilot {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let limits = &self.settings;
        let v = observation.speed_mps;
        let cruise = set_speed::max_accel_mps2(limits.set_speed_mps, SPEED_GAIN_PER_S, observation);
        let follow = observation.ahead.map_or(f64::INFINITY, |ahead| {
            let spare_m = ahead.gap_m - limits.desired_distance_m(v, ahead.speed_mps);
            // Spreads the deviation over the time gap, as a follow distance of t_follow seconds allows.
            let spread_s = limits.follow_s.max(0.1);
            let settling_mps2 = spare_m / (spread_s * spread_s) / 4.0;
            if spare_m >= 0.0 {
                return settling_mps2;
            }
            // v²/(2 a) = gap + v_lead²/(2 b) - stop distance: stops where openpilot's equations want it to.
            let obstacle_m =
                ahead.gap_m + ahead.speed_mps * ahead.speed_mps / (2.0 * limits.comfort_brake_mps2);
            let room_m = (obstacle_m - limits.stop_distance_m).max(0.01);
            if v > ahead.speed_mps {
                (-v * v / (2.0 * room_m)).min(settling_mps2)
            } else {
                settling_mps2.max(-1.0)
            }
        });
        Ok(cruise
            .min(follow)
            .max(-limits.max_brake_mps2)
            .min(limits.max_accel_mps2))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind};
    use super::*;

    fn command(speed_mps: f64, gap_m: f64, lead_mps: f64) -> f64 {
        let mut controller = Openpilot::start(&OpenpilotSettings::default(), &EGO, 0);
        command_behind(&mut controller, speed_mps, gap_m, lead_mps, 0.0)
    }

    #[test]
    fn distances_and_commands_by_hand() {
        let settings = OpenpilotSettings::default();
        // 20 m/s behind 20 m/s: 1.45 · 20 + 6. Behind a standing lead: 400/5 + 29 + 6.
        assert_eq!(settings.desired_distance_m(20.0, 20.0), 35.0);
        assert_eq!(settings.desired_distance_m(20.0, 0.0), 115.0);
        assert_eq!(command(20.0, 35.0, 20.0), 0.0, "at its distance");
        // 400/(2 · (100 - 6)) = 2.128 m/s², which exceeds 15/(4 · 1.45²) = 1.78 m/s².
        assert!((command(20.0, 100.0, 0.0) + 400.0 / 188.0).abs() < 1e-12);
        assert_eq!(command(20.0, 30.0, 0.0), -3.5, "at its limit");
        assert_eq!(command(20.0, 500.0, 20.0), 1.2, "follows without a limit");
        assert_eq!(
            command(20.0, 500.0, 10.0),
            0.0,
            "closes a gap at 2 m/s at most"
        );
        let settings = OpenpilotSettings {
            set_speed_mps: 20.5,
            ..settings
        };
        let mut controller = Openpilot::start(&settings, &EGO, 0);
        assert_eq!(
            command_behind(&mut controller, 20.0, 500.0, 20.0, 0.0),
            0.5,
            "up to its set speed"
        );
    }
}
