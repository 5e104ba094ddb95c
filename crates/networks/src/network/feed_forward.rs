//! Feed-forward networks: sequences of matrix products and elementwise operations.

use super::{Elementwise, MAX_LAYER_WIDTH, MAX_PARAMETERS, MAX_STEPS, NetworkError};
use crumple_sim::policy::{PackedNetwork, Workspace};

/// An affine layer, h W + b.
#[derive(Debug, Clone, PartialEq)]
pub struct Linear {
    /// W, row-major: one row per input.
    pub weights: Vec<f32>,
    /// b, one per output.
    pub biases: Vec<f32>,
}

/// A step of a network.
#[derive(Debug, Clone, PartialEq)]
pub enum NetworkStep {
    /// A product with a matrix.
    Linear(Linear),
    /// An elementwise operation.
    Elementwise(Elementwise),
}

/// A fully connected network.
///
/// ```
/// use crumple_networks::network::{Elementwise, FeedForward, Linear, NetworkStep};
/// use crumple_sim::policy::Workspace;
///
/// let layer = Linear { weights: vec![1.0, -2.0], biases: vec![0.5] };
/// let steps = vec![NetworkStep::Linear(layer), NetworkStep::Elementwise(Elementwise::Relu)];
/// let network = FeedForward::new(2, steps).unwrap();
/// let mut space = Workspace::default();
/// assert_eq!(network.forward(&[3.0, 1.0, 0.0, 1.0], 2, &mut space), [1.5, 0.0]);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct FeedForward {
    /// Numbers of values between the steps, from the inputs to the answers.
    widths: Vec<usize>,
    steps: Vec<NetworkStep>,
    packed: PackedNetwork,
}

impl FeedForward {
    /// Creates a network from steps that fit each other.
    ///
    /// # Errors
    /// [`NetworkError::Step`] for a step that does not fit or is not finite; other errors for too large networks.
    pub fn new(inputs: usize, steps: Vec<NetworkStep>) -> Result<Self, NetworkError> {
        if !(1..=MAX_LAYER_WIDTH).contains(&inputs) || steps.len() > MAX_STEPS {
            let problem = format!(
                "{inputs} inputs and {} steps: at most {MAX_LAYER_WIDTH} and {MAX_STEPS} are allowed",
                steps.len()
            );
            return Err(NetworkError::Unsupported(problem));
        }
        let mut widths = vec![inputs];
        let mut width = inputs;
        let mut parameters = 0_usize;
        for (index, step) in steps.iter().enumerate() {
            width = check_step(step, width).map_err(|problem| NetworkError::Step {
                step: index,
                problem,
            })?;
            widths.push(width);
            if let NetworkStep::Linear(linear) = step {
                parameters = parameters.saturating_add(linear.weights.len() + linear.biases.len());
            }
        }
        if parameters > MAX_PARAMETERS {
            return Err(NetworkError::TooManyParameters);
        }
        let packed = pack_steps(&steps, &widths);
        Ok(Self {
            widths,
            steps,
            packed,
        })
    }

    /// Returns the number of inputs.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.widths.first().copied().unwrap_or_default()
    }

    /// Returns the number of answers.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.widths.last().copied().unwrap_or_default()
    }

    /// Returns the steps, in order.
    #[must_use]
    pub fn steps(&self) -> &[NetworkStep] {
        &self.steps
    }

    /// Returns the widths of the layers as text: `5-20-20-1`.
    #[must_use]
    pub fn shape(&self) -> String {
        let products = self.steps.iter().zip(&self.widths[1..]);
        let layers = products
            .filter(|(step, _)| matches!(step, NetworkStep::Linear(_)))
            .map(|(_, width)| *width);
        std::iter::once(self.inputs())
            .chain(layers)
            .map(|width| width.to_string())
            .collect::<Vec<_>>()
            .join("-")
    }

    /// Returns the answers to `batch` rows of inputs; the bits of a row do not depend on other rows.
    #[must_use]
    pub fn forward<'w>(&self, inputs: &[f32], batch: usize, space: &'w mut Workspace) -> &'w [f32] {
        self.packed.forward(inputs, batch, space)
    }

    /// Returns the bounds of each answer by the functions after the last layer: -1 and 1 after tanh, or infinite.
    #[must_use]
    pub fn answer_bounds(&self) -> Vec<[f64; 2]> {
        let after_last = self
            .steps
            .iter()
            .rposition(|step| matches!(step, NetworkStep::Linear(_)))
            .map_or(0, |last| last + 1);
        (0..self.outputs())
            .map(|index| {
                self.steps.iter().skip(after_last).fold(
                    [f64::NEG_INFINITY, f64::INFINITY],
                    |bounds, step| match step {
                        NetworkStep::Elementwise(function) => function.range(index, bounds),
                        NetworkStep::Linear(_) => bounds,
                    },
                )
            })
            .collect()
    }

    /// Returns the range of each answer for inputs within their limits, without rounding.
    ///
    /// # Errors
    /// [`NetworkError::Overflow`] if a sum could leave single precision, so that an answer might be NaN.
    pub fn answer_ranges(&self, inputs: &[[f64; 2]]) -> Result<Vec<[f64; 2]>, NetworkError> {
        // Half of the range is reserved for rounding.
        let highest = 0.5 * f64::from(f32::MAX);
        let mut ranges = inputs.to_vec();
        ranges.resize(self.inputs(), [0.0, 0.0]);
        if !are_within(&ranges, highest) {
            return Err(NetworkError::Overflow { step: 0 });
        }
        for (index, step) in self.steps.iter().enumerate() {
            let next = match step {
                NetworkStep::Linear(linear) => linear.ranges(&ranges, highest),
                NetworkStep::Elementwise(function) => Some(
                    ranges
                        .iter()
                        .enumerate()
                        .map(|(index, range)| function.range(index, *range))
                        .collect(),
                ),
            };
            ranges = next
                .filter(|next| are_within(next, highest))
                .ok_or(NetworkError::Overflow { step: index })?;
        }
        Ok(ranges)
    }
}

