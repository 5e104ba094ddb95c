//! The numbers that a shield computes with, so that one text is what drives and what is proved.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Sub};

/// A number as the kernel and the shield's test need it: `f64` on the road.
///
/// Exact quotients and terms of a logic are others: certificates are held against the kernel by computing with the former, and
/// the obligations for solvers are written by computing with the latter.
pub trait Real:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// What a comparison answers.
    type Truth: Copy + BitAnd<Output = Self::Truth> + BitOr<Output = Self::Truth>;

    /// A constant, exactly.
    fn from_f64(value: f64) -> Self;

    /// Whether this is greater than `other`.
    fn greater_than(self, other: Self) -> Self::Truth;

    /// Whether this is not less than `other`.
    fn at_least(self, other: Self) -> Self::Truth;

    /// One or the other.
    fn select(truth: Self::Truth, then: impl FnOnce() -> Self, otherwise: impl FnOnce() -> Self) -> Self;

    /// The larger of two.
    #[must_use]
    fn larger(self, other: Self) -> Self {
        Self::select(self.at_least(other), || self, || other)
    }

    /// The smaller of two.
    #[must_use]
    fn smaller(self, other: Self) -> Self {
        Self::select(self.at_least(other), || other, || self)
    }
}

impl Real for f64 {
    type Truth = bool;

    #[inline]
    fn from_f64(value: f64) -> Self {
        value
    }

    #[inline]
    fn greater_than(self, other: Self) -> bool {
        self > other
    }

    #[inline]
    fn at_least(self, other: Self) -> bool {
        self >= other
    }

    #[inline]
    fn select(truth: bool, then: impl FnOnce() -> Self, otherwise: impl FnOnce() -> Self) -> Self {
        if truth { then() } else { otherwise() }
    }

    #[inline]
    fn larger(self, other: Self) -> Self {
        self.max(other)
    }

    #[inline]
    fn smaller(self, other: Self) -> Self {
        self.min(other)
    }
}
