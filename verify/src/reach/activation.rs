//! Activation functions: a straight line, and the excess over it.
//!
//! Over [l, h] a line s x + [m, M] replaces each function f, with a plain number s and m ≤ f(x) - s x ≤ M; the excess
//! is a symbol of its own. s is near the slope of the chord; m and M are bounds for the chosen s. The single-precision
//! value differs from f by a stated rounding. With u = 2⁻²⁴, the list states where m and M come from, and the rounding:
//!
//! - max(0, x): convex, and a line on either side of 0: f - s x takes its extremes at l, 0 and h; no rounding;
//! - leaky ReLU (x, but a x below 0): a line on either side of 0, so the extremes are at l, 0 and h for any a; rounding
//!   u |a x| below 0;
//! - x clipped to [c, d]: f - s x takes its extremes at l, c, d and h; no rounding;
//! - tanh: odd, convex below 0 and concave above: each half by its tangent; rounding assumed as [`TANH_ERROR`];
//! - 1/(1 + e⁻ˣ): bounded as 1/2 + tanh(x/2)/2, where every operation but the tanh is exact; rounding: next section;
//! - ELU (x, but α (eˣ - 1) below 0): for 0 ≤ α ≤ 1 convex: f - s x is largest at l or h, and lies above its tangents
//!   and, if α ≤ s ≤ 1, above 0; for other α, s = 0 and [m, M] is the range of f; rounding: next section;
//! - x + a, a x, x / a: a line; rounding u of the result, plus 10⁻⁴⁴ for products and quotients.
//!
//! # Rounding of exp
//! exp and exp - 1 in single precision are assumed to have a relative error of at most 2⁻²², and an error of 10⁻³⁸ for
//! values that small; libm's are within 2⁻²³ in tests. If e⁻ˣ overflows to infinity, the computed 1/(1 + e⁻ˣ) is 0, and
//! the true value is less than 2⁻¹²⁶. With y = e⁻ˣ the derivative of 1/(1 + y) is at most 1 and, times y, at most 1/4.
//! So the quotient is off by 2⁻²⁴ for the exponential, u for the sum and u for the division, in all by less than 2⁻²².
//! α (eˣ - 1) is off by |α| (2⁻²² + u) at most, less than |α| 2⁻²¹.

use super::controller::{TANH_ERROR, UNIT_ROUNDOFF};
use super::form::AffineForm;
use super::relax::{
    LinearBound, elu_relaxation, linear_enclosure, relu_excess, relu_slope, tanh_relaxation,
};
use crate::interval::Interval;

/// Largest error of the single-precision 1/(1 + e⁻ˣ).
const SIGMOID_ERROR: f64 = TANH_ERROR;
/// Largest error of the single-precision α (eˣ - 1), for α = 1.
const ELU_ERROR: f64 = 2.0 * TANH_ERROR;
/// Upper bound of the loss of a single-precision product by underflow.
const UNDERFLOW: f64 = 1e-44;

/// An elementwise function, with one operand per number if it has operands.
#[derive(Debug, Clone, PartialEq)]
pub enum Activation {
    /// max(0, x).
    Relu,
    /// x, and the parameter times x below 0.
    LeakyRelu(f64),
    /// x, and the parameter times eˣ - 1 below 0.
    Elu(f64),
    /// tanh x.
    Tanh,
    /// 1 / (1 + e⁻ˣ).
    Sigmoid,
    /// x + a.
    Add(Vec<f64>),
    /// x a.
    Multiply(Vec<f64>),
    /// x / a.
    Divide(Vec<f64>),
    /// x clipped to an interval.
    Clip {
        /// Lower limits.
        low: Vec<f64>,
        /// Upper limits.
        high: Vec<f64>,
    },
}

/// A function within `slope` x + [`low`, `high`], and its computed value within `rounding` of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LinearRelaxation {
    pub(super) slope: f64,
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) rounding: f64,
}

impl LinearRelaxation {
    const IDENTITY: Self = Self {
        slope: 1.0,
        low: 0.0,
        high: 0.0,
        rounding: 0.0,
    };

    fn new_constant(value: f64) -> Self {
        Self {
            slope: 0.0,
            low: value,
            high: value,
            rounding: 0.0,
        }
    }

    fn from_bound(bound: LinearBound, rounding: f64) -> Self {
        Self {
            slope: bound.slope,
            low: bound.deviation.low(),
            high: bound.deviation.high(),
            rounding,
        }
    }

