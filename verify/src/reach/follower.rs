//! Who drives behind: one that holds its speed until a latched emergency brake fires, or one that follows by a law.
//!
//! # Latched
//! See [`braking`](super::braking) and [`drive`](super::drive).
//!
//! # By a law
//! At every step, not only where the ego decides, it asks for an acceleration that depends on its own speed v, on that of the ego w, and on the
//! gap s between them. It is cut to what the vehicle can do, from -b (of the ranges) up to a largest acceleration, and held over the step.
//!
//! - `idm` (Treiber, Hennecke and Helbing, Phys. Rev. E 62, 1805 (2000), equations 3 and 4): A (1 - (v/v₀)⁴ - (s*/s)²) with
//!   s* = s₀ + max(0, v T + v (v - w) / (2 √(A B))), where a gap below 1 cm counts as 1 cm;
//! - `acc-aeb`: -b at a step at whose begin s < θ (v - w), and else the smaller of k_v (u - v) and k_g (s - s₀ - T v) + k_v (w - v), cut to its
//!   comfort limits, where u is its speed at the first such step. Until then it has only braked, so that u is from 0 to v(0), and v(0) where the
//!   brake does not fire at the start.
//!
//! The law is evaluated in forms, so that the follower of a member remembers which ego it followed: a sum costs nothing, a product or a bend the
//! second order of the width. It sees everything within 10⁻⁹ of the truth, since that is what it sees in double precision. What all that adds
//! within a decision interval belongs to no symbol; at the decision it becomes symbols, like what is uncertain about the ego. Where the emergency
//! brake of `acc-aeb` may fire or not, the acceleration is any number in between.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::braking::Seen;
use super::form::Form;
use super::members::moved;
use super::ranges::{Dimension, Ranges};
use super::relax::{reciprocal, rectified, rectified_square};
use crate::Rejection;
use crate::interval::Interval;

/// A gap below this counts as this, in metres, for who drives `idm`.
const LEAST_GAP_M: f64 = 0.01;

/// More than a simulator in double precision is off, within a kilometre of its origin, in what it shows to who follows, in m and m/s.
const ROUNDED: f64 = 1e-9;

/// Who drives behind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Follower {
    /// It holds its speed until its time to collision falls below this, in seconds, and then brakes to standstill.
    Latched {
        /// θ.
        ttc_s: f64,
    },
    /// It follows by a law.
    Driven(Law),
}

/// A law by which somebody follows, in SI units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// The Intelligent Driver Model.
    Idm(Idm),
    /// Adaptive cruise control with an emergency brake.
    AccAeb(AccAeb),
}

/// Numbers of the Intelligent Driver Model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Idm {
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
    /// Most that the vehicle accelerates at, in m/s².
    pub max_accel_mps2: f64,
}

/// Numbers of adaptive cruise control with an emergency brake.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccAeb {
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
    /// Hardest braking but for the emergency brake, in m/s².
    pub comfort_brake_mps2: f64,
    /// Hardest acceleration, in m/s².
    pub comfort_accel_mps2: f64,
    /// Most that the vehicle accelerates at, in m/s².
    pub max_accel_mps2: f64,
}

impl fmt::Display for Idm {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { desired_speed_mps, time_headway_s, standstill_gap_m, accel_mps2, comfortable_brake_mps2, .. } = self;
        write!(
            out,
            "drives idm towards {desired_speed_mps} m/s with a time headway of {time_headway_s} s, {standstill_gap_m} m at standstill, \
             {accel_mps2} and {comfortable_brake_mps2} m/s²"
        )
    }
}

impl fmt::Display for Law {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Idm(law) => law.fmt(out),
            Self::AccAeb(law) => write!(
                out,
                "drives acc-aeb with a time headway of {} s, {} m at standstill, gains {} and {}, from -{} to {} m/s², and full braking while its \
                 time to collision is below {} s",
                law.time_headway_s,
                law.standstill_gap_m,
                law.gap_gain_per_s2,
                law.speed_gain_per_s,
                law.comfort_brake_mps2,
                law.comfort_accel_mps2,
                law.ttc_s
            ),
        }
    }
}

impl Law {
    /// # Errors
    /// [`Rejection`] if a number of it is negative or infinite, or 0 where it divides.
    pub(super) fn validated(self) -> Result<Self, Rejection> {
        let (numbers, divisors): (Vec<f64>, Vec<f64>) = match self {
            Self::Idm(law) => (
                vec![law.time_headway_s, law.standstill_gap_m, law.max_accel_mps2],
                vec![law.desired_speed_mps, law.accel_mps2, law.comfortable_brake_mps2],
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
                    law.max_accel_mps2,
                ],
                Vec::new(),
            ),
        };
        let is_fit = |number: &f64| *number >= 0.0 && number.is_finite();
        if numbers.iter().all(is_fit) && divisors.iter().all(|number| is_fit(number) && *number > 0.0) {
            Ok(self)
        } else {
            Err(Rejection::invalid("follower_law", "holds a number that is negative, infinite, or 0 where it divides"))
        }
    }

    /// Most that the vehicle accelerates at, in m/s².
    #[must_use]
    pub(crate) fn max_accel_mps2(&self) -> f64 {
        match self {
            Self::Idm(law) => law.max_accel_mps2,
            Self::AccAeb(law) => law.max_accel_mps2,
        }
    }
}

