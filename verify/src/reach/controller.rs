//! What a network may answer to a set of observations.
//!
//! The network sees affine functions of what is observed, cut to limits; computes, step after step, h W + b or a function of each
//! number; and its answer is stretched to an acceleration. It does so in single precision. Here each of its numbers is, for every
//! observation of the set,
//!
//! ```text
//! c + Σ Λᵢ (yᵢ - middle of yᵢ) + Σ Eⱼ ηⱼ + ρ,    ηⱼ, ρ/size of ρ in [-1, 1]
//! ```
//!
//! with y its inputs, which are affine forms, one symbol ηⱼ for each function that is not straight over the range of its number
//! (it is replaced by a straight line and a bounded excess, see [`activation`](super::activation)), and ρ for everything small. A number's
//! range is that over the forms, not over the box around them: what the observations have in common counts. The answer is
//! again an affine form in the symbols of the state: what a step of driving does to the state is not lost on the next one.
//! What is done to the one answer behind the last product is done to that form.
//!
//! # Rounding of the network
//! With u = 2⁻²⁴, a sum of n products and a bias in single precision, in any order, fused or not (a fused
//! multiply-add rounds once where the other two do twice), is off by at most γ (Σ|w||h| + |b|), where γ
//! = (n + 2) u / (1 - (n + 2) u), and by less than (n + 1) 10⁻⁴⁴ in all if products underflow. Maxima do not round. An
//! input is off by u (1 + 10⁻⁶) of itself, and a difference of two observed numbers by 2⁻⁵³ of itself before anything is subtracted from it.
//! The tanh of a single-precision number is assumed to be within 2⁻²² of the true one; libm's is within 2⁻²³ in tests. Each is added to ρ.
//! The stretched answer is off by less than 10⁻¹⁴ of its terms. Nothing uses that a number *is* rounded: what is said of the network holds
//! in real numbers as well.
//!
//! # Rounding of these bounds
//! Sums of up to 8500 products in double precision err by less than 10⁻¹² of the sum of the absolute values, which is added too.

use serde::{Deserialize, Serialize};

use super::activation::Activation;
use super::bounds::{InputForms, NetworkBounds};
use super::form::AffineForm;
use super::relax::relu;
use super::residual::ResidualPolicy;
use crate::interval::Interval;
use crate::work::{OpBudget, WorkLimit};

/// Numbers that are observed: gap ahead, gap behind, speed ahead, own, behind, acceleration ahead, own, behind.
pub const OBSERVATION_SIZE: usize = 8;

/// Rounding of single precision.
pub(super) const UNIT_ROUNDOFF: f64 = 1.0 / (1 << 24) as f64;

/// Assumed of the single-precision tanh: how far it is from the true one at most; and of exp and exp - 1, relative to themselves.
pub const TANH_ERROR: f64 = 1.0 / (1 << 22) as f64;

/// A network with what surrounds it, exactly as in its file.
#[derive(Debug, Clone, PartialEq)]
pub struct NeuralController {
    /// What the network sees, in order.
    pub inputs: Vec<ControllerInput>,
    /// What it does with that.
    pub layers: Vec<NetworkLayer>,
    /// Which of its answers counts, from 0.
    pub output_index: usize,
    /// What the answer is multiplied with, in m/s²; 1 where it is an action that departs from a law, and then nothing is added to it.
    pub scale_mps2: f64,
    /// What is added to that, in m/s².
    pub offset_mps2: f64,
    /// Bounds of the accelerations that it asks for, in m/s².
    pub action_bounds_mps2: [f64; 2],
    /// Whether these are kept by cutting what goes beyond them, or nothing can.
    pub is_clipped: bool,
    /// The law from which it departs; none if it answers with an acceleration.
    pub residual_over: Option<ResidualPolicy>,
    /// The gap that stands in for a vehicle that is not there, in metres.
    pub empty_gap_m: f64,
    /// Time between decisions, in seconds.
    pub decision_interval_s: f64,
    /// The file that it was read from, if it is not one of crumple's own policies.
    pub source: Option<NetworkFileSource>,
}

/// A file that the checker does not read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkFileSource {
    /// Its format.
    pub format: NetworkFileFormat,
    /// Its SHA-256, in hexadecimal.
    pub sha256: String,
}

/// Formats of networks.
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
    /// Its name for a reader.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Onnx => "ONNX",
            Self::StableBaselines => "Stable-Baselines3",
        }
    }
}

/// A number that a network sees: (an affine function of what is observed - offset) / scale, cut to lie between two numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerInput {
    /// What each observed number is multiplied with: 1, -1 or 0.
    pub coefficients: [f64; OBSERVATION_SIZE],
    /// What is added.
    pub constant: f64,
    /// What stands in for all of that where nobody is behind, if it is about who is behind.
    pub absent_value: Option<f64>,
    /// Subtracted.
    pub offset: f64,
    /// Divided by.
    pub scale: f64,
    /// The least that the network sees.
    pub low: f64,
    /// The most that it sees.
    pub high: f64,
}

