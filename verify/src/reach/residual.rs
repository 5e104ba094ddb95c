//! An ego with a residual policy: the network's action blends the command of a base controller with a bound.
//!
//! At every step, not only at decisions, the base controller commands an acceleration from the own speed v, the
//! leader's speed w, and the gap s between them, clipped to the bounds l and h of the policy. It is `idm`, as for a
//! [follower](super::follower). The action a, from -1 to 1 and held until the next decision, changes it by
//!
//! ```text
//! d = max(0, (|a| - z) / (1 - z))    towards l for a < 0, else h:    (1 - d) law + d l,    (1 - d) law + d h
//! ```
//!
//! with z the dead zone. With p = max(0, (a - z) / (1 - z)) and q = max(0, (-a - z) / (1 - z)), of which one is always
//! 0, that is law + p (h - law) + q (l - law). It is evaluated in affine forms: two bends and two products. While no
//! member leaves the dead zone only the law loses; with d = 1 for all members the law does not count. Interval bounds
//! of p, q and the law are taken if they are tighter, since a product of wide forms ignores [l, h].
//!
//! # Observation
//! The law observes gap, own speed and leader speed anew at every step, each within the stated error, as the network
//! does at decisions, and within the 10⁻⁹ of double precision.
//!
//! # Rate limit
//! d changes by r per second at most. With r h ≥ 2 for steps of h seconds one step completes any change, since none is
//! larger than from -1 to 1, and d follows the action but for 10⁻¹⁵ of double precision. Slower policies are rejected,
//! because d would be part of the state. Bounds for them are computed with any acceleration from l to h.

use std::fmt;

use super::OBSERVATION_SIZE;
use super::follower::{IdmLaw, LawInput};
use super::form::AffineForm;
use super::relax::relu;
use crate::interval::Interval;

const MAX_DEAD_ZONE: f64 = 0.99;
const RATE_RANGE_PER_S: [f64; 2] = [0.1, 1000.0];
const MAX_RESIDUAL_CHANGE: f64 = 2.0;
/// Upper bound of the double-precision error of law and residual, as a share of the largest acceleration.
const REL_ROUNDING_ERROR: f64 = 1e-14;

/// An interval hull replaces an affine form only if it is < 0.9 as wide: the hull loses correlations with earlier
/// steps.
const MAX_RELATIVE_WIDTH: f64 = 0.9;

/// A residual policy over a base controller, in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualPolicy {
    /// z: actions up to this magnitude leave the base controller unchanged.
    pub dead_zone: f64,
    /// r: rate limit of the residual, in 1/s.
    pub rate_per_s: f64,
    /// Base controller. Its largest acceleration is the upper bound of the policy.
    pub idm: IdmLaw,
}

impl fmt::Display for ResidualPolicy {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { dead_zone, rate_per_s, idm } = self;
        let most_mps2 = idm.max_accel_mps2;
        write!(
            out,
            "it {idm}, at every step and at up to {most_mps2} m/s², and departs from that where the network's action \
             is beyond {dead_zone}; departures come and go at {rate_per_s} 1/s"
        )
    }
}

impl ResidualPolicy {
    /// # Errors
    /// Names the first parameter outside the simulator's range.
    pub(super) fn check(&self) -> Result<(), String> {
        let Self { dead_zone, rate_per_s, idm } = *self;
        let numbers = [
            ("dead_zone", dead_zone, [0.0, MAX_DEAD_ZONE]),
            ("rate_per_s", rate_per_s, RATE_RANGE_PER_S),
            ("desired_speed_mps", idm.desired_speed_mps, [0.1, 100.0]),
            ("time_headway_s", idm.time_headway_s, [0.0, 10.0]),
            ("standstill_gap_m", idm.standstill_gap_m, [0.0, 100.0]),
            ("accel_mps2", idm.accel_mps2, [0.01, 30.0]),
            ("comfortable_brake_mps2", idm.comfortable_brake_mps2, [0.01, 30.0]),
        ];
        match numbers.into_iter().find(|(_, number, [low, high])| !(low..=high).contains(&number)) {
            None => Ok(()),
            Some((field, number, [low, high])) => Err(format!("{field}: {number} is not from {low} to {high}")),
        }
    }

