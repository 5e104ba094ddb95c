//! Intervals with floating-point ends, and outward-rounded arithmetic.
//!
//! Every operation rounds to nearest and then moves each end outwards by one floating-point number. The nearest number
//! is at most half a gap away from the exact result, so the exact result lies inside. Overflow and undefined results
//! become the whole line, about which nothing can be proved.

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
    pub const ZERO: Self = Self {
        low: 0.0,
        high: 0.0,
    };
    pub(crate) const ONE: Self = Self {
        low: 1.0,
        high: 1.0,
    };
    pub(crate) const ENTIRE: Self = Self {
        low: f64::NEG_INFINITY,
        high: f64::INFINITY,
    };

    /// Returns the numbers from `low` to `high`, or `None` unless both are finite and in order.
    #[must_use]
    pub fn new(low: f64, high: f64) -> Option<Self> {
        (low.is_finite() && high.is_finite() && low <= high).then_some(Self { low, high })
    }

    /// Returns one number; the whole line if it is not finite.
    #[must_use]
    pub fn point(value: f64) -> Self {
        Self::new(value, value).unwrap_or(Self::ENTIRE)
    }

    /// Returns [-`radius`, `radius`]; the whole line unless `radius` is finite and not negative.
    #[must_use]
    pub(crate) fn around_zero(radius: f64) -> Self {
        Self::new(-radius, radius).unwrap_or(Self::ENTIRE)
    }

    /// Returns a number near the middle, and a bound of every member's distance from it.
    #[must_use]
    pub(crate) fn middle_and_radius(self) -> (f64, f64) {
        if self.low == self.high {
            return (self.low, 0.0);
        }
        let middle = 0.5 * self.low + 0.5 * self.high;
        if !middle.is_finite() {
            return (0.0, f64::INFINITY);
        }
        (
            middle,
            (self.high - middle).max(middle - self.low).next_up(),
        )
    }

    /// Returns the lower end.
    #[must_use]
    pub fn low(self) -> f64 {
        self.low
    }

    /// Returns the upper end.
    #[must_use]
    pub fn high(self) -> f64 {
        self.high
    }

    /// True if `value` is a member.
    #[must_use]
    pub fn contains(self, value: f64) -> bool {
        self.low <= value && value <= self.high
    }

    /// Moves ends that were rounded to nearest outwards. NaN compares false and gives the whole line.
    fn round_outward(low: f64, high: f64) -> Self {
        if low <= high {
            Self {
                low: low.next_down(),
                high: high.next_up(),
            }
        } else {
            Self::ENTIRE
        }
    }

    /// Returns the quotient; the whole line if the divisor may be zero.
    #[must_use]
    pub fn over(self, divisor: Self) -> Self {
        if divisor.contains(0.0) {
            Self::ENTIRE
        } else {
            self.apply_at_corners(divisor, |a, b| a / b)
        }
    }

    /// Returns the square: never negative, unlike the product of two independent members.
    #[must_use]
    pub fn sqr(self) -> Self {
        let [a, b] = [self.low.abs(), self.high.abs()];
        let nearest = if self.contains(0.0) { 0.0 } else { a.min(b) };
        let square = Self::round_outward(nearest * nearest, a.max(b) * a.max(b));
        Self {
            low: square.low.max(0.0),
            ..square
        }
    }

    /// Returns the square root of the members that are not negative; the whole line if there is none.
    #[must_use]
    pub fn sqrt(self) -> Self {
        let root = Self::round_outward(self.low.max(0.0).sqrt(), self.high.sqrt());
        if self.high < 0.0 {
            Self::ENTIRE
        } else {
            Self {
                low: root.low.max(0.0),
                ..root
            }
        }
    }

    /// Returns the range of min(x, y) for x and y in the two intervals.
    #[must_use]
    pub fn min(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.min(other.high),
        }
    }

    /// Returns the range of max(x, y) for x and y in the two intervals.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            low: self.low.max(other.low),
            high: self.high.max(other.high),
        }
    }

    /// Returns the smallest interval that holds both.
    #[must_use]
    pub fn hull(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }

    /// Applies an operation whose extremes are at the ends of both operands.
    fn apply_at_corners(self, other: Self, operation: impl Fn(f64, f64) -> f64) -> Self {
        let [a, b] = [
            operation(self.low, other.low),
            operation(self.low, other.high),
        ];
        let [c, d] = [
            operation(self.high, other.low),
            operation(self.high, other.high),
        ];
        // The sum is NaN if one of them is; NaN from opposite infinities loses nothing.
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
        Self {
            low: -self.high,
            high: -self.low,
        }
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
        if low == high {
            Self::Number(low)
        } else {
            Self::Ends(IntervalEnds { low, high })
        }
    }
}

// Handwritten: an untagged enumeration buffers any value before it is checked.
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
        let IntervalEnds { low, high } =
            IntervalEnds::deserialize(MapAccessDeserializer::new(fields))?;
        from_ends(low, high)
    }
}

fn from_ends<E: Error>(low: f64, high: f64) -> Result<Interval, E> {
    Interval::new(low, high)
        .ok_or_else(|| E::custom(format!("an interval from {low} to {high} has no members")))
}
