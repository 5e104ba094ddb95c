//! The evaluation of gates.

use serde::Serialize;

use super::case::CaseVerdict;
use super::claims::{AssuranceClaim, Domain, Property, Strength};
use super::{
    AssessmentComparison, AssessmentGate, AssessmentPlan, AssessmentReport, CertificateStatus,
    CheckedCertificate, ControllerUsefulness, Rounded, RunEnds, ScenarioCases,
};
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_sim::engine::FailedControllerRuns;

/// The result of a gate.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GateResult {
    /// Condition in words.
    pub gate: String,
    /// True if the condition holds.
    pub holds: bool,
    /// Deciding fact, in words.
    #[serde(rename = "because")]
    pub reason: String,
}

impl AssessmentGate {
    pub(super) fn evaluate(&self, plan: &AssessmentPlan, found: &AssessmentReport) -> GateResult {
        let named = |space: &Option<String>| {
            let only = || {
                plan.rate_spaces
                    .first()
                    .map(|named| named.name.clone())
                    .unwrap_or_default()
            };
            space.clone().unwrap_or_else(only)
        };
        let (gate, (holds, reason)) = match self {
            Self::NoCollisionInPaperScenarios { controller } => {
                let paper = found
                    .paper_scenarios
                    .as_ref()
                    .map_or(&[][..], |paper| &paper.scenarios);
                let gate = format!("{controller}: no collision in the paper's scenarios");
                (gate, check_no_contact(paper, controller))
            }
            Self::NoCollisionInScenarioFiles { controller } => {
                let files = found
                    .file_scenarios
                    .as_ref()
                    .map_or(&[][..], |files| &files.scenarios);
                let gate = format!("{controller}: no collision in scenario files and recordings");
                (gate, check_no_contact(files, controller))
            }
            Self::NoCollisionInSpace { controller, space } => {
                let gate = format!("{controller}: no collision in random scenarios of `{space}`");
                (
                    gate,
                    check_no_collision_in_space(plan, found, controller, space),
                )
            }
            Self::RateAtMost {
                controller,
                percent,
                space,
            } => {
                let gate = format!(
                    "{controller}: failure rate in `{}` at most {percent} %",
                    named(space)
                );
                (
                    gate,
                    check_rate_at_most(plan, found, controller, *percent, space.as_deref()),
                )
            }
            Self::RateNotAbove {
                controller,
                than,
                space,
            } => {
                let place = named(space);
                let gate = format!(
                    "{controller}: no more failures than {than} in the same random scenarios of `{place}`"
                );
                (
                    gate,
                    check_rate_not_above(plan, found, [controller, than], space.as_deref()),
                )
            }
            Self::NoAvoidableFailure { controller, space } => {
                let gate =
                    format!("{controller}: the search of `{space}` finds no avoidable failure");
                (gate, check_no_avoidable_failure(found, controller, space))
            }
            Self::UnnecessaryBrakingAtMost {
                controller,
                percent,
            } => {
                let gate = format!(
                    "{controller}: unnecessary braking in at most {percent} % of drives in `traffic`"
                );
                (
                    gate,
                    check_drives_at_most(found, controller, *percent, |useful| {
                        useful.unnecessary_braking
                    }),
                )
            }
            Self::LeftBehindAtMost {
                controller,
                percent,
            } => {
                let gate = format!(
                    "{controller}: falls behind in at most {percent} % of drives in `traffic`"
                );
                (
                    gate,
                    check_drives_at_most(found, controller, *percent, |useful| useful.left_behind),
                )
            }
            Self::StringStable { controller } => {
                let gate =
                    format!("{controller}: no speed oscillation grows from vehicle to vehicle");
                (gate, check_string_stable(found, controller))
            }
            Self::SuitePassed { controller, suite } => {
                let gate =
                    format!("{controller}: passes every test of suite `{suite}` that can be run");
                (gate, check_suite_passed(plan, found, controller, suite))
            }
            Self::ProofsAccepted {} => (
                "the checker accepts every certificate".to_owned(),
                check_proofs_accepted(found),
            ),
            Self::NothingWorse {} => {
                let gate = "no result is worse than in the earlier assessment".to_owned();
                (gate, check_nothing_worse(found.comparison.as_ref()))
            }
        };
        GateResult {
            gate,
            holds,
            reason,
        }
    }
}

fn check_no_contact(scenarios: &[ScenarioCases], controller: &str) -> (bool, String) {
    let runs = scenarios.iter().flat_map(|scenario| {
        let own = scenario
            .cases
            .iter()
            .filter(|case| case.controller == controller && case.verdict.is_conclusive());
        own.map(|case| (scenario.scenario.as_str(), &case.verdict))
    });
    let runs: Vec<_> = runs.collect();
    let ends = RunEnds::from_verdicts(runs.iter().map(|(_, verdict)| *verdict));
    if let Some(unanswered) = ends.unanswered {
        let is_first = |(_, verdict): &&(&str, &CaseVerdict)| verdict.unanswered().is_some();
        let first = runs.iter().find(is_first).map_or("", |(name, _)| name);
        return (
            false,
            format!(
                "it {} (first in {first})",
                unanswered.describe(runs.len() as u64)
            ),
        );
    }
    let failing: Vec<_> = runs
        .iter()
        .filter(|(_, verdict)| verdict.is_failure())
        .map(|(name, _)| *name)
        .collect();
    match (failing.is_empty(), runs.len()) {
        (false, _) => (false, format!("it collides in {}", failing.join(", "))),
        (true, 0) => (false, "it has no run".to_owned()),
        (true, passing) => (true, format!("0 of {passing} runs collide")),
    }
}

