//! Elementwise operations of a network.

/// An elementwise operation, with one operand per number or none.
///
/// Uses single precision in a fixed order, with `tanh` and `exp` from `libm`: bit-identical on every machine.
#[derive(Debug, Clone, PartialEq)]
pub enum Elementwise {
    /// x + a.
    Add(Vec<f32>),
    /// x a.
    Multiply(Vec<f32>),
    /// x / a.
    Divide(Vec<f32>),
    /// x clipped to a minimum and a maximum.
    Clip {
        /// Minimum.
        low: Vec<f32>,
        /// Maximum.
        high: Vec<f32>,
    },
    /// max(0, x).
    Relu,
    /// x, multiplied by the slope if negative.
    LeakyRelu {
        /// Slope.
        slope: f32,
    },
    /// x, or α (eˣ - 1) if negative.
    Elu {
        /// α.
        alpha: f32,
    },
    /// tanh x.
    Tanh,
    /// 1 / (1 + e⁻ˣ).
    Sigmoid,
}

impl Elementwise {
    /// Returns the number of operands; `None` without operands.
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

    /// Applies the operation to rows of `width` values.
    pub fn apply(&self, values: &mut [f32], width: usize) {
        match self {
            Self::Add(operands) => map_rows(values, operands, |x, a| x + a),
            Self::Multiply(operands) => map_rows(values, operands, |x, a| x * a),
            Self::Divide(operands) => map_rows(values, operands, |x, a| x / a),
            Self::Clip { low, high } => {
                for row in values.chunks_exact_mut(width.max(1)) {
                    for ((value, &low), &high) in row.iter_mut().zip(low).zip(high) {
                        *value = clamp(*value, low, high);
                    }
                }
            }
            Self::Relu => map_values(values, |x| if x > 0.0 { x } else { 0.0 }),
            Self::LeakyRelu { slope } => {
                map_values(values, |x| if x < 0.0 { slope * x } else { x })
            }
            Self::Elu { alpha } => {
                map_values(
                    values,
                    |x| if x < 0.0 { alpha * libm::expm1f(x) } else { x },
                )
            }
            Self::Tanh => map_values(values, libm::tanhf),
            Self::Sigmoid => map_values(values, |x| 1.0 / (1.0 + libm::expf(-x))),
        }
    }

    /// Returns the range of number `index` for an input between `low` and `high`, without rounding.
    #[must_use]
    pub fn range(&self, index: usize, [low, high]: [f64; 2]) -> [f64; 2] {
        let ends = [low, high];
        match self {
            Self::Add(operands) => ends.map(|x| x + operand(operands, index)),
            Self::Multiply(operands) => sorted(ends.map(|x| x * operand(operands, index))),
            Self::Divide(operands) => sorted(ends.map(|x| x / operand(operands, index))),
            Self::Clip { low, high } => {
                ends.map(|x| x.max(operand(low, index)).min(operand(high, index)))
            }
            Self::Relu => ends.map(|x| x.max(0.0)),
            Self::LeakyRelu { slope } => range_if_negative(ends, |x| f64::from(*slope) * x),
            Self::Elu { alpha } => range_if_negative(ends, |x| f64::from(*alpha) * libm::expm1(x)),
            Self::Tanh => ends.map(libm::tanh),
            Self::Sigmoid => ends.map(|x| 1.0 / (1.0 + libm::exp(-x))),
        }
    }
}

fn operand(operands: &[f32], index: usize) -> f64 {
    operands.get(index).copied().map_or(f64::NAN, f64::from)
}

fn sorted([a, b]: [f64; 2]) -> [f64; 2] {
    if a <= b { [a, b] } else { [b, a] }
}

/// Returns the range of a function that is `negative` below 0 and the identity above, between two inputs.
fn range_if_negative(ends: [f64; 2], negative: impl Fn(f64) -> f64) -> [f64; 2] {
    let [min, max] = sorted(ends.map(|x| if x < 0.0 { negative(x) } else { x }));
    // A negative factor has its extremum at 0.
    if ends[0] < 0.0 && ends[1] > 0.0 {
        [min.min(0.0), max.max(0.0)]
    } else {
        [min, max]
    }
}

/// Clips a number. Plain comparisons: for 0 and -0 `f32::max` may return either.
#[inline]
fn clamp(value: f32, low: f32, high: f32) -> f32 {
    let value = if value < low { low } else { value };
    if value > high { high } else { value }
}

#[inline]
fn map_values(values: &mut [f32], change: impl Fn(f32) -> f32) {
    values.iter_mut().for_each(|value| *value = change(*value));
}

#[inline]
fn map_rows(values: &mut [f32], operands: &[f32], change: impl Fn(f32, f32) -> f32) {
    for row in values.chunks_exact_mut(operands.len().max(1)) {
        row.iter_mut()
            .zip(operands)
            .for_each(|(value, &operand)| *value = change(*value, operand));
    }
}
