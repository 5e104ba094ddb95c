//! The Intelligent Driver Model (Treiber, Hennecke and Helbing, Phys. Rev. E 62, 1805 (2000)).

use super::Controller;
use crate::estimate::Observation;
use crate::scenario::IdmSettings;

/// A gap below this counts as this, in metres: the model divides by the gap, and an estimated one can be negative.
const LEAST_GAP_M: f64 = 0.01;

/// a · [1 - (v/v₀)⁴ - (s*/s)²] with the desired gap s* = s₀ + max(0, v T + v Δv / (2 √(a b))) (equations 3 and 4).
#[derive(Debug, Clone, PartialEq)]
pub struct Idm {
    settings: IdmSettings,
}

impl Idm {
    /// The model with given settings.
    #[must_use]
    pub fn new(settings: &IdmSettings) -> Self {
        Self { settings: settings.clone() }
    }
}

impl Controller for Idm {
    #[inline]
    fn act(&mut self, seen: &Observation) -> f64 {
        let IdmSettings { desired_speed_mps, time_headway_s, standstill_gap_m, accel_mps2, comfortable_brake_mps2 } =
            self.settings;
        let v = seen.speed_mps;
        let free = 1.0 - (v / desired_speed_mps).powi(4);
        let interaction = seen.ahead.map_or(0.0, |ahead| {
            let closing_mps = v - ahead.speed_mps;
            let dynamic_m = v * time_headway_s + v * closing_mps / (2.0 * (accel_mps2 * comfortable_brake_mps2).sqrt());
            ((standstill_gap_m + dynamic_m.max(0.0)) / ahead.gap_m.max(LEAST_GAP_M)).powi(2)
        });
        accel_mps2 * (free - interaction)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::behind;
    use super::*;

    #[test]
    fn is_in_equilibrium_at_its_equilibrium_gap() {
        let settings = IdmSettings::default();
        let v = 25.0_f64;
        // s_e(v) = (s₀ + v T) / sqrt(1 - (v/v₀)⁴): equation 5 of the paper.
        let share = 1.0 - (v / settings.desired_speed_mps).powi(4);
        let gap_m = (settings.standstill_gap_m + v * settings.time_headway_s) / share.sqrt();
        let command = Idm::new(&settings).act(&behind(v, gap_m, v, 0.0));
        assert!(command.abs() < 1e-12, "{command}");
    }

    #[test]
    fn a_negative_estimated_gap_means_braking() {
        let command = Idm::new(&IdmSettings::default()).act(&behind(10.0, -0.5, 10.0, 0.0));
        assert!(command.is_finite() && command < -100.0);
    }
}
