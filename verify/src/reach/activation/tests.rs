//! Comparisons of lines with computed values and closed forms.

use super::*;
use num_traits::Float;
use proptest::prelude::*;

/// Evaluates a function in single precision, as a network does, or in double for real numbers.
fn evaluate<F: Float>(activation: &Activation, x: F) -> F {
    let number_of = |number: f64| F::from(number).unwrap();
    let operand = |operands: &[f64]| number_of(operands[0]);
    let below = |value: F| if x < F::zero() { value } else { x };
    match activation {
        Activation::Relu => x.max(F::zero()),
        Activation::LeakyRelu(slope) => below(number_of(*slope) * x),
        Activation::Elu(alpha) => below(number_of(*alpha) * x.exp_m1()),
        Activation::Tanh => x.tanh(),
        Activation::Sigmoid => F::one() / (F::one() + (-x).exp()),
        Activation::Add(operands) => x + operand(operands),
        Activation::Multiply(operands) => x * operand(operands),
        Activation::Divide(operands) => x / operand(operands),
        Activation::Clip { low, high } => x.max(operand(low)).min(operand(high)),
    }
}

fn any_f32(size: f32) -> impl Strategy<Value = f64> {
    (-size..size).prop_map(f64::from)
}

fn any_activation() -> impl Strategy<Value = Activation> {
    let single_layer = |numbers: f64| vec![numbers];
    prop_oneof![
        Just(Activation::Relu),
        prop_oneof![Just(0.0), Just(1.0), any_f32(2.0)].prop_map(Activation::LeakyRelu),
        prop_oneof![Just(0.0), Just(1.0), any_f32(2.0)].prop_map(Activation::Elu),
        Just(Activation::Tanh),
        Just(Activation::Sigmoid),
        any_f32(10.0).prop_map(move |a| Activation::Add(single_layer(a))),
        any_f32(10.0).prop_map(move |a| Activation::Multiply(single_layer(a))),
        any_f32(10.0)
            .prop_filter("not 0", |a| *a != 0.0)
            .prop_map(move |a| Activation::Divide(single_layer(a))),
        (any_f32(3.0), 0.0..3.0_f32).prop_map(move |(low, more)| {
            Activation::Clip {
                low: single_layer(low),
                high: single_layer(f64::from(low as f32 + more)),
            }
        }),
    ]
}

/// Returns the inner points at which a function less a line of this slope may be extreme.
fn extremum_candidates(activation: &Activation, slope: f64) -> Vec<f64> {
    let either = |x: f64| vec![-x, x];
    match activation {
        Activation::Relu | Activation::LeakyRelu(_) => vec![0.0],
        Activation::Elu(alpha) => vec![0.0, (slope / alpha).ln()],
        Activation::Tanh => either((1.0 - slope).sqrt().atanh()),
        Activation::Sigmoid => either(2.0 * (1.0 - 4.0 * slope).sqrt().atanh()),
        Activation::Clip { low, high } => vec![low[0], high[0]],
        Activation::Add(_) | Activation::Multiply(_) | Activation::Divide(_) => Vec::new(),
    }
}

