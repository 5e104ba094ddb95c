//! Gates: the conditions of an assessment to pass.

use serde::{Deserialize, Serialize};

use super::claims::{AssuranceClaim, Domain, Property, Strength};
use super::parts::EVERYDAY_SPACES;
use super::{
    AssessConfig, AssessmentComparison, AssessmentPlan, AssessmentReport, CertificateStatus, CheckedCertificate,
    ControllerUsefulness, Rounded,
};
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_world::scenario::file::FileError;
use crumple_world::sim::FailedControllerRuns;

/// A condition that must hold for an assessment to pass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "require", rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum AssessmentGate {
    /// A controller collides in none of the paper's scenarios.
    NoContactInPaperScenarios {
        /// Name of the controller.
        controller: String,
    },
    /// A controller collides in none of the scenarios of `scenarios` and `recordings`; spaces are not considered.
    NoCollisionInScenarioFiles {
        /// Name of the controller.
        controller: String,
    },
    /// A controller collides in none of the simulated random scenarios of a space. Scenarios that a collision of other
    /// vehicles ends count against it.
    NoCollisionInSpace {
        /// Name of the controller.
        controller: String,
        /// Scenario space: one of `distributions`, or `traffic` or `high-risk` if `everyday_draws` is above 0.
        space: String,
    },
    /// The failure rate of a controller in a scenario space is at most this, by bounds on counted runs.
    RateAtMost {
        /// Name of the controller.
        controller: String,
        /// Largest bound that passes, in percent.
        percent: f64,
        /// Scenario space, one of `distributions`. Default: the only one there is.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        space: Option<String>,
    },
    /// A controller collides in no more random scenarios of a space than another one.
    RateNotAbove {
        /// Name of the controller.
        controller: String,
        /// Name of the other controller.
        than: String,
        /// Scenario space, one of `distributions`. Default: the only one there is.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        space: Option<String>,
    },
    /// No search found a failure of a controller that is avoidable or undecided.
    NoAvoidableFailure {
        /// Name of the controller.
        controller: String,
        /// Scenario space of the search.
        space: String,
    },
    /// A controller brakes unnecessarily in at most this share of its drives in everyday traffic.
    #[serde(rename = "needless-braking-at-most")]
    UnnecessaryBrakingAtMost {
        /// Name of the controller.
        controller: String,
        /// Largest share that passes, in percent.
        percent: f64,
    },
    /// A controller falls behind in at most this share of its drives in everyday traffic.
    LeftBehindAtMost {
        /// Name of the controller.
        controller: String,
        /// Largest share that passes, in percent.
        percent: f64,
    },
    /// A disturbance does not grow in a line of vehicles with a controller.
    StringStable {
        /// Name of the controller.
        controller: String,
    },
    /// A controller passes every test of a suite that can be run.
    SuitePassed {
        /// Name of the controller.
        controller: String,
        /// Suite, as `suites` names it.
        suite: String,
    },
    /// The checker accepts every certificate.
    ProofsAccepted {},
    /// The assessment is compared with an earlier one, and no result is worse.
    NothingWorse {},
}

/// Replaces the message about the former name of a gate, which a configuration may no longer use.
pub(super) fn explain_former_name(error: FileError) -> FileError {
    match error {
        FileError::Syntax { path, line, message } => {
            let place = message.split_once("unknown variant `no-contact-in-traffic`").map(|(place, _)| place);
            let message = place.map_or_else(|| message.clone(), |place| format!("{place}{FORMER_NAME}"));
            FileError::Syntax { path, line, message }
        }
        other => other,
    }
}

const FORMER_NAME: &str = "`no-contact-in-traffic` is now called `no-collision-in-scenario-files`, because it \
    evaluates only `scenarios` and `recordings`; for random scenarios of the space `traffic`, use \
    `no-collision-in-space` with `space = \"traffic\"`";