    /// Creates the chord, and the excess at `points`, between which the function is straight.
    fn from_breakpoints(points: &[(f64, Interval)], [least, most]: [f64; 2]) -> Self {
        let (Some((low, at_low)), Some((high, at_high))) = (points.first(), points.last()) else {
            return Self::new_constant(f64::NAN);
        };
        let chord = (at_high.low() - at_low.low()) / (high - low);
        let slope = if chord.is_finite() {
            chord.max(least).min(most)
        } else {
            0.0
        };
        let off =
            |&(x, value): &(f64, Interval)| value - Interval::point(slope) * Interval::point(x);
        let off = points
            .iter()
            .map(off)
            .reduce(Interval::hull)
            .unwrap_or(Interval::ENTIRE);
        Self {
            slope,
            low: off.low(),
            high: off.high(),
            rounding: 0.0,
        }
    }

    pub(super) fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }

    /// True if the result is one number for all inputs.
    pub(super) fn is_constant(&self) -> bool {
        self.slope == 0.0 && self.low == self.high && self.rounding == 0.0
    }

    pub(super) fn middle_and_radius(&self) -> (f64, f64) {
        Interval::new(self.low, self.high).map_or((0.0, f64::INFINITY), Interval::middle_and_radius)
    }

    fn apply(&self, x: &AffineForm) -> AffineForm {
        if self.is_identity() {
            return x.clone();
        }
        let mut line = linear_enclosure(x, self.slope, self.low, self.high);
        if self.rounding > 0.0 {
            line.widen(self.rounding);
        }
        line
    }
}

impl Activation {
    /// Returns the number of operands, or `None` for a function of any width.
    #[must_use]
    pub fn width(&self) -> Option<usize> {
        match self {
            Self::Add(operands) | Self::Multiply(operands) | Self::Divide(operands) => {
                Some(operands.len())
            }
            Self::Clip { low, .. } => Some(low.len()),
            _ => None,
        }
    }

    /// Bounds the magnitude of the result for magnitudes up to `bound`.
    pub(super) fn max_magnitude(&self, number: usize, bound: f64) -> f64 {
        match self {
            Self::Relu => bound,
            Self::LeakyRelu(slope) => bound * slope.abs().max(1.0),
            Self::Elu(alpha) => bound.max(alpha.abs()),
            Self::Tanh | Self::Sigmoid => 1.0,
            Self::Add(operands) => bound + operand(operands, number).abs(),
            Self::Multiply(operands) => bound * operand(operands, number).abs(),
            Self::Divide(operands) => bound / operand(operands, number).abs(),
            Self::Clip { low, high } => operand(low, number).abs().max(operand(high, number).abs()),
        }
    }

    pub(super) fn operations(&self) -> u64 {
        match self {
            Self::Relu => 0,
            Self::Tanh | Self::Sigmoid | Self::Elu(_) => 1000,
            _ => 100,
        }
    }

    /// True if a narrower range could tighten the line.
    pub(super) fn is_nonlinear_on(&self, number: usize, low: f64, high: f64) -> bool {
        match self {
            Self::Relu | Self::LeakyRelu(_) => low < 0.0 && high > 0.0,
            Self::Elu(_) => low < 0.0,
            Self::Tanh | Self::Sigmoid => true,
            Self::Add(_) | Self::Multiply(_) | Self::Divide(_) => false,
            Self::Clip {
                low: least,
                high: most,
            } => {
                let least = operand(least, number);
                let most = operand(most, number);
                !(least <= low && high <= most || high <= least || low >= most)
            }
        }
    }

    /// Returns the line of number `number` over [`low`, `high`].
    pub(super) fn relaxation(&self, number: usize, low: f64, high: f64) -> LinearRelaxation {
        let largest = low.abs().max(high.abs());
        match self {
            Self::Relu => relax_relu(low, high),
            Self::LeakyRelu(_) | Self::Elu(_) if low >= 0.0 => LinearRelaxation::IDENTITY,
            Self::LeakyRelu(slope) => relax_leaky_relu(*slope, low, high),
            Self::Elu(alpha) => LinearRelaxation::from_bound(
                elu_relaxation(*alpha, low, high),
                alpha.abs() * ELU_ERROR + UNDERFLOW,
            ),
            Self::Tanh => LinearRelaxation::from_bound(tanh_relaxation(low, high), TANH_ERROR),
            Self::Sigmoid => relax_sigmoid(low, high),
            Self::Add(operands) => relax_sum(operand(operands, number), largest),
            Self::Multiply(operands) => relax_product(operand(operands, number), largest),
            Self::Divide(operands) => relax_quotient(operand(operands, number), largest),
            Self::Clip {
                low: least,
                high: most,
            } => relax_clip([operand(least, number), operand(most, number)], [low, high]),
        }
    }