/// Bounds the single-precision rounding between two ends, by the list in the module documentation.
fn expected_rounding(activation: &Activation, low: f64, high: f64) -> f64 {
    let u = 2.0_f64.powi(-24);
    let largest = [low, high]
        .map(|x| evaluate(activation, x).abs())
        .into_iter()
        .fold(0.0, f64::max);
    match activation {
        Activation::LeakyRelu(slope) if low < 0.0 => u * slope.abs() * -low,
        Activation::Elu(alpha) if low < 0.0 => 8.0 * u * alpha.abs(),
        Activation::Tanh | Activation::Sigmoid => 4.0 * u,
        // For operands of either sign the magnitudes are added.
        Activation::Add(operands) => u * (low.abs().max(high.abs()) + operands[0].abs()),
        Activation::Multiply(_) | Activation::Divide(_) => u * largest,
        _ => 0.0,
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(2000))]

    /// Checks that lines enclose computed values tightly: extremes are at ends, kinks, and points with the line's
    /// slope.
    #[test]
    fn lines_enclose_computed_values_tightly(
        activation in any_activation(), middle in prop_oneof![-4.0..4.0_f32, -100.0..100.0_f32],
        radius in prop_oneof![Just(0.0), 0.0..0.01_f32, 0.0..8.0_f32, 0.0..100.0_f32],
    ) {
        let (low, high) = (f64::from(middle - radius), f64::from(middle + radius));
        let line = activation.relaxation(0, low, high);
        for at in 0..=20 {
            let x = (low + (high - low) * f64::from(at) / 20.0).clamp(low, high) as f32;
            let (actual, on_line) = (f64::from(evaluate(&activation, x)), line.slope * f64::from(x));
            let slack = line.rounding + 1e-15 * (1.0 + actual.abs() + on_line.abs());
            let off = actual - on_line;
            prop_assert!(off >= line.low - slack && off <= line.high + slack, "{activation:?} at {x}: {off} {line:?}");
        }
        let inside = extremum_candidates(&activation, line.slope).into_iter().filter(|&x| low < x && x < high);
        let off: Vec<f64> = inside.chain([low, high]).map(|x| evaluate(&activation, x) - line.slope * x).collect();
        let (least, most) = off.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &x| (a.min(x), b.max(x)));
        let near = 1e-11 * (1.0 + line.slope.abs()) * (1.0 + low.abs().max(high.abs()));
        let is_near = (line.low - least).abs() <= near && (line.high - most).abs() <= near;
        prop_assert!(is_near, "{activation:?} {line:?} {least} {most}");
        let expected = expected_rounding(&activation, low, high);
        let tight = expected..=expected * (1.0 + 1e-5) + 2e-44;
        prop_assert!(tight.contains(&line.rounding), "{activation:?} {line:?} {expected}");
        let chord = (evaluate(&activation, high) - evaluate(&activation, low)) / (high - low);
        let is_smooth = matches!(activation, Activation::Tanh | Activation::Sigmoid | Activation::Elu(_));
        if high - low > 1e-3 && !is_smooth {
            prop_assert!((line.slope - chord).abs() <= 1e-9 * (1.0 + chord.abs()), "{activation:?} {line:?} {chord}");
        }
    }

    #[test]
    fn an_activation_is_nonlinear_exactly_if_a_kink_is_inside(
        low in -3..4_i32, width in 0..4_i32, least in -2..3_i32, between in 0..3_i32,
        slope in prop::sample::select(vec![-0.5, 0.0, 0.1]),
    ) {
        let (low, high) = (f64::from(low), f64::from(low + width));
        let (least, most) = (f64::from(least), f64::from(least + between));
        let clip = Activation::Clip { low: vec![least], high: vec![most] };
        let leaky = Activation::LeakyRelu(slope);
        for (activation, kinks) in [(Activation::Relu, vec![0.0]), (leaky, vec![0.0]), (clip, vec![least, most])] {
            let is_bent = kinks.iter().any(|&kink| low < kink && kink < high);
            prop_assert_eq!(activation.is_nonlinear_on(0, low, high), is_bent, "{:?} {} {}", activation, low, high);
            let line = activation.relaxation(0, low, high);
            let is_straight = line.high - line.low <= 1e-290;
            // Two kinks may be level with each other.
            prop_assert!(is_straight || is_bent, "{activation:?} {line:?}");
        }
        prop_assert_eq!(Activation::Elu(0.5).is_nonlinear_on(0, low, high), low < 0.0);
        let is_bent = |activation: Activation| activation.is_nonlinear_on(0, low, high);
        prop_assert!(is_bent(Activation::Tanh) && is_bent(Activation::Sigmoid));
        prop_assert!(!is_bent(Activation::Add(vec![1.0])) && !is_bent(Activation::Divide(vec![2.0])));
    }

    #[test]
    fn the_magnitude_bound_is_reached(activation in any_activation()) {
        let bound = 50.0;
        let reached = [-bound, bound].map(|x| evaluate(&activation, x).abs()).into_iter().fold(0.0, f64::max);
        let largest = activation.max_magnitude(0, bound);
        prop_assert!((largest - reached).abs() <= 1e-12 * reached, "{activation:?}: {largest} {reached}");
    }

    #[test]
    fn a_form_is_enclosed_by_its_relaxation(
        activation in any_activation(), low in -4.0..4.0_f64, width in 0.1..4.0_f64,
    ) {
        let x = AffineForm::symbol(0, Interval::new(low, low + width).unwrap());
        let (line, made) = (activation.relaxation(0, x.range().low(), x.range().high()), activation.apply(0, &x));
        let (middle, radius) = line.middle_and_radius();
        let near = 1e-13 * (1.0 + low.abs() + width) * (1.0 + line.slope.abs()) + 1e-13 * middle.abs();
        prop_assert!((made.centre() - (line.slope * x.centre() + middle)).abs() <= near);
        let term = made.terms().first().copied().unwrap_or(0.0);
        prop_assert!((term - line.slope * x.terms()[0]).abs() <= near);
        let rest = radius + line.rounding;
        prop_assert!(made.rest() >= rest && made.rest() <= rest + near, "{made:?} {line:?}");
    }
}

