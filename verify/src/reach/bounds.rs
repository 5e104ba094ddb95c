//! Bounds of the numbers between the layers of a network: see [`controller`](super::controller).

use super::activation::{Activation, LinearRelaxation};
use super::controller::{LinearLayer, UNIT_ROUNDOFF};
use super::form::{AffineForm, SUM_REL_ERROR, round_up};
use crate::interval::Interval;

pub(super) struct InputForms {
    symbol_count: usize,
    terms: Vec<f64>,
    rest: Vec<f64>,
    radius: Vec<f64>,
}

/// Radii of all numbers before an activation or a product.
struct NumberRadii {
    /// The largest |Σ Λᵢ (yᵢ - middle)| for uncorrelated yᵢ.
    of_inputs: Vec<f64>,
    /// The largest |Σ Eⱼ ηⱼ|.
    of_excess: Vec<f64>,
}

/// The Λᵢ and Eⱼ of all numbers, the middles, and ρ.
pub(super) struct NetworkBounds {
    /// The Λᵢ of all numbers, then the Eⱼ of all numbers.
    pub(super) columns: Vec<f64>,
    pub(super) centre: Vec<f64>,
    pub(super) rho: Vec<f64>,
    /// Excess of the last activations, not yet in columns: (index, radius), in order.
    excess: Vec<(usize, f64)>,
}

impl InputForms {
    pub(super) fn new(inputs: &[AffineForm]) -> Self {
        let symbols = inputs
            .iter()
            .map(|form| form.terms().len())
            .max()
            .unwrap_or(0);
        let terms = inputs.iter().flat_map(|form| {
            let padding = std::iter::repeat(0.0);
            form.terms().iter().copied().chain(padding).take(symbols)
        });
        Self {
            symbol_count: symbols,
            terms: terms.collect(),
            rest: inputs.iter().map(AffineForm::rest).collect(),
            radius: inputs.iter().map(AffineForm::radius).collect(),
        }
    }

    /// Returns the largest |Σ Λᵢ (yᵢ - middle)|, given `apart`, its value for uncorrelated yᵢ.
    fn max_linear_part(&self, slopes: &[f64], apart: f64) -> f64 {
        let mut sums = vec![0.0; self.symbol_count];
        for (row, &slope) in self
            .terms
            .chunks_exact(self.symbol_count.max(1))
            .zip(slopes)
        {
            add_scaled(&mut sums, row, slope);
        }
        let rest: f64 = self
            .rest
            .iter()
            .zip(slopes)
            .map(|(rest, slope)| rest * slope.abs())
            .sum();
        sums.iter().map(|sum| sum.abs()).sum::<f64>() + rest + 2.0 * SUM_REL_ERROR * apart
    }
}

impl NetworkBounds {
    pub(super) fn from_inputs(inputs: &[AffineForm]) -> Self {
        let count = inputs.len();
        let identity =
            (0..count).flat_map(|i| (0..count).map(move |number| f64::from(u8::from(i == number))));
        Self {
            columns: identity.collect(),
            centre: inputs.iter().map(AffineForm::centre).collect(),
            rho: vec![0.0; count],
            excess: Vec::new(),
        }
    }

    fn column_count(&self) -> usize {
        self.columns.len() / self.centre.len().max(1)
    }

    pub(super) fn operations(&self, layer: &LinearLayer) -> u64 {
        let width = (self.column_count() + self.excess.len()) as u64;
        let alive = self.centre.iter().filter(|&&centre| centre != 0.0).count() as u64;
        alive * layer.outputs as u64 * (width + 2) + 1000
    }

    fn radii(&self, inputs: &InputForms) -> NumberRadii {
        let numbers = self.centre.len();
        let mut of_inputs = vec![0.0; numbers];
        let mut of_excess = vec![0.0; numbers];
        for (index, column) in self.columns.chunks_exact(numbers.max(1)).enumerate() {
            match inputs.radius.get(index) {
                Some(radius) => of_inputs
                    .iter_mut()
                    .zip(column)
                    .for_each(|(sum, slope)| *sum += radius * slope.abs()),
                None => of_excess
                    .iter_mut()
                    .zip(column)
                    .for_each(|(sum, term)| *sum += term.abs()),
            }
        }
        NumberRadii {
            of_inputs,
            of_excess,
        }
    }

    /// Computes h W + b with the rounding of single and double precision.
    pub(super) fn apply_linear(&self, layer: &LinearLayer, inputs: &InputForms) -> Self {
        let numbers = self.centre.len();
        let outputs = layer.outputs.max(1);
        let relative = relative_sum_error(layer.inputs);
        let width = self.column_count();
        let radii = self.radii(inputs);
        let mut columns = vec![0.0; outputs * (width + self.excess.len())];
        let (dense, sparse) = columns.split_at_mut(outputs * width);
        let mut sparse = sparse.chunks_exact_mut(outputs);
        let mut centre = layer.biases.clone();
        let underflow = (layer.inputs as f64 + 2.0) * 1e-44;
        let mut rho: Vec<f64> = layer
            .biases
            .iter()
            .map(|bias| bias.abs() * relative + underflow)
            .collect();
        let mut excess = self.excess.iter().peekable();
        let rows = layer.weights.chunks_exact(outputs).take(numbers);
        for (input, weights) in rows.enumerate() {
            let new = excess
                .next_if(|(number, _)| *number == input)
                .map(|(_, radius)| *radius);
            let size = self.magnitude(input, &radii, new.unwrap_or(0.0));
            if size == 0.0 {
                continue;
            }
            let share = self.rho[input] + relative * size;
            add_scaled(&mut centre, weights, self.centre[input]);
            rho.iter_mut()
                .zip(weights)
                .for_each(|(rho, weight)| *rho += weight.abs() * share);
            self.add_column_products(dense, weights, input);
            if let Some(radius) = new
                && let Some(to) = sparse.next()
            {
                add_scaled(to, weights, radius);
            }
        }
        rho.iter_mut()
            .for_each(|rho| *rho = round_up(*rho * (1.0 + SUM_REL_ERROR)));
        Self {
            columns,
            centre,
            rho,
            excess: Vec::new(),
        }
    }

