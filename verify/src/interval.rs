//! Sets of real numbers with floating-point ends, and arithmetic that never loses a member.
//!
//! Every operation rounds to nearest and then moves each end outwards by one floating-point number. The nearest number is
//! at most half a gap away from the exact result, so the exact result lies inside. What overflows or has no value becomes
//! the whole line, about which nothing can be proved.

use std::fmt;
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserializer, Error, MapAccess, Visitor};
use serde::{Deserialize, Serialize};

/// All real numbers from `low` to `high`. In a file a plain number, or `{"low": …, "high": …}`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(into = "IntervalRepr")]
pub struct Interval {
    low: f64,
    high: f64,
}

impl Interval {
    /// Exactly zero.
    pub const ZERO: Self = Self { low: 0.0, high: 0.0 };
    /// Exactly one.
    pub(crate) const ONE: Self = Self { low: 1.0, high: 1.0 };
    /// The whole line.
    pub(crate) const ENTIRE: Self = Self { low: f64::NEG_INFINITY, high: f64::INFINITY };

    /// The numbers from `low` to `high`; none unless both are finite and in order.
    #[must_use]
    pub fn new(low: f64, high: f64) -> Option<Self> {
        (low.is_finite() && high.is_finite() && low <= high).then_some(Self { low, high })
    }

    /// One number; the whole line if it is not finite.
    #[must_use]
    pub fn point(value: f64) -> Self {
        Self::new(value, value).unwrap_or(Self::ENTIRE)
    }

    /// The numbers from -`radius` to `radius`; the whole line unless `radius` is a finite number that is not negative.
    #[must_use]
    pub(crate) fn around_zero(radius: f64) -> Self {
        Self::new(-radius, radius).unwrap_or(Self::ENTIRE)
    }

    /// A number near the middle, and a bound of every member's distance from it.
    #[must_use]
    pub(crate) fn middle_and_radius(self) -> (f64, f64) {
        if self.low == self.high {
            return (self.low, 0.0);
        }
        let middle = 0.5 * self.low + 0.5 * self.high;
        if !middle.is_finite() {
            return (0.0, f64::INFINITY);
        }
        (middle, (self.high - middle).max(middle - self.low).next_up())
    }

    /// Its lower end.
    #[must_use]
    pub fn low(self) -> f64 {
        self.low
    }

    /// Its upper end.
    #[must_use]
    pub fn high(self) -> f64 {
        self.high
    }

    /// Whether `value` is a member.
    #[must_use]
    pub fn contains(self, value: f64) -> bool {
        self.low <= value && value <= self.high
    }

    /// The ends of a result that were rounded to nearest, moved outwards. A NaN is in neither order and gives the line.
    fn round_outward(low: f64, high: f64) -> Self {
        if low <= high { Self { low: low.next_down(), high: high.next_up() } } else { Self::ENTIRE }
    }

    /// The quotient; the whole line if the divisor may be zero.
    #[must_use]
    pub fn over(self, divisor: Self) -> Self {
        if divisor.contains(0.0) { Self::ENTIRE } else { self.apply_at_corners(divisor, |a, b| a / b) }
    }

    /// The square: not the product of two independent members, so never negative.
    #[must_use]
    pub fn sqr(self) -> Self {
        let (a, b) = (self.low.abs(), self.high.abs());
        let nearest = if self.contains(0.0) { 0.0 } else { a.min(b) };
        let square = Self::round_outward(nearest * nearest, a.max(b) * a.max(b));
        Self { low: square.low.max(0.0), ..square }
    }

    /// The square root of its members that are not negative; the whole line if there is none.
    #[must_use]
    pub fn sqrt(self) -> Self {
        let root = Self::round_outward(self.low.max(0.0).sqrt(), self.high.sqrt());
        if self.high < 0.0 { Self::ENTIRE } else { Self { low: root.low.max(0.0), ..root } }
    }

    /// The smaller of a member of each.
    #[must_use]
    pub fn min(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.min(other.high) }
    }

    /// The larger of a member of each.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self { low: self.low.max(other.low), high: self.high.max(other.high) }
    }

    /// The smallest interval that holds both.
    #[must_use]
    pub fn hull(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// An operation that takes its extremes at the ends of both operands.
    fn apply_at_corners(self, other: Self, operation: impl Fn(f64, f64) -> f64) -> Self {
        let [a, b] = [operation(self.low, other.low), operation(self.low, other.high)];
        let [c, d] = [operation(self.high, other.low), operation(self.high, other.high)];
        // The sum is a NaN if one of them is, and nothing is lost if it is one for opposite infinities.
        if (a + b + c + d).is_nan() {
            Self::ENTIRE
        } else {
            Self::round_outward(a.min(b).min(c.min(d)), a.max(b).max(c.max(d)))
        }
    }
}

impl Add for Interval {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::round_outward(self.low + other.low, self.high + other.high)
    }
}

impl AddAssign for Interval {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Neg for Interval {
    type Output = Self;

    fn neg(self) -> Self {
        Self { low: -self.high, high: -self.low }
    }
}

impl Sub for Interval {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Interval {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        self.apply_at_corners(other, |a, b| a * b)
    }
}

/// An interval as a file states it.
#[derive(Serialize)]
#[serde(untagged)]
enum IntervalRepr {
    Number(f64),
    Ends(IntervalEnds),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct IntervalEnds {
    low: f64,
    high: f64,
}

impl From<Interval> for IntervalRepr {
    fn from(Interval { low, high }: Interval) -> Self {
        if low == high { Self::Number(low) } else { Self::Ends(IntervalEnds { low, high }) }
    }
}

// By hand, since an untagged enumeration keeps whatever it finds in memory before it looks at it.
impl<'de> Deserialize<'de> for Interval {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(IntervalVisitor)
    }
}

struct IntervalVisitor;

impl<'de> Visitor<'de> for IntervalVisitor {
    type Value = Interval;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a number or {\"low\": number, \"high\": number}")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Interval, E> {
        from_ends(value, value)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Interval, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Interval, E> {
        self.visit_f64(value as f64)
    }

    fn visit_map<A: MapAccess<'de>>(self, fields: A) -> Result<Interval, A::Error> {
        let IntervalEnds { low, high } = IntervalEnds::deserialize(MapAccessDeserializer::new(fields))?;
        from_ends(low, high)
    }
}

fn from_ends<E: Error>(low: f64, high: f64) -> Result<Interval, E> {
    Interval::new(low, high).ok_or_else(|| E::custom(format!("an interval from {low} to {high} has no members")))
}