    pub(super) fn apply(&self, number: usize, x: &AffineForm) -> AffineForm {
        let range = x.range();
        self.relaxation(number, range.low(), range.high()).apply(x)
    }
}

/// Returns the operand of one number, NaN if there is none.
fn operand(operands: &[f64], number: usize) -> f64 {
    operands.get(number).copied().unwrap_or(f64::NAN)
}

fn relax_relu(low: f64, high: f64) -> LinearRelaxation {
    if low >= 0.0 {
        return LinearRelaxation::IDENTITY;
    }
    if high <= 0.0 {
        return LinearRelaxation::new_constant(0.0);
    }
    let slope = relu_slope(low, high);
    LinearRelaxation {
        slope,
        low: 0.0,
        high: relu_excess(slope, low, high),
        rounding: 0.0,
    }
}

/// Relaxes the leaky ReLU with the slope `leak` below 0, for `low` < 0.
fn relax_leaky_relu(leak: f64, low: f64, high: f64) -> LinearRelaxation {
    let line = if high <= 0.0 {
        LinearRelaxation {
            slope: leak,
            low: 0.0,
            high: 0.0,
            rounding: 0.0,
        }
    } else {
        let points = [
            (low, Interval::point(leak) * Interval::point(low)),
            (0.0, Interval::ZERO),
            (high, Interval::point(high)),
        ];
        LinearRelaxation::from_breakpoints(&points, [leak.min(1.0), leak.max(1.0)])
    };
    let rounding = if leak == 0.0 {
        0.0
    } else {
        rounding_error(leak.abs() * -low) + UNDERFLOW
    };
    LinearRelaxation { rounding, ..line }
}

fn relax_sigmoid(low: f64, high: f64) -> LinearRelaxation {
    // Halves and quarters are exact, but for an underflow that is much smaller than the rounding.
    let bound = tanh_relaxation(0.5 * low, 0.5 * high);
    let bound = LinearBound {
        slope: 0.25 * bound.slope,
        deviation: Interval::point(0.5) + bound.deviation * Interval::point(0.5),
    };
    LinearRelaxation::from_bound(bound, SIGMOID_ERROR)
}

/// Relaxes x + a for magnitudes of x up to `largest`.
fn relax_sum(a: f64, largest: f64) -> LinearRelaxation {
    LinearRelaxation {
        slope: 1.0,
        low: a,
        high: a,
        rounding: rounding_error(largest + a.abs()),
    }
}

/// Relaxes x a for magnitudes of x up to `largest`.
fn relax_product(a: f64, largest: f64) -> LinearRelaxation {
    LinearRelaxation {
        slope: a,
        low: 0.0,
        high: 0.0,
        rounding: rounding_error(largest * a.abs()) + UNDERFLOW,
    }
}

/// Relaxes x / a for magnitudes of x up to `largest`.
fn relax_quotient(a: f64, largest: f64) -> LinearRelaxation {
    let slope = 1.0 / a;
    let size = largest * slope.abs();
    let slope_error = size * (2.0 * f64::EPSILON);
    LinearRelaxation {
        slope,
        low: -slope_error,
        high: slope_error,
        rounding: rounding_error(size) + UNDERFLOW,
    }
}

/// Relaxes x clipped to [`least`, `most`], for x in [`low`, `high`].
fn relax_clip([least, most]: [f64; 2], [low, high]: [f64; 2]) -> LinearRelaxation {
    if low >= least && high <= most {
        return LinearRelaxation::IDENTITY;
    }
    if high <= least || low >= most {
        return LinearRelaxation::new_constant(clip_number(low, least, most));
    }
    let kinks = [least, most]
        .into_iter()
        .filter(|&kink| low < kink && kink < high);
    let points: Vec<_> = std::iter::once(low)
        .chain(kinks)
        .chain([high])
        .map(|x| (x, Interval::point(clip_number(x, least, most))))
        .collect();
    LinearRelaxation::from_breakpoints(&points, [0.0, 1.0])
}

fn clip_number(x: f64, least: f64, most: f64) -> f64 {
    if x < least {
        least
    } else if x > most {
        most
    } else {
        x
    }
}

fn rounding_error(size: f64) -> f64 {
    size * (UNIT_ROUNDOFF * (1.0 + 1e-6))
}

#[cfg(test)]
mod tests;