/// What a network does next.
#[derive(Debug, Clone, PartialEq)]
pub enum NetworkLayer {
    /// A product with a matrix.
    Linear(LinearLayer),
    /// Something done to each number.
    Activation(Activation),
}

/// h W + b.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearLayer {
    /// Length of h.
    pub inputs: usize,
    /// Length of the result.
    pub outputs: usize,
    /// W row after row, one row an input.
    pub weights: Vec<f64>,
    /// b.
    pub biases: Vec<f64>,
}

/// What crumple's own policies are made of: layers with rectifiers between them and a tanh behind.
#[derive(Debug, Clone, PartialEq)]
pub struct NativePolicy {
    /// From the observation on.
    pub layers: Vec<LinearLayer>,
    /// Subtracted from observations.
    pub offset: [f64; OBSERVATION_SIZE],
    /// Observations are divided by this.
    pub scale: [f64; OBSERVATION_SIZE],
    /// Scaled observations are cut to plus and minus this.
    pub limit: f64,
    /// The gap that stands in for a vehicle that is not there, in metres.
    pub empty_gap_m: f64,
    /// Accelerations for a tanh of -1 and 1, in m/s².
    pub action_bounds_mps2: [f64; 2],
    /// The law that it departs from towards these, if it does.
    pub residual_over: Option<ResidualPolicy>,
    /// Time between decisions, in seconds.
    pub decision_interval_s: f64,
}

impl From<NativePolicy> for NeuralController {
    fn from(own: NativePolicy) -> Self {
        let NativePolicy {
            layers,
            offset,
            scale,
            limit,
            empty_gap_m,
            action_bounds_mps2: action_mps2,
            residual_over: departs_from,
            decision_interval_s,
        } = own;
        let input = |i: usize| ControllerInput {
            coefficients: std::array::from_fn(|j| f64::from(u8::from(i == j))),
            constant: 0.0,
            absent_value: None,
            offset: offset[i],
            scale: scale[i],
            low: -limit,
            high: limit,
        };
        let [low, high] = action_mps2;
        let stretched = [0.5 * (high - low), 0.5 * (low + high)];
        let [scale_mps2, offset_mps2] = if departs_from.is_some() { [1.0, 0.0] } else { stretched };
        Self {
            inputs: (0..OBSERVATION_SIZE).map(input).collect(),
            layers: interleave_relu(layers).chain([NetworkLayer::Activation(Activation::Tanh)]).collect(),
            output_index: 0,
            scale_mps2,
            offset_mps2,
            action_bounds_mps2: action_mps2,
            is_clipped: false,
            residual_over: departs_from,
            empty_gap_m,
            decision_interval_s,
            source: None,
        }
    }
}

/// The steps of layers with rectifiers between them.
pub fn interleave_relu(layers: Vec<LinearLayer>) -> impl Iterator<Item = NetworkLayer> {
    let rectified = |(index, layer)| {
        let rectifier = (index > 0).then_some(NetworkLayer::Activation(Activation::Relu));
        rectifier.into_iter().chain([NetworkLayer::Linear(layer)])
    };
    layers.into_iter().enumerate().flat_map(rectified)
}

impl NeuralController {
    /// How many bytes the bounds between two steps take at most.
    pub(super) fn max_decision_bytes(&self) -> usize {
        let mut width = self.inputs.len();
        let mut numbers = width;
        let mut is_each = true;
        let of_step = |step: &NetworkLayer| {
            match step {
                NetworkLayer::Linear(layer) => {
                    // What is off the lines of a function behind it.
                    numbers = layer.outputs;
                    width += numbers;
                }
                // A second function in a row.
                NetworkLayer::Activation(_) if is_each => width += numbers,
                NetworkLayer::Activation(_) => {}
            }
            is_each = matches!(step, NetworkLayer::Activation(_));
            width.saturating_mul(numbers)
        };
        // Those before a step and those after it.
        self.layers.iter().map(of_step).max().unwrap_or(0).saturating_mul(2 * size_of::<f64>())
    }

    /// The acceleration that is wanted for observations of which each may be off by `error`, in m/s², with somebody behind or not; of who
    /// departs from a law the action.
    #[must_use]
    pub fn decide(
        &self,
        seen: &[AffineForm; OBSERVATION_SIZE],
        error: &[f64; OBSERVATION_SIZE],
        is_followed: bool,
    ) -> AffineForm {
        self.decide_with_budget(seen, error, is_followed, &OpBudget::new(WorkLimit::UNLIMITED))
    }

