//! Followers: one with a latched emergency brake, or one with a control law.
//!
//! # Latched
//! See [`braking`](super::braking) and [`propagate`](super::propagate).
//!
//! # Control law
//! At every step, not only at decisions, the law commands an acceleration from the own speed v, the ego's speed w, and
//! the gap s between them. It is clipped to the vehicle's limits, from -b (of the ranges) up to a largest acceleration,
//! and held over the step.
//!
//! - `idm` (Treiber, Hennecke and Helbing, Phys. Rev. E 62, 1805 (2000), equations 3 and 4): A (1 - (v/v₀)⁴ - (s*/s)²)
//!   with s* = s₀ + max(0, v T + v (v - w) / (2 √(A B))), where a gap below 1 cm counts as 1 cm;
//! - `acc-aeb`: -b in a step that begins with s < θ (v - w). Otherwise the smaller of k_g (s - s₀ - T v) + k_v (w - v)
//!   and of a limit, clipped to its comfort limits. With a set speed u the limit is k_v (u - v). Without one it is
//!   max(0, k_v (w + 2 m/s - v)).
//!
//! The law is evaluated in affine forms, which keep the correlation of follower and ego. A sum is exact; a product, a
//! minimum or a maximum loses an amount of second order in the width. Inputs are within 10⁻⁹ of the truth, the rounding
//! of double precision. New uncertainty within a decision interval belongs to no symbol; it becomes symbols at the
//! decision, as for the ego. If the emergency brake of `acc-aeb` may fire or not, the acceleration is any number in
//! between.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::braking::VehicleState;
use super::ego_set::advance_vehicle;
use super::form::AffineForm;
use super::ranges::{BoxDimension, InitialRanges};
use super::relax::{reciprocal, relu, relu_squared};
use crate::Rejection;
use crate::interval::Interval;
use crate::number::round_down;

/// Smallest gap of `idm`, in metres; smaller ones count as this.
const MIN_GAP_M: f64 = 0.01;

/// Speed difference to the leader up to which `acc-aeb` accelerates without a set speed, in m/s.
const CATCH_UP_MPS: f64 = 2.0;

/// Upper bound of the double-precision error of the law's inputs within a kilometre of the origin, in m and m/s.
const OBSERVATION_ROUNDING: f64 = 1e-9;

/// A model of the follower.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FollowerModel {
    /// Holds its speed until its time to collision falls below a threshold, and then brakes to standstill.
    Latched {
        /// θ, in seconds.
        ttc_s: f64,
    },
    /// Follows a control law.
    ByLaw(FollowerLaw),
}

/// A control law of a follower, in SI units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FollowerLaw {
    /// The Intelligent Driver Model.
    Idm(IdmLaw),
    /// Adaptive cruise control with an emergency brake.
    AccAeb(AccAebLaw),
}

/// Parameters of the Intelligent Driver Model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IdmLaw {
    /// v₀, in m/s.
    pub desired_speed_mps: f64,
    /// T, in seconds.
    pub time_headway_s: f64,
    /// s₀, in metres.
    pub standstill_gap_m: f64,
    /// A, in m/s².
    pub accel_mps2: f64,
    /// B, in m/s².
    pub comfortable_brake_mps2: f64,
    /// Largest acceleration of the vehicle, in m/s².
    pub max_accel_mps2: f64,
}

/// Parameters of adaptive cruise control with an emergency brake.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccAebLaw {
    /// θ, in seconds.
    pub ttc_s: f64,
    /// T, in seconds.
    pub time_headway_s: f64,
    /// s₀, in metres.
    pub standstill_gap_m: f64,
    /// k_g, in 1/s².
    pub gap_gain_per_s2: f64,
    /// k_v, in 1/s.
    pub speed_gain_per_s: f64,
    /// Hardest braking without the emergency brake, in m/s².
    pub comfort_brake_mps2: f64,
    /// Hardest acceleration of the law, in m/s².
    pub comfort_accel_mps2: f64,
    /// u, in m/s; absent without a set speed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set_speed_mps: Option<f64>,
    /// Largest acceleration of the vehicle, in m/s².
    pub max_accel_mps2: f64,
}

