use super::*;
use num_rational::BigRational;
use num_traits::{Signed, Zero};
use proptest::prelude::*;

fn ego(max_brake_mps2: f64, max_accel_mps2: f64) -> SceneEgo {
    SceneEgo {
        position_m: Interval::ZERO,
        length_m: 2.0,
        speed_mps: Interval::ZERO,
        max_brake_mps2,
        max_accel_mps2,
    }
}

fn rational(value: f64) -> BigRational {
    BigRational::from_float(value).unwrap()
}

fn integral(ego: &SceneEgo, [begin, end]: [f64; 2], step_s: f64) -> BigRational {
    let (q, two) = ([rational(begin), rational(end)], rational(2.0));
    // Returns the integral of the part of q with one sign, over a step of length 1.
    let part = |sign: f64| {
        let [a, b] = [&q[0], &q[1]].map(|q| q * rational(sign));
        match (a.is_positive(), b.is_positive()) {
            (true, true) => (&a + &b) / &two,
            (true, false) => &a * &a / (&two * (&a - &b)),
            (false, true) => &b * &b / (&two * (&b - &a)),
            (false, false) => BigRational::zero(),
        }
    };
    -(rational(ego.max_brake_mps2) * part(1.0) + rational(ego.max_accel_mps2) * part(-1.0))
        * rational(step_s)
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn the_motion_of_a_step_is_integrated_exactly(
        begin in -5.0..5.0_f64, end in -5.0..5.0_f64, brake in 0.0..9.0_f64, accel in 0.0..9.0_f64,
        h in 0.01..2.0_f64,
    ) {
        let ego = ego(brake, accel);
        let actual = min_step_integral(&ego, Interval::point(begin), Interval::point(end), Interval::point(h));
        let least = integral(&ego, [begin, end], h);
        prop_assert!(rational(actual.low()) <= least);
        prop_assert!(least - rational(actual.low()) < rational(1e-12 * (1.0 + actual.low().abs())), "{actual:?}");
    }
}

/// A sign change is uncertain if an end may be zero; a trapezoid is then a lower bound.
#[test]
fn a_q_that_may_be_zero_at_an_end_is_integrated_as_a_trapezoid() {
    let (brake, accel) = (8.0, 3.0);
    let interval = |low, high| Interval::new(low, high).unwrap();
    let point = Interval::point;
    for (begin, end, expected) in [
        (interval(0.0, 2.0), point(-1.0), -2.0 * brake - accel),
        (point(1.0), interval(-2.0, 0.0), -brake - 2.0 * accel),
        (interval(-2.0, 0.0), point(1.0), -brake - 2.0 * accel),
        (point(-1.0), interval(0.0, 2.0), -2.0 * brake - accel),
    ] {
        let actual = min_step_integral(&ego(brake, accel), begin, end, point(0.5)).low();
        assert!(
            (actual - 0.25 * expected).abs() < 1e-12,
            "{begin:?} {end:?}: {actual}"
        );
    }
}
