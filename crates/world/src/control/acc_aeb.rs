//! Adaptive cruise control with automatic emergency braking, as production systems combine them.

use super::baseline::Aeb;
use super::{Controller, Ego};
use crate::estimate::Observation;
use crate::scenario::AccAebSettings;

/// Follows at a constant time headway within comfort limits; brakes fully while time to collision is below a threshold.
///
/// The follower law is the usual linear one, a = k_g (gap - s₀ - T v) + k_v (v_ahead - v), with T counted bumper to
/// bumper (Rajamani, *Vehicle Dynamics and Control*, 2nd edition, section 6.6.1 has its constant-time-gap family).
#[derive(Debug, Clone, PartialEq)]
pub struct AccAeb {
    settings: AccAebSettings,
    aeb: Aeb,
    set_speed_mps: Option<f64>,
}

impl AccAeb {
    /// The controller for a vehicle. Its set speed is the one it first sees itself drive at.
    #[must_use]
    pub fn new(settings: &AccAebSettings, ego: &Ego) -> Self {
        Self { settings: settings.clone(), aeb: Aeb::new(settings.ttc_s, ego), set_speed_mps: None }
    }
}

impl Controller for AccAeb {
    #[inline]
    fn act(&mut self, seen: &Observation) -> f64 {
        if self.aeb.demands_braking(seen) {
            return -self.aeb.max_brake_mps2;
        }
        let acc = &self.settings;
        let v = seen.speed_mps;
        let set_speed_mps = *self.set_speed_mps.get_or_insert(v);
        let cruise = acc.speed_gain_per_s * (set_speed_mps - v);
        let follow = seen.ahead.map_or(f64::INFINITY, |ahead| {
            let spacing_error_m = ahead.gap_m - acc.standstill_gap_m - acc.time_headway_s * v;
            acc.gap_gain_per_s2 * spacing_error_m + acc.speed_gain_per_s * (ahead.speed_mps - v)
        });
        cruise.min(follow).max(-acc.comfort_brake_mps2).min(acc.comfort_accel_mps2)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, behind};
    use super::*;

    #[test]
    fn cruises_follows_and_brakes() {
        let settings = AccAebSettings::default();
        let mut controller = AccAeb::new(&settings, &EGO);
        assert_eq!(controller.act(&behind(25.0, 200.0, 25.0, 0.0)), 0.0, "holds its set speed on an open road");
        assert_eq!(controller.act(&behind(25.0, 22.0, 25.0, 0.0)), 0.0, "2 m + 0.8 s · 25 m/s is its gap");
        assert_eq!(controller.act(&behind(25.0, 21.0, 25.0, 0.0)), -0.25);
        assert_eq!(controller.act(&behind(25.0, 10.0, 20.0, 0.0)), -3.5, "comfort limit");
        assert_eq!(controller.act(&behind(25.0, 10.0, 15.0, 0.0)), -7.5, "TTC is 1 s");
        assert_eq!(controller.act(&behind(20.0, 200.0, 25.0, 0.0)), 2.0, "back to the set speed");
    }
}