/// Checks that lines without excess change nothing, to the bit.
#[test]
fn linear_pieces_are_relaxed_without_error() {
    let single_layer = |number: f64| vec![number];
    for activation in [
        Activation::Relu,
        Activation::LeakyRelu(0.1),
        Activation::Elu(0.5),
        Activation::Clip {
            low: single_layer(-1.0),
            high: single_layer(9.0),
        },
    ] {
        for (low, high) in [(0.0, 2.0), (0.5, 0.5), (1.0, 3.0)] {
            assert!(
                activation.relaxation(0, low, high).is_identity(),
                "{activation:?}"
            );
        }
        let x = AffineForm::symbol(0, Interval::new(0.5, 2.0).unwrap());
        assert_eq!(activation.apply(0, &x), x);
    }
    for (low, high) in [(-2.0, 0.0), (-2.0, -1.0)] {
        let line = Activation::Relu.relaxation(0, low, high);
        assert!(line.is_constant() && line == LinearRelaxation::new_constant(0.0));
    }
    for (activation, cut) in
        [(single_layer(-1.0), 2.0), (single_layer(-9.0), -3.0)].map(|(low, high)| {
            (
                Activation::Clip {
                    low,
                    high: single_layer(high),
                },
                high,
            )
        })
    {
        for (low, high) in [(3.0, 3.0), (3.0, 7.0), (cut, 7.0)] {
            let line = activation.relaxation(0, low, high);
            assert!(
                line.is_constant() && line.low == cut,
                "{activation:?} {line:?}"
            );
        }
    }
    let below = Activation::Clip {
        low: single_layer(-1.0),
        high: single_layer(2.0),
    }
    .relaxation(0, -7.0, -1.0);
    assert!(below.is_constant() && below.low == -1.0);
    let level = LinearRelaxation::new_constant(2.0);
    for line in [
        LinearRelaxation {
            slope: 1.0,
            ..level
        },
        LinearRelaxation { high: 3.0, ..level },
        LinearRelaxation {
            rounding: 1e-9,
            ..level
        },
    ] {
        assert!(!line.is_constant() && level.is_constant());
    }
}

#[test]
fn an_activation_has_the_width_of_its_operands() {
    let numbers = vec![1.0, 2.0, 3.0];
    let clip = Activation::Clip {
        low: numbers.clone(),
        high: numbers.clone(),
    };
    for activation in [
        Activation::Add(numbers.clone()),
        Activation::Multiply(numbers.clone()),
        Activation::Divide(numbers),
        clip,
    ] {
        assert_eq!(activation.width(), Some(3));
    }
    for activation in [
        Activation::Relu,
        Activation::LeakyRelu(0.1),
        Activation::Elu(1.0),
        Activation::Tanh,
        Activation::Sigmoid,
    ] {
        assert_eq!(activation.width(), None);
    }
}

/// exp costs ten times as much as a product; a ReLU is free, as it is merged with the layer before it.
#[test]
fn curved_activations_have_the_highest_cost() {
    assert_eq!(
        [
            Activation::Relu,
            Activation::LeakyRelu(0.1),
            Activation::Tanh
        ]
        .map(|activation| activation.operations()),
        [0, 100, 1000]
    );
}

/// Small products lose more than in proportion; a quotient rounds on either side of its line.
#[test]
fn rounding_includes_underflow() {
    let least = f64::from(f32::from_bits(1));
    for (activation, by) in [
        (Activation::LeakyRelu(0.25), 0.25),
        (Activation::Multiply(vec![0.25]), 0.25),
        (Activation::Divide(vec![4.0]), 0.25),
    ] {
        let line = activation.relaxation(0, -3.0 * least, -least);
        let lost = by * 3.0 * least - f64::from((by * 3.0 * least) as f32);
        assert!(
            line.rounding >= lost.abs() && line.rounding >= 0.5 * least && line.rounding <= 2e-44,
            "{activation:?} {line:?}"
        );
    }
    let line = Activation::Divide(vec![3.0]).relaxation(0, -1.0, 6.0);
    assert!(
        line.low < 0.0 && line.high == -line.low && line.high >= f64::EPSILON && line.high <= 1e-14,
        "{line:?}"
    );
}