fn are_within(ranges: &[[f64; 2]], highest: f64) -> bool {
    ranges.iter().flatten().all(|bound| bound.abs() <= highest)
}

impl Linear {
    /// Returns the range of each sum; `None` if a partial sum could exceed `highest`.
    fn ranges(&self, inputs: &[[f64; 2]], highest: f64) -> Option<Vec<[f64; 2]>> {
        let mut sums: Vec<[f64; 3]> = self
            .biases
            .iter()
            .map(|bias| [f64::from(*bias), f64::from(*bias), f64::from(bias.abs())])
            .collect();
        for (input, row) in inputs
            .iter()
            .zip(self.weights.chunks_exact(self.biases.len().max(1)))
        {
            for ([low, high, size], weight) in sums.iter_mut().zip(row) {
                let ends = input.map(|end| end * f64::from(*weight));
                *low += ends[0].min(ends[1]);
                *high += ends[0].max(ends[1]);
                *size += ends[0].abs().max(ends[1].abs());
            }
        }
        sums.into_iter()
            .map(|[low, high, size]| (size <= highest).then_some([low, high]))
            .collect()
    }
}

/// Checks a step with `width` inputs and returns the number of its outputs.
fn check_step(step: &NetworkStep, width: usize) -> Result<usize, String> {
    match step {
        NetworkStep::Linear(linear) => check_linear(linear, width),
        NetworkStep::Elementwise(function) => {
            check_elementwise(function, width)?;
            Ok(width)
        }
    }
}

fn check_linear(Linear { weights, biases }: &Linear, width: usize) -> Result<usize, String> {
    let outputs = biases.len();
    if !(1..=MAX_LAYER_WIDTH).contains(&outputs) {
        return Err(format!(
            "a layer must be 1 to {MAX_LAYER_WIDTH} wide, found {outputs}"
        ));
    }
    if outputs.checked_mul(width) != Some(weights.len()) {
        return Err(format!(
            "{} weights cannot take {width} numbers to {outputs}",
            weights.len()
        ));
    }
    check_finite(weights)?;
    check_finite(biases)?;
    Ok(outputs)
}

fn check_elementwise(function: &Elementwise, width: usize) -> Result<(), String> {
    if let Some(operands) = function.width().filter(|&operands| operands != width) {
        return Err(format!("{operands} operands for {width} numbers"));
    }
    match function {
        Elementwise::Add(numbers) | Elementwise::Multiply(numbers) => check_finite(numbers),
        Elementwise::Divide(numbers) => {
            check_finite(numbers)?;
            if numbers.contains(&0.0) {
                return Err("divides by 0".to_owned());
            }
            Ok(())
        }
        Elementwise::Clip { low, high }
            if low.len() != high.len() || !low.iter().zip(high).all(|(low, high)| low <= high) =>
        {
            Err("a lower limit above the upper one".to_owned())
        }
        Elementwise::LeakyRelu { slope: number } | Elementwise::Elu { alpha: number } => {
            check_finite(&[*number])
        }
        _ => Ok(()),
    }
}

fn check_finite(numbers: &[f32]) -> Result<(), String> {
    if numbers.iter().all(|number| number.is_finite()) {
        Ok(())
    } else {
        Err("holds a number that is not finite".to_owned())
    }
}

/// Packs the steps, with a ReLU after a product merged into it.
fn pack_steps(steps: &[NetworkStep], widths: &[usize]) -> PackedNetwork {
    let last = steps
        .iter()
        .rposition(|step| matches!(step, NetworkStep::Linear(_)));
    let mut packed = PackedNetwork::default();
    let mut is_merged = false;
    for (index, (step, &width)) in steps.iter().zip(widths).enumerate() {
        match step {
            NetworkStep::Linear(Linear { weights, biases }) => {
                let is_last = last == Some(index);
                is_merged = steps.get(index + 1)
                    == Some(&NetworkStep::Elementwise(Elementwise::Relu))
                    && !(is_last && biases.len() == 1);
                packed.push_product(weights, biases, width, is_last, is_merged);
            }
            NetworkStep::Elementwise(_) if is_merged => is_merged = false,
            NetworkStep::Elementwise(function) => {
                packed.push_elementwise(function.clone(), width);
            }
        }
    }
    packed
}