/// Counts of the random scenarios of a space, under one controller.
pub(super) struct SpaceTally {
    pub(super) scenarios: u64,
    /// Number in which a vehicle under test collides.
    pub(super) collisions: u64,
    /// Number in which the controller gives no answer.
    pub(super) unanswered: u64,
    /// Number that end with a collision of other vehicles.
    pub(super) ended_by_others: u64,
}

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
    pub(super) fn controllers_mut(&mut self) -> Vec<(&'static str, &mut String)> {
        match self {
            Self::RateNotAbove { controller, than, .. } => vec![("controller", controller), ("than", than)],
            Self::NoContactInPaperScenarios { controller }
            | Self::NoCollisionInScenarioFiles { controller }
            | Self::NoCollisionInSpace { controller, .. }
            | Self::RateAtMost { controller, .. }
            | Self::UnnecessaryBrakingAtMost { controller, .. }
            | Self::LeftBehindAtMost { controller, .. }
            | Self::StringStable { controller }
            | Self::SuitePassed { controller, .. }
            | Self::NoAvoidableFailure { controller, .. } => vec![("controller", controller)],
            Self::ProofsAccepted {} | Self::NothingWorse {} => Vec::new(),
        }
    }

    /// Returns the field, and the problem, that prevents any assessment of this configuration from evaluating the gate.
    pub(super) fn config_problem(&self, config: &AssessConfig) -> Option<(&'static str, String)> {
        let needs_drives =
            || (config.everyday_draws == 0).then(|| ("require", "needs `everyday_draws` above 0".to_owned()));
        match self {
            Self::NoContactInPaperScenarios { .. } if !config.paper => {
                Some(("require", "needs `paper = true`".to_owned()))
            }
            Self::NoAvoidableFailure { space, .. } if !config.search_spaces().contains(space) => {
                Some(("space", format!("`{space}` is not among `search.spaces`")))
            }
            Self::RateAtMost { percent, space, .. } => share_problem(*percent).or_else(|| space_problem(space, config)),
            Self::RateNotAbove { controller, than, .. } if controller == than => {
                Some(("than", "is the controller itself: name another one".to_owned()))
            }
            Self::RateNotAbove { .. } if config.draws == 0 => Some(("require", "needs `draws` above 0".to_owned())),
            Self::RateNotAbove { space, .. } => space_problem(space, config),
            Self::NoCollisionInSpace { space, .. } => simulated_space_problem(space, config),
            Self::NoCollisionInScenarioFiles { .. } if config.scenarios.is_empty() && config.recordings.is_empty() => {
                Some(("require", "needs `scenarios` or `recordings`".to_owned()))
            }
            Self::UnnecessaryBrakingAtMost { percent, .. } | Self::LeftBehindAtMost { percent, .. } => {
                share_problem(*percent).or_else(needs_drives)
            }
            Self::StringStable { .. } => needs_drives(),
            Self::SuitePassed { controller, suite } => suite_problem(config, controller, suite),
            _ => None,
        }
    }

    pub(super) fn evaluate(&self, plan: &AssessmentPlan, found: &AssessmentReport) -> GateResult {
        let (holds, reason) = match self {
            Self::NoContactInPaperScenarios { controller } => {
                let paper = found.paper_scenarios.as_ref().map_or(&[][..], |paper| &paper.scenarios);
                check_no_contact(paper, controller)
            }
            Self::NoCollisionInScenarioFiles { controller } => match &found.file_scenarios {
                Some(traffic) => check_no_contact(&traffic.scenarios, controller),
                None => (false, "the configuration names no scenarios or recordings".to_owned()),
            },
            Self::NoCollisionInSpace { controller, space } => {
                check_no_collision_in_space(plan, found, controller, space)
            }
            Self::RateAtMost { controller, percent, space } => {
                check_rate_at_most(plan, found, controller, *percent, space.as_deref())
            }
            Self::RateNotAbove { controller, than, space } => {
                check_rate_not_above(plan, found, [controller, than], space.as_deref())
            }
            Self::NoAvoidableFailure { controller, space } => check_no_avoidable_failure(found, controller, space),
            Self::UnnecessaryBrakingAtMost { controller, percent } => {
                check_drives_at_most(found, controller, *percent, |useful| useful.unnecessary_braking)
            }
            Self::LeftBehindAtMost { controller, percent } => {
                check_drives_at_most(found, controller, *percent, |useful| useful.left_behind)
            }
            Self::StringStable { controller } => check_string_stable(found, controller),
            Self::SuitePassed { controller, suite } => check_suite_passed(plan, found, controller, suite),
            Self::ProofsAccepted {} => check_proofs_accepted(found),
            Self::NothingWorse {} => check_nothing_worse(found.comparison.as_ref()),
        };
        GateResult { gate: self.describe(plan), holds, reason }
    }

    fn describe(&self, plan: &AssessmentPlan) -> String {
        let named = |space: &Option<String>| {
            let only = || plan.rate_spaces.first().map(|named| named.name.clone()).unwrap_or_default();
            space.clone().unwrap_or_else(only)
        };
        match self {
            Self::NoContactInPaperScenarios { controller } => {
                format!("{controller}: no collision in the paper's scenarios")
            }
            Self::NoCollisionInScenarioFiles { controller } => {
                format!("{controller}: no collision in scenario files and recordings")
            }
            Self::NoCollisionInSpace { controller, space } => {
                format!("{controller}: no collision in random scenarios of `{space}`")
            }
            Self::RateAtMost { controller, percent, space } => {
                format!("{controller}: failure rate in `{}` at most {percent} %", named(space))
            }
            Self::RateNotAbove { controller, than, space } => {
                format!("{controller}: no more failures than {than} in the same random scenarios of `{}`", named(space))
            }
            Self::NoAvoidableFailure { controller, space } => {
                format!("{controller}: the search of `{space}` finds no avoidable failure")
            }
            Self::UnnecessaryBrakingAtMost { controller, percent } => {
                format!("{controller}: unnecessary braking in at most {percent} % of drives in `traffic`")
            }
            Self::LeftBehindAtMost { controller, percent } => {
                format!("{controller}: falls behind in at most {percent} % of drives in `traffic`")
            }
            Self::StringStable { controller } => format!("{controller}: string stability"),
            Self::SuitePassed { controller, suite } => {
                format!("{controller}: passes every test of suite `{suite}` that can be run")
            }
            Self::ProofsAccepted {} => "the checker accepts every certificate".to_owned(),
            Self::NothingWorse {} => "no result is worse than in the earlier assessment".to_owned(),
        }
    }
}

