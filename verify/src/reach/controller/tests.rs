use super::super::fixtures::{
    affine_controller, affine_input, assert_bounds, is_near, point_form, symbol_form,
};
use super::*;

const NO_ERROR: [f64; OBSERVATION_SIZE] = [0.0; OBSERVATION_SIZE];

fn observation_with(first: AffineForm, second: AffineForm) -> [AffineForm; OBSERVATION_SIZE] {
    let mut seen: [AffineForm; OBSERVATION_SIZE] = std::array::from_fn(|_| point_form(5.0));
    [seen[0], seen[1]] = [first, second];
    seen
}

fn coefficients(factors: [f64; 2]) -> [f64; OBSERVATION_SIZE] {
    let mut errors = NO_ERROR;
    errors[..2].copy_from_slice(&factors);
    errors
}

#[test]
fn an_input_is_as_wide_as_its_observation_error_and_rounding() {
    let seen = observation_with(symbol_form(0, 3.0, 5.0), symbol_form(1, 10.0, 11.0));
    let mut error = NO_ERROR;
    [error[0], error[1]] = [0.25, 0.5];
    for (factors, off) in [
        ([1.0, 0.0], 0.25),
        ([0.0, -1.0], 0.5),
        ([2.0, -3.0], 2.0),
        ([1.0, 1.0], 0.75),
    ] {
        for (error, off) in [(&error, off), (&NO_ERROR, 0.0)] {
            for (offset, scale) in [(0.0, 1.0), (7.0, 4.0), (7.0, -4.0), (4.0, 1.0)] {
                let actual = ControllerInput {
                    offset,
                    scale,
                    ..affine_input(coefficients(factors), 0.5)
                }
                .enclose(&seen, error, true)
                .range();
                let ends = |x: [f64; 2], factor: f64| [x[0] * factor, x[1] * factor];
                let [a, b] = [ends([3.0, 5.0], factors[0]), ends([10.0, 11.0], factors[1])];
                let ends = [
                    a[0].min(a[1]) + b[0].min(b[1]) - off,
                    a[0].max(a[1]) + b[0].max(b[1]) + off,
                ];
                let ends = ends.map(|end| (end + 0.5 - offset) / scale);
                let [low, high] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
                let rounding = low.abs().max(high.abs()) * UNIT_ROUNDOFF * (1.0 + 1e-6);
                assert_bounds(actual, [low - rounding, high + rounding], 1e-10);
            }
        }
    }
}

#[test]
fn an_input_is_clipped_and_may_be_absent() {
    let seen = observation_with(point_form(3.0), point_form(10.0));
    let at =
        |input: ControllerInput, is_followed| input.enclose(&seen, &NO_ERROR, is_followed).range();
    let limited = |low, high| ControllerInput {
        low,
        high,
        ..affine_input(coefficients([1.0, 0.0]), 0.0)
    };
    assert_bounds(
        at(limited(-1.5, 2.0), true),
        [2.0 - 2.0 * UNIT_ROUNDOFF, 2.0 + 2.0 * UNIT_ROUNDOFF],
        1e-10,
    );
    assert_bounds(
        at(limited(4.0, 9.0), true),
        [4.0 - 4.0 * UNIT_ROUNDOFF, 4.0 + 4.0 * UNIT_ROUNDOFF],
        1e-10,
    );
    let absent = ControllerInput {
        absent_value: Some(2.0),
        ..affine_input(coefficients([1.0, 0.0]), 1.0)
    };
    assert_bounds(
        at(absent.clone(), false),
        [2.0 - 2.0 * UNIT_ROUNDOFF, 2.0 + 2.0 * UNIT_ROUNDOFF],
        1e-10,
    );
    assert_bounds(
        at(absent, true),
        [4.0 - 4.0 * UNIT_ROUNDOFF, 4.0 + 4.0 * UNIT_ROUNDOFF],
        1e-10,
    );
}

/// A single exact observation has the single-precision error; even 0 is not taken as exact.
#[test]
fn an_exact_input_is_off_by_one_rounding_of_single_precision() {
    let seen = observation_with(point_form(3.0), point_form(0.0));
    let radius = |input: ControllerInput| input.enclose(&seen, &NO_ERROR, true).radius();
    let radius_of_gap = radius(ControllerInput {
        offset: 1.0,
        scale: 2.0,
        ..affine_input(coefficients([1.0, 0.0]), 0.0)
    });
    assert!(
        is_near(radius_of_gap, UNIT_ROUNDOFF * (1.0 + 1e-6), 1e-7),
        "{radius_of_gap}"
    );
    let nothing = radius(affine_input(coefficients([0.0, 1.0]), 0.0));
    assert!(is_near(nothing, 1e-44, 1e-9), "{nothing}");
}

