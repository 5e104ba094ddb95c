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
//! Sums of up to 4096 products in double precision err by less than 10⁻¹² of the sum of the absolute values, which is added too.

use super::form::{Form, SLACK, up};
use super::relax::{hyperbolic_tangent, rectified, rectifier};
use crate::interval::Interval;

/// Numbers that are observed: gap ahead, gap behind, speed ahead, own, behind, acceleration ahead, own, behind.
pub const OBSERVED: usize = 8;

/// Rounding of single precision.
const U: f64 = 1.0 / (1 << 24) as f64;

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

/// Bounds of the numbers between two layers: one row of `width` factors (the Λᵢ and Eⱼ) for each.
struct Bounds {
    width: usize,
    rows: Vec<f64>,
    centre: Vec<f64>,
    rho: Vec<f64>,
    /// Excess of rectifiers of the last layer, not yet columns: (which number, radius).
    excess: Vec<(usize, f64)>,
}

/// The observations as one matrix: `terms` has one row of eight for each symbol.
struct Inputs {
    terms: Vec<[f64; OBSERVED]>,
    rest: [f64; OBSERVED],
    radius: [f64; OBSERVED],
}

impl Actor {
    /// The acceleration that is wanted for observations of which each may be off by `error`, in m/s².
    #[must_use]
    pub fn decide(&self, seen: &[Form; OBSERVED], error: &[f64; OBSERVED]) -> Form {
        let scaled: [Form; OBSERVED] = std::array::from_fn(|i| self.scaled(i, &seen[i], error[i]));
        let mut tanh = hyperbolic_tangent(&answer(&self.layers, &scaled));
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
    let symbols = inputs.iter().map(|form| form.terms().len()).max().unwrap_or(0);
    let term = |symbol: usize, form: &Form| form.terms().get(symbol).copied().unwrap_or(0.0);
    let matrix = Inputs {
        terms: (0..symbols).map(|symbol| std::array::from_fn(|i| term(symbol, &inputs[i]))).collect(),
        rest: std::array::from_fn(|i| inputs[i].rest()),
        radius: std::array::from_fn(|i| inputs[i].radius()),
    };
    let identity = |i: usize| (0..OBSERVED).map(move |column| f64::from(u8::from(i == column)));
    let mut bounds = Bounds {
        width: OBSERVED,
        rows: (0..OBSERVED).flat_map(identity).collect(),
        centre: inputs.iter().map(Form::centre).collect(),
        rho: vec![0.0; OBSERVED],
        excess: Vec::new(),
    };
    for (index, layer) in layers.iter().enumerate() {
        bounds = bounds.through(layer, &matrix);
        if index + 1 < layers.len() {
            bounds.rectify(&matrix);
        }
    }
    let ([centre], [rho]) = (bounds.centre.as_slice(), bounds.rho.as_slice()) else { return Form::line() };
    let mut form = Form::constant(Interval::point(*centre));
    let (on_inputs, on_excess) = bounds.rows.split_at(OBSERVED);
    for (input, &factor) in inputs.iter().zip(on_inputs) {
        let mut deviation = input.clone();
        deviation.shift(-Interval::point(input.centre()));
        form.add(&deviation, Interval::point(factor));
    }
    form.widen((on_excess.iter().map(|term| term.abs()).sum::<f64>() + rho) * (1.0 + SLACK));
    form
}

fn weigh(sizes: &[f64; OBSERVED], slopes: &[f64; OBSERVED]) -> f64 {
    sizes.iter().zip(slopes).map(|(size, slope)| size * slope.abs()).sum()
}

impl Inputs {
    /// Largest |Σ Λᵢ (yᵢ - middle)|.
    fn together(&self, slopes: &[f64; OBSERVED]) -> f64 {
        let along = |terms: &[f64; OBSERVED]| (0..OBSERVED).map(|i| terms[i] * slopes[i]).sum::<f64>().abs();
        self.terms.iter().map(along).sum::<f64>() + weigh(&self.rest, slopes) + 2.0 * SLACK * self.apart(slopes)
    }

    /// The same if the yᵢ had nothing in common.
    fn apart(&self, slopes: &[f64; OBSERVED]) -> f64 {
        weigh(&self.radius, slopes)
    }
}

impl Bounds {
    /// Λ and E of a number.
    fn row(&self, number: usize) -> ([f64; OBSERVED], &[f64]) {
        let (slopes, terms) = self.rows[number * self.width..(number + 1) * self.width].split_at(OBSERVED);
        (std::array::from_fn(|i| slopes[i]), terms)
    }

    /// h W + b with what single and double precision may add.
    fn through(&self, layer: &Layer, inputs: &Inputs) -> Self {
        let (n, outputs) = (layer.inputs as f64 + 2.0, layer.outputs);
        let relative = n * U / (1.0 - n * U) * (1.0 + 1e-6) + 2.0 * SLACK;
        let width = self.width + self.excess.len();
        let mut rows = vec![0.0; outputs * width];
        let mut centre = layer.biases.clone();
        let mut rho: Vec<f64> = layer.biases.iter().map(|bias| bias.abs() * relative + n * 1e-44).collect();
        let mut excess = self.excess.iter().copied().zip(self.width..).peekable();
        for input in 0..layer.inputs {
            let weights = &layer.weights[input * outputs..(input + 1) * outputs];
            let (slopes, terms) = self.row(input);
            let new = excess.next_if(|((number, _), _)| *number == input);
            let new_radius = new.map_or(0.0, |((_, radius), _)| radius);
            let size = self.centre[input].abs()
                + inputs.apart(&slopes)
                + terms.iter().map(|term| term.abs()).sum::<f64>()
                + new_radius
                + self.rho[input];
            if size == 0.0 {
                continue;
            }
            let share = self.rho[input] + relative * size;
            let row = &self.rows[input * self.width..(input + 1) * self.width];
            for (output, &weight) in weights.iter().enumerate() {
                centre[output] += weight * self.centre[input];
                rho[output] += weight.abs() * share;
                let target = &mut rows[output * width..(output + 1) * width];
                for (to, from) in target.iter_mut().zip(row) {
                    *to += weight * from;
                }
                if let Some(((_, radius), column)) = new {
                    target[column] = weight * radius;
                }
            }
        }
        rho.iter_mut().for_each(|rho| *rho = up(*rho * (1.0 + SLACK)));
        Self { width, rows, centre, rho, excess: Vec::new() }
    }

    /// max(0, ·) of each number.
    fn rectify(&mut self, inputs: &Inputs) {
        for number in 0..self.centre.len() {
            let (slopes, terms) = self.row(number);
            let (together, apart) = (inputs.together(&slopes), inputs.apart(&slopes));
            let own = terms.iter().map(|term| term.abs()).sum::<f64>();
            let radius = up((together + own + self.rho[number]) * (1.0 + SLACK));
            let (low, high) = ((self.centre[number] - radius).next_down(), (self.centre[number] + radius).next_up());
            if low >= 0.0 {
                continue;
            }
            let row = &mut self.rows[number * self.width..(number + 1) * self.width];
            if high <= 0.0 {
                row.fill(0.0);
                (self.centre[number], self.rho[number]) = (0.0, 0.0);
                continue;
            }
            let (slope, excess) = rectifier(low, high);
            row.iter_mut().for_each(|factor| *factor *= slope);
            let size = self.centre[number].abs() + apart + own + excess;
            self.centre[number] = self.centre[number] * slope + 0.5 * excess;
            self.rho[number] = up(self.rho[number] * slope + SLACK * size);
            self.excess.push((number, up(0.5 * excess)));
        }
    }
}
