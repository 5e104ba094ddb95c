//! Number type of the shield, so that simulation and proofs use the same code.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Sub};

/// A number type for the kernel and the test of the shield; `f64` in simulations.
///
/// Certificates are checked with exact quotients. Proof obligations are written with symbolic terms.
pub trait Real:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// Result of a comparison.
    type Truth: Copy + BitAnd<Output = Self::Truth> + BitOr<Output = Self::Truth>;

    /// Converts a constant, exactly.
    fn from_f64(value: f64) -> Self;

    /// Returns true if this is greater than `other`.
    fn greater_than(self, other: Self) -> Self::Truth;

    /// Returns true if this is not less than `other`.
    fn at_least(self, other: Self) -> Self::Truth;

    /// Returns `then` if `truth` holds, and `otherwise` if not.
    fn select(
        truth: Self::Truth,
        then: impl FnOnce() -> Self,
        otherwise: impl FnOnce() -> Self,
    ) -> Self;

    /// Returns the larger of two.
    #[must_use]
    fn larger(self, other: Self) -> Self {
        Self::select(self.at_least(other), || self, || other)
    }

    /// Returns the smaller of two.
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