fn check_no_contact(scenarios: &[super::ScenarioCases], controller: &str) -> (bool, String) {
    let of_controller = || {
        scenarios.iter().flat_map(|scenario| {
            let own =
                scenario.cases.iter().filter(|case| case.controller == controller && case.verdict.is_conclusive());
            own.map(|case| (scenario.scenario.as_str(), &case.verdict))
        })
    };
    if let Some((name, unanswered)) = of_controller().find_map(|(name, verdict)| Some((name, verdict.unanswered()?))) {
        let runs = of_controller().filter(|(_, verdict)| verdict.unanswered().is_some()).count() as u64;
        let words = FailedControllerRuns { runs, ..unanswered }.describe(of_controller().count() as u64);
        return (false, format!("it {words} (first in {name})"));
    }
    let cases = of_controller().map(|(name, verdict)| (name, verdict.is_failure()));
    let (failing, passing): (Vec<_>, Vec<_>) = cases.partition(|(_, collides)| *collides);
    let names: Vec<_> = failing.iter().map(|(name, _)| *name).collect();
    match (names.is_empty(), passing.is_empty()) {
        (false, _) => (false, format!("it collides in {}", names.join(", "))),
        (true, true) => (false, "it has no run".to_owned()),
        (true, false) => (true, format!("0 of {} runs collide", passing.len())),
    }
}

