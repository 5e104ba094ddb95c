//! Gates on collisions in scenarios of the paper, of files, and of a space.

use super::{GateInputs, GateMetric, GateRule, GateVerdict, is_in_space, require};
use crate::assessment::case::CaseVerdict;
use crate::assessment::claims::{Domain, Property};
use crate::assessment::config::{EVERYDAY_SPACES, FOLLOWER_SPACES};
use crate::assessment::parts::{FILE_SCENARIOS_ANCHOR, PAPER_ANCHOR};
use crate::assessment::{AssessConfig, RunEnds, ScenarioCases};
use crumple_core::field_error::FieldError;

pub(super) fn in_paper_scenarios<'a>(config: &AssessConfig, controller: &'a str) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: no collision in the paper's scenarios"),
        GateMetric::none_of("runs that fail"),
        require(config.paper, "`paper = true`"),
        |inputs| {
            let paper = inputs.results.paper_scenarios.as_ref();
            check_no_collision(paper.map_or(&[], |paper| &paper.scenarios), controller)
        },
    )
    .about(|row, claim| claim.property == Property::NoCollision && row.part == PAPER_ANCHOR)
}

pub(super) fn in_scenario_files<'a>(config: &AssessConfig, controller: &'a str) -> GateRule<'a> {
    let has_files = !config.scenarios.is_empty() || !config.recordings.is_empty();
    GateRule::new(
        format!("{controller}: no collision in scenario files and recordings"),
        GateMetric::none_of("runs that fail"),
        require(has_files, "`scenarios` or `recordings`"),
        |inputs| {
            let files = inputs.results.file_scenarios.as_ref();
            check_no_collision(files.map_or(&[], |files| &files.scenarios), controller)
        },
    )
    .about(|row, claim| {
        claim.property == Property::NoCollision && row.part == FILE_SCENARIOS_ANCHOR
    })
}

fn check_no_collision(scenarios: &[ScenarioCases], controller: &str) -> GateVerdict {
    let runs = conclusive_runs(scenarios, controller);
    let ends = RunEnds::from_verdicts(runs.iter().map(|run| run.verdict));
    let failures = ends.failures() as f64;
    if let Some(unanswered) = ends.unanswered {
        let first = runs.iter().find(|run| run.verdict.unanswered().is_some());
        return GateVerdict::fails(format!(
            "it {} (first in {})",
            unanswered.describe(runs.len() as u64),
            first.map_or("", |run| run.scenario)
        ))
        .with_value(failures);
    }
    let failing: Vec<_> = runs
        .iter()
        .filter(|run| run.verdict.is_failure())
        .map(|run| run.scenario)
        .collect();
    match (failing.is_empty(), runs.len()) {
        (false, _) => GateVerdict::fails(format!("it collides in {}", failing.join(", ")))
            .with_value(failures),
        (true, 0) => GateVerdict::fails("it has no run"),
        (true, passing) => {
            GateVerdict::holds(format!("0 of {passing} runs collide")).with_value(failures)
        }
    }
}

/// A run that is evidence about the controller.
struct ConclusiveRun<'a> {
    scenario: &'a str,
    verdict: &'a CaseVerdict,
}

fn conclusive_runs<'a>(scenarios: &'a [ScenarioCases], controller: &str) -> Vec<ConclusiveRun<'a>> {
    let mut runs = Vec::new();
    for scenario in scenarios {
        let own = scenario
            .cases
            .iter()
            .filter(|case| case.controller == controller && case.verdict.is_conclusive());
        runs.extend(own.map(|case| ConclusiveRun {
            scenario: &scenario.scenario,
            verdict: &case.verdict,
        }));
    }
    runs
}

pub(super) fn in_space<'a>(
    config: &AssessConfig,
    controller: &'a str,
    space: &'a str,
) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: no collision in random scenarios of `{space}`"),
        GateMetric::none_of("random scenarios that fail or end early"),
        simulated_space_problem(space, config),
        |inputs| check_no_collision_in_space(inputs, controller, space),
    )
    .about(|_, claim| {
        let is_drawn = matches!(claim.domain, Domain::Draws { .. });
        claim.property == Property::NoCollision && is_drawn && is_in_space(claim, space)
    })
}

/// Evaluates the random scenarios of `distributions`, or the drives in `traffic`, `high-risk`, `followers` or
/// `everyday`. All use the same seed: the larger sample contains the smaller one.
fn check_no_collision_in_space(
    inputs: &GateInputs<'_>,
    controller: &str,
    space: &str,
) -> GateVerdict {
    let usefulness = inputs.results.usefulness.as_ref();
    let everyday = usefulness.and_then(|report| report.space_ends(controller, space));
    let followers = inputs.results.followers.as_ref();
    let with_followers = followers.and_then(|report| {
        let counts = &report.find_space(space)?.find(controller)?.all;
        Some((counts.random_scenarios, counts.ends.clone()))
    });
    let larger_sample = inputs
        .sampled_ends(controller, space)
        .into_iter()
        .chain(everyday)
        .chain(with_followers)
        .max_by_key(|(scenarios, _)| *scenarios);
    match larger_sample {
        Some((scenarios @ 1.., ends)) => {
            let against = ends.failures() + ends.ended_by_others;
            GateVerdict::new(against == 0, describe_ends(&ends, scenarios))
                .with_value(against as f64)
        }
        _ => GateVerdict::fails("no random scenario of the space was simulated"),
    }
}

impl GateInputs<'_> {
    /// Returns the number and the ends of the random scenarios of one of `distributions`.
    fn sampled_ends(&self, controller: &str, space: &str) -> Option<(u64, RunEnds)> {
        let mut spaces = self.plan.rate_spaces.iter();
        let index = spaces.position(|named| named.name == space)?;
        let sample = self.results.rate_spaces.spaces.get(index)?;
        Some((
            sample.random_scenarios,
            sample.find(controller)?.ends.clone(),
        ))
    }
}

fn describe_ends(ends: &RunEnds, scenarios: u64) -> String {
    let mut reason = format!(
        "{} of {scenarios} random scenarios collide",
        ends.collisions
    );
    if ends.unanswered_runs() > 0 {
        reason += &format!(
            ", and the controller gives no answer in {}",
            ends.unanswered_runs()
        );
    }
    if ends.ended_by_others > 0 {
        reason += &format!(
            ", and {} end early with a collision of other vehicles",
            ends.ended_by_others
        );
    }
    reason
}

fn simulated_space_problem(space: &str, config: &AssessConfig) -> Option<FieldError> {
    let is_drawn = config.rate_spaces().iter().any(|name| name == space);
    let is_driven = EVERYDAY_SPACES.contains(&space) || FOLLOWER_SPACES.contains(&space);
    match (is_drawn && config.draws > 0) || (is_driven && config.everyday_draws > 0) {
        true => None,
        false if is_drawn => Some(FieldError::new("require", "needs `draws` above 0")),
        false if is_driven => Some(FieldError::new(
            "require",
            format!("needs `everyday_draws` above 0, or `{space}` in `distributions`"),
        )),
        false => {
            let driven: Vec<_> = EVERYDAY_SPACES
                .iter()
                .chain(&FOLLOWER_SPACES)
                .map(|name| format!("`{name}`"))
                .collect();
            let driven = driven.join(", ");
            Some(FieldError::new(
                "space",
                format!("`{space}` is neither among `distributions` nor one of {driven}"),
            ))
        }
    }
}
