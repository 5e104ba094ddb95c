//! Bounds of a network's output for a set of observations.
//!
//! The network's inputs are affine functions of the observation, clipped to limits. Each layer computes h W + b or an
//! activation function. The output is scaled to an acceleration. All in single precision. Here each of its numbers is,
//! for every observation of the set,
//!
//! ```text
//! c + Σ Λᵢ (yᵢ - middle of yᵢ) + Σ Eⱼ ηⱼ + ρ,    ηⱼ, ρ/size of ρ in [-1, 1]
//! ```
//!
//! with y its inputs, which are affine forms. There is one symbol ηⱼ for each activation that is not straight over the
//! range of its number (a straight line and a bounded excess replace it, see [`activation`](super::activation)), and ρ
//! for everything small. The range of a number follows from the forms, not from the box around them, so correlations of
//! the observations count. The output is again an affine form in the symbols of the state, so correlations survive the
//! next step. Operations after the last product apply to that form.
//!
//! # Rounding of the network
//! With u = 2⁻²⁴, a sum of n products and a bias in single precision, in any order, fused or not (a fused multiply-add
//! rounds once instead of twice), is off by at most γ (Σ|w||h| + |b|), with γ = (n + 2) u / (1 - (n + 2) u). Products
//! that underflow add less than (n + 1) 10⁻⁴⁴ in all. Maxima do not round. An input is off by u (1 + 10⁻⁶) of itself. A
//! difference of two observed numbers is off by 2⁻⁵³ of itself, before the offset is subtracted. The tanh of a
//! single-precision number is assumed to be within 2⁻²² of the true one; libm's is within 2⁻²³ in tests. Each is added
//! to ρ. The scaled output is off by less than 10⁻¹⁴ of its terms. The bounds also hold for the network in real
//! numbers.
//!
//! # Rounding of these bounds
//! Sums of up to 8500 products in double precision err by less than 10⁻¹² of the sum of the absolute values, which is
//! added too.

use serde::{Deserialize, Serialize};

use super::activation::Activation;
use super::bounds::{InputForms, NetworkBounds};
use super::form::AffineForm;
use super::relax::relu;
use crate::interval::Interval;
use crate::work::{OpBudget, WorkLimit};

/// Number of observed quantities: gaps ahead and behind, speeds ahead, own and behind, accelerations ahead, own and
/// behind.
pub const OBSERVATION_SIZE: usize = 8;

/// Unit roundoff of single precision.
pub(super) const UNIT_ROUNDOFF: f64 = 1.0 / (1 << 24) as f64;

/// Assumed absolute error of the single-precision tanh, and relative error of exp and exp - 1.
pub const TANH_ERROR: f64 = 1.0 / (1 << 22) as f64;

/// A network with its input mapping and output scaling, exactly as in its file.
#[derive(Debug, Clone, PartialEq)]
pub struct NeuralController {
    /// Inputs of the network, in order.
    pub inputs: Vec<ControllerInput>,
    /// Layers of the network.
    pub layers: Vec<NetworkLayer>,
    /// Index of the used output, from 0.
    pub output_index: usize,
    /// Factor of the output, in m/s².
    pub scale_mps2: f64,
    /// Offset of the scaled output, in m/s².
    pub offset_mps2: f64,
    /// Bounds of the commanded acceleration, in m/s².
    pub action_bounds_mps2: [f64; 2],
    /// True if these bounds clip; false if the output cannot exceed them.
    pub is_clipped: bool,
    /// Gap that stands in for an absent vehicle, in metres.
    pub empty_gap_m: f64,
    /// Time between decisions, in seconds.
    pub decision_interval_s: f64,
    /// Source file of an imported network.
    pub source: Option<NetworkFileSource>,
}

/// A file that the checker does not read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkFileSource {
    /// Format of the file.
    pub format: NetworkFileFormat,
    /// SHA-256 of the file, in hexadecimal.
    pub sha256: String,
}

/// A format of network files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum NetworkFileFormat {
    /// ONNX.
    Onnx,
    /// A model saved by Stable-Baselines3.
    StableBaselines,
}

impl NetworkFileFormat {
    /// Returns the display name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Onnx => "ONNX",
            Self::StableBaselines => "Stable-Baselines3",
        }
    }
}

/// An input of a network: (an affine function of the observation - offset) / scale, clipped to [low, high].
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerInput {
    /// Coefficient of each observed number: 1, -1 or 0.
    pub coefficients: [f64; OBSERVATION_SIZE],
    /// Constant term.
    pub constant: f64,
    /// Value of the affine function without a follower, for inputs about the follower.
    pub absent_value: Option<f64>,
    /// Subtracted value.
    pub offset: f64,
    /// Divisor.
    pub scale: f64,
    /// Lower clipping limit.
    pub low: f64,
    /// Upper clipping limit.
    pub high: f64,
}