/// The simulator rounds a sum of two numbers, but not a single number.
#[test]
fn a_sum_of_observations_is_off_by_one_rounding_of_double_precision() {
    let large = f64::from(1 << 20);
    let seen = observation_with(point_form(large), point_form(1.0));
    // An observation of 0 has no other rounding.
    let off = |factors: [f64; 2], constant: f64| {
        let sum = factors[0] * large + factors[1] + constant;
        let input = ControllerInput {
            offset: sum,
            ..affine_input(coefficients(factors), constant)
        };
        input.enclose(&seen, &NO_ERROR, true).radius() / (f64::EPSILON * sum.abs())
    };
    assert!(off([1.0, 0.0], 0.0) < 1e-20);
    // Rounding of the form: twice that of adding a product or a constant.
    let (product, constant) = (off([1.0, -1.0], 0.0), off([1.0, 0.0], 1.0));
    assert!(is_near(product, 3.0, 1e-2), "{product}");
    assert!(is_near(constant, 2.0, 1e-2), "{constant}");
}

#[test]
fn the_rounding_of_the_scaled_output_is_relative_to_its_terms() {
    let seen = observation_with(point_form(0.0), symbol_form(1, -5.0, 7.0));
    for (factors, constant, scale_mps2, offset_mps2) in [
        ([0.0, 1.0], 2.0, 3.0, -2.0),
        ([0.0, 1.0], -30.0, -0.25, 0.0),
        ([0.0, 1.0], -1.0, 100.0, 1.0),
        ([1.0, 0.0], 0.0, 3.0, -2.0),
    ] {
        let controller = NeuralController {
            scale_mps2,
            offset_mps2,
            ..affine_controller(coefficients(factors), constant)
        };
        let inputs: Vec<AffineForm> = controller
            .inputs
            .iter()
            .map(|input| input.enclose(&seen, &NO_ERROR, true))
            .collect();
        let answer = network_output(&controller.layers, &inputs);
        let wanted = controller.decide(&seen, &NO_ERROR, true);
        let size = offset_mps2.abs() + scale_mps2.abs() * (answer.centre().abs() + answer.radius());
        let added = wanted.rest() - scale_mps2.abs() * answer.rest();
        assert!(
            added >= 1e-14 * size * 0.99 && added <= 1.2e-14 * size,
            "{added} {size}"
        );
        let [low, high] =
            [answer.range().low(), answer.range().high()].map(|end| scale_mps2 * end + offset_mps2);
        assert_bounds(wanted.range(), [low.min(high), low.max(high)], 1e-11);
    }
}

fn constant_layer(inputs: usize, outputs: usize) -> NetworkLayer {
    NetworkLayer::Linear(LinearLayer {
        inputs,
        outputs,
        weights: vec![0.5; inputs * outputs],
        biases: vec![0.1; outputs],
    })
}

/// The excess of an activation is stored for each number of any later layer.
#[test]
fn the_bytes_of_a_decision_are_those_of_the_widest_step() {
    let bytes = |steps: Vec<NetworkLayer>| {
        NeuralController {
            layers: steps,
            inputs: vec![affine_input(NO_ERROR, 1.0); 8],
            ..affine_controller(NO_ERROR, 0.0)
        }
        .max_decision_bytes()
    };
    let (relu, tanh) = (
        || NetworkLayer::Activation(Activation::Relu),
        || NetworkLayer::Activation(Activation::Tanh),
    );
    assert_eq!(bytes(Vec::new()), 0);
    // 8 + 12 for 12, then as many and 9 for 9, then one more for 1; of each two, before and after.
    assert_eq!(
        bytes(vec![
            constant_layer(8, 12),
            relu(),
            constant_layer(12, 9),
            relu(),
            constant_layer(9, 1),
            tanh()
        ]),
        29 * 9 * 16
    );
    // A second activation in a row, or one before all layers, has its own lines.
    assert_eq!(
        bytes(vec![
            constant_layer(8, 12),
            relu(),
            tanh(),
            constant_layer(12, 1)
        ]),
        32 * 12 * 16
    );
    assert_eq!(bytes(vec![relu(), constant_layer(8, 1)]), 16 * 8 * 16);
}

fn min_operations(controller: &NeuralController) -> u64 {
    let seen = observation_with(point_form(3.0), point_form(10.0));
    let suffice = |operations: u64| {
        let work = OpBudget::new(WorkLimit::from_operations(operations));
        controller
            .decide_with_budget(&seen, &NO_ERROR, true, &work)
            .radius()
            .is_finite()
    };
    let (mut few, mut enough) = (0_u64, 1 << 30);
    while enough - few > 1 {
        let middle = few.midpoint(enough);
        if suffice(middle) {
            enough = middle
        } else {
            few = middle
        }
    }
    enough
}

#[test]
fn activations_are_charged_for_each_number() {
    let with = |each: usize| {
        let between = std::iter::repeat_n(
            NetworkLayer::Activation(Activation::Add(vec![0.25; 7])),
            each,
        );
        let steps = [constant_layer(1, 7)]
            .into_iter()
            .chain(between)
            .chain([constant_layer(7, 1)])
            .collect();
        NeuralController {
            layers: steps,
            ..affine_controller(NO_ERROR, 1.0)
        }
    };
    assert_eq!(
        min_operations(&with(3)) - min_operations(&with(0)),
        3 * 7 * Activation::Add(Vec::new()).operations()
    );
    // 7 (1/2 + 1/10 + 3/4)/2 + 1/10.
    let actual = with(3).decide(
        &observation_with(point_form(3.0), point_form(10.0)),
        &NO_ERROR,
        true,
    );
    assert_bounds(actual.range(), [4.825; 2], 1e-5);
}