    /// True if each change of the residual is complete after one step.
    #[must_use]
    pub(crate) fn is_complete_in_one_step(&self, step_s: f64) -> bool {
        self.rate_per_s * step_s >= MAX_RESIDUAL_CHANGE
    }

    /// Returns the residual shares p and q of an action.
    fn residual_shares(&self, action: &AffineForm) -> [AffineForm; 2] {
        let zone = Interval::point(self.dead_zone);
        let left = Interval::ONE - zone;
        [1.0, -1.0].map(|sign| {
            let mut beyond = action.scaled(Interval::point(sign));
            beyond.shift(-zone);
            relu(&beyond.scaled(Interval::ONE.over(left)))
        })
    }

    /// Returns the commanded acceleration between the bounds, in m/s².
    pub(super) fn acceleration(&self, bounds: &Residual, sight: &LawInput) -> AffineForm {
        let Residual { up, down, bounds_mps2: [low, high] } = bounds;
        let [least, most] = [low, high].map(|bound| AffineForm::constant(Interval::point(*bound)));
        let (law, plain) = self.idm.acceleration_bounds(sight, &AffineForm::constant(-Interval::point(*low)));
        let law = tighter_form(law, plain);
        let mut wanted = law.clone();
        for (share, bound) in [(up, &most), (down, &least)] {
            if !share.is_zero() {
                wanted = wanted.plus(&share.times(&bound.clone().minus(&law)));
            }
        }
        let rounded = REL_ROUNDING_ERROR * low.abs().max(high.abs());
        wanted.widen(rounded);
        tighter_form(wanted, bounds.interval_bounds(law.range()) + Interval::around_zero(rounded))
    }
}

/// Returns a form, or the interval if it is so much tighter that losing correlations pays.
fn tighter_form(form: AffineForm, plain: Interval) -> AffineForm {
    let is_worth_it = plain.high() - plain.low() < MAX_RELATIVE_WIDTH * 2.0 * form.radius();
    if is_worth_it { AffineForm::constant(plain) } else { form }
}

pub(super) struct Residual {
    up: AffineForm,
    down: AffineForm,
    bounds_mps2: [f64; 2],
}

impl Residual {
    pub(super) fn new(residual: &ResidualPolicy, action: &AffineForm, bounds_mps2: [f64; 2]) -> Self {
        let [up, down] = residual.residual_shares(action);
        Self { up, down, bounds_mps2 }
    }

    /// Bounds the command in interval arithmetic. It grows with the law and with p, and falls with q.
    fn interval_bounds(&self, law: Interval) -> Interval {
        let [low, high] = self.bounds_mps2.map(Interval::point);
        let law = law.max(low).min(high);
        let [least, most] = [law.low(), law.high()].map(Interval::point);
        let share = |form: &AffineForm| form.range().max(Interval::ZERO).min(Interval::ONE);
        let [up, down] = [&self.up, &self.down].map(share);
        let towards = |bound: Interval, law: Interval, share: f64| {
            let share = Interval::point(share);
            (Interval::ONE - share) * law + share * bound
        };
        let upwards = towards(high, least, up.low()).hull(towards(high, most, up.high()));
        let downwards = towards(low, least, down.high()).hull(towards(low, most, down.low()));
        // One of p and q is always 0.
        let plain = match (self.up.is_zero(), self.down.is_zero()) {
            (true, _) => downwards,
            (false, true) => upwards,
            (false, false) => upwards.hull(downwards),
        };
        plain.max(low).min(high)
    }
}

/// Returns the errors of the law's inputs: gap, own speed, and difference of speeds.
pub(super) fn law_input_errors(observation_error: &[f64; OBSERVATION_SIZE]) -> [f64; 3] {
    let [gap, _, ahead, own, ..] = *observation_error;
    [gap, own, own + ahead]
}

#[cfg(test)]
mod tests;
