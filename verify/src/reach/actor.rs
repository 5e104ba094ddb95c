//! What a network may answer to a set of observations.
//!
//! The network computes, layer after layer, h W + b and max(0, ·), ends in a tanh and a scaling, and does so in single
//! precision. Here each of its numbers is, for every observation of the set,
//!
//! ```text
//! c + Σ Λᵢ (yᵢ - middle of yᵢ) + Σ Eⱼ ηⱼ + ρ,    ηⱼ, ρ/size of ρ in [-1, 1]
//! ```
//!
//! with y the eight scaled observations, which are affine forms, one symbol ηⱼ for each rectifier that may or may not be active
//! (it is replaced by a straight line and a bounded excess, see [`relax`](super::relax)), and ρ for everything small. A number's
//! range is that over the forms, not over the box around them: what the observations have in common counts. The answer is
//! again an affine form in the symbols of the state: what a step of driving does to the state is not lost on the next one.
//!
//! # Rounding of the network
//! With u = 2⁻²⁴, a sum of n products and a bias in single precision, in any order, is off by at most γ (Σ|w||h| + |b|), where γ
//! = (n + 2) u / (1 - (n + 2) u), and by less than (n + 1) 10⁻⁴⁴ in all if products underflow. Maxima do not round. The scaled
//! observation is off by u (1 + 10⁻⁶) of itself. The tanh of a single-precision number is assumed to be within 2⁻²² of the true
//! one; libm's is within 2⁻²³ in tests. Each is added to ρ.
//!
//! # Rounding of these bounds
//! Sums of up to 8500 products in double precision err by less than 10⁻¹² of the sum of the absolute values, which is added too.

use super::bounds::{Bounds, Inputs};
use super::form::{Form, SLACK};
use super::relax::{hyperbolic_tangent, rectified};
use crate::interval::Interval;
use crate::work::{Work, WorkLimit};

/// Numbers that are observed: gap ahead, gap behind, speed ahead, own, behind, acceleration ahead, own, behind.
pub const OBSERVED: usize = 8;

/// Rounding of single precision.
pub(super) const U: f64 = 1.0 / (1 << 24) as f64;

/// Assumed of the single-precision tanh: how far it is from the true one at most.
pub const TANH_ERROR: f64 = 1.0 / (1 << 22) as f64;

/// A network with what surrounds it, exactly as in the policy file.
#[derive(Debug, Clone, PartialEq)]
pub struct Actor {
    /// From the observation on.
    pub layers: Vec<Layer>,
    /// Subtracted from observations.
    pub offset: [f64; OBSERVED],
    /// Observations are divided by this.
    pub scale: [f64; OBSERVED],
    /// Scaled observations are cut to plus and minus this.
    pub limit: f64,
    /// The gap that stands in for a vehicle that is not there, in metres.
    pub empty_gap_m: f64,
    /// Accelerations for a tanh of -1 and 1, in m/s².
    pub action_mps2: [f64; 2],
    /// Time between decisions, in seconds.
    pub decision_interval_s: f64,
}

/// h W + b.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Length of h.
    pub inputs: usize,
    /// Length of the result.
    pub outputs: usize,
    /// W row after row, one row an input.
    pub weights: Vec<f64>,
    /// b.
    pub biases: Vec<f64>,
}

impl Actor {
    /// How many bytes the bounds between two layers take at most.
    pub(super) fn bytes_to_decide(&self) -> usize {
        let mut width = OBSERVED;
        let of_layer = |layer: &Layer| {
            width += layer.outputs;
            width.saturating_mul(layer.outputs)
        };
        // Those before a layer and those after it.
        self.layers.iter().map(of_layer).max().unwrap_or(0).saturating_mul(2 * size_of::<f64>())
    }

    /// The acceleration that is wanted for observations of which each may be off by `error`, in m/s².
    #[must_use]
    pub fn decide(&self, seen: &[Form; OBSERVED], error: &[f64; OBSERVED]) -> Form {
        self.decide_within(seen, error, &Work::within(WorkLimit::NONE))
    }

    /// The same; any number at all where it takes too much work.
    pub(super) fn decide_within(&self, seen: &[Form; OBSERVED], error: &[f64; OBSERVED], work: &Work) -> Form {
        let scaled: [Form; OBSERVED] = std::array::from_fn(|i| self.scaled(i, &seen[i], error[i]));
        let answer = answer_within(&self.layers, &scaled, work).unwrap_or_else(Form::line);
        let mut tanh = hyperbolic_tangent(&answer);
        tanh.widen(TANH_ERROR);
        let [low, high] = self.action_mps2.map(Interval::point);
        let half = Interval::point(0.5);
        let mut wanted = tanh.scaled(half * (high - low));
        wanted.shift(half * (low + high));
        wanted.widen(1e-14 * (self.action_mps2[0].abs() + self.action_mps2[1].abs()));
        wanted
    }

    fn scaled(&self, i: usize, seen: &Form, error: f64) -> Form {
        let mut scaled = seen.clone();
        scaled.shift(-Interval::point(self.offset[i]));
        if error > 0.0 {
            scaled.widen(error);
        }
        scaled = scaled.scaled(Interval::ONE.over(Interval::point(self.scale[i])));
        // Cut to [-limit, limit]: y + max(0, -limit - y) - max(0, y - limit).
        let beyond = |sign: f64| {
            let mut beyond = scaled.scaled(Interval::point(sign));
            beyond.shift(-Interval::point(self.limit));
            rectified(&beyond)
        };
        let (above, below) = (beyond(1.0), beyond(-1.0));
        let mut cut = scaled.minus(&above).plus(&below);
        let largest = cut.centre().abs() + cut.radius();
        cut.widen(largest * U * (1.0 + 1e-6) + 1e-44);
        cut
    }
}

/// What the layers answer to inputs, rectified between layers, as a form in the inputs' symbols.
#[must_use]
pub fn answer(layers: &[Layer], inputs: &[Form; OBSERVED]) -> Form {
    answer_within(layers, inputs, &Work::within(WorkLimit::NONE)).unwrap_or_else(Form::line)
}

/// The same; none where it takes too much work, or the layers do not end in one number.
fn answer_within(layers: &[Layer], inputs: &[Form; OBSERVED], work: &Work) -> Option<Form> {
    let seen = Inputs::new(inputs);
    let mut bounds = Bounds::of_inputs(inputs);
    for (index, layer) in layers.iter().enumerate() {
        if !work.may_do(bounds.operations(layer)) {
            return None;
        }
        bounds = bounds.through(layer, &seen);
        if index + 1 < layers.len() {
            bounds.rectify(&seen);
        }
    }
    let ([centre], [rho]) = (bounds.centre.as_slice(), bounds.rho.as_slice()) else { return None };
    let mut form = Form::constant(Interval::point(*centre));
    let (on_inputs, on_excess) = bounds.columns.split_at_checked(OBSERVED)?;
    for (input, &factor) in inputs.iter().zip(on_inputs) {
        let mut deviation = input.clone();
        deviation.shift(-Interval::point(input.centre()));
        form.add(&deviation, Interval::point(factor));
    }
    form.widen((on_excess.iter().map(|term| term.abs()).sum::<f64>() + rho) * (1.0 + SLACK));
    Some(form)
}
