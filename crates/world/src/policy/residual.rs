//! Residual policies: actions that are added to the command of a base controller.

use serde::{Deserialize, Serialize};

use super::ActionBounds;
use crate::idm::{Idm, IdmSettings};
use crate::observation::Observation;
use crate::settings::ControllerSettings;

/// A residual policy's base controller and dead zone.
///
/// Within the dead zone around 0 the base controller drives. Beyond it the acceleration moves towards a bound, which an
/// action of -1 or 1 stands for. The base controller uses the observation of every step, and residuals change at a
/// limited rate. Within the dead zone the command is therefore bit-identical to that of the base controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ResidualControl {
    /// Absolute action up to which the base controller drives; from 0 to 0.99.
    pub dead_zone: f64,
    /// Rate at which residuals change, in 1/s; from 0.1 to 1000. With 4, reaching a bound takes a quarter of a second.
    pub rate_per_s: f64,
    /// The base controller: the Intelligent Driver Model with these settings.
    #[serde(default)]
    pub idm: IdmSettings,
}

/// Maximum dead zone; a wider one would leave no room for residuals.
const MAX_DEAD_ZONE: f64 = 0.99;

/// Range of the rate. Slower residuals come too late in an emergency, faster ones take less than a step.
const RATE_RANGE_PER_S: [f64; 2] = [0.1, 1000.0];

impl ResidualControl {
    /// Returns every number with the path of its field and its range.
    pub fn parameters(&self) -> impl Iterator<Item = (String, f64, [f64; 2])> {
        let own =
            [("dead_zone", self.dead_zone, [0.0, MAX_DEAD_ZONE]), ("rate_per_s", self.rate_per_s, RATE_RANGE_PER_S)];
        let of_law = IdmSettings::FIELDS.iter().enumerate().map(|(index, field)| {
            let value = self.idm.get(index).unwrap_or(f64::NAN);
            (format!("idm.{}", field.name), value, field.range)
        });
        own.into_iter().map(|(field, value, range)| (field.to_owned(), value, range)).chain(of_law)
    }

    /// Checks the numbers; an error has the path of the field and the problem.
    ///
    /// # Errors
    /// If a number is outside its range.
    pub fn check(&self) -> Result<(), (String, String)> {
        match self.parameters().find(|(_, value, [low, high])| !(low..=high).contains(&value)) {
            None => Ok(()),
            Some((field, value, [low, high])) => {
                Err((field, format!("must be a number from {low} to {high}, found {value}")))
            }
        }
    }

    /// Returns the residual that an action demands, from -1 (lowest acceleration) to 1; 0 is the base controller.
    fn target_residual(&self, action: f64) -> f64 {
        let strength = ((action.abs() - self.dead_zone) / (1.0 - self.dead_zone)).max(0.0);
        if action < 0.0 { -strength } else { strength }
    }

    fn acceleration_mps2(&self, departed: f64, seen: &Observation, [low_mps2, high_mps2]: [f64; 2]) -> f64 {
        let wanted_mps2 = Idm::from(&self.idm).desired_acceleration_mps2(seen);
        // NaN means full braking, as for a network.
        let base_mps2 = if wanted_mps2.is_nan() { low_mps2 } else { wanted_mps2.max(low_mps2).min(high_mps2) };
        let bound_mps2 = if departed < 0.0 { low_mps2 } else { high_mps2 };
        let strength = departed.abs();
        ((1.0 - strength) * base_mps2 + strength * bound_mps2).max(low_mps2).min(high_mps2)
    }
}

/// The current action, the residual so far and the last answer.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct HeldAction {
    action: f32,
    residual: f64,
    last_answer_mps2: f64,
}

impl HeldAction {
    /// Sets the action, between -1 and 1.
    #[inline]
    pub fn set(&mut self, action: f32) {
        self.action = action;
    }

    /// Returns the absolute residual, from 0 to 1; always 0 without a base controller.
    #[must_use]
    #[inline]
    pub fn residual(&self) -> f64 {
        self.residual.abs()
    }

    /// Returns the last answer, in m/s²; 0 before the first.
    #[must_use]
    #[inline]
    pub fn last_answer_mps2(&self) -> f64 {
        self.last_answer_mps2
    }

