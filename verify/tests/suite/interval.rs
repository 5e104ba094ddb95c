//! Interval operations keep every member, compared with rational arithmetic.

use crumple_verify::Interval;
use num_rational::BigRational;
use proptest::prelude::*;

use crate::support::rational;

fn holds(interval: Interval, value: &BigRational) -> bool {
    (interval.low() == f64::NEG_INFINITY || rational(interval.low()) <= *value)
        && (interval.high() == f64::INFINITY || rational(interval.high()) >= *value)
}

fn number() -> impl Strategy<Value = f64> {
    let any = any::<f64>().prop_filter("finite", |x| x.is_finite());
    prop_oneof![4 => -100.0..100.0, 2 => any, 1 => Just(0.0), 1 => Just(-0.0), 1 => Just(f64::MAX), 1 => Just(5e-324)]
}

prop_compose! {
    fn interval()(a in number(), b in number(), inside in 0.0..=1.0_f64) -> (Interval, [f64; 2]) {
        let (low, high) = (a.min(b), a.max(b));
        let member = (low + inside * (high / 2.0 - low / 2.0) * 2.0).clamp(low, high);
        (Interval::new(low, high).unwrap(), [member, low])
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(2000))]

    #[test]
    fn intervals_contain_all_exact_results((x, of_x) in interval(), (y, of_y) in interval()) {
        for a in of_x {
            for b in of_y {
                prop_assert!(holds(x + y, &(rational(a) + rational(b))));
                prop_assert!(holds(x - y, &(rational(a) - rational(b))));
                prop_assert!(holds(x * y, &(rational(a) * rational(b))));
                prop_assert!(holds(-x, &-rational(a)));
                prop_assert!(x.min(y).contains(a.min(b)) && x.max(y).contains(a.max(b)));
                prop_assert!(x.hull(y).contains(a) && x.hull(y).contains(b));
                if b != 0.0 {
                    prop_assert!(holds(x.over(y), &(rational(a) / rational(b))));
                }
            }
            prop_assert!(holds(x.sqr(), &(rational(a) * rational(a))) && x.sqr().low() >= 0.0);
            if a >= 0.0 {
                // The root lies between r1 and r2 if r1² <= a <= r2².
                let root = x.sqrt();
                let square = |end: f64| rational(end) * rational(end);
                prop_assert!(root.low() >= 0.0 && square(root.low()) <= rational(a));
                prop_assert!(root.high() == f64::INFINITY || square(root.high()) >= rational(a));
            }
        }
    }

    #[test]
    fn results_are_as_narrow_as_rounding_allows(a in -100.0..100.0_f64, b in 0.1..100.0_f64) {
        let (x, y) = (Interval::point(a), Interval::point(b));
        for result in [x + y, x - y, x * y, x.over(y), x.sqr(), y.sqrt()] {
            prop_assert!(result.high() - result.low() <= 4.0 * f64::EPSILON * result.high().abs().max(1e-300));
        }
    }

    #[test]
    fn intervals_in_files_keep_every_bit((x, _) in interval()) {
        let text = serde_json::to_string(&x).unwrap();
        prop_assert_eq!(serde_json::from_str::<Interval>(&text).unwrap(), x);
    }
}

#[test]
fn undefined_results_are_the_whole_line() {
    let everything = |interval: Interval| {
        interval.low() == f64::NEG_INFINITY && interval.high() == f64::INFINITY
    };
    let (zero, huge) = (Interval::ZERO, Interval::point(f64::MAX));
    assert!(everything(Interval::point(f64::NAN)) && everything(Interval::point(f64::INFINITY)));
    assert!(everything(huge.over(zero)) && everything(zero.over(zero)));
    assert!(everything((huge * huge) - (huge * huge)));
    assert!(everything((huge * huge) * zero) && everything(Interval::point(-1.0).sqrt()));
    assert_eq!((huge + huge).low(), f64::MAX);
    // One-sided overflow keeps the other end.
    let to_huge = Interval::new(0.0, f64::MAX).unwrap();
    assert_eq!((huge * huge).low(), f64::MAX);
    assert!(
        (huge * to_huge).low() >= -1e-300
            && (to_huge * huge).low() >= -1e-300
            && (huge * -to_huge).high() <= 1e-300
    );
    assert!(zero.sqrt().low() == 0.0 && zero.sqrt().high() <= 1e-300);
}

#[test]
fn errors_of_files_name_the_expected_form() {
    for (text, expected) in [
        ("\"3\"", "a number or"),
        ("[1]", "a number or"),
        ("null", "a number or"),
        ("{\"low\": 1}", "missing field `high`"),
        (
            "{\"low\": 1, \"high\": 2, \"middle\": 1.5}",
            "unknown field `middle`",
        ),
        ("{\"low\": 2, \"high\": 1}", "no members"),
        ("1e400", "out of range"),
    ] {
        let message = serde_json::from_str::<Vec<Interval>>(&format!("[\n{text}]"))
            .unwrap_err()
            .to_string();
        assert!(
            message.contains(expected) && message.contains("line 2 column"),
            "{text}: {message}"
        );
    }
    assert_eq!(
        serde_json::from_str::<Interval>("3").unwrap(),
        Interval::point(3.0)
    );
}
