//! Comparisons of lines with closed forms: enclosing and tight.

use super::*;
use num_rational::BigRational;
use num_traits::FromPrimitive;
use proptest::prelude::*;

fn rational(value: f64) -> BigRational {
    BigRational::from_f64(value).unwrap()
}

/// Returns the slope of a function of one symbol, and the middle and radius of the excess.
fn slope_and_offset(f: impl Fn(&AffineForm) -> AffineForm, low: f64, high: f64) -> (f64, [f64; 2]) {
    let x = AffineForm::symbol(0, Interval::new(low, high).unwrap());
    let line = f(&x);
    let slope = line.terms()[0] / x.terms()[0];
    (slope, [line.centre() - slope * x.centre(), line.rest()])
}

fn is_near(actual: f64, expected: f64, within: f64) -> bool {
    (actual - expected).abs() <= within
}

/// Returns the least and largest f(x) - s x at the ends and at places between them.
fn extremes(f: impl Fn(f64) -> f64, slope: f64, [low, high]: [f64; 2], places: &[f64]) -> [f64; 2] {
    let inside = places.iter().copied().filter(|&x| low < x && x < high);
    inside
        .chain([low, high])
        .map(|x| f(x) - slope * x)
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], off| {
            [least.min(off), most.max(off)]
        })
}