    /// Replaces the last answer, if another controller drove, in m/s².
    pub fn set_last_answer_mps2(&mut self, answer_mps2: f64) {
        self.last_answer_mps2 = answer_mps2;
    }

    /// Returns the acceleration of the next step, in m/s²: linear in the action, or blended with the base controller.
    #[inline]
    pub fn acceleration_mps2(&mut self, bounds: &ActionBounds, seen: &Observation, step_s: f64) -> f64 {
        let ActionBounds { low_mps2, high_mps2, residual_over } = bounds;
        self.last_answer_mps2 = match residual_over {
            None => 0.5 * (low_mps2 + high_mps2) + 0.5 * (high_mps2 - low_mps2) * f64::from(self.action),
            Some(control) => {
                let most = control.rate_per_s * step_s;
                self.residual += (control.target_residual(f64::from(self.action)) - self.residual).max(-most).min(most);
                control.acceleration_mps2(self.residual, seen, [*low_mps2, *high_mps2])
            }
        };
        self.last_answer_mps2
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::control::{BuiltIn, Controller, Ego};
    use crate::observation::Neighbour;

    const EGO: Ego = Ego { vehicle: 1, max_brake_mps2: 7.5, max_accel_mps2: 3.0, length_m: 4.0, step_s: 0.01 };

    fn bounds(dead_zone: f64) -> ActionBounds {
        let residual_over = Some(ResidualControl { dead_zone, rate_per_s: 4.0, idm: IdmSettings::default() });
        ActionBounds { residual_over, ..ActionBounds::default() }
    }

    proptest! {
        #[test]
        fn the_dead_zone_gives_the_base_controller_and_full_action_a_bound(
            (gap_m, ahead_mps, speed_mps) in (-1.0..200.0, 0.0..40.0, 0.0..40.0),
            dead_zone in 0.0..=0.99,
            action in -1.0_f32..=1.0,
        ) {
            let ahead = Some(Neighbour { gap_m, speed_mps: ahead_mps, acceleration_mps2: 0.0 });
            let seen = Observation { speed_mps, acceleration_mps2: 0.0, ahead, behind: None };
            let bounds = bounds(dead_zone);
            let mut idm = Idm::start(&IdmSettings::default(), &EGO, 0);
            let base_mps2 = idm.decide(&seen).unwrap().clamp(-7.5, 3.0);
            let mut held = HeldAction::default();
            let mut after = |action, steps| {
                held.set(action);
                let of_each = (0..steps).map(|_| held.acceleration_mps2(&bounds, &seen, 0.01)).collect::<Vec<_>>();
                (of_each, held.residual())
            };
            let calm = (f64::from(action) * dead_zone * 0.999) as f32;
            prop_assert_eq!(after(calm, 2), (vec![base_mps2; 2], 0.0));
            let bound_mps2 = if action < 0.0 { -7.5 } else { 3.0 };
            let (on_the_way, residual) = after(action.signum(), 26);
            prop_assert_eq!((on_the_way[25], residual), (bound_mps2, 1.0));
            let largest = on_the_way.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
            prop_assert!(largest <= 0.04 * (bound_mps2 - base_mps2).abs() + 1e-9);
            prop_assert_eq!(after(calm, 26).0[25], base_mps2);
        }
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let with = |dead_zone, rate_per_s, idm| {
            ResidualControl { dead_zone, rate_per_s, idm }.check().map_err(|(field, _)| field)
        };
        assert_eq!(with(0.3, 4.0, IdmSettings::default()), Ok(()));
        assert_eq!(with(1.0, 4.0, IdmSettings::default()), Err("dead_zone".to_owned()));
        assert_eq!(with(f64::NAN, 4.0, IdmSettings::default()), Err("dead_zone".to_owned()));
        assert_eq!(with(0.3, 0.0, IdmSettings::default()), Err("rate_per_s".to_owned()));
        let weak = IdmSettings { accel_mps2: 0.0, ..IdmSettings::default() };
        assert_eq!(with(0.3, 4.0, weak), Err("idm.accel_mps2".to_owned()));
    }
}