/// Evaluates the random scenarios of `distributions`, and the drives in `traffic` or `high-risk`.
fn check_no_collision_in_space(
    plan: &AssessmentPlan,
    found: &AssessmentReport,
    controller: &str,
    space: &str,
) -> (bool, String) {
    let place = plan.rate_spaces.iter().position(|named| named.name == space);
    let drawn = place.and_then(|place| found.rate_spaces.spaces.get(place)).and_then(|drawn| {
        let of_controller = drawn.controllers.iter().find(|sampled| sampled.controller == controller)?;
        Some(SpaceTally {
            scenarios: drawn.random_scenarios,
            collisions: of_controller.collisions,
            unanswered: of_controller.unanswered_runs(),
            ended_by_others: of_controller.ended_by_others,
        })
    });
    let everyday = found.usefulness.as_ref().and_then(|all| all.space_tally(controller, space));
    // Both use the same seed: the larger sample contains the smaller one.
    let all = drawn.into_iter().chain(everyday).max_by_key(|tally| tally.scenarios);
    let Some(SpaceTally { scenarios: scenarios @ 1.., collisions, unanswered, ended_by_others }) = all else {
        return (false, "no random scenario of the space was simulated".to_owned());
    };
    let mut reason = format!("{collisions} of {scenarios} random scenarios collide");
    if unanswered > 0 {
        reason += &format!(", and the controller gives no answer in {unanswered}");
    }
    if ended_by_others > 0 {
        reason += &format!(", and {ended_by_others} end early with a collision of other vehicles");
    }
    (collisions + unanswered + ended_by_others == 0, reason)
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
    let place = plan.controllers.iter().position(|one| one.name == controller);
    let subject = place.and_then(|place| plan.claim_subject(place, plan.config.estimator));
    let (Some(named), Some(subject)) = (named, subject) else {
        return (false, "no random scenario was simulated".to_owned());
    };
    // Round the required rate down, never in favour of the controller.
    let property = Property::RateAtMost { percent: Rounded::down(percent) };
    let domain = Domain::Space { space: named.content_id.clone() };
    let status = found.evidence.claim_status(&AssuranceClaim { subject, property, domain });
    (matches!(status.strength, Strength::Bounded { .. }), status.describe())
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
    let of = |name: &str| drawn.controllers.iter().find(|sampled| sampled.controller == name);
    let (Some(own), Some(other)) = (of(controller), of(than)) else {
        return (false, "it has no run in this space".to_owned());
    };
    let ended_by_others = match own.ended_by_others {
        0 => String::new(),
        ended_by_others => format!(", and {ended_by_others} ended early with a collision of other vehicles"),
    };
    let unanswered: String = [("it", own), ("the other controller, for which such runs do not count,", other)]
        .into_iter()
        .filter_map(|(who, of)| {
            Some(format!(", and {who} {}", of.unanswered.as_ref()?.describe(drawn.random_scenarios)))
        })
        .collect();
    let reason = format!(
        "{} against {} of the same {} random scenarios collide{ended_by_others}{unanswered}",
        own.collisions, other.collisions, drawn.random_scenarios
    );
    let is_known = own.ended_by_others < drawn.random_scenarios && other.unanswered_runs() < drawn.random_scenarios;
    (is_known && own.failures() + own.ended_by_others <= other.collisions, reason)
}

fn space_index(plan: &AssessmentPlan, space: Option<&str>) -> Option<usize> {
    plan.rate_spaces.iter().position(|named| space.is_none_or(|space| named.name == space))
}