impl fmt::Display for IdmLaw {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            desired_speed_mps,
            time_headway_s,
            standstill_gap_m,
            accel_mps2,
            comfortable_brake_mps2,
            ..
        } = self;
        write!(
            out,
            "drives idm towards {} m/s with a time headway of {time_headway_s} s, {standstill_gap_m} m at standstill, \
             {accel_mps2} and {comfortable_brake_mps2} m/s²",
            round_down(*desired_speed_mps)
        )
    }
}

impl fmt::Display for AccAebLaw {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            time_headway_s,
            standstill_gap_m,
            gap_gain_per_s2,
            speed_gain_per_s,
            ..
        } = self;
        write!(
            out,
            "drives acc-aeb with a time headway of {time_headway_s} s, {standstill_gap_m} m at standstill, gains \
             {gap_gain_per_s2} and {speed_gain_per_s}, from -{} to {} m/s², ",
            self.comfort_brake_mps2, self.comfort_accel_mps2
        )?;
        match self.set_speed_mps {
            Some(speed_mps) => write!(out, "a set speed of {speed_mps} m/s, ")?,
            None => write!(
                out,
                "no acceleration while it is more than {CATCH_UP_MPS} m/s faster than its leader, "
            )?,
        }
        write!(
            out,
            "and full braking while its time to collision is below {} s",
            self.ttc_s
        )
    }
}

impl fmt::Display for FollowerLaw {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Idm(law) => law.fmt(out),
            Self::AccAeb(law) => law.fmt(out),
        }
    }
}

impl FollowerLaw {
    /// # Errors
    /// [`Rejection`] if a parameter is negative or infinite, or a divisor is 0.
    pub(crate) fn validate(self) -> Result<Self, Rejection> {
        let (numbers, divisors): (Vec<f64>, Vec<f64>) = match self {
            Self::Idm(law) => (
                vec![law.time_headway_s, law.standstill_gap_m, law.max_accel_mps2],
                vec![
                    law.desired_speed_mps,
                    law.accel_mps2,
                    law.comfortable_brake_mps2,
                ],
            ),
            Self::AccAeb(law) => (
                vec![
                    law.ttc_s,
                    law.time_headway_s,
                    law.standstill_gap_m,
                    law.gap_gain_per_s2,
                    law.speed_gain_per_s,
                    law.comfort_brake_mps2,
                    law.comfort_accel_mps2,
                    law.set_speed_mps.unwrap_or_default(),
                    law.max_accel_mps2,
                ],
                Vec::new(),
            ),
        };

        if numbers.iter().all(is_nonnegative)
            && divisors
                .iter()
                .all(|number| is_nonnegative(number) && *number > 0.0)
        {
            Ok(self)
        } else {
            Err(Rejection::invalid(
                "follower_law",
                "holds a number that is negative, infinite, or 0 where it divides",
            ))
        }
    }

    /// Returns the commands for observed gaps, own and leader's speeds. `limits` are those of the vehicle.
    pub(crate) fn command_range(&self, observed: &[AffineForm; 3], limits: Interval) -> Interval {
        let [gap, speed, leader] = observed.clone();
        let sight = LawInput {
            closing: speed.clone().minus(&leader),
            gap,
            speed,
        };
        let brake = AffineForm::constant(-Interval::point(limits.low()));
        match self {
            Self::Idm(law) => law.acceleration(&sight, &brake).range(),
            // The limit of the own speed alone bounds the command for any gap.
            Self::AccAeb(law) => {
                let form = law.acceleration(&sight, &brake).range();
                let limit = law.speed_limit(&sight).range();
                let limit = limit
                    .max(-Interval::point(law.comfort_brake_mps2))
                    .max(Interval::point(limits.low()));
                let high = form.high().min(limit.high());
                Interval::new(form.low().min(high), high).unwrap_or(Interval::ENTIRE)
            }
        }
    }

    #[must_use]
    pub(crate) fn max_accel_mps2(&self) -> f64 {
        match self {
            Self::Idm(law) => law.max_accel_mps2,
            Self::AccAeb(law) => law.max_accel_mps2,
        }
    }
}

pub(super) struct LawFollower<'a> {
    law: &'a FollowerLaw,
    /// b, and the initial gap.
    brake: AffineForm,
    start_gap: &'a AffineForm,
    step: Interval,
}

struct LawInput {
    gap: AffineForm,
    speed: AffineForm,
    closing: AffineForm,
}

