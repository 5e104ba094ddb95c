//! Gates on suites of tests.

use super::{GateInputs, GateMetric, GateRule, GateVerdict};
use crate::assessment::claims::{Domain, Property};
use crate::assessment::{AssessConfig, SuiteOutcome};
use crumple_core::field_error::FieldError;
use crumple_sim::engine::FailedControllerRuns;

pub(super) fn passed<'a>(
    config: &AssessConfig,
    controller: &'a str,
    suite: &'a str,
) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: passes every test of suite `{suite}` that can be run"),
        GateMetric::none_of("tests that do not pass"),
        suite_problem(config, controller, suite),
        |inputs| check_suite_passed(inputs, controller, suite),
    )
    .about(|_, claim| {
        claim.property == Property::PassesTests
            && matches!(&claim.domain, Domain::Suite { suite: tested } if tested.name == *suite)
    })
}

fn suite_problem(config: &AssessConfig, controller: &str, suite: &str) -> Option<FieldError> {
    let Some(named) = config.suites.iter().find(|named| named.suite == suite) else {
        return Some(FieldError::new(
            "suite",
            format!("`{suite}` is not among `suites`"),
        ));
    };
    let is_tested = named
        .controllers
        .as_ref()
        .is_none_or(|tested| tested.iter().any(|name| name == controller));
    (!is_tested).then(|| {
        FieldError::new(
            "controller",
            format!("`{controller}` is not tested by suite `{suite}`"),
        )
    })
}

/// Ignores tests that cannot be run, but requires at least one test.
fn check_suite_passed(inputs: &GateInputs<'_>, controller: &str, suite: &str) -> GateVerdict {
    let run: Vec<_> = inputs
        .suite_outcomes(controller, suite)
        .into_iter()
        .filter(|outcome| outcome.tested.points > 0)
        .collect();
    let missed: Vec<_> = run
        .iter()
        .filter(|outcome| outcome.tested.outcome() != Some(true))
        .map(|outcome| outcome.test.name.as_str())
        .collect();
    let count = missed.len() as f64;
    let verdict = match (run.len(), missed.as_slice()) {
        (0, _) => GateVerdict::fails("no test could be run"),
        (all, []) => GateVerdict::holds(format!("{all} of {all} tests pass")),
        (_, missed) => GateVerdict::fails(format!(
            "these tests do not pass: {}{}",
            missed.join(", "),
            note_unanswered_runs(&run)
        )),
    };
    if run.is_empty() {
        verdict
    } else {
        verdict.with_value(count)
    }
}

impl GateInputs<'_> {
    fn suite_outcomes<'s>(&'s self, controller: &'s str, suite: &str) -> Vec<SuiteOutcome<'s>> {
        let mut planned = self.plan.suites.iter();
        let index = planned.position(|planned| planned.config_name == suite);
        match (index, &self.results.suites) {
            (Some(index), Some(suites)) => suites.controller_outcomes(index, controller).collect(),
            _ => Vec::new(),
        }
    }
}

fn note_unanswered_runs(outcomes: &[SuiteOutcome<'_>]) -> String {
    let mut unanswered = None;
    for outcome in outcomes {
        FailedControllerRuns::merge(&mut unanswered, outcome.tested.total_unanswered());
    }
    let runs = outcomes.iter().map(|outcome| outcome.tested.points_run());
    let runs = runs.sum::<usize>() as u64;
    unanswered.map_or(String::new(), |failed| {
        format!("; it {}", failed.describe(runs))
    })
}
