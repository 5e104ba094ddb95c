//! Gates on collisions in scenarios of the paper, of files, and of a space.

use super::{GateInputs, GateMetric, GateRule, GateVerdict, IndicatorInterval, require};
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
        GateMetric::percent("random scenarios that fail or end early", 0.0),
        simulated_space_problem(space, config),
        |inputs| check_no_collision_in_space(inputs, controller, space),
    )
    .about(|_, claim| {
        let is_drawn = matches!(claim.domain, Domain::Draws { .. });
        claim.property == Property::NoCollision && is_drawn
    })
}

/// The random scenarios of a space that a controller drove.
struct DrivenScenarios {
    domain: Domain,
    random_scenarios: u64,
    ends: RunEnds,
    /// Two-sided confidence level of intervals.
    confidence: f64,
}

/// Evaluates the random scenarios of `distributions`, or the drives in `traffic`, `high-risk`, `followers` or
/// `everyday`. All use the same seed: the larger sample contains the smaller one.
fn check_no_collision_in_space(
    inputs: &GateInputs<'_>,
    controller: &str,
    space: &str,
) -> GateVerdict {
    let samples = [
        inputs.sampled_scenarios(controller, space),
        inputs.everyday_scenarios(controller, space),
        inputs.scenarios_with_followers(controller, space),
    ];
    let larger = samples
        .into_iter()
        .flatten()
        .max_by_key(|driven| driven.random_scenarios)
        .filter(|driven| driven.random_scenarios > 0);
    let Some(driven) = larger else {
        return GateVerdict::fails("no random scenario of the space was simulated");
    };
    let DrivenScenarios {
        random_scenarios,
        ends,
        ..
    } = &driven;
    let against = ends.failures() + ends.ended_by_others;
    let confidence = 0.5 * (1.0 + driven.confidence);
    let interval = IndicatorInterval::of_share(against, *random_scenarios, confidence);
    GateVerdict::new(against == 0, describe_ends(ends, *random_scenarios))
        .with_value(100.0 * against as f64 / *random_scenarios as f64)
        .with_interval(Some(interval))
        .with_domain(driven.domain)
}

impl GateInputs<'_> {
    /// Returns the random scenarios of one of `distributions`.
    fn sampled_scenarios(&self, controller: &str, space: &str) -> Option<DrivenScenarios> {
        let sample = self.sample(space)?;
        Some(DrivenScenarios {
            domain: sample.draws_domain(),
            random_scenarios: sample.random_scenarios,
            ends: sample.find(controller)?.ends.clone(),
            confidence: sample.confidence,
        })
    }

    /// Returns the drives in `traffic` or `high-risk`.
    fn everyday_scenarios(&self, controller: &str, space: &str) -> Option<DrivenScenarios> {
        let report = self.results.usefulness.as_ref()?;
        let index = EVERYDAY_SPACES.iter().position(|name| *name == space)?;
        Some(DrivenScenarios {
            domain: report.domains().get(index)?.clone(),
            random_scenarios: report.random_scenarios,
            ends: report.find(controller)?.ends(index),
            confidence: report.confidence,
        })
    }

    /// Returns the random scenarios of `followers` or `everyday`.
    fn scenarios_with_followers(&self, controller: &str, space: &str) -> Option<DrivenScenarios> {
        let space = self.results.followers.as_ref()?.find_space(space)?;
        let counts = &space.find(controller)?.all;
        Some(DrivenScenarios {
            domain: space.domain(),
            random_scenarios: counts.random_scenarios,
            ends: counts.ends.clone(),
            confidence: space.confidence,
        })
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