impl LawInput {
    fn new(gap: AffineForm, speed: AffineForm, closing: AffineForm) -> Self {
        let [gap, speed, closing] = [gap, speed, closing].map(|mut form| {
            form.widen(OBSERVATION_ROUNDING);
            form
        });
        Self {
            gap,
            speed,
            closing,
        }
    }
}

impl<'a> LawFollower<'a> {
    pub(super) fn new(
        law: &'a FollowerLaw,
        ranges: &InitialRanges,
        start_gap: &'a AffineForm,
        step: Interval,
    ) -> Self {
        let dimension = BoxDimension::FollowerBrakeMps2;
        Self {
            law,
            brake: AffineForm::symbol(dimension as usize, ranges.get(dimension)),
            start_gap,
            step,
        }
    }

    pub(super) fn gap(&self, ego: &VehicleState, own: &VehicleState) -> AffineForm {
        self.start_gap
            .clone()
            .plus(&ego.distance)
            .minus(&own.distance)
    }

    /// Returns the follower after one step at an acceleration.
    pub(super) fn advance(&self, own: &VehicleState, acceleration: &AffineForm) -> VehicleState {
        step_follower(own, acceleration, self.step)
    }

    /// Returns the follower's acceleration behind the ego vehicle.
    pub(super) fn acceleration_behind(&self, ego: &VehicleState, own: &VehicleState) -> AffineForm {
        self.acceleration(&self.law_input(ego, own))
    }

    fn acceleration(&self, input: &LawInput) -> AffineForm {
        match self.law {
            FollowerLaw::Idm(law) => law.acceleration(input, &self.brake),
            FollowerLaw::AccAeb(law) => law.acceleration(input, &self.brake),
        }
    }

    fn law_input(&self, ego: &VehicleState, own: &VehicleState) -> LawInput {
        LawInput::new(
            self.gap(ego, own),
            own.speed.clone(),
            own.speed.clone().minus(&ego.speed),
        )
    }
}

impl IdmLaw {
    /// Returns the acceleration of a vehicle that brakes at up to `brake`: the narrower of form and interval.
    fn acceleration(&self, sight: &LawInput, brake: &AffineForm) -> AffineForm {
        let acceleration = clamp_to_limits(
            &self.desired_acceleration(sight, brake),
            brake,
            self.max_accel_mps2,
        );
        let speed = sight.speed.range().max(Interval::ZERO);
        let plain =
            self.desired_acceleration_interval(sight.gap.range(), speed, sight.closing.range());
        let plain = plain
            .max(-brake.range())
            .min(Interval::point(self.max_accel_mps2));
        // For a gap near zero a line is wider than an interval.
        let is_wider = 2.0 * acceleration.radius() > plain.high() - plain.low();
        if is_wider {
            AffineForm::constant(plain)
        } else {
            acceleration
        }
    }

    fn desired_acceleration(
        &self,
        LawInput {
            gap,
            speed,
            closing,
        }: &LawInput,
        brake: &AffineForm,
    ) -> AffineForm {
        let point = Interval::point;
        let accel = point(self.accel_mps2);
        if gap.range().low() <= MIN_GAP_M {
            // It commands at most A and brakes at most at its limit.
            return AffineForm::constant((-brake.range()).hull(accel));
        }
        let mut wants = speed.scaled(point(self.time_headway_s));
        wants.add_scaled(&speed.times(closing), self.inverse_twice_geometric_mean());
        let mut gap_wanted = relu(&wants);
        gap_wanted.shift(point(self.standstill_gap_m));
        let share = gap_wanted.times(&reciprocal(gap));
        let of_desired = speed.scaled(Interval::ONE.over(point(self.desired_speed_mps)));
        let fourth = relu_squared(&relu_squared(&of_desired));
        let taken = fourth.plus(&relu_squared(&share));
        AffineForm::constant(accel).minus(&taken.scaled(accel))
    }

    /// Returns the desired acceleration in interval arithmetic, without correlations.
    fn desired_acceleration_interval(
        &self,
        gap: Interval,
        speed: Interval,
        closing: Interval,
    ) -> Interval {
        let point = Interval::point;
        let wants = speed * point(self.time_headway_s)
            + speed * closing * self.inverse_twice_geometric_mean();
        let gap = gap.max(point(MIN_GAP_M));
        let share = (point(self.standstill_gap_m) + wants.max(Interval::ZERO)).over(gap);
        let fourth = speed.over(point(self.desired_speed_mps)).sqr().sqr();
        point(self.accel_mps2) * (Interval::ONE - fourth - share.sqr())
    }

