//! Bounds of the numbers between the layers of a network: see [`controller`](super::controller).

use super::activation::Activation;
use super::controller::{LinearLayer, UNIT_ROUNDOFF};
use super::form::{AffineForm, SUM_REL_ERROR, round_up};
use crate::interval::Interval;

pub(super) struct InputForms {
    symbol_count: usize,
    terms: Vec<f64>,
    rest: Vec<f64>,
    radius: Vec<f64>,
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
        let row = |form: &AffineForm| {
            form.terms()
                .iter()
                .copied()
                .chain(std::iter::repeat(0.0))
                .take(symbols)
                .collect::<Vec<_>>()
        };
        Self {
            symbol_count: symbols,
            terms: inputs.iter().flat_map(row).collect(),
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
        let identity = |i: usize| (0..count).map(move |number| f64::from(u8::from(i == number)));
        Self {
            columns: (0..count).flat_map(identity).collect(),
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

    /// Returns for each number the largest |Σ Λᵢ (yᵢ - middle)| for uncorrelated yᵢ, and the largest |Σ Eⱼ ηⱼ|.
    fn radii(&self, inputs: &InputForms) -> (Vec<f64>, Vec<f64>) {
        let numbers = self.centre.len();
        let (mut apart, mut own) = (vec![0.0; numbers], vec![0.0; numbers]);
        for (index, column) in self.columns.chunks_exact(numbers.max(1)).enumerate() {
            match inputs.radius.get(index) {
                Some(radius) => apart
                    .iter_mut()
                    .zip(column)
                    .for_each(|(sum, slope)| *sum += radius * slope.abs()),
                None => own
                    .iter_mut()
                    .zip(column)
                    .for_each(|(sum, term)| *sum += term.abs()),
            }
        }
        (apart, own)
    }

    /// Computes h W + b with the rounding of single and double precision.
    pub(super) fn apply_linear(&self, layer: &LinearLayer, inputs: &InputForms) -> Self {
        let (n, numbers, outputs) = (
            layer.inputs as f64 + 2.0,
            self.centre.len(),
            layer.outputs.max(1),
        );
        let relative =
            n * UNIT_ROUNDOFF / (1.0 - n * UNIT_ROUNDOFF) * (1.0 + 1e-6) + 2.0 * SUM_REL_ERROR;
        let width = self.column_count();
        let (apart, own) = self.radii(inputs);
        let mut columns = vec![0.0; outputs * (width + self.excess.len())];
        let (dense, sparse) = columns.split_at_mut(outputs * width);
        let mut sparse = sparse.chunks_exact_mut(outputs);
        let mut centre = layer.biases.clone();
        let mut rho: Vec<f64> = layer
            .biases
            .iter()
            .map(|bias| bias.abs() * relative + n * 1e-44)
            .collect();
        let mut excess = self.excess.iter().peekable();
        for (input, weights) in layer
            .weights
            .chunks_exact(outputs)
            .take(numbers)
            .enumerate()
        {
            let new = excess
                .next_if(|(number, _)| *number == input)
                .map(|(_, radius)| *radius);
            let size = self.centre[input].abs()
                + apart[input]
                + own[input]
                + new.unwrap_or(0.0)
                + self.rho[input];
            if size == 0.0 {
                continue;
            }
            let share = self.rho[input] + relative * size;
            add_scaled(&mut centre, weights, self.centre[input]);
            rho.iter_mut()
                .zip(weights)
                .for_each(|(rho, weight)| *rho += weight.abs() * share);
            for (to, from) in dense
                .chunks_exact_mut(outputs)
                .zip(self.columns.chunks_exact(numbers))
            {
                if from[input] != 0.0 {
                    add_scaled(to, weights, from[input]);
                }
            }
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

    pub(super) fn apply_activation(&mut self, each: &Activation, inputs: &InputForms) {
        self.append_excess_columns();
        let numbers = self.centre.len();
        let (apart, own) = self.radii(inputs);
        let mut slopes = vec![0.0; inputs.radius.len()];
        for number in 0..numbers {
            let within = |by: f64| {
                let radius =
                    round_up((by + own[number] + self.rho[number]) * (1.0 + SUM_REL_ERROR));
                (
                    (self.centre[number] - radius).next_down(),
                    (self.centre[number] + radius).next_up(),
                )
            };
            let (mut low, mut high) = within(apart[number]);
            if each.is_nonlinear_on(number, low, high) {
                let of_number = self.columns.iter().skip(number).step_by(numbers);
                slopes
                    .iter_mut()
                    .zip(of_number)
                    .for_each(|(to, from)| *to = *from);
                (low, high) = within(inputs.max_linear_part(&slopes, apart[number]));
            }
            let line = each.relaxation(number, low, high);
            if line.is_identity() {
                continue;
            }
            let slope = line.slope;
            for factor in self.columns.iter_mut().skip(number).step_by(numbers) {
                *factor = if slope == 0.0 { 0.0 } else { *factor * slope };
            }
            if line.is_constant() {
                (self.centre[number], self.rho[number]) = (line.low, 0.0);
                continue;
            }
            let (middle, radius) = line.middle_and_radius();
            let size =
                (self.centre[number].abs() + apart[number] + own[number]) * slope.abs().max(1.0);
            let rounding = SUM_REL_ERROR * (size + middle.abs() + radius) + line.rounding;
            self.centre[number] = self.centre[number] * slope + middle;
            self.rho[number] = round_up(self.rho[number] * slope.abs() + rounding);
            if radius > 0.0 {
                self.excess.push((number, round_up(radius)));
            }
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
        let (centre, rho) = (*self.centre.get(number)?, *self.rho.get(number)?);
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

fn add_scaled(to: &mut [f64], from: &[f64], factor: f64) {
    to.iter_mut()
        .zip(from)
        .for_each(|(to, from)| *to += factor * from);
}

#[cfg(test)]
mod tests;
