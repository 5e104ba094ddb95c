//! The Intelligent Driver Model as a controller.

use super::{BuiltIn, Controller, ControllerFailure, Ego};
use crate::idm::{Idm, IdmSettings};
use crate::observation::Observation;

impl BuiltIn for Idm {
    const NAME: &'static str = "idm";
    const SUMMARY: &'static str = "Intelligent Driver Model (Treiber et al. 2000)";
    type Settings = IdmSettings;
    type Driver = Self;

    fn start(settings: &IdmSettings, _ego: &Ego, _seed: u64) -> Self {
        settings.into()
    }
}

impl Controller for Idm {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        Ok(self.desired_acceleration_mps2(observation))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, leader_observation};
    use super::*;

    #[test]
    fn is_in_equilibrium_at_its_equilibrium_gap() {
        let settings = IdmSettings::default();
        let v = 25.0_f64;
        // s_e(v) = (s₀ + v T) / sqrt(1 - (v/v₀)⁴), equation 5 of the paper.
        let share = 1.0 - (v / settings.desired_speed_mps).powi(4);
        let gap_m = (settings.standstill_gap_m + v * settings.time_headway_s) / share.sqrt();
        let command = Idm::start(&settings, &EGO, 0)
            .decide(&leader_observation(v, gap_m, v, 0.0))
            .unwrap();
        assert!(command.abs() < 1e-12, "{command}");
    }

    #[test]
    fn a_negative_estimated_gap_means_braking() {
        let command = Idm::start(&IdmSettings::default(), &EGO, 0)
            .decide(&leader_observation(10.0, -0.5, 10.0, 0.0))
            .unwrap();
        assert!(command.is_finite() && command < -100.0);
    }
}
