//! Gates on failure rates.

use super::{ConfigProblem, GateInputs, GateRule, GateVerdict, require, share_problem};
use crate::assessment::claims::{AssuranceClaim, Domain, Property, Strength};
use crate::assessment::{AssessConfig, ControllerSample, Rounded, SpaceSample};

pub(super) fn at_most<'a>(
    config: &AssessConfig,
    controller: &'a str,
    &percent: &'a f64,
    space: &'a Option<String>,
) -> GateRule<'a> {
    let name = named_or_only(space, config);
    GateRule::new(
        format!("{controller}: failure rate in `{name}` at most {percent} %"),
        share_problem(percent).or_else(|| space_problem(space, config)),
        move |found| check_rate_at_most(found, controller, percent, &name),
    )
}

pub(super) fn not_above<'a>(
    config: &AssessConfig,
    controller: &'a str,
    than: &'a str,
    space: &'a Option<String>,
) -> GateRule<'a> {
    let name = named_or_only(space, config);
    let is_itself = || {
        let problem = "is the controller itself: name another one";
        (controller == than).then(|| ("than", problem.to_owned()))
    };
    GateRule::new(
        format!(
            "{controller}: no more failures than {than} in the same random scenarios of `{name}`"
        ),
        is_itself()
            .or_else(|| require(config.draws > 0, "`draws` above 0"))
            .or_else(|| space_problem(space, config)),
        move |found| check_rate_not_above(found, controller, than, &name),
    )
}

/// Returns the space that a gate names, or else the first one of `distributions`.
fn named_or_only(space: &Option<String>, config: &AssessConfig) -> String {
    let first = || config.rate_spaces().into_iter().next();
    space.clone().or_else(first).unwrap_or_default()
}

fn space_problem(space: &Option<String>, config: &AssessConfig) -> Option<ConfigProblem> {
    let known = config.rate_spaces();
    match space {
        _ if known.is_empty() => Some(("require", "needs `distributions`".to_owned())),
        Some(space) if !known.contains(space) => {
            Some(("space", format!("`{space}` is not among `distributions`")))
        }
        None if known.len() > 1 => Some((
            "space",
            "must be named, because there are several `distributions`".to_owned(),
        )),
        _ => None,
    }
}

/// Uses the strongest known bound, with or without a certificate.
fn check_rate_at_most(
    found: &GateInputs<'_>,
    controller: &str,
    percent: f64,
    space: &str,
) -> GateVerdict {
    let Some(claim) = rate_claim(found, controller, percent, space) else {
        return GateVerdict::fails("no random scenario was simulated");
    };
    let status = found.evidence.claim_status(&claim);
    GateVerdict::new(
        matches!(status.strength, Strength::Bounded { .. }),
        status.describe(),
    )
}

fn rate_claim(
    found: &GateInputs<'_>,
    controller: &str,
    percent: f64,
    space: &str,
) -> Option<AssuranceClaim> {
    let plan = found.plan;
    let named = plan.rate_spaces.get(found.space_index(space)?)?;
    let mut controllers = plan.controllers.iter();
    let index = controllers.position(|one| one.name == controller)?;
    Some(AssuranceClaim {
        subject: plan.claim_subject(index, plan.config.estimator)?,
        // Round the required rate down, never in favour of the controller.
        property: Property::RateAtMost {
            percent: Rounded::down(percent),
        },
        domain: Domain::Space {
            space: named.content_id.clone(),
        },
    })
}

impl GateInputs<'_> {
    fn space_index(&self, space: &str) -> Option<usize> {
        let mut spaces = self.plan.rate_spaces.iter();
        spaces.position(|named| named.name == space)
    }

    /// Returns the random scenarios of a space, if any were simulated.
    fn sample(&self, space: &str) -> Option<&SpaceSample> {
        let drawn = self
            .results
            .rate_spaces
            .spaces
            .get(self.space_index(space)?)?;
        (drawn.random_scenarios > 0).then_some(drawn)
    }
}

fn check_rate_not_above(
    found: &GateInputs<'_>,
    controller: &str,
    than: &str,
    space: &str,
) -> GateVerdict {
    let Some(drawn) = found.sample(space) else {
        return GateVerdict::fails("no random scenario was simulated");
    };
    match (drawn.find(controller), drawn.find(than)) {
        (Some(own), Some(other)) => compare_samples(own, other, drawn.random_scenarios),
        _ => GateVerdict::fails("it has no run in this space"),
    }
}

/// Counts a run that ended early against the controller.
fn compare_samples(
    own: &ControllerSample,
    other: &ControllerSample,
    scenarios: u64,
) -> GateVerdict {
    let own = &own.ends;
    let other = &other.ends;
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
    if let Some(unanswered) = &own.unanswered {
        reason += &format!(", and it {}", unanswered.describe(scenarios));
    }
    if let Some(unanswered) = &other.unanswered {
        reason += &format!(
            ", and the other controller, for which such runs do not count, {}",
            unanswered.describe(scenarios)
        );
    }
    let is_known = own.ended_by_others < scenarios && other.unanswered_runs() < scenarios;
    let is_not_above = own.failures() + own.ended_by_others <= other.collisions;
    GateVerdict::new(is_known && is_not_above, reason)
}