fn any_magnitude() -> impl Strategy<Value = f64> {
    (-12.0..3.0_f64).prop_map(|exponent| 10.0_f64.powf(exponent))
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(500))]

    /// Checks in rational arithmetic that the excess covers both ends tightly, however different they are.
    #[test]
    fn a_rectifier_exceeds_its_chord_by_the_stated_amount(below in any_magnitude(), high in any_magnitude()) {
        let slope = relu_slope(-below, high);
        let excess = relu_excess(slope, -below, high);
        let (s, m) = (rational(slope), rational(excess));
        let at_ends = [&s * rational(below), (rational(1.0) - &s) * rational(high)];
        for end in &at_ends {
            prop_assert!(*end <= m);
        }
        let most = at_ends.into_iter().max().unwrap();
        prop_assert!(m <= most * rational(1.0 + 1e-14) + rational(1e-290));
        prop_assert!(is_near(slope, high / (high + below), 1e-15));
    }

    /// The excess is (1/l + 1/h - 2/√(l h)) wide.
    #[test]
    fn a_reciprocal_is_as_near_its_chord_as_can_be(low in 1e-3..10.0_f64, more in 0.01..100.0_f64) {
        let high = low * (1.0 + more);
        let (slope, [middle, off]) = slope_and_offset(reciprocal, low, high);
        let (at_ends, on_tangent) = (1.0 / low + 1.0 / high, 2.0 / (low * high).sqrt());
        // A form widens a range by 10⁻¹² of its radius, which matters most at the lower end.
        let near = 1e-12 * (1.0 + more) / low;
        prop_assert!(is_near(slope, -1.0 / (low * high), near / high));
        prop_assert!(is_near(middle, 0.5 * (at_ends + on_tangent), near));
        prop_assert!(is_near(off, 0.5 * (at_ends - on_tangent), near));
    }

    /// The excess is (h - l)²/4 wide for positive members.
    #[test]
    fn a_square_is_as_near_its_chord_as_can_be(high in 0.011..7.0_f64, width in 0.01..4.0_f64) {
        let low = high - width;
        let (slope, [middle, off]) = slope_and_offset(relu_squared, low, high);
        let square = |x: f64| x.max(0.0).powi(2);
        let chord = (square(high) - square(low)) / width;
        let [least, most] = extremes(square, chord, [low, high], &[0.5 * chord]);
        prop_assert!(is_near(slope, chord, 1e-12 * (1.0 + chord)));
        prop_assert!(is_near(middle, 0.5 * (least + most), 1e-11), "{least} {most}");
        prop_assert!(is_near(off, 0.5 * (most - least), 1e-11), "{least} {most}");
    }

    /// The line is the chord, unless a level line is tighter; extremes are at the ends and at tangent points.
    #[test]
    fn a_hyperbolic_tangent_is_as_near_its_chord_as_can_be(
        low in prop_oneof![-4.0..4.0_f64, -40.0..40.0_f64, Just(0.0)],
        width in prop_oneof![0.01..8.0_f64, 0.01..60.0_f64],
    ) {
        let high = low + width;
        let LinearBound { slope, deviation: off } = tanh_relaxation(low, high);
        let chord = (high.tanh() - low.tanh()) / width;
        let turn = (1.0 - chord).sqrt().atanh();
        let [least, most] = extremes(f64::tanh, chord, [low, high], &[-turn, turn]);
        let reach = 0.5 * (chord * width + most - least);
        if reach > 1.0 + 1e-9 {
            prop_assert!(slope == 0.0 && is_near(off.low(), low.tanh(), 1e-12));
            prop_assert!(is_near(off.high(), high.tanh(), 1e-12));
        } else if reach < 1.0 - 1e-9 {
            prop_assert!(is_near(slope, chord, 1e-12 / width));
            let near = 1e-11 * (1.0 + low.abs() + high.abs());
            prop_assert!(is_near(off.low(), least, near) && is_near(off.high(), most, near), "{off:?} {least} {most}");
        }
    }

    #[test]
    fn exponentials_below_0_are_tightest_to_their_chord(
        alpha in prop_oneof![Just(0.0), Just(1.0), 0.0..1.0_f64, -2.0..3.0_f64],
        low in -6.0..-0.01_f64, width in 0.01..8.0_f64,
    ) {
        let high = low + width;
        let LinearBound { slope, deviation: off } = elu_relaxation(alpha, low, high);
        let value = |x: f64| if x < 0.0 { alpha * x.exp_m1() } else { x };
        let is_convex = (0.0..=1.0).contains(&alpha);
        let chord = if is_convex { (value(high) - value(low)) / width } else { 0.0 };
        let turn = if is_convex { (chord / alpha).ln() } else { 0.0 };
        let [least, most] = extremes(value, chord, [low, high], &[0.0, turn]);
        prop_assert!(is_near(slope, chord, 1e-11 / width), "{slope} {chord}");
        prop_assert!(is_near(off.low(), least, 1e-10) && is_near(off.high(), most, 1e-10), "{off:?} {least} {most}");
    }

    #[test]
    fn exponentials_and_tangents_are_nearly_exact(y in 0.0..40.0_f64, z in -30.0..30.0_f64) {
        let power = exp_neg(y);
        prop_assert!(power.low() <= (-y).exp() * (1.0 + 1e-15) && (-y).exp() * (1.0 - 1e-15) <= power.high());
        prop_assert!(power.high() - power.low() <= 1e-11 * power.high());
        let tangent = tanh(z);
        prop_assert!(tangent.low() - 1e-15 <= z.tanh() && z.tanh() <= tangent.high() + 1e-15);
        prop_assert!(tangent.high() - tangent.low() <= 1e-12 && tanh(-z) == -tangent);
    }
}

#[test]
fn functions_reach_their_limits_far_from_zero() {
    let unit = Interval::new((1.0 - f64::EPSILON).next_down(), 1.0).unwrap();
    for z in [20.5, 400.0, 1e300] {
        assert_eq!((tanh(z), tanh(-z)), (unit, -unit));
    }
    assert!(tanh(20.0).high() >= 1.0 && tanh(20.0) != unit);
    assert!(
        exp(-40.0).low() > 0.0 && exp(-50.0).low() == 0.0 && exp(-50.0).high() == exp(-40.0).high()
    );
    let everything = LinearBound {
        slope: 0.0,
        deviation: Interval::ENTIRE,
    };
    assert_eq!(elu_relaxation(0.5, -1.0, f64::INFINITY), everything);
    assert_eq!(elu_relaxation(0.5, f64::NEG_INFINITY, 1.0), everything);
    let within_one = LinearBound {
        slope: 0.0,
        deviation: Interval::around_zero(1.0),
    };
    assert_eq!(tanh_relaxation(-1.0, f64::INFINITY), within_one);
    assert_eq!(tanh_relaxation(f64::NEG_INFINITY, 1.0), within_one);
}
