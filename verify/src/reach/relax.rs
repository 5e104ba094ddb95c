//! Functions of affine forms: a straight line and the largest deviation from it.
//!
//! Over [l, h] a line s x + [m, M] with a slope s near the chord's and m ≤ f(x) - s x ≤ M replaces each function f. The
//! slope need not be exact: m and M are bounds for the chosen slope.
//!
//! - f convex: f - s x is largest at an end, and lies above its tangent at any x₀, whose least value is at an end. x₀
//!   is chosen where f' is about s, so that the tangent is nearly level.
//! - tanh is odd, convex below 0 and concave above, so each half is bounded like that.
//! - ELU (x, but α (eˣ - 1) below 0) is convex for 0 ≤ α ≤ 1; f - s x is not negative if α ≤ s ≤ 1.
//!
//! # exp and tanh
//! For 0 ≤ y ≤ 40 let t = y / 1024. Then e⁻ᵗ lies between the Taylor sums of degree 7 and 8 (the series alternates and
//! falls), and e⁻ʸ is that squared ten times; tanh z = (1 - e⁻²ᶻ) / (1 + e⁻²ᶻ). Beyond z = 20 tanh is within 2⁻⁵³ of 1.

use super::form::{AffineForm, round_up};
use crate::interval::Interval;

const ONE: Interval = Interval::ONE;

/// A function f within `slope` x + `deviation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LinearBound {
    pub(super) slope: f64,
    /// Bounds of f(x) - `slope` x.
    pub(super) deviation: Interval,
}

pub(super) fn linear_enclosure(x: &AffineForm, slope: f64, low: f64, high: f64) -> AffineForm {
    let Some(off) = Interval::new(low, high) else {
        return AffineForm::entire();
    };
    let mut line = if slope == 0.0 {
        AffineForm::default()
    } else {
        x.scaled(Interval::point(slope))
    };
    line.shift(off);
    line
}

/// Returns max(0, x).
#[must_use]
pub fn relu(x: &AffineForm) -> AffineForm {
    relu_above(x, f64::NEG_INFINITY)
}

/// Returns max(0, x) for members x of at least `floor`, which is not positive; unspecified for the others.
#[must_use]
pub(super) fn relu_above(x: &AffineForm, floor: f64) -> AffineForm {
    let low = x.range().low().max(floor);
    let high = x.range().high();
    if low >= 0.0 {
        return x.clone();
    }
    if high <= 0.0 {
        return AffineForm::default();
    }
    let slope = relu_slope(low, high);
    linear_enclosure(x, slope, 0.0, relu_excess(slope, low, high))
}

/// Returns for l < 0 < h a slope s in [0, 1], near the chord's.
pub(super) fn relu_slope(low: f64, high: f64) -> f64 {
    (high / (high - low)).clamp(0.0, 1.0)
}

/// Returns M with 0 ≤ max(0, x) - s x ≤ M over [l, h], for l < 0 < h and 0 ≤ s ≤ 1: by convexity the larger of -s l
/// and (1 - s) h.
pub(super) fn relu_excess(slope: f64, low: f64, high: f64) -> f64 {
    round_up((-slope * low).max((1.0 - slope) * high))
}

/// Returns max(0, x)².
#[must_use]
pub fn relu_squared(x: &AffineForm) -> AffineForm {
    if x.range().high() <= 0.0 {
        return AffineForm::default();
    }
    relax_convex(
        x,
        |x| x.max(Interval::ZERO).sqr(),
        |x| x.max(Interval::ZERO) + x.max(Interval::ZERO),
        |slope| slope / 2.0,
    )
}

/// Returns 1 / x; the whole line unless x is positive.
#[must_use]
pub fn reciprocal(x: &AffineForm) -> AffineForm {
    if x.range().low() <= 0.0 {
        return AffineForm::entire();
    }
    relax_convex(
        x,
        |x| ONE.over(x),
        |x| -ONE.over(x.sqr()),
        |slope| (-1.0 / slope).sqrt(),
    )
}

fn relax_convex(
    x: &AffineForm,
    value: impl Fn(Interval) -> Interval,
    derivative: impl Fn(Interval) -> Interval,
    touch: impl Fn(f64) -> f64,
) -> AffineForm {
    let ends = [x.range().low(), x.range().high()];
    let limits = ends.map(|end| derivative(Interval::point(end)).low());
    let chord = Chord::new(ends, &value, limits);
    let lowest = tangent_lower_bound(value, derivative, chord.slope, touch(chord.slope), ends);
    linear_enclosure(x, chord.slope, lowest, chord.highest)
}

/// A slope s near that of the chord of a convex f, and the maximum of f - s x, which is at an end.
struct Chord {
    slope: f64,
    highest: f64,
}

impl Chord {
    /// Creates the chord over [`low`, `high`] with a slope between `least` and `most`.
    fn new(
        [low, high]: [f64; 2],
        value: impl Fn(Interval) -> Interval,
        [least, most]: [f64; 2],
    ) -> Self {
        let [at_low, at_high] = [low, high].map(|end| value(Interval::point(end)));
        let chord = (at_high.low() - at_low.low()) / (high - low);
        let slope = chord.max(least).min(most);
        let above = |end: f64, value: Interval| {
            (value - Interval::point(slope) * Interval::point(end)).high()
        };
        Self {
            slope,
            highest: above(low, at_low).max(above(high, at_high)),
        }
    }
}

