//! Measures of runs, and formulas over them.

use crumple_fuzzing::formula_from_bytes;
use crumple_measure::Specification;
use crumple_measure::stl::{
    Formula, SampledSignals, SyntaxProblem, motion_signal_names, motion_signals, naive_robustness,
};
use crumple_sim::engine::{AfterCollision, Trace, Track};
use crumple_sim::scenario::built_in_scenario;
use proptest::prelude::*;

use crate::generate::{any_test_case, simulate_traced, with_cases};

proptest! {
    #![proptest_config(with_cases(256))]

    /// The error names the text after a formula.
    #[test]
    fn a_formula_is_followed_by_nothing(
        bytes in prop::collection::vec(any::<u8>(), 0..80),
        (more, found) in prop::sample::select(vec![(")", "`)`"), ("x > 0", "`x`"), ("]", "`]`"), ("1", "1")]),
    ) {
        let formula = formula_from_bytes(&bytes, &["x", "y"], 0.1).unwrap().to_string();
        let error = format!("({formula}) {more}").parse::<Formula>().expect_err("more than a formula");
        prop_assert_eq!(error.column, formula.chars().count() + 4);
        match &error.problem {
            SyntaxProblem::UnknownOperator { word } => prop_assert_eq!(format!("`{word}`"), found),
            problem => {
                prop_assert!(matches!(problem, SyntaxProblem::Expected { .. }), "{}", problem);
                prop_assert!(problem.to_string().ends_with(&format!("found {found}")), "{}", problem);
            }
        }
    }

    /// Numbers are parsed as elsewhere, including a signed exponent.
    #[test]
    fn numbers_are_read_as_written(number in "[0-9]{1,3}(\\.[0-9]{0,3})?([eE][+-]?[0-9]{1,2})?") {
        let Formula::Compare(comparison) = format!("x > {number}").parse().unwrap() else { panic!("no comparison") };
        prop_assert_eq!(comparison.bound(), number.parse::<f64>().unwrap());
    }

    /// Windows that begin late in a trace that is processed in pieces.
    #[test]
    fn long_traces_are_monitored_by_the_definition(
        samples in 1500..2600_usize,
        formula in prop::sample::select(vec![
            "eventually[5, 12] (always[0, 1] (x + 0.5 * y > 0.2))",
            "always[11, 14] ((x > 0.5) or (y < 0.1))",
            "(x < 0.9) until[4, 11] (eventually[0, 2] (y > 0.9))",
        ]),
        [rate, other] in prop::array::uniform2(0.001..0.1_f64),
    ) {
        let mut signals = SampledSignals::new(0.01, samples).unwrap();
        for (name, rate) in [("x", rate), ("y", other)] {
            signals.insert(name, (0..samples).map(|k| (rate * k as f64).sin()).collect::<Vec<f64>>()).unwrap();
        }
        let formula: Formula = formula.parse().unwrap();
        prop_assert_eq!(formula.robustness(&signals).unwrap(), naive_robustness(&formula, &signals, 0).unwrap());
    }

    /// Vehicles that stick together have a distance of exactly zero: rounding must not decide "never apart again".
    #[test]
    fn vehicles_that_touched_have_no_gap(mut test_case in any_test_case()) {
        test_case.setup.after_collision = AfterCollision::Continue;
        let options = test_case.setup.options(test_case.scenario.spec().step_s);
        let result = simulate_traced(&test_case.scenario, &options);
        let trace = result.trace.as_ref().expect("kept");
        let names = motion_signal_names(trace.vehicles.len());
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let signals = motion_signals(trace, test_case.scenario.spec().step_s, &names).unwrap();
        for impact in &result.impacts {
            let name = format!("v{}.gap_m", impact.collision.rear_vehicle);
            let gaps_m = signals.get(&name).expect("it is behind another");
            let mut after = trace.time_s.iter().zip(gaps_m).filter(|(t, _)| **t > impact.collision.time_s + 1e-9);
            prop_assert!(after.all(|(_, gap_m)| *gap_m == 0.0), "{impact:?}: {gaps_m:?}");
        }
    }
}