/// A layer of a network.
#[derive(Debug, Clone, PartialEq)]
pub enum NetworkLayer {
    /// Product with a matrix.
    Linear(LinearLayer),
    /// Activation of each number.
    Activation(Activation),
}

/// The affine map h W + b.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearLayer {
    /// Length of h.
    pub inputs: usize,
    /// Length of the result.
    pub outputs: usize,
    /// W row by row, one row per input.
    pub weights: Vec<f64>,
    /// b.
    pub biases: Vec<f64>,
}

/// A policy of crumple's own: ReLU layers with a tanh at the end.
#[derive(Debug, Clone, PartialEq)]
pub struct NativePolicy {
    /// Layers from the observation on.
    pub layers: Vec<LinearLayer>,
    /// Values subtracted from observations.
    pub offset: [f64; OBSERVATION_SIZE],
    /// Divisors of observations.
    pub scale: [f64; OBSERVATION_SIZE],
    /// Clipping limit of scaled observations, on either side.
    pub limit: f64,
    /// Gap that stands in for an absent vehicle, in metres.
    pub empty_gap_m: f64,
    /// Accelerations for a tanh of -1 and 1, in m/s².
    pub action_bounds_mps2: [f64; 2],
    /// Time between decisions, in seconds.
    pub decision_interval_s: f64,
}

impl From<NativePolicy> for NeuralController {
    fn from(own: NativePolicy) -> Self {
        let inputs = (0..OBSERVATION_SIZE).map(|i| ControllerInput {
            coefficients: std::array::from_fn(|j| f64::from(u8::from(i == j))),
            constant: 0.0,
            absent_value: None,
            offset: own.offset[i],
            scale: own.scale[i],
            low: -own.limit,
            high: own.limit,
        });
        let [low, high] = own.action_bounds_mps2;
        Self {
            inputs: inputs.collect(),
            layers: interleave_relu(own.layers)
                .chain([NetworkLayer::Activation(Activation::Tanh)])
                .collect(),
            output_index: 0,
            scale_mps2: 0.5 * (high - low),
            offset_mps2: 0.5 * (low + high),
            action_bounds_mps2: own.action_bounds_mps2,
            is_clipped: false,
            empty_gap_m: own.empty_gap_m,
            decision_interval_s: own.decision_interval_s,
            source: None,
        }
    }
}

/// Returns layers with ReLUs between them.
pub fn interleave_relu(layers: Vec<LinearLayer>) -> impl Iterator<Item = NetworkLayer> {
    layers.into_iter().enumerate().flat_map(|(index, layer)| {
        let rectifier = (index > 0).then_some(NetworkLayer::Activation(Activation::Relu));
        rectifier.into_iter().chain([NetworkLayer::Linear(layer)])
    })
}

impl NeuralController {
    /// Returns an upper bound of the bytes for the bounds between two layers.
    pub(super) fn max_decision_bytes(&self) -> usize {
        let mut width = self.inputs.len();
        let mut numbers = width;
        let mut follows_activation = true;
        let mut most = 0;
        for layer in &self.layers {
            match layer {
                NetworkLayer::Linear(layer) => {
                    numbers = layer.outputs;
                    width += numbers;
                    follows_activation = false;
                }
                NetworkLayer::Activation(_) => {
                    if follows_activation {
                        width += numbers;
                    }
                    follows_activation = true;
                }
            }
            most = most.max(width.saturating_mul(numbers));
        }
        most.saturating_mul(2 * size_of::<f64>())
    }

    /// Returns the commanded acceleration in m/s², for observations with errors of up to `error`.
    #[must_use]
    pub fn decide(
        &self,
        observation: &[AffineForm; OBSERVATION_SIZE],
        error: &[f64; OBSERVATION_SIZE],
        is_followed: bool,
    ) -> AffineForm {
        self.decide_with_budget(
            observation,
            error,
            is_followed,
            &OpBudget::new(WorkLimit::UNLIMITED),
        )
    }

    /// Decides like [`decide`](Self::decide) within a budget; returns the whole line if it is exceeded.
    pub(crate) fn decide_with_budget(
        &self,
        observation: &[AffineForm; OBSERVATION_SIZE],
        error: &[f64; OBSERVATION_SIZE],
        is_followed: bool,
        work: &OpBudget,
    ) -> AffineForm {
        let inputs: Vec<AffineForm> = self
            .inputs
            .iter()
            .map(|input| input.enclose(observation, error, is_followed))
            .collect();
        let answer = network_output_with_budget(&self.layers, self.output_index, &inputs, work)
            .unwrap_or_else(AffineForm::entire);
        let size = self.offset_mps2.abs()
            + self.scale_mps2.abs() * (answer.centre().abs() + answer.radius());
        let mut wanted = answer.scaled(Interval::point(self.scale_mps2));
        wanted.shift(Interval::point(self.offset_mps2));
        wanted.widen(1e-14 * size);
        if self.is_clipped {
            clip(&wanted, self.action_bounds_mps2)
        } else {
            wanted
        }
    }
}

