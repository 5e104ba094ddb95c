use super::super::generate::{any_comparison, any_formula};
use super::super::naive_robustness;
use super::*;
use proptest::prelude::*;

const STEP_S: f64 = 0.1;

fn comparison() -> impl Strategy<Value = Formula> {
    let weight = prop_oneof![Just(1.0), Just(-1.0), Just(0.5)];
    // Small whole numbers often yield margins of exactly zero.
    any_comparison(
        weight,
        prop_oneof![Just("x"), Just("y")],
        2,
        (-2i32..3).prop_map(f64::from),
    )
}

fn window() -> impl Strategy<Value = TimeWindow> {
    prop_oneof![
        Just(TimeWindow::ALL),
        // Decimal multiples of the step, which are not multiples in binary.
        (0u32..12, 0u32..25).prop_map(|(a, b)| {
            TimeWindow::new(f64::from(a) / 10.0, f64::from(a + b) / 10.0).unwrap()
        }),
    ]
}

fn formula() -> impl Strategy<Value = Formula> {
    any_formula(comparison(), window(), 4, 12)
}

fn trace() -> impl Strategy<Value = (Vec<f64>, Vec<f64>)> {
    let value = prop_oneof![(-3i32..4).prop_map(f64::from), -3.0..3.0f64];
    prop::collection::vec((value.clone(), value), 1..60).prop_map(|pairs| pairs.into_iter().unzip())
}

fn signals<'a>(x: &'a [f64], y: &'a [f64]) -> SampledSignals<'a> {
    let mut signals = SampledSignals::new(STEP_S, x.len()).unwrap();
    signals.insert("x", x).unwrap();
    signals.insert("y", y).unwrap();
    signals
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(2000))]

    #[test]
    fn robustness_equals_its_definition((x, y) in trace(), formula in formula()) {
        let signals = signals(&x, &y);
        let over_time = formula.robustness_over_time(&signals).unwrap();
        for (k, &value) in over_time.iter().enumerate() {
            prop_assert_eq!(value, naive_robustness(&formula, &signals, k).unwrap(), "sample {} of {}", k, formula);
        }
        prop_assert_eq!(formula.robustness(&signals).unwrap(), over_time[0]);
    }

    #[test]
    fn truth_is_the_sign_of_robustness((x, y) in trace(), formula in formula()) {
        let signals = signals(&x, &y);
        let robustness = formula.robustness(&signals).unwrap();
        let satisfied = formula.is_satisfied(&signals).unwrap();
        prop_assert!(robustness == 0.0 || satisfied == (robustness > 0.0));
        let negated = Formula::Not(Box::new(formula));
        prop_assert_eq!(negated.is_satisfied(&signals).unwrap(), !satisfied);
        prop_assert_eq!(negated.robustness(&signals).unwrap(), -robustness);
    }

    #[test]
    fn samples_after_the_horizon_do_not_matter((x, y) in trace(), formula in formula(), noise in -9.0..9.0f64) {
        let horizon = (formula.horizon_s() / STEP_S + 1e-6).floor();
        if horizon >= x.len() as f64 {
            return Ok(());
        }
        let disturbed: Vec<f64> =
            x.iter().enumerate().map(|(k, &v)| if k as f64 > horizon { v * noise + 1.0 } else { v }).collect();
        let cut = horizon as usize + 1;
        let whole = formula.robustness(&signals(&x, &y)).unwrap();
        prop_assert_eq!(whole, formula.robustness(&signals(&disturbed, &y)).unwrap());
        prop_assert_eq!(whole, formula.robustness(&signals(&x[..cut], &y[..cut])).unwrap());
    }
}

#[test]
fn windows_after_the_end_of_the_trace_are_clipped_or_empty() {
    let x = [3.0, 2.0, 1.0];
    let at = |text: &str| {
        text.parse::<Formula>()
            .unwrap()
            .robustness(&signals(&x, &x))
            .unwrap()
    };
    assert_eq!(at("always[0.1,9] x > 0"), 1.0);
    assert_eq!(at("eventually[0.2,9] x > 0"), 1.0);
    assert_eq!(at("always[0.3,9] x > 0"), f64::INFINITY);
    assert_eq!(at("not eventually[0.3,9] x > 0"), f64::INFINITY);
    assert_eq!(at("(x > 0) until[0.3,9] (x > 0)"), f64::NEG_INFINITY);
}

#[test]
fn the_longest_formula_that_parses_is_evaluated() {
    let x = [1.0; 4];
    for operator in ["and", "or", "implies"] {
        let formula: Formula = vec!["x > 0"; 990]
            .join(&format!(" {operator} "))
            .parse()
            .unwrap();
        assert_eq!(formula.robustness(&signals(&x, &x)).unwrap(), 1.0);
        assert_eq!(
            naive_robustness(&formula, &signals(&x, &x), 0).unwrap(),
            1.0
        );
        assert!(formula.to_string().len() > 990);
    }
}

#[test]
fn formulas_without_a_defined_value_are_refused() {
    let x = [f64::INFINITY, 1.0];
    let signals = signals(&x, &x);
    let error = |text: &str| {
        text.parse::<Formula>()
            .unwrap()
            .robustness(&signals)
            .unwrap_err()
            .to_string()
    };
    assert_eq!(error("z > 0"), "there is no signal `z`; there are: x, y");
    assert_eq!(
        error("always[0.11,0.19] x > 0"),
        "the window [0.11,0.19] s holds no sample at a step of 0.1 s"
    );
    assert_eq!(
        error("x - y > 0"),
        "`x - y > 0` is undefined at 0 s: infinity minus infinity"
    );
}