/// Positions of an external trace are rounded: a tiny gap counts as none.
#[test]
fn rounding_opens_no_gap() {
    let track = |position_m: [f64; 3]| Track {
        length_m: 2.0,
        mass_kg: 1.0,
        position_m: position_m.to_vec(),
        speed_mps: vec![1.0; 3],
        acceleration_mps2: vec![0.0; 3],
        in_lane_s: Track::THROUGHOUT_S,
    };
    let vehicles = vec![track([5.0; 3]), track([3.0 - 1e-10, 3.0 + 1e-10, 2.999])];
    let trace = Trace {
        time_s: vec![0.0, 0.1, 0.2],
        vehicles,
    };
    let signals = motion_signals(&trace, 0.1, &["v1.gap_m"]).unwrap();
    let gaps_m = signals.get("v1.gap_m").unwrap();
    assert_eq!(gaps_m[..2], [0.0, 0.0]);
    assert!((gaps_m[2] - 0.001).abs() < 1e-12);
}

/// Equal sides have a robustness of zero, and strictness decides.
#[test]
fn equality_satisfies_non_strict_comparisons() {
    let mut signals = SampledSignals::new(0.1, 1).unwrap();
    signals.insert("x", vec![1.0]).unwrap();
    let cases = [
        ("x > 1", false),
        ("x >= 1", true),
        ("x < 1", false),
        ("x <= 1", true),
        ("not x > 1", true),
        ("not x <= 1", false),
    ];
    for (text, holds) in cases {
        let formula: Formula = text.parse().unwrap();
        assert_eq!(formula.robustness(&signals).unwrap(), 0.0, "{text}");
        assert_eq!(formula.is_satisfied(&signals).unwrap(), holds, "{text}");
    }
}

/// The monitor and the definition report the same time of a non-finite sum.
#[test]
fn undefined_values_are_reported_with_their_time() {
    let mut signals = SampledSignals::new(0.1, 10).unwrap();
    for name in ["x", "y"] {
        let samples: Vec<f64> = (0..10)
            .map(|k| if k == 7 { f64::INFINITY } else { 0.0 })
            .collect();
        signals.insert(name, samples).unwrap();
    }
    let formula: Formula = "always (x - y >= 0)".parse().unwrap();
    let error = formula.robustness(&signals).unwrap_err().to_string();
    assert_eq!(
        naive_robustness(&formula, &signals, 0)
            .unwrap_err()
            .to_string(),
        error
    );
    assert!(error.contains("0.7"), "{error}");
}

/// A stated end of an interval lies within the run, also beside and inside intervals without an end.
#[test]
fn formulas_that_need_longer_runs_are_refused() {
    let nominal = built_in_scenario("paper-1").expect("built in");
    let limit_s = nominal.spec().duration_s;
    for (text, needed_s) in [
        ("eventually[0,5] always[0,3] v1.gap_m > 0", 8.0),
        ("always[2,inf] eventually[0,5] v1.gap_m > 0", 7.0),
        ("always v1.gap_m > 0", 0.0),
        ("always v1.gap_m > 0 and always[0,90] v1.gap_m > 0", 90.0),
        ("always[80,inf] v1.gap_m > 0", 80.0),
        ("always eventually[0,70] v1.gap_m > 0", 70.0),
    ] {
        let formula: Formula = text.parse().unwrap();
        assert_eq!(formula.stated_horizon_s(), needed_s, "{text}");
        let parsed = Specification::parse(text, &nominal);
        assert_eq!(parsed.is_ok(), needed_s <= limit_s, "{text}: {parsed:?}");
    }
}

/// The page lists every operator and signal, and explains the parsing of formulas.
#[test]
fn the_page_on_formulas_is_complete_and_right() {
    let page =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/stl.md")).unwrap();
    for word in [
        "not",
        "and",
        "or",
        "implies",
        "always[a,b]",
        "eventually[a,b]",
        "until[a,b]",
        "inf",
    ] {
        assert!(page.contains(&format!("`{word}`")), "{word}");
    }
    for sign in [
        "<", "<=", ">", ">=", "≤", "≥", "!", "¬", "□", "◇", "&&", "∧", "\\|\\|", "∨", "->", "=>",
        "→",
    ] {
        assert!(page.contains(&format!("`{sign}`")), "{sign}");
    }
    for name in motion_signal_names(2)
        .iter()
        .filter_map(|name| name.strip_prefix("v1."))
    {
        assert!(page.contains(&format!("| `vi.{name}` |")), "{name}");
    }
    let table = page.split("| written | read as |").nth(1).expect("a table");
    let rows: Vec<Vec<&str>> = table
        .lines()
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(|line| line.split('`').collect())
        .collect();
    assert_eq!(rows.len(), 5);
    for row in rows {
        assert_eq!(
            row[1].parse::<Formula>().unwrap().to_string(),
            row[3],
            "{row:?}"
        );
    }
}