/// Evaluates the random scenarios of `distributions`, and the drives in `traffic` or `high-risk`.
fn check_no_collision_in_space(
    plan: &AssessmentPlan,
    found: &AssessmentReport,
    controller: &str,
    space: &str,
) -> (bool, String) {
    let place = plan
        .rate_spaces
        .iter()
        .position(|named| named.name == space);
    let drawn = place.and_then(|place| found.rate_spaces.spaces.get(place));
    let drawn = drawn
        .and_then(|drawn| Some((drawn.random_scenarios, drawn.find(controller)?.ends.clone())));
    let everyday = found
        .usefulness
        .as_ref()
        .and_then(|all| all.space_ends(controller, space));
    // Both use the same seed: the larger sample contains the smaller one.
    let all = drawn
        .into_iter()
        .chain(everyday)
        .max_by_key(|(scenarios, _)| *scenarios);
    let Some((scenarios @ 1.., ends)) = all else {
        return (
            false,
            "no random scenario of the space was simulated".to_owned(),
        );
    };
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
    (ends.failures() + ends.ended_by_others == 0, reason)
}

/// Uses the strongest known bound, with or without a certificate.
fn check_rate_at_most(
    plan: &AssessmentPlan,
    found: &AssessmentReport,
    controller: &str,
    percent: f64,
    space: Option<&str>,
) -> (bool, String) {
    let named = space_index(plan, space).and_then(|place| plan.rate_spaces.get(place));
    let place = plan
        .controllers
        .iter()
        .position(|one| one.name == controller);
    let subject = place.and_then(|place| plan.claim_subject(place, plan.config.estimator));
    let (Some(named), Some(subject)) = (named, subject) else {
        return (false, "no random scenario was simulated".to_owned());
    };
    // Round the required rate down, never in favour of the controller.
    let property = Property::RateAtMost {
        percent: Rounded::down(percent),
    };
    let domain = Domain::Space {
        space: named.content_id.clone(),
    };
    let status = found.evidence.claim_status(&AssuranceClaim {
        subject,
        property,
        domain,
    });
    (
        matches!(status.strength, Strength::Bounded { .. }),
        status.describe(),
    )
}

/// Counts a run that ended early against the controller.
fn check_rate_not_above(
    plan: &AssessmentPlan,
    found: &AssessmentReport,
    [controller, than]: [&str; 2],
    space: Option<&str>,
) -> (bool, String) {
    let drawn = space_index(plan, space).and_then(|place| found.rate_spaces.spaces.get(place));
    let Some(drawn) = drawn.filter(|drawn| drawn.random_scenarios > 0) else {
        return (false, "no random scenario was simulated".to_owned());
    };
    let (Some(own), Some(other)) = (drawn.find(controller), drawn.find(than)) else {
        return (false, "it has no run in this space".to_owned());
    };
    let (own, other, scenarios) = (&own.ends, &other.ends, drawn.random_scenarios);
    let mut reason = format!(
        "{} against {} of the same {scenarios} random scenarios collide",
        own.collisions, other.collisions
    );
    if own.ended_by_others > 0 {
        reason += &format!(
            ", and {} ended early with a collision of other vehicles",
            own.ended_by_others
        );
    }
    for (who, of) in [
        ("it", own),
        (
            "the other controller, for which such runs do not count,",
            other,
        ),
    ] {
        if let Some(unanswered) = &of.unanswered {
            reason += &format!(", and {who} {}", unanswered.describe(scenarios));
        }
    }
    let is_known = own.ended_by_others < scenarios && other.unanswered_runs() < scenarios;
    (
        is_known && own.failures() + own.ended_by_others <= other.collisions,
        reason,
    )
}

fn space_index(plan: &AssessmentPlan, space: Option<&str>) -> Option<usize> {
    plan.rate_spaces
        .iter()
        .position(|named| space.is_none_or(|space| named.name == space))
}

fn check_no_avoidable_failure(
    found: &AssessmentReport,
    controller: &str,
    space: &str,
) -> (bool, String) {
    let searched = found
        .searches
        .spaces
        .iter()
        .find(|searched| searched.name == space);
    let Some(search) = searched.and_then(|searched| searched.find(controller)) else {
        return (false, "there is no search for it".to_owned());
    };
    if let Some(words) = search.describe_unanswered() {
        return (false, format!("it {words}"));
    }
    let not_asked = search.count(AvoidabilityClass::NotAsked);
    let (avoidable, undecided) = (
        search.count(AvoidabilityClass::Avoidable),
        search.count(AvoidabilityClass::Undecided),
    );
    match avoidable + undecided {
        0 if not_asked > 0 => (
            false,
            format!("the avoidability of {not_asked} failures was not examined"),
        ),
        0 => (
            true,
            format!("none in {} simulations", search.evaluations()),
        ),
        _ => (
            false,
            format!("{avoidable} avoidable and {undecided} undecided failures"),
        ),
    }
}