fn check_no_avoidable_failure(found: &AssessmentReport, controller: &str, space: &str) -> (bool, String) {
    let searches = found.searches.spaces.iter().filter(|of| of.name == space).flat_map(|of| &of.controllers);
    let Some(search) = searches.into_iter().find(|search| search.controller == controller) else {
        return (false, "there is no search for it".to_owned());
    };
    if let Some(words) = search.describe_unanswered() {
        return (false, format!("it {words}"));
    }
    let not_asked = search.count(AvoidabilityClass::NotAsked);
    let (avoidable, undecided) =
        (search.count(AvoidabilityClass::Avoidable), search.count(AvoidabilityClass::Undecided));
    match avoidable + undecided {
        0 if not_asked > 0 => (false, format!("the avoidability of {not_asked} failures was not examined")),
        0 => (true, format!("none in {} simulations", search.evaluations())),
        _ => (false, format!("{avoidable} avoidable and {undecided} undecided failures")),
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
    let describe = |unanswered: &FailedControllerRuns| format!("; {}", unanswered.describe(all.random_scenarios));
    let words = useful.unanswered[0].as_ref().map_or(String::new(), describe);
    (share <= percent, format!("{} of {} drives{words}", count(useful), all.random_scenarios))
}

fn check_string_stable(found: &AssessmentReport, controller: &str) -> (bool, String) {
    let line = found.usefulness.as_ref().and_then(|all| Some(&all.find(controller)?.string_stability));
    line.map_or((false, "no platoon was simulated".to_owned()), |line| (line.is_string_stable(), line.describe()))
}

fn suite_problem(config: &AssessConfig, controller: &String, suite: &str) -> Option<(&'static str, String)> {
    let Some(named) = config.suites.iter().find(|named| named.suite == suite) else {
        return Some(("suite", format!("`{suite}` is not among `suites`")));
    };
    let is_tested = named.controllers.as_ref().is_none_or(|tested| tested.contains(controller));
    (!is_tested).then(|| ("controller", format!("`{controller}` is not tested by suite `{suite}`")))
}

/// Ignores tests that cannot be run, but requires at least one test.
fn check_suite_passed(
    plan: &AssessmentPlan,
    found: &AssessmentReport,
    controller: &str,
    suite: &str,
) -> (bool, String) {
    let place = plan.suites.iter().position(|planned| planned.config_name == suite);
    let of_controller = place.zip(found.suites.as_ref());
    let outcomes: Vec<_> =
        of_controller.iter().flat_map(|(place, suites)| suites.controller_outcomes(*place, controller)).collect();
    let run: Vec<_> = outcomes.iter().filter(|(_, outcome)| outcome.points > 0).collect();
    let missed: Vec<_> =
        run.iter().filter(|(_, outcome)| outcome.passed != Some(true)).map(|(test, _)| test.test.as_str()).collect();
    let (mut unanswered, mut runs) = (None, 0);
    for (_, outcome) in &run {
        FailedControllerRuns::merge(&mut unanswered, outcome.total_unanswered());
        runs += outcome.runs;
    }
    let unanswered = unanswered.map_or(String::new(), |unanswered| format!("; it {}", unanswered.describe(runs)));
    match (run.len(), missed.as_slice()) {
        (0, _) => (false, "no test could be run".to_owned()),
        (all, []) => (true, format!("{all} of {all} tests pass")),
        (_, missed) => (false, format!("these tests do not pass: {}{unanswered}", missed.join(", "))),
    }
}

fn share_problem(percent: f64) -> Option<(&'static str, String)> {
    let is_share = (0.0..=100.0).contains(&percent);
    (!is_share).then(|| ("percent", format!("must be from 0 to 100, found {percent}")))
}

fn space_problem(space: &Option<String>, config: &AssessConfig) -> Option<(&'static str, String)> {
    let known = config.rate_spaces();
    match space {
        _ if known.is_empty() => Some(("require", "needs `distributions`".to_owned())),
        Some(space) if !known.contains(space) => Some(("space", format!("`{space}` is not among `distributions`"))),
        None if known.len() > 1 => {
            Some(("space", "must be named, because there are several `distributions`".to_owned()))
        }
        _ => None,
    }
}

fn simulated_space_problem(space: &str, config: &AssessConfig) -> Option<(&'static str, String)> {
    let is_drawn = config.rate_spaces().iter().any(|known| known == space);
    let is_driven = EVERYDAY_SPACES.contains(&space);
    match (is_drawn && config.draws > 0) || (is_driven && config.everyday_draws > 0) {
        true => None,
        false if is_drawn => Some(("require", "needs `draws` above 0".to_owned())),
        false if is_driven => {
            Some(("require", format!("needs `everyday_draws` above 0, or `{space}` in `distributions`")))
        }
        false => {
            let [traffic, high_risk] = EVERYDAY_SPACES;
            Some(("space", format!("`{space}` is neither among `distributions` nor `{traffic}` or `{high_risk}`")))
        }
    }
}

fn check_proofs_accepted(found: &AssessmentReport) -> (bool, String) {
    let claims_to_prove = |one: &&CheckedCertificate| !matches!(one.status, CertificateStatus::NothingShown { .. });
    let certificates: Vec<_> = found.proofs.certificates.iter().filter(claims_to_prove).collect();
    let all = certificates.len();
    let rejected: Vec<_> = certificates.iter().filter(|one| !one.is_accepted()).collect();
    match rejected.first() {
        None => (all > 0, format!("{all} of {all} certificates are accepted")),
        Some(first) => (false, format!("{} of {all} are rejected; first: {}", rejected.len(), first.name)),
    }
}

fn check_nothing_worse(comparison: Option<&AssessmentComparison>) -> (bool, String) {
    match comparison {
        None => (false, "there is no earlier assessment; name one with --against".to_owned()),
        Some(comparison) if comparison.has_no_overlap() => {
            (false, "the earlier assessment has no result in common with this one".to_owned())
        }
        Some(comparison) => {
            // A new failure, and a result other than a failure that is gone, count as worse.
            let new = comparison.new.iter().filter(|change| change.is_failure);
            let gone = comparison.gone.iter().filter(|change| !change.is_failure);
            let bad: Vec<_> = comparison.worse.iter().chain(new).chain(gone).collect();
            match bad.as_slice() {
                [] => (true, "no result is worse".to_owned()),
                [first, ..] => (
                    false,
                    format!("{} results are worse, new failures, or missing; first: {}", bad.len(), first.description),
                ),
            }
        }
    }
}