/// Bounds f(x) - s x over [l, h] from below for convex f, by the tangent near `touch`.
fn tangent_lower_bound(
    value: impl Fn(Interval) -> Interval,
    derivative: impl Fn(Interval) -> Interval,
    slope: f64,
    touch: f64,
    [low, high]: [f64; 2],
) -> f64 {
    let touch = Interval::point(touch.max(low).min(high));
    let tilt = derivative(touch) - Interval::point(slope);
    let [left, right] = [low, high].map(|end| tilt * (Interval::point(end) - touch));
    (value(touch) - Interval::point(slope) * touch + left.min(right)).low()
}

/// Returns the hyperbolic tangent.
#[must_use]
pub fn hyperbolic_tangent(z: &AffineForm) -> AffineForm {
    let bound = tanh_relaxation(z.range().low(), z.range().high());
    linear_enclosure(
        z,
        bound.slope,
        bound.deviation.low(),
        bound.deviation.high(),
    )
}

/// Returns a slope s, and bounds of tanh z - s z over [l, h].
pub(super) fn tanh_relaxation(low: f64, high: f64) -> LinearBound {
    if !(low.is_finite() && high.is_finite()) {
        return LinearBound {
            slope: 0.0,
            deviation: (-ONE).hull(ONE),
        };
    }
    let [at_low, at_high] = [low, high].map(tanh);
    let chord = (at_high.low() - at_low.low()) / (high - low);
    let slope = if chord.is_finite() {
        chord.clamp(0.0, 1.0)
    } else {
        0.0
    };
    let mut deviation = (at_low - Interval::point(slope) * Interval::point(low))
        .hull(at_high - Interval::point(slope) * Interval::point(high));
    if high > 0.0 {
        let most = tanh_upper_bound(slope, low.max(0.0), high);
        deviation = deviation.hull(Interval::point(most));
    }
    if low < 0.0 {
        let most = tanh_upper_bound(slope, (-high).max(0.0), -low);
        deviation = deviation.hull(Interval::point(-most));
    }
    // A line that exceeds the range of tanh is worse than a constant.
    let reach = slope * (0.5 * high - 0.5 * low) + 0.5 * (deviation.high() - deviation.low());
    if reach < 1.0 {
        LinearBound { slope, deviation }
    } else {
        LinearBound {
            slope: 0.0,
            deviation: at_low.hull(at_high),
        }
    }
}

/// Bounds tanh z - s z from above for 0 ≤ `low` ≤ z ≤ `high`: the negative of the tangent bound of -tanh.
fn tanh_upper_bound(slope: f64, low: f64, high: f64) -> f64 {
    let touch = (1.0 - slope).sqrt().min(1.0 - 1e-15).atanh();
    -tangent_lower_bound(
        |z| -tanh(z.low()),
        |z| tanh(z.low()).sqr() - ONE,
        -slope,
        touch,
        [low, high],
    )
}

/// Returns for l < 0 a slope s, and bounds of f(x) - s x over [l, h] for the ELU f.
pub(super) fn elu_relaxation(alpha: f64, low: f64, high: f64) -> LinearBound {
    if !(low.is_finite() && high.is_finite()) {
        return LinearBound {
            slope: 0.0,
            deviation: Interval::ENTIRE,
        };
    }
    if !(0.0..=1.0).contains(&alpha) {
        let ends = elu(alpha, low).hull(elu(alpha, high));
        let deviation = if high > 0.0 {
            ends.hull(Interval::ZERO)
        } else {
            ends
        };
        return LinearBound {
            slope: 0.0,
            deviation,
        };
    }
    let chord = Chord::new([low, high], |x| elu(alpha, x.low()), [0.0, 1.0]);
    let least = if chord.slope >= alpha {
        0.0
    } else {
        tangent_lower_bound(
            |x| elu(alpha, x.low()),
            |x| Interval::point(alpha) * exp(x.low()),
            chord.slope,
            // The point where α eˣ is the slope. Above 0, f - s x grows from its value at 0.
            (chord.slope / alpha).ln().clamp(-40.0, 0.0),
            [low, high.min(0.0)],
        )
    };
    LinearBound {
        slope: chord.slope,
        deviation: Interval::new(least, chord.highest).unwrap_or(Interval::ENTIRE),
    }
}

fn elu(alpha: f64, x: f64) -> Interval {
    if x >= 0.0 {
        Interval::point(x)
    } else {
        Interval::point(alpha) * (exp(x) - ONE)
    }
}

fn exp(x: f64) -> Interval {
    if x < -40.0 {
        Interval::ZERO.hull(exp_neg(40.0))
    } else {
        exp_neg(-x)
    }
}

/// Returns tanh of a number.
#[must_use]
pub fn tanh(z: f64) -> Interval {
    if z < 0.0 {
        return -tanh(-z);
    }
    if z > 20.0 {
        return (ONE - Interval::point(f64::EPSILON)).hull(ONE);
    }
    let e = exp_neg(2.0 * z);
    (ONE - e).over(ONE + e)
}

/// Returns e⁻ʸ for 0 ≤ y ≤ 40.
#[must_use]
pub(crate) fn exp_neg(y: f64) -> Interval {
    let t = Interval::point(y / 1024.0);
    let enclosure = taylor_exp_neg(t, 7).hull(taylor_exp_neg(t, 8));
    (0..10).fold(enclosure, |power, _| power.sqr())
}

/// Returns the Taylor sum of e⁻ᵗ: 1 - t/1 (1 - t/2 (… (1 - t/`degree`))).
fn taylor_exp_neg(t: Interval, degree: u32) -> Interval {
    (1..=degree).rev().fold(ONE, |sum, n| {
        ONE - t.over(Interval::point(f64::from(n))) * sum
    })
}

#[cfg(test)]
mod tests;
