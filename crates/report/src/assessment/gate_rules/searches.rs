//! Gates on searches for failures.

use super::{GateInputs, GateMetric, GateRule, GateVerdict};
use crate::assessment::claims::Domain;
use crate::assessment::{AssessConfig, FailureSearch};
use crumple_core::field_error::FieldError;
use crumple_search::falsify::counterexample::AvoidabilityClass;

pub(super) fn no_avoidable_failure<'a>(
    config: &AssessConfig,
    controller: &'a str,
    space: &'a str,
) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: the search of `{space}` finds no avoidable failure"),
        GateMetric::none_of("distinct failures that are avoidable or undecided"),
        searched_space_problem(space, config),
        |inputs| check_no_avoidable_failure(inputs, controller, space),
    )
    .about(|_, claim| {
        matches!(&claim.domain, Domain::Search { space: searched, .. } if searched.name == *space)
    })
}

fn searched_space_problem(space: &str, config: &AssessConfig) -> Option<FieldError> {
    let is_searched = config.search_spaces().iter().any(|name| name == space);
    (!is_searched)
        .then(|| FieldError::new("space", format!("`{space}` is not among `search.spaces`")))
}

fn check_no_avoidable_failure(
    inputs: &GateInputs<'_>,
    controller: &str,
    space: &str,
) -> GateVerdict {
    let mut spaces = inputs.results.searches.spaces.iter();
    let searches = spaces.find(|searches| searches.name == space);
    match searches.and_then(|searches| searches.find(controller)) {
        Some(search) => check_search(search),
        None => GateVerdict::fails("there is no search for it"),
    }
}

fn check_search(search: &FailureSearch) -> GateVerdict {
    if let Some(unanswered) = search.describe_unanswered() {
        return GateVerdict::fails(format!("it {unanswered}"));
    }
    let not_asked = search.count(AvoidabilityClass::NotAsked);
    let avoidable = search.count(AvoidabilityClass::Avoidable);
    let undecided = search.count(AvoidabilityClass::Undecided);
    let verdict = match avoidable + undecided {
        0 if not_asked > 0 => GateVerdict::fails(format!(
            "the avoidability of {not_asked} failures was not examined"
        )),
        0 => GateVerdict::holds(format!("none in {} simulations", search.evaluations())),
        _ => GateVerdict::fails(format!(
            "{avoidable} avoidable and {undecided} undecided failures"
        )),
    };
    let mut failures = search.failures.iter();
    let against = failures.find(|failure| failure.class != AvoidabilityClass::Unavoidable);
    verdict
        .with_value((avoidable + undecided) as f64)
        .with_file(against.map(|failure| failure.file.clone()))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::assessment::{AssessmentPlan, EvidenceCache, SearchConfig, assess};
    use crumple_core::observer::Quiet;

    /// The severest failure may be unavoidable, which does not decide against the gate.
    #[test]
    fn a_failed_gate_names_a_failure_that_is_not_unavoidable() {
        let config = AssessConfig {
            controllers: vec!["baseline".to_owned()],
            paper: false,
            distributions: Some(Vec::new()),
            everyday_draws: 0,
            search: SearchConfig {
                spaces: Some(vec!["high-risk".to_owned()]),
                budget: 40,
            },
            subject: None,
            gates: Vec::new(),
            ..AssessConfig::default()
        };
        let plan = AssessmentPlan::new(config, [], Path::new("")).unwrap();
        let report = assess(&plan, &EvidenceCache::disabled(), None, &Quiet).unwrap();
        let mut search = report.results.searches.spaces[0].controllers[0].clone();
        search.failures.truncate(2);
        let files: Vec<String> = search
            .failures
            .iter()
            .map(|failure| failure.file.clone())
            .collect();
        for (classes, expected) in [
            (
                [AvoidabilityClass::Undecided, AvoidabilityClass::Avoidable],
                &files[0],
            ),
            (
                [AvoidabilityClass::Unavoidable, AvoidabilityClass::Undecided],
                &files[1],
            ),
        ] {
            for (failure, class) in search.failures.iter_mut().zip(classes) {
                failure.class = class;
            }
            assert_eq!(check_search(&search).file.as_ref(), Some(expected));
        }
    }
}