    fn inverse_twice_geometric_mean(&self) -> Interval {
        let mean = (Interval::point(self.accel_mps2)
            * Interval::point(self.comfortable_brake_mps2))
        .sqrt();
        Interval::ONE.over(Interval::point(2.0) * mean)
    }
}

impl AccAebLaw {
    fn guard(&self, LawInput { gap, closing, .. }: &LawInput) -> AffineForm {
        let mut guard = gap.clone();
        guard.add_scaled(closing, -Interval::point(self.ttc_s));
        guard
    }

    /// Returns the command of a vehicle that brakes at up to `brake`.
    fn acceleration(&self, sight: &LawInput, brake: &AffineForm) -> AffineForm {
        let guard = self.guard(sight).range();
        if guard.high() < 0.0 {
            return clamp_to_limits(&negative(brake), brake, self.max_accel_mps2);
        }
        let following = clamp_to_limits(&self.acc_acceleration(sight), brake, self.max_accel_mps2);
        if guard.low() >= 0.0 {
            following
        } else {
            AffineForm::constant(following.range().hull(-brake.range()))
        }
    }

    /// Returns the largest acceleration that the own speed allows.
    fn speed_limit(&self, LawInput { speed, closing, .. }: &LawInput) -> AffineForm {
        match self.set_speed_mps {
            Some(set_speed_mps) => self.acceleration_to(set_speed_mps, speed),
            None => relu(&self.acceleration_to(CATCH_UP_MPS, closing)),
        }
    }

    /// Returns the acceleration that is proportional to the distance of a speed from `limit_mps`.
    fn acceleration_to(&self, limit_mps: f64, speed: &AffineForm) -> AffineForm {
        AffineForm::constant(Interval::point(limit_mps))
            .minus(speed)
            .scaled(Interval::point(self.speed_gain_per_s))
    }

    /// Returns the command without the emergency brake.
    fn acc_acceleration(&self, sight: &LawInput) -> AffineForm {
        let LawInput {
            gap,
            speed,
            closing,
        } = sight;
        let point = Interval::point;
        let mut spacing = gap.clone();
        spacing.shift(-point(self.standstill_gap_m));
        spacing.add_scaled(speed, -point(self.time_headway_s));
        let mut follow = spacing.scaled(point(self.gap_gain_per_s2));
        follow.add_scaled(closing, -point(self.speed_gain_per_s));
        let least = AffineForm::constant(-point(self.comfort_brake_mps2));
        let most = AffineForm::constant(point(self.comfort_accel_mps2));
        min_form(
            &max_form(&min_form(&self.speed_limit(sight), &follow), &least),
            &most,
        )
    }
}

fn clamp_to_limits(wanted: &AffineForm, brake: &AffineForm, max_accel_mps2: f64) -> AffineForm {
    let most = AffineForm::constant(Interval::point(max_accel_mps2));
    min_form(&max_form(wanted, &negative(brake)), &most)
}

fn is_nonnegative(number: &f64) -> bool {
    *number >= 0.0 && number.is_finite()
}

fn max_form(a: &AffineForm, b: &AffineForm) -> AffineForm {
    let beyond = a.clone().minus(b);
    if beyond.range().low() >= 0.0 {
        a.clone()
    } else {
        b.clone().plus(&relu(&beyond))
    }
}

fn min_form(a: &AffineForm, b: &AffineForm) -> AffineForm {
    negative(&max_form(&negative(a), &negative(b)))
}

fn negative(form: &AffineForm) -> AffineForm {
    form.scaled(Interval::point(-1.0))
}

fn step_follower(from: &VehicleState, wanted: &AffineForm, step: Interval) -> VehicleState {
    let later = advance_vehicle(from, wanted, step);
    let acceleration = if from.speed.is_zero() {
        relu(wanted)
    } else if from.speed.range().low() > 0.0 || wanted.range().low() >= 0.0 {
        wanted.clone()
    } else {
        AffineForm::constant(wanted.range().hull(Interval::ZERO))
    };
    VehicleState {
        acceleration,
        ..later
    }
}

#[cfg(test)]
mod tests;