/// A follower by a law, behind all egos of a set.
pub(super) struct Behind<'a> {
    law: &'a Law,
    /// u of `acc-aeb`, b, and the gap at the start.
    set_speed: Form,
    brake: Form,
    start_gap: &'a Form,
    step: Interval,
}

/// What a law sees at an instant.
pub(super) struct Sight {
    gap: Form,
    speed: Form,
    /// v - w.
    closing: Form,
    /// No speed that is seen is smaller, in m/s: nobody reverses, but what is seen may be off.
    least_mps: f64,
}

impl Sight {
    fn of(gap: Form, speed: Form, closing: Form) -> Self {
        Self::within([gap, speed, closing], [0.0; 3])
    }

    /// The same of gap, speed and v - w that may be off by so much more.
    pub(super) fn within(mut seen: [Form; 3], errors: [f64; 3]) -> Self {
        seen.iter_mut().zip(errors).for_each(|(form, error)| form.widen(ROUNDED + error));
        let ([gap, speed, closing], [_, of_speed, _]) = (seen, errors);
        Self { gap, speed, closing, least_mps: -of_speed }
    }
}

impl<'a> Behind<'a> {
    pub(super) fn new(law: &'a Law, ranges: &Ranges, start_gap: &'a Form, step: Interval) -> Self {
        let get = |dimension: Dimension| Form::symbol(dimension as usize, ranges.get(dimension));
        let speed = get(Dimension::FollowerSpeedMps);
        let closing = speed.clone().minus(&get(Dimension::EgoSpeedMps));
        let start = Sight::of(start_gap.clone(), speed.clone(), closing);
        let set_speed = match law {
            Law::AccAeb(law) if law.guard(&start).range().low() < 0.0 => {
                Form::constant(speed.range().hull(Interval::ZERO))
            }
            _ => speed,
        };
        Self { law, set_speed, brake: get(Dimension::FollowerBrakeMps2), start_gap, step }
    }

    /// The gap to an ego.
    pub(super) fn gap(&self, ego: &Seen, own: &Seen) -> Form {
        self.start_gap.clone().plus(&ego.distance).minus(&own.distance)
    }

    /// A follower a step later, and the acceleration that it asks for.
    pub(super) fn stepped(&self, own: &Seen, ego: &Seen) -> (Seen, Form) {
        let acceleration = self.acceleration(&self.sight(ego, own));
        (stepped(own, &acceleration, self.step), acceleration)
    }

    fn acceleration(&self, sight: &Sight) -> Form {
        let hardest = || self.brake.scaled(Interval::point(-1.0));
        match self.law {
            Law::Idm(law) => law.within(sight, &self.brake),
            Law::AccAeb(law) => {
                let guard = law.guard(sight).range();
                if guard.high() < 0.0 {
                    return self.able(&hardest());
                }
                let following = self.able(&law.followed(sight, &self.set_speed));
                if guard.low() >= 0.0 {
                    return following;
                }
                Form::constant(following.range().hull(-self.brake.range()))
            }
        }
    }

    fn sight(&self, ego: &Seen, own: &Seen) -> Sight {
        Sight::of(self.gap(ego, own), own.speed.clone(), own.speed.clone().minus(&ego.speed))
    }

    /// What the vehicle does of what is asked for.
    fn able(&self, wanted: &Form) -> Form {
        able(wanted, &self.brake, self.law.max_accel_mps2())
    }
}

impl Idm {
    /// What a vehicle does of what it asks for that brakes at up to `brake`.
    fn within(&self, sight: &Sight, brake: &Form) -> Form {
        let (acceleration, plain) = self.bounds(sight, brake);
        // Of a gap that may be next to nothing a line says less than plain numbers do.
        let is_wider = 2.0 * acceleration.radius() > plain.high() - plain.low();
        if is_wider { Form::constant(plain) } else { acceleration }
    }

    /// The same, as a form and by plain numbers.
    pub(super) fn bounds(&self, sight: &Sight, brake: &Form) -> (Form, Interval) {
        let acceleration = able(&self.wanted(sight, brake), brake, self.max_accel_mps2);
        (acceleration, self.plainly(sight).max(-brake.range()).min(Interval::point(self.max_accel_mps2)))
    }

