//! Vehicles that brake to standstill: leader and follower.
//!
//! Both hold their speed until they brake at b from a time τ on, to standstill. With P = max(0, t - τ) and w = v - b P:
//!
//! ```text
//! speed    = max(0, w)
//! distance = v t - b P²/2 + max(0, -w)² / (2 b)     (what it would have reversed is added again)
//!          = v τ + v²/(2 b)                         once all members stand
//! ```
//!
//! These equations are evaluated anew at each decision from forms of v, b and τ: no error adds up. The leader's τ need
//! not be an instant. Over the step of τ, the simulator holds the mean acceleration, which costs at most b h²/8 of
//! distance, subtracted as an interval. The acceleration observed is that of the step before; if members differ it is
//! any number from -b to 0.

use super::form::AffineForm;
use super::relax::{reciprocal, relu, relu_squared};
use crate::interval::Interval;

/// A vehicle that brakes to standstill from a time on.
#[derive(Debug, Clone)]
pub(super) struct BrakingVehicle {
    pub(super) speed: AffineForm,
    pub(super) rate: AffineForm,
    /// 1 / (2 b).
    pub(super) half_over_rate: AffineForm,
    /// τ / h.
    pub(super) onset: AffineForm,
    pub(super) onset_range: Interval,
    pub(super) onset_step_error_m: Interval,
}

/// Distance, speed and the acceleration of the step before.
#[derive(Debug, Clone, Default)]
pub(super) struct VehicleState {
    pub(super) distance: AffineForm,
    pub(super) speed: AffineForm,
    pub(super) acceleration: AffineForm,
}

impl VehicleState {
    pub(super) fn join(&self, other: &Self) -> Self {
        Self {
            distance: self.distance.join(&other.distance),
            speed: self.speed.join(&other.speed),
            acceleration: self.acceleration.join(&other.acceleration),
        }
    }
}

impl BrakingVehicle {
    pub(super) fn new(
        speed: AffineForm,
        rate: AffineForm,
        onset: AffineForm,
        onset_range: Interval,
        step: Interval,
    ) -> Self {
        let is_instant =
            onset_range.low() == onset_range.high() && onset_range.low().fract() == 0.0;
        let cost = rate.range() * step.sqr() * Interval::point(0.125);
        let mean_held_m = if is_instant {
            Interval::ZERO
        } else {
            -cost.max(Interval::ZERO).hull(Interval::ZERO)
        };
        let half_over_rate = reciprocal(&rate).scaled(Interval::point(0.5));
        Self {
            speed,
            rate,
            half_over_rate,
            onset,
            onset_range,
            onset_step_error_m: mean_held_m,
        }
    }

    /// True if all members have stood for a step at instant k: their state no longer changes.
    pub(super) fn has_stood(&self, k: u32, step: Interval) -> bool {
        let since = Interval::point(f64::from(k) - 1.0) - self.onset_range;
        since.low() >= 0.0 && (self.speed.range() - self.rate.range() * since * step).high() <= 0.0
    }

    pub(super) fn state_at(&self, k: u32, step: Interval) -> VehicleState {
        let k = f64::from(k);
        let coasting = self.speed.scaled(Interval::point(k) * step);
        if self.onset_range.low() >= k || self.rate.is_zero() {
            return VehicleState {
                distance: coasting,
                speed: self.speed.clone(),
                ..VehicleState::default()
            };
        }
        let since = AffineForm::constant(Interval::point(k)).minus(&self.onset);
        let free = self
            .speed
            .clone()
            .minus(&self.rate.times(&relu(&since).scaled(step)));
        let a_step_before = free.clone().plus(&self.rate.scaled(step));
        let acceleration = if self.onset_range.high() > k - 1.0 {
            AffineForm::constant((-self.rate.range()).hull(Interval::ZERO))
        } else if free.range().low() > 0.0 {
            self.rate.scaled(Interval::point(-1.0))
        } else if a_step_before.range().high() <= 0.0 {
            AffineForm::default()
        } else {
            AffineForm::constant((-self.rate.range()).hull(Interval::ZERO))
        };
        let mut distance = if free.range().high() <= 0.0 {
            let until_braking = self.speed.times(&self.onset).scaled(step);
            until_braking.plus(&relu_squared(&self.speed).times(&self.half_over_rate))
        } else {
            let braked = self
                .rate
                .times(&relu_squared(&since))
                .scaled(step.sqr() * Interval::point(0.5));
            let reversed = relu_squared(&free.scaled(Interval::point(-1.0)));
            let moving = coasting.minus(&braked);
            if reversed.is_zero() {
                moving
            } else {
                moving.plus(&reversed.times(&self.half_over_rate))
            }
        };
        distance.shift(self.onset_step_error_m);
        VehicleState {
            distance,
            speed: relu(&free),
            acceleration,
        }
    }
}

#[cfg(test)]
mod tests;
