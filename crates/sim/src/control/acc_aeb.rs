//! Adaptive cruise control with automatic emergency braking.

use super::baseline::{Aeb, FIRING_TTC_S};
use super::set_speed::{self, NO_SET_SPEED_MPS};
use super::{BuiltIn, Controller, ControllerFailure, Ego};
use crate::observation::Observation;
use crate::settings::settings;

settings! {
    /// Settings of adaptive cruise control with emergency braking.
    AccAebSettings {
        /// Time to collision below which the controller brakes fully, in seconds.
        ttc_s: FIRING_TTC_S, 0.0..=100.0, 0.0..=4.0;
        /// Desired time gap in seconds (ISO 15622:2018, 6.2.3: at least 0.8 s in steady state).
        time_headway_s: 0.8, 0.0..=10.0, 0.0..=3.0;
        /// Gap at standstill, in metres.
        standstill_gap_m: 2.0, 0.0..=100.0, 0.0..=5.0;
        /// Acceleration per metre of spacing error, in 1/s².
        gap_gain_per_s2: 0.25, 0.0..=10.0, 0.0..=1.0;
        /// Acceleration per m/s of speed difference, in 1/s.
        speed_gain_per_s: 0.8, 0.0..=10.0, 0.0..=2.0;
        /// Maximum deceleration of the cruise control, in m/s² (ISO 15622:2018, 6.4: at most 3.5 at motorway speeds).
        comfort_brake_mps2: 3.5, 0.0..=30.0, 0.0..=5.0;
        /// Maximum acceleration of the cruise control, in m/s².
        comfort_accel_mps2: 2.0, 0.0..=30.0, 0.0..=3.0;
        /// Set speed, in m/s, which the cruise control does not exceed and drives on an empty road. 100, the default,
        /// stands for none: it follows its leader at any speed, and holds its speed on an empty road.
        set_speed_mps: NO_SET_SPEED_MPS, 0.1..=100.0, 5.0..=100.0, none NO_SET_SPEED_MPS;
    }
}

impl AccAebSettings {
    /// Returns the set speed, in m/s; `None` without one.
    #[must_use]
    pub fn set_speed(&self) -> Option<f64> {
        set_speed::is_set(self.set_speed_mps).then_some(self.set_speed_mps)
    }
}

/// A controller that follows at a constant time gap within comfort limits and brakes fully at a low TTC.
///
/// The command is the usual linear one, a = k_g (gap - s₀ - T v) + k_v (v_ahead - v), with T from bumper to bumper
/// (Rajamani, *Vehicle Dynamics and Control*, 2nd edition, section 6.6.1 has its constant-time-gap family). It is at
/// most k_v (u - v) with a set speed u. Without one it is at most k_v (v_ahead + 2 m/s - v), or 0 if that is negative:
/// the controller closes a gap at 2 m/s at most, but never brakes for this reason.
#[derive(Debug, Clone, PartialEq)]
pub struct AccAeb {
    settings: AccAebSettings,
    aeb: Aeb,
}

impl BuiltIn for AccAeb {
    const NAME: &'static str = "acc-aeb";
    const SUMMARY: &'static str =
        "cruise control at a time gap of 0.8 s, emergency braking while TTC < 1.4 s";
    type Settings = AccAebSettings;
    type Driver = Self;

    fn start(settings: &AccAebSettings, ego: &Ego, _seed: u64) -> Self {
        Self {
            settings: settings.clone(),
            aeb: Aeb::new(settings.ttc_s, ego),
        }
    }
}

impl Controller for AccAeb {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        if self.aeb.demands_braking(observation) {
            return Ok(-self.aeb.max_brake_mps2);
        }
        let acc = &self.settings;
        let v = observation.speed_mps;
        let cruise =
            set_speed::max_accel_mps2(acc.set_speed_mps, acc.speed_gain_per_s, observation);
        let follow = observation.ahead.map_or(f64::INFINITY, |ahead| {
            let spacing_error_m = ahead.gap_m - acc.standstill_gap_m - acc.time_headway_s * v;
            acc.gap_gain_per_s2 * spacing_error_m + acc.speed_gain_per_s * (ahead.speed_mps - v)
        });
        Ok(cruise
            .min(follow)
            .max(-acc.comfort_brake_mps2)
            .min(acc.comfort_accel_mps2))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind};
    use super::*;

    #[test]
    fn cruises_follows_and_brakes() {
        let settings = AccAebSettings {
            set_speed_mps: 25.0,
            ..AccAebSettings::default()
        };
        let mut controller = AccAeb::start(&settings, &EGO, 0);
        assert_eq!(
            command_behind(&mut controller, 25.0, 200.0, 25.0, 0.0),
            0.0,
            "holds its set speed on an open road"
        );
        assert_eq!(
            command_behind(&mut controller, 25.0, 22.0, 25.0, 0.0),
            0.0,
            "2 m + 0.8 s · 25 m/s is its gap"
        );
        assert_eq!(
            command_behind(&mut controller, 25.0, 21.0, 25.0, 0.0),
            -0.25
        );
        assert_eq!(
            command_behind(&mut controller, 25.0, 10.0, 20.0, 0.0),
            -3.5,
            "comfort limit"
        );
        assert_eq!(
            command_behind(&mut controller, 25.0, 10.0, 15.0, 0.0),
            -7.5,
            "TTC is 1 s"
        );
        assert_eq!(
            command_behind(&mut controller, 20.0, 200.0, 25.0, 0.0),
            2.0,
            "back to the set speed"
        );
    }

    #[test]
    fn follows_without_a_limit_by_default() {
        let mut controller = AccAeb::start(&AccAebSettings::default(), &EGO, 0);
        let mut command = |speed_mps, gap_m, ahead_mps| {
            command_behind(&mut controller, speed_mps, gap_m, ahead_mps, 0.0)
        };
        assert_eq!(command(0.0, 2.0, 0.0), 0.0, "at its gap at standstill");
        assert_eq!(
            command(0.0, 4.0, 1.0),
            0.5 + 0.8,
            "drives off behind a leader that drives off"
        );
        assert_eq!(
            command(25.0, 30.0, 25.0),
            1.6,
            "the gap is 8 m too long, and it closes in at up to 2 m/s"
        );
        assert!((command(26.0, 200.0, 25.0) - 0.8).abs() < 1e-12);
        assert_eq!(command(28.0, 200.0, 25.0), 0.0);
        assert_eq!(
            command(25.0, 500.0, 0.0),
            0.0,
            "does not accelerate towards a standing vehicle"
        );
    }
}