    /// Returns the largest magnitude of a number, with an excess that is not yet in columns.
    fn magnitude(&self, number: usize, radii: &NumberRadii, excess: f64) -> f64 {
        self.centre[number].abs()
            + radii.of_inputs[number]
            + radii.of_excess[number]
            + excess
            + self.rho[number]
    }

    /// Adds the product of one number in each column with its weights to the columns of the outputs.
    fn add_column_products(&self, to: &mut [f64], weights: &[f64], number: usize) {
        for (to, from) in to
            .chunks_exact_mut(weights.len())
            .zip(self.columns.chunks_exact(self.centre.len()))
        {
            if from[number] != 0.0 {
                add_scaled(to, weights, from[number]);
            }
        }
    }

    pub(super) fn apply_activation(&mut self, activation: &Activation, inputs: &InputForms) {
        self.append_excess_columns();
        let radii = self.radii(inputs);
        let mut slopes = vec![0.0; inputs.radius.len()];
        for number in 0..self.centre.len() {
            let line = self.relax(activation, number, &radii, inputs, &mut slopes);
            if !line.is_identity() {
                self.apply_line(&line, number, &radii);
            }
        }
    }

    /// Returns the line of an activation over the range of a number. Overwrites `slopes`.
    fn relax(
        &self,
        activation: &Activation,
        number: usize,
        radii: &NumberRadii,
        inputs: &InputForms,
        slopes: &mut [f64],
    ) -> LinearRelaxation {
        let apart = radii.of_inputs[number];
        let [low, high] = self.range(number, apart + radii.of_excess[number]);
        if !activation.is_nonlinear_on(number, low, high) {
            return activation.relaxation(number, low, high);
        }
        let of_number = self.columns.iter().skip(number).step_by(self.centre.len());
        slopes
            .iter_mut()
            .zip(of_number)
            .for_each(|(to, from)| *to = *from);
        let correlated = inputs.max_linear_part(slopes, apart);
        let [low, high] = self.range(number, correlated + radii.of_excess[number]);
        activation.relaxation(number, low, high)
    }

    /// Returns the range of a number with this radius, without ρ.
    fn range(&self, number: usize, radius: f64) -> [f64; 2] {
        let radius = round_up((radius + self.rho[number]) * (1.0 + SUM_REL_ERROR));
        [
            (self.centre[number] - radius).next_down(),
            (self.centre[number] + radius).next_up(),
        ]
    }

    fn apply_line(&mut self, line: &LinearRelaxation, number: usize, radii: &NumberRadii) {
        let numbers = self.centre.len();
        let slope = line.slope;
        for factor in self.columns.iter_mut().skip(number).step_by(numbers) {
            *factor = if slope == 0.0 { 0.0 } else { *factor * slope };
        }
        if line.is_constant() {
            (self.centre[number], self.rho[number]) = (line.low, 0.0);
            return;
        }
        let (middle, radius) = line.middle_and_radius();
        let size = (self.centre[number].abs() + radii.of_inputs[number] + radii.of_excess[number])
            * slope.abs().max(1.0);
        let rounding = SUM_REL_ERROR * (size + middle.abs() + radius) + line.rounding;
        self.centre[number] = self.centre[number] * slope + middle;
        self.rho[number] = round_up(self.rho[number] * slope.abs() + rounding);
        if radius > 0.0 {
            self.excess.push((number, round_up(radius)));
        }
    }

    /// Turns excesses into columns, so that another activation can follow without a product in between.
    fn append_excess_columns(&mut self) {
        let numbers = self.centre.len();
        for (number, radius) in self.excess.drain(..) {
            let column = self.columns.len();
            self.columns.resize(column + numbers, 0.0);
            self.columns[column + number] = radius;
        }
    }

    /// Returns one number as a form in the symbols of the inputs, or `None` if it does not exist.
    pub(super) fn into_form(mut self, number: usize, inputs: &[AffineForm]) -> Option<AffineForm> {
        self.append_excess_columns();
        let centre = *self.centre.get(number)?;
        let rho = *self.rho.get(number)?;
        let mut form = AffineForm::constant(Interval::point(centre));
        let mut factors = self
            .columns
            .into_iter()
            .skip(number)
            .step_by(self.centre.len());
        for (input, factor) in inputs.iter().zip(factors.by_ref()) {
            let mut deviation = input.clone();
            deviation.shift(-Interval::point(input.centre()));
            form.add_scaled(&deviation, Interval::point(factor));
        }
        form.widen((factors.map(f64::abs).sum::<f64>() + rho) * (1.0 + SUM_REL_ERROR));
        Some(form)
    }
}

/// Returns the relative error of a sum of products with so many inputs and a bias, in single and double precision.
fn relative_sum_error(inputs: usize) -> f64 {
    let n = inputs as f64 + 2.0;
    n * UNIT_ROUNDOFF / (1.0 - n * UNIT_ROUNDOFF) * (1.0 + 1e-6) + 2.0 * SUM_REL_ERROR
}

fn add_scaled(to: &mut [f64], from: &[f64], factor: f64) {
    to.iter_mut()
        .zip(from)
        .for_each(|(to, from)| *to += factor * from);
}

#[cfg(test)]
mod tests;
