//! Network bounds, compared with the formulas of `reach::controller` written out number by number.

use crumple_verify::Interval;
use crumple_verify::reach::controller::{interleave_relu, network_output};
use crumple_verify::reach::form::AffineForm;
use crumple_verify::reach::{LinearLayer, OBSERVATION_SIZE};
use proptest::prelude::*;

const SYMBOLS: usize = 3;

/// c + Σ Λᵢ (yᵢ - middle of yᵢ) + Σ Eⱼ ηⱼ + ρ.
#[derive(Debug, Clone, Default)]
struct NumberBounds {
    centre: f64,
    slopes: [f64; OBSERVATION_SIZE],
    excess: Vec<f64>,
    rho: f64,
}

fn abs_sum(values: &[f64]) -> f64 {
    values.iter().map(|value| value.abs()).sum()
}

fn weighted_sum(
    slopes: &[f64; OBSERVATION_SIZE],
    seen: &[AffineForm; OBSERVATION_SIZE],
    of: impl Fn(&AffineForm) -> f64,
) -> f64 {
    slopes
        .iter()
        .zip(seen)
        .map(|(slope, seen)| slope.abs() * of(seen))
        .sum()
}

fn terms(
    slopes: &[f64; OBSERVATION_SIZE],
    seen: &[AffineForm; OBSERVATION_SIZE],
) -> [f64; SYMBOLS] {
    let coefficient =
        |form: &AffineForm, symbol: usize| form.terms().get(symbol).copied().unwrap_or(0.0);
    std::array::from_fn(|symbol| {
        slopes
            .iter()
            .zip(seen)
            .map(|(slope, seen)| slope * coefficient(seen, symbol))
            .sum()
    })
}

/// Computes h W + b in single precision: off by at most γ (Σ|w||h| + |b|), γ = (n + 2) u / (1 - (n + 2) u).
fn apply_linear(
    numbers: &[NumberBounds],
    layer: &LinearLayer,
    seen: &[AffineForm; OBSERVATION_SIZE],
) -> Vec<NumberBounds> {
    let nu = (layer.inputs as f64 + 2.0) * 2.0_f64.powi(-24);
    let gamma = nu / (1.0 - nu);
    let of_output = |output: usize| {
        let bias = layer.biases[output];
        let mut sum = NumberBounds {
            centre: bias,
            rho: gamma * bias.abs(),
            ..NumberBounds::default()
        };
        for (input, number) in numbers.iter().enumerate() {
            let weight = layer.weights[input * layer.outputs + output];
            let most = number.centre.abs()
                + weighted_sum(&number.slopes, seen, AffineForm::radius)
                + abs_sum(&number.excess)
                + number.rho;
            sum.centre += weight * number.centre;
            sum.rho += weight.abs() * (number.rho + gamma * most);
            sum.slopes
                .iter_mut()
                .zip(number.slopes)
                .for_each(|(sum, slope)| *sum += weight * slope);
            sum.excess
                .resize(sum.excess.len().max(number.excess.len()), 0.0);
            sum.excess
                .iter_mut()
                .zip(&number.excess)
                .for_each(|(sum, excess)| *sum += weight * excess);
        }
        sum
    };
    (0..layer.outputs).map(of_output).collect()
}

/// Applies max(0, ·): the chord from l to h, and half its largest distance on either side as a column of its own.
fn apply_relu(numbers: &mut [NumberBounds], seen: &[AffineForm; OBSERVATION_SIZE]) {
    let mut columns = numbers
        .iter()
        .map(|number| number.excess.len())
        .max()
        .unwrap_or(0);
    for number in numbers {
        let radius = abs_sum(&terms(&number.slopes, seen))
            + weighted_sum(&number.slopes, seen, AffineForm::rest)
            + abs_sum(&number.excess)
            + number.rho;
        let (low, high) = (number.centre - radius, number.centre + radius);
        if high <= 0.0 {
            *number = NumberBounds::default();
        } else if low < 0.0 {
            let slope = high / (high - low);
            let half = -0.5 * slope * low;
            number.centre = slope * number.centre + half;
            number
                .slopes
                .iter_mut()
                .chain(&mut number.excess)
                .for_each(|factor| *factor *= slope);
            number.rho *= slope;
            number.excess.resize(columns + 1, 0.0);
            number.excess[columns] = half;
            columns += 1;
        }
    }
}

prop_compose! {
    fn observation()(
        centre in -2.0..2.0_f64,
        factors in prop::array::uniform3(prop_oneof![Just(0.0), -0.5..0.5_f64]),
        rest in prop_oneof![Just(0.0), 0.0..0.2_f64],
    ) -> AffineForm {
        let mut form = AffineForm::constant(Interval::point(centre));
        for (symbol, factor) in factors.into_iter().enumerate() {
            form.add_scaled(&AffineForm::symbol(symbol, Interval::new(-1.0, 1.0).unwrap()), Interval::point(factor));
        }
        if rest > 0.0 {
            form.widen(rest);
        }
        form
    }
}

fn layer(inputs: usize, outputs: usize) -> impl Strategy<Value = LinearLayer> {
    let weights = prop::collection::vec(
        prop_oneof![4 => -1.0..1.0_f64, 1 => Just(0.0)],
        inputs * outputs,
    );
    (weights, prop::collection::vec(-2.0..2.0_f64, outputs)).prop_map(move |(weights, biases)| {
        LinearLayer {
            inputs,
            outputs,
            weights,
            biases,
        }
    })
}

fn layers() -> impl Strategy<Value = Vec<LinearLayer>> {
    (1..6_usize, 1..6_usize).prop_flat_map(|(first, second)| {
        (
            layer(OBSERVATION_SIZE, first),
            layer(first, second),
            layer(second, 1),
        )
            .prop_map(|(a, b, c)| vec![a, b, c])
    })
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(1000))]

    /// Compares centre, terms and rest with the formulas. Rounding is a millionth of its sum, so sampling would not
    /// notice an error in it.
    #[test]
    fn bounds_are_those_of_the_formulas(
        seen in prop::collection::vec(observation(), OBSERVATION_SIZE), layers in layers(),
    ) {
        let seen: [AffineForm; OBSERVATION_SIZE] = seen.try_into().unwrap();
        let mut numbers: Vec<NumberBounds> = (0..OBSERVATION_SIZE)
            .map(|i| NumberBounds {
                centre: seen[i].centre(),
                slopes: std::array::from_fn(|column| f64::from(u8::from(i == column))),
                ..NumberBounds::default()
            })
            .collect();
        for (index, layer) in layers.iter().enumerate() {
            numbers = apply_linear(&numbers, layer, &seen);
            if index + 1 < layers.len() {
                apply_relu(&mut numbers, &seen);
            }
        }
        let expected = &numbers[0];
        let off = 1e-3 * expected.rho + 1e-40;
        let actual = network_output(&interleave_relu(layers).collect::<Vec<_>>(), &seen);
        prop_assert!((actual.centre() - expected.centre).abs() <= off, "{actual:?} {expected:?}");
        for (symbol, expected) in terms(&expected.slopes, &seen).into_iter().enumerate() {
            let actual = actual.terms().get(symbol).copied().unwrap_or(0.0);
            prop_assert!((actual - expected).abs() <= off, "symbol {symbol}: {actual} {expected}");
        }
        let rest = weighted_sum(&expected.slopes, &seen, AffineForm::rest) + abs_sum(&expected.excess) + expected.rho;
        prop_assert!((actual.rest() - rest).abs() <= off, "{} {rest} {expected:?}", actual.rest());
    }
}
