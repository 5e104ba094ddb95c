//! Comparisons of rounding bounds with the formulas.

use super::super::fixtures::is_near;
use super::*;
use proptest::prelude::*;

const NUMBERS: usize = 3;

fn input_forms(
    centres: [f64; NUMBERS],
    terms: [[f64; 2]; NUMBERS],
    rests: [f64; NUMBERS],
) -> [AffineForm; NUMBERS] {
    std::array::from_fn(|i| {
        let mut form = AffineForm::constant(Interval::point(centres[i]));
        form.replace_terms(0, terms[i].into_iter(), rests[i]);
        form
    })
}

fn network_bounds(
    centre: [f64; NUMBERS],
    columns: [[f64; NUMBERS]; NUMBERS + 2],
    rho: [f64; NUMBERS],
) -> NetworkBounds {
    NetworkBounds {
        columns: columns.concat(),
        centre: centre.to_vec(),
        rho: rho.to_vec(),
        excess: Vec::new(),
    }
}

fn abs_sum(numbers: &[f64]) -> f64 {
    numbers.iter().map(|number| number.abs()).sum()
}

fn any<const N: usize>(most: f64) -> impl Strategy<Value = [f64; N]> {
    prop::collection::vec(-most..most, N).prop_map(|numbers| numbers.try_into().unwrap())
}

fn not_negative<const N: usize>(most: f64) -> impl Strategy<Value = [f64; N]> {
    any::<N>(most).prop_map(|numbers| numbers.map(f64::abs))
}

fn rows<const N: usize, const M: usize>(most: f64) -> impl Strategy<Value = [[f64; N]; M]> {
    prop::collection::vec(any::<N>(most), M).prop_map(|rows| rows.try_into().unwrap())
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(200))]

    /// Checks a ReLU of c + Σ Λᵢ (yᵢ - middle) + Σ Eⱼ ηⱼ + ρ against the chord; double precision adds 10⁻¹² of all
    /// sizes to ρ.
    #[test]
    fn a_relu_of_bounds_equals_the_chord_formula(
        centres in any(1.0), terms in rows(0.5), rests in not_negative(0.1),
        centre in any(0.5), columns in rows(1.0), rho in not_negative(0.05), is_sure: bool,
    ) {
        let inputs = input_forms(centres, terms, rests);
        let input_forms = InputForms::new(&inputs);
        let rho = if is_sure { [0.0; NUMBERS] } else { rho };
        let mut actual = network_bounds(centre, columns, rho);
        actual.apply_activation(&Activation::Relu, &input_forms);
        let column = |j: usize, number: usize| columns[j][number];
        let mut excess = actual.excess.iter();
        for number in 0..NUMBERS {
            let slopes: [f64; NUMBERS] = std::array::from_fn(|i| column(i, number));
            let own = column(NUMBERS, number).abs() + column(NUMBERS + 1, number).abs();
            let shared = [0, 1].map(|symbol| (0..NUMBERS).map(|i| slopes[i] * terms[i][symbol]).sum::<f64>());
            let apart: f64 = (0..NUMBERS).map(|i| slopes[i].abs() * inputs[i].radius()).sum();
            let rests: f64 = (0..NUMBERS).map(|i| slopes[i].abs() * inputs[i].rest()).sum();
            let together = abs_sum(&shared) + rests + 2.0 * SUM_REL_ERROR * apart;
            let bent = |by: f64| {
                let radius = (by + own + rho[number]) * (1.0 + SUM_REL_ERROR);
                (centre[number] - radius, centre[number] + radius)
            };
            let (low, high) = if bent(apart).0 < 0.0 && bent(apart).1 > 0.0 { bent(together) } else { bent(apart) };
            // Nearer to 0, double precision does not determine the sign of an end.
            let ends = [bent(apart), bent(together)].into_iter().flat_map(|(low, high)| [low, high]);
            prop_assume!(ends.into_iter().all(|end| end.abs() > 1e-2));
            if high <= 0.0 {
                prop_assert!(actual.centre[number] == 0.0 && actual.rho[number] == 0.0);
                prop_assert!(actual.columns.iter().skip(number).step_by(NUMBERS).all(|&factor| factor == 0.0));
            } else if low >= 0.0 {
                prop_assert!(actual.centre[number] == centre[number] && actual.rho[number] == rho[number]);
            } else {
                let slope = high / (high - low);
                let half = -0.5 * slope * low;
                let &(of, radius) = excess.next().unwrap();
                prop_assert!(of == number && is_near(radius, half, 2e-13), "{radius} {half}");
                prop_assert!((actual.centre[number] - (centre[number] * slope + half)).abs() <= 1e-13);
                for (j, &factor) in actual.columns.iter().skip(number).step_by(NUMBERS).enumerate() {
                    prop_assert!((factor - slope * column(j, number)).abs() <= 1e-13);
                }
                let size = centre[number].abs() + apart + own + 2.0 * half;
                let relative = if is_sure { 1e-9 } else { 2e-13 };
                prop_assert!(is_near(actual.rho[number], rho[number] * slope + SUM_REL_ERROR * size, relative));
            }
        }
        prop_assert!(excess.next().is_none());
    }

    #[test]
    fn a_product_increases_the_rounding_bound(centre in 0.5..2.0_f64, factor in 2.0..50.0_f64, own in 0.0..1.0_f64) {
        let mut actual = NetworkBounds { columns: vec![own], centre: vec![centre], rho: vec![0.0], excess: Vec::new() };
        actual.apply_activation(&Activation::Multiply(vec![factor]), &InputForms::new(&[]));
        let line = Activation::Multiply(vec![factor]).relaxation(0, centre - own, centre + own);
        let expected = SUM_REL_ERROR * (centre + own) * factor + line.rounding;
        prop_assert!(is_near(actual.rho[0], expected, 1e-11), "{} {expected}", actual.rho[0]);
        prop_assert!(actual.excess.is_empty() && actual.columns == [own * factor]);
    }
}