fn check_drives_at_most(
    found: &AssessmentReport,
    controller: &str,
    percent: f64,
    count: impl Fn(&ControllerUsefulness) -> u64,
) -> (bool, String) {
    let all = found.usefulness.as_ref();
    let Some((all, useful)) = all.and_then(|all| Some((all, all.find(controller)?))) else {
        return (false, "no drive was simulated".to_owned());
    };
    // The result of a drive without an answer is unknown: count it as the worse.
    let [unanswered, _] = useful.unanswered_runs();
    let share = 100.0 * (count(useful) + unanswered) as f64 / all.random_scenarios as f64;
    let describe = |unanswered: &FailedControllerRuns| {
        format!("; {}", unanswered.describe(all.random_scenarios))
    };
    let words = useful.unanswered[0]
        .as_ref()
        .map_or(String::new(), describe);
    (
        share <= percent,
        format!(
            "{} of {} drives{words}",
            count(useful),
            all.random_scenarios
        ),
    )
}

fn check_string_stable(found: &AssessmentReport, controller: &str) -> (bool, String) {
    let gain = found
        .usefulness
        .as_ref()
        .and_then(|all| Some(&all.find(controller)?.oscillation_gain));
    gain.map_or((false, "no gain was measured".to_owned()), |gain| {
        (gain.damps_all(), gain.describe())
    })
}

/// Ignores tests that cannot be run, but requires at least one test.
fn check_suite_passed(
    plan: &AssessmentPlan,
    found: &AssessmentReport,
    controller: &str,
    suite: &str,
) -> (bool, String) {
    let place = plan
        .suites
        .iter()
        .position(|planned| planned.config_name == suite);
    let of_controller = place.zip(found.suites.as_ref());
    let outcomes: Vec<_> = of_controller
        .iter()
        .flat_map(|(place, suites)| suites.controller_outcomes(*place, controller))
        .collect();
    let run: Vec<_> = outcomes
        .iter()
        .filter(|(_, outcome)| outcome.points > 0)
        .collect();
    let missed: Vec<_> = run
        .iter()
        .filter(|(_, outcome)| outcome.passed != Some(true))
        .map(|(test, _)| test.test.as_str())
        .collect();
    let (mut unanswered, mut runs) = (None, 0);
    for (_, outcome) in &run {
        FailedControllerRuns::merge(&mut unanswered, outcome.total_unanswered());
        runs += outcome.runs;
    }
    let unanswered = unanswered.map_or(String::new(), |unanswered| {
        format!("; it {}", unanswered.describe(runs))
    });
    match (run.len(), missed.as_slice()) {
        (0, _) => (false, "no test could be run".to_owned()),
        (all, []) => (true, format!("{all} of {all} tests pass")),
        (_, missed) => (
            false,
            format!("these tests do not pass: {}{unanswered}", missed.join(", ")),
        ),
    }
}

fn check_proofs_accepted(found: &AssessmentReport) -> (bool, String) {
    let claims_to_prove =
        |one: &&CheckedCertificate| !matches!(one.status, CertificateStatus::NothingShown { .. });
    let certificates: Vec<_> = found
        .proofs
        .certificates
        .iter()
        .filter(claims_to_prove)
        .collect();
    let all = certificates.len();
    let rejected: Vec<_> = certificates
        .iter()
        .filter(|one| !one.is_accepted())
        .collect();
    match rejected.first() {
        None => (all > 0, format!("{all} of {all} certificates are accepted")),
        Some(first) => (
            false,
            format!(
                "{} of {all} are rejected; first: {}",
                rejected.len(),
                first.name
            ),
        ),
    }
}

fn check_nothing_worse(comparison: Option<&AssessmentComparison>) -> (bool, String) {
    match comparison {
        None => (
            false,
            "there is no earlier assessment; name one with --against".to_owned(),
        ),
        Some(comparison) if comparison.has_no_overlap() => (
            false,
            "the earlier assessment has no result in common with this one".to_owned(),
        ),
        Some(comparison) => {
            // A new failure, and a result other than a failure that is gone, count as worse.
            let new = comparison.new.iter().filter(|change| change.is_failure);
            let gone = comparison.gone.iter().filter(|change| !change.is_failure);
            let bad: Vec<_> = comparison.worse.iter().chain(new).chain(gone).collect();
            match bad.as_slice() {
                [] => (
                    true,
                    format!("no result is worse{}", comparison.describe_changed()),
                ),
                [first, ..] => (
                    false,
                    format!(
                        "{} results are worse, new failures, or missing; first: {}",
                        bad.len(),
                        first.description
                    ),
                ),
            }
        }
    }
}