/// A weighted sum of observations, without their errors.
struct InputSum {
    value: AffineForm,
    /// Largest deviation by errors and rounding.
    deviation: f64,
}

impl InputSum {
    fn exact(number: f64) -> Self {
        let mut value = AffineForm::default();
        value.shift(Interval::point(number));
        Self {
            value,
            deviation: 0.0,
        }
    }
}

impl ControllerInput {
    fn enclose_sum(
        &self,
        observation: &[AffineForm; OBSERVATION_SIZE],
        error: &[f64; OBSERVATION_SIZE],
    ) -> InputSum {
        let mut value = AffineForm::default();
        let mut deviation = 0.0;
        let mut terms = 0;
        for ((&factor, number), error) in self
            .coefficients
            .iter()
            .zip(observation)
            .zip(error)
            .filter(|((factor, _), _)| **factor != 0.0)
        {
            if terms == 0 && factor == 1.0 {
                value = number.clone();
            } else {
                value.add_scaled(number, Interval::point(factor));
            }
            deviation += error * factor.abs();
            terms += 1;
        }
        if self.constant != 0.0 {
            value.shift(Interval::point(self.constant));
            terms += 1;
        }
        if terms > 1 {
            // The simulator rounds this sum as well.
            deviation += (value.centre().abs() + value.radius()) * f64::EPSILON;
        }
        InputSum { value, deviation }
    }

    fn enclose(
        &self,
        observation: &[AffineForm; OBSERVATION_SIZE],
        error: &[f64; OBSERVATION_SIZE],
        is_followed: bool,
    ) -> AffineForm {
        let InputSum {
            mut value,
            deviation,
        } = match self.absent_value.filter(|_| !is_followed) {
            Some(absent) => InputSum::exact(absent),
            None => self.enclose_sum(observation, error),
        };
        value.shift(-Interval::point(self.offset));
        if deviation > 0.0 {
            value.widen(deviation);
        }
        let mut clipped = clip(
            &value.scaled(Interval::ONE.over(Interval::point(self.scale))),
            [self.low, self.high],
        );
        let largest = clipped.centre().abs() + clipped.radius();
        clipped.widen(largest * UNIT_ROUNDOFF * (1.0 + 1e-6) + 1e-44);
        clipped
    }
}

/// Clips a form to an interval: y + max(0, low - y) - max(0, y - high).
fn clip(y: &AffineForm, [low, high]: [f64; 2]) -> AffineForm {
    y.clone()
        .minus(&excess_over(y, 1.0, high))
        .plus(&excess_over(y, -1.0, low))
}

/// Returns max(0, `sign` (y - `limit`)).
fn excess_over(y: &AffineForm, sign: f64, limit: f64) -> AffineForm {
    let mut excess = y.scaled(Interval::point(sign));
    excess.shift(-Interval::point(sign * limit));
    relu(&excess)
}

/// Returns the first output of layers, as a form in the symbols of the inputs.
#[must_use]
pub fn network_output(steps: &[NetworkLayer], inputs: &[AffineForm]) -> AffineForm {
    network_output_with_budget(steps, 0, inputs, &OpBudget::new(WorkLimit::UNLIMITED))
        .unwrap_or_else(AffineForm::entire)
}

/// Returns one of the outputs, or `None` if the budget is exceeded or no such output exists.
fn network_output_with_budget(
    steps: &[NetworkLayer],
    which: usize,
    inputs: &[AffineForm],
    work: &OpBudget,
) -> Option<AffineForm> {
    let input_forms = InputForms::new(inputs);
    let mut bounds = NetworkBounds::from_inputs(inputs);
    let last = steps
        .iter()
        .rposition(|step| matches!(step, NetworkLayer::Linear(_)));
    let (until_last, after_last) = steps.split_at(last.map_or(0, |last| last + 1));
    for step in until_last {
        match step {
            NetworkLayer::Linear(layer) => {
                if !work.charge(bounds.operations(layer)) {
                    return None;
                }
                bounds = bounds.apply_linear(layer, &input_forms);
            }
            NetworkLayer::Activation(activation) => {
                if !work.charge(activation.operations() * bounds.centre.len() as u64) {
                    return None;
                }
                bounds.apply_activation(activation, &input_forms);
            }
        }
    }
    let mut form = bounds.into_form(which, inputs)?;
    for step in after_last {
        if let NetworkLayer::Activation(activation) = step {
            form = activation.apply(which, &form);
        }
    }
    Some(form)
}

#[cfg(test)]
mod tests;
