//! How runs are measured, and formulas over them.

use crumple::measure::stl::{Formula, SyntaxProblem, motion_signal_names, motion_signals};
use crumple::sim::AfterContact;
use crumple::trial::any_formula;
use proptest::prelude::*;

use crate::generate::{any_trial, cases, traced};

proptest! {
    #![proptest_config(cases(256))]

    /// What a formula is followed by is told where it stands, not passed over.
    #[test]
    fn a_formula_is_followed_by_nothing(
        bytes in prop::collection::vec(any::<u8>(), 0..80),
        more in prop::sample::select(vec![")", "x > 0", "]", "1"]),
    ) {
        let formula = any_formula(&bytes, &["x", "y"], 0.1).unwrap().to_string();
        let error = format!("({formula}) {more}").parse::<Formula>().expect_err("more than a formula");
        prop_assert_eq!(error.column, formula.chars().count() + 4);
        prop_assert!(matches!(error.problem, SyntaxProblem::Expected { .. }), "{}", error.problem);
    }

    /// Vehicles that stick together are at distance zero, exactly: "never apart again" must not be decided by rounding.
    #[test]
    fn vehicles_that_touched_have_no_gap(mut trial in any_trial()) {
        trial.setup.after_contact = AfterContact::Continue;
        let options = trial.setup.options(trial.scenario.spec().step_s);
        let result = traced(&trial.scenario, &options);
        let trace = result.trace.as_ref().expect("kept");
        let names = motion_signal_names(trace.vehicles.len());
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let signals = motion_signals(trace, trial.scenario.spec().step_s, &names).unwrap();
        for impact in &result.impacts {
            let gaps_m = signals.get(&format!("v{}.gap_m", impact.contact.rear_vehicle)).expect("it is behind another");
            let mut after = trace.time_s.iter().zip(gaps_m).filter(|(t, _)| **t > impact.contact.time_s + 1e-9);
            prop_assert!(after.all(|(_, gap_m)| *gap_m == 0.0), "{impact:?}: {gaps_m:?}");
        }
    }
}