/// The sum of roundings grows faster than their number: γ = n u / (1 - n u).
#[test]
fn the_rounding_bound_grows_faster_than_the_width() {
    let (wide, u) = (1000_usize, 2.0_f64.powi(-24));
    let inputs: Vec<AffineForm> = (0..wide)
        .map(|i| {
            AffineForm::symbol(
                i % 7,
                Interval::new(0.25, 1.0 + i as f64 / wide as f64).unwrap(),
            )
        })
        .collect();
    let weights: Vec<f64> = (0..wide)
        .map(|i| if i % 3 == 0 { -0.5 } else { 0.25 })
        .collect();
    let layer = LinearLayer {
        inputs: wide,
        outputs: 1,
        weights: weights.clone(),
        biases: vec![3.0],
    };
    let mut bounds = NetworkBounds::from_inputs(&inputs);
    bounds.rho.fill(1e-3);
    bounds.excess.push((5, 0.125));
    bounds
        .columns
        .extend((0..wide).map(|i| if i == 8 { 0.25 } else { 0.0 }));
    let actual = bounds.apply_linear(&layer, &InputForms::new(&inputs));
    let nu = (wide as f64 + 2.0) * u;
    let gamma = nu / (1.0 - nu) * (1.0 + 1e-6) + 2.0 * SUM_REL_ERROR;
    let form_at = |i: usize| {
        let own = [(5, 0.125), (8, 0.25)]
            .into_iter()
            .find(|(at, _)| *at == i)
            .map_or(0.0, |(_, own)| own);
        let size = inputs[i].centre().abs() + inputs[i].radius() + 1e-3 + own;
        weights[i].abs() * (1e-3 + gamma * size)
    };
    let expected = 3.0 * gamma + (0..wide).map(form_at).sum::<f64>();
    assert!(
        is_near(actual.rho[0], expected, 1e-11),
        "{} {expected}",
        actual.rho[0]
    );
    assert!(actual.rho[0] > expected * (1.0 + 0.9 * SUM_REL_ERROR));
    let centre = 3.0
        + inputs
            .iter()
            .zip(&weights)
            .map(|(input, weight)| input.centre() * weight)
            .sum::<f64>();
    assert!(is_near(actual.centre[0], centre, 1e-12));
    assert_eq!(actual.columns.last(), Some(&(weights[5] * 0.125)));
}

#[test]
fn consecutive_activations_are_bounded() {
    let inputs = input_forms(
        [0.0, 1.0, 2.0],
        [[1.0, 0.0], [0.5, 0.5], [0.0, 0.25]],
        [0.0, 0.125, 0.0],
    );
    let input_forms = InputForms::new(&inputs);
    let mut actual = NetworkBounds::from_inputs(&inputs);
    actual.apply_activation(&Activation::Relu, &input_forms);
    assert_eq!(actual.excess.len(), 2);
    actual.apply_activation(&Activation::Multiply(vec![2.0; NUMBERS]), &input_forms);
    assert!(actual.excess.is_empty() && actual.column_count() == NUMBERS + 2);
    let form = actual.into_form(0, &inputs).unwrap();
    // From [-1, 1]: half of it and 1/4 on either side, twice.
    assert!(
        is_near(form.rest(), 0.5, 1e-6)
            && is_near(form.centre(), 0.5, 1e-6)
            && form.terms()[0] == 1.0
    );
    assert!(form.range().low() <= 0.0 - 1.0 && form.range().high() >= 2.0);
    let mut alone = NetworkBounds::from_inputs(&inputs);
    alone.apply_activation(&Activation::Relu, &input_forms);
    let rho = alone.rho[0];
    let form = alone.into_form(0, &inputs).unwrap();
    let rest = (0.25 + rho) * (1.0 + 0.9 * SUM_REL_ERROR);
    assert!(
        form.rest() >= rest && is_near(form.rest(), rest, 1e-11),
        "{form:?}"
    );
}

#[test]
fn a_layer_costs_its_number_of_products() {
    let layer = LinearLayer {
        inputs: 3,
        outputs: 5,
        weights: vec![0.0; 15],
        biases: vec![0.0; 5],
    };
    let mut some = network_bounds(
        [1.0, 0.0, 2.0],
        [[1.0; NUMBERS]; NUMBERS + 2],
        [0.0; NUMBERS],
    );
    assert_eq!(some.operations(&layer), 2 * 5 * (5 + 2) + 1000);
    some.excess.push((0, 1.0));
    assert_eq!(some.operations(&layer), 2 * 5 * (6 + 2) + 1000);
}