    /// The same; any number at all where it takes too much work.
    pub(crate) fn decide_with_budget(
        &self,
        seen: &[AffineForm; OBSERVATION_SIZE],
        error: &[f64; OBSERVATION_SIZE],
        is_followed: bool,
        work: &OpBudget,
    ) -> AffineForm {
        let inputs: Vec<AffineForm> = self.inputs.iter().map(|input| input.enclose(seen, error, is_followed)).collect();
        let answer = network_output_with_budget(&self.layers, self.output_index, &inputs, work)
            .unwrap_or_else(AffineForm::entire);
        let size = self.offset_mps2.abs() + self.scale_mps2.abs() * (answer.centre().abs() + answer.radius());
        let mut wanted = answer.scaled(Interval::point(self.scale_mps2));
        wanted.shift(Interval::point(self.offset_mps2));
        wanted.widen(1e-14 * size);
        if self.is_clipped { clip(&wanted, self.action_bounds_mps2) } else { wanted }
    }
}

impl ControllerInput {
    /// It, for observations of which each may be off by `error`.
    fn enclose(
        &self,
        seen: &[AffineForm; OBSERVATION_SIZE],
        error: &[f64; OBSERVATION_SIZE],
        is_followed: bool,
    ) -> AffineForm {
        let Self { coefficients: of, constant, absent_value: absent, offset, scale, low, high } = self;
        let (mut value, mut off, mut terms) = (AffineForm::default(), 0.0, 0);
        match absent.filter(|_| !is_followed) {
            Some(absent) => value.shift(Interval::point(absent)),
            None => {
                for ((&factor, number), error) in
                    of.iter().zip(seen).zip(error).filter(|((factor, _), _)| **factor != 0.0)
                {
                    if terms == 0 && factor == 1.0 {
                        value = number.clone();
                    } else {
                        value.add_scaled(number, Interval::point(factor));
                    }
                    off += error * factor.abs();
                    terms += 1;
                }
                if *constant != 0.0 {
                    value.shift(Interval::point(*constant));
                    terms += 1;
                }
            }
        }
        if terms > 1 {
            // The simulator rounds it as well.
            off += (value.centre().abs() + value.radius()) * f64::EPSILON;
        }
        value.shift(-Interval::point(*offset));
        if off > 0.0 {
            value.widen(off);
        }
        let mut cut = clip(&value.scaled(Interval::ONE.over(Interval::point(*scale))), [*low, *high]);
        let largest = cut.centre().abs() + cut.radius();
        cut.widen(largest * UNIT_ROUNDOFF * (1.0 + 1e-6) + 1e-44);
        cut
    }
}

/// A form cut to lie between two numbers: y + max(0, low - y) - max(0, y - high).
fn clip(y: &AffineForm, [low, high]: [f64; 2]) -> AffineForm {
    let beyond = |sign: f64, limit: f64| {
        let mut beyond = y.scaled(Interval::point(sign));
        beyond.shift(-Interval::point(sign * limit));
        relu(&beyond)
    };
    y.clone().minus(&beyond(1.0, high)).plus(&beyond(-1.0, low))
}

/// What steps make of inputs, the first of their answers, as a form in the inputs' symbols.
#[must_use]
pub fn network_output(steps: &[NetworkLayer], inputs: &[AffineForm]) -> AffineForm {
    network_output_with_budget(steps, 0, inputs, &OpBudget::new(WorkLimit::UNLIMITED))
        .unwrap_or_else(AffineForm::entire)
}

/// One of the answers; none where it takes too much work, or there is no such answer.
fn network_output_with_budget(
    steps: &[NetworkLayer],
    which: usize,
    inputs: &[AffineForm],
    work: &OpBudget,
) -> Option<AffineForm> {
    let seen = InputForms::new(inputs);
    let mut bounds = NetworkBounds::from_inputs(inputs);
    let last = steps.iter().rposition(|step| matches!(step, NetworkLayer::Linear(_)));
    let (until_last, behind) = steps.split_at(last.map_or(0, |last| last + 1));
    for step in until_last {
        match step {
            NetworkLayer::Linear(layer) => {
                if !work.charge(bounds.operations(layer)) {
                    return None;
                }
                bounds = bounds.apply_linear(layer, &seen);
            }
            NetworkLayer::Activation(each) => {
                if !work.charge(each.operations() * bounds.centre.len() as u64) {
                    return None;
                }
                bounds.apply_activation(each, &seen);
            }
        }
    }
    let mut form = bounds.into_form(which, inputs)?;
    for step in behind {
        if let NetworkLayer::Activation(each) = step {
            form = each.apply(which, &form);
        }
    }
    Some(form)
}

#[cfg(test)]
mod tests;
