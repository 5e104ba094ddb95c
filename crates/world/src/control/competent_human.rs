//! The careful and competent human driver of UN Regulation No. 157, for car following.

use super::reaction::{Noticed, Ramp, whole_steps};
use super::{BuiltIn, Controller, ControllerFailure, Ego, Role, STANDARD_GRAVITY_MPS2};
use crate::observation::Observation;
use crate::settings::settings;

settings! {
    /// Settings of the careful and competent human driver (UN R157, car following).
    CompetentHumanSettings {
        /// Braking of the vehicle ahead beyond which a risk is there, in m/s², positive.
        risk_brake_mps2: 5.0, 0.0..=30.0, 0.0..=9.0;
        /// Time to perceive the risk, in seconds.
        risk_perception_s: 0.4, 0.0..=10.0, 0.0..=1.0;
        /// Time from perceiving it to the beginning of braking, in seconds.
        reaction_s: 0.75, 0.0..=10.0, 0.0..=2.0;
        /// Deceleration between perceiving the risk and braking, in m/s², positive: the foot is off the pedal.
        coasting_mps2: 0.4, 0.0..=30.0, 0.0..=1.0;
        /// How fast braking builds up, in m/s³.
        jerk_mps3: 12.65, 0.1..=10_000.0, 1.0..=50.0;
        /// Braking that is held, in m/s², positive (0.774 g).
        brake_mps2: 0.774 * STANDARD_GRAVITY_MPS2, 0.0..=30.0, 0.0..=9.0;
    }
}

/// Holds its speed. From the moment that the vehicle ahead brakes harder than a threshold it takes a time to perceive the risk,
/// a time to react during which it coasts, builds braking up at a limited jerk, and brakes to standstill.
///
/// It is a model of one situation: a vehicle that is slower or stands, without braking, is no risk to it.
#[derive(Debug, Clone, PartialEq)]
pub struct CompetentHuman {
    settings: CompetentHumanSettings,
    coasts_after_steps: u32,
    brakes_after_steps: u32,
    noticed: Noticed,
    braking: Ramp,
}

impl BuiltIn for CompetentHuman {
    const NAME: &'static str = "competent-human";
    const SUMMARY: &'static str = "reference driver after UN R157: brakes at 0.774 g from 1.15 s after the vehicle ahead brakes harder than 5 m/s²";
    const ROLE: Role = Role::Reference;
    type Settings = CompetentHumanSettings;
    type Driver = Self;

    fn start(settings: &CompetentHumanSettings, ego: &Ego, _seed: u64) -> Self {
        let coasts_after_steps = whole_steps(settings.risk_perception_s, ego.step_s);
        Self {
            settings: settings.clone(),
            coasts_after_steps,
            brakes_after_steps: coasts_after_steps.saturating_add(whole_steps(settings.reaction_s, ego.step_s)),
            noticed: Noticed::default(),
            braking: Ramp::new(settings.coasting_mps2, settings.jerk_mps3, ego.step_s),
        }
    }
}

impl Controller for CompetentHuman {
    #[inline]
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        let is_risky = seen.ahead.is_some_and(|ahead| ahead.acceleration_mps2 < -self.settings.risk_brake_mps2);
        Ok(match self.noticed.steps(is_risky) {
            Some(steps) if steps >= self.brakes_after_steps => -self.braking.towards(self.settings.brake_mps2),
            Some(steps) if steps >= self.coasts_after_steps => -self.settings.coasting_mps2,
            _ => 0.0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, behind, stopping_distance_m};
    use super::*;

    /// v τ + v₁ T - c T²/2 with coasting c over T, then a ramp of jerk j from c to b, then v₂²/(2 b). Braking is held over
    /// each step at its mean: speeds are exact, and each of the n steps of the ramp is j dt³/12 longer than the ramp itself.
    #[test]
    fn stops_within_the_distance_of_its_closed_form() {
        let settings = CompetentHumanSettings { brake_mps2: 0.4 + 12.65 * 0.57, ..Default::default() };
        let CompetentHumanSettings { risk_perception_s: tau, reaction_s: t, coasting_mps2: c, jerk_mps3: j, .. } =
            settings;
        for v in [14.0_f64, 22.0, 36.1] {
            let v1 = v - c * t;
            let rise_s = (settings.brake_mps2 - c) / j;
            let v2 = v1 - c * rise_s - j * rise_s * rise_s / 2.0;
            let ramp_m = v1 * rise_s - c * rise_s * rise_s / 2.0 - j * rise_s.powi(3) / 6.0;
            let held_m = rise_s / EGO.step_s * j * EGO.step_s.powi(3) / 12.0;
            let expected_m = v * (tau + t) - c * t * t / 2.0 + ramp_m - held_m + v2 * v2 / (2.0 * settings.brake_mps2);
            let driver = CompetentHuman::start(&settings, &EGO, 0);
            let found_m = stopping_distance_m(driver, v, |speed_mps| behind(speed_mps, 90.0, 10.0, -5.01));
            assert!((found_m - expected_m).abs() < 1e-9, "{v} m/s: {found_m} against {expected_m}");
        }
    }

    #[test]
    fn reaches_its_full_braking_exactly_and_sees_no_risk_in_less() {
        let settings = CompetentHumanSettings::default();
        let mut driver = CompetentHuman::start(&settings, &EGO, 0);
        for _ in 0..1000 {
            assert_eq!(driver.decide(&behind(20.0, 5.0, 0.0, -5.0)).unwrap(), 0.0, "not harder than 5 m/s²");
        }
        let commands = [0; 200].map(|_| driver.decide(&behind(20.0, 30.0, 20.0, -5.1)).unwrap());
        assert_eq!(commands[39..=114].iter().filter(|&&command| command == -0.4).count(), 75);
        assert_eq!((commands[39], commands[199]), (0.0, -settings.brake_mps2));
        assert!(commands.windows(2).all(|pair| pair[1] <= pair[0] && pair[0] - pair[1] < 0.401));
    }
}