    fn wanted(&self, Sight { gap, speed, closing, least_mps }: &Sight, brake: &Form) -> Form {
        let point = Interval::point;
        let accel = point(self.accel_mps2);
        if gap.range().low() <= LEAST_GAP_M {
            // It wants at most A, and is not let brake harder than it can.
            return Form::constant((-brake.range()).hull(accel));
        }
        let mut wants = speed.scaled(point(self.time_headway_s));
        wants.add(&speed.times(closing), self.over_twice_mean());
        let mut gap_wanted = rectified(&wants);
        gap_wanted.shift(point(self.standstill_gap_m));
        let share = gap_wanted.times(&reciprocal(gap));
        let of_desired = speed.scaled(Interval::ONE.over(point(self.desired_speed_mps)));
        let mut fourth = rectified_square(&rectified_square(&of_desired));
        if *least_mps < 0.0 {
            // Of a speed below 0 it is not 0.
            fourth.shift(Interval::ZERO.hull(point(*least_mps).over(point(self.desired_speed_mps)).sqr().sqr()));
        }
        let taken = fourth.plus(&rectified_square(&share));
        Form::constant(accel).minus(&taken.scaled(accel))
    }

    /// The same of numbers that have nothing to do with each other.
    fn plainly(&self, Sight { gap, speed, closing, least_mps }: &Sight) -> Interval {
        let point = Interval::point;
        let (speed, gap) = (speed.range().max(point(*least_mps)), gap.range().max(point(LEAST_GAP_M)));
        let wants = speed * point(self.time_headway_s) + speed * closing.range() * self.over_twice_mean();
        let share = (point(self.standstill_gap_m) + wants.max(Interval::ZERO)).over(gap);
        let fourth = speed.over(point(self.desired_speed_mps)).sqr().sqr();
        point(self.accel_mps2) * (Interval::ONE - fourth - share.sqr())
    }

    /// 1 / (2 √(A B)).
    fn over_twice_mean(&self) -> Interval {
        let mean = (Interval::point(self.accel_mps2) * Interval::point(self.comfortable_brake_mps2)).sqrt();
        Interval::ONE.over(Interval::point(2.0) * mean)
    }
}

impl AccAeb {
    /// Below 0 the emergency brake fires.
    fn guard(&self, Sight { gap, closing, .. }: &Sight) -> Form {
        let mut guard = gap.clone();
        guard.add(closing, -Interval::point(self.ttc_s));
        guard
    }

    /// What it asks for where the emergency brake does not fire.
    fn followed(&self, Sight { gap, speed, closing, .. }: &Sight, set_speed: &Form) -> Form {
        let point = Interval::point;
        let gain = point(self.speed_gain_per_s);
        let cruise = set_speed.clone().minus(speed).scaled(gain);
        let mut spacing = gap.clone();
        spacing.shift(-point(self.standstill_gap_m));
        spacing.add(speed, -point(self.time_headway_s));
        let mut follow = spacing.scaled(point(self.gap_gain_per_s2));
        follow.add(closing, -gain);
        let least = Form::constant(-point(self.comfort_brake_mps2));
        let most = Form::constant(point(self.comfort_accel_mps2));
        smaller(&larger(&smaller(&cruise, &follow), &least), &most)
    }
}

/// What a vehicle does of what is asked for, that brakes at up to `brake` and accelerates at up to a number.
fn able(wanted: &Form, brake: &Form, max_accel_mps2: f64) -> Form {
    let most = Form::constant(Interval::point(max_accel_mps2));
    smaller(&larger(wanted, &brake.scaled(Interval::point(-1.0))), &most)
}

/// The larger of two: b + max(0, a - b).
fn larger(a: &Form, b: &Form) -> Form {
    let beyond = a.clone().minus(b);
    if beyond.range().low() >= 0.0 { a.clone() } else { b.clone().plus(&rectified(&beyond)) }
}

/// The smaller of two.
fn smaller(a: &Form, b: &Form) -> Form {
    let negative = |form: &Form| form.scaled(Interval::point(-1.0));
    negative(&larger(&negative(a), &negative(b)))
}

/// A follower a step later, if it asks for an acceleration: distance and speed then, and the acceleration that is seen of it.
fn stepped(from: &Seen, wanted: &Form, step: Interval) -> Seen {
    let later = moved(from, wanted, step);
    let acceleration = if from.speed.is_zero() {
        // Who stands accelerates at max(0, u).
        rectified(wanted)
    } else if from.speed.range().low() > 0.0 || wanted.range().low() >= 0.0 {
        wanted.clone()
    } else {
        Form::constant(wanted.range().hull(Interval::ZERO))
    };
    Seen { acceleration, ..later }
}

#[cfg(test)]
mod tests;
