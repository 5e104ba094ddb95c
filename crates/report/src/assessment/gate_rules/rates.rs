//! Gates on failure rates.

use super::{
    EventCount, GateInputs, GateMetric, GateRule, GateVerdict, IndicatorInterval, is_in_space,
    require, share_problem,
};
use crate::assessment::claims::{AssuranceClaim, Domain, Property, RateBounds, Strength};
use crate::assessment::{AssessConfig, ControllerSample, Rounded, RunEnds, SpaceSample};
use crumple_core::field_error::FieldError;

pub(super) fn at_most<'a>(
    config: &AssessConfig,
    controller: &'a str,
    &percent: &'a f64,
    space: &'a Option<String>,
) -> GateRule<'a> {
    let name = named_or_only(space, config);
    let own_name = name.clone();
    GateRule::new(
        format!("{controller}: failure rate in `{name}` at most {percent} %"),
        GateMetric::percent("upper bound of the failure rate", percent),
        share_problem(percent).or_else(|| space_problem(space, config)),
        move |inputs| check_rate_at_most(inputs, controller, percent, &name),
    )
    .about(move |_, claim| {
        let percent = claimed_percent(percent);
        claim.property == Property::RateAtMost { percent } && is_in_space(claim, &own_name)
    })
}

pub(super) fn not_above<'a>(
    config: &AssessConfig,
    controller: &'a str,
    than: &'a str,
    space: &'a Option<String>,
) -> GateRule<'a> {
    let name = named_or_only(space, config);
    GateRule::new(
        format!(
            "{controller}: no more failures than {than} in the same random scenarios of `{name}`"
        ),
        GateMetric::percent(
            "failure rate, less that of the other controller in the same scenarios",
            0.0,
        ),
        itself_problem(controller, than)
            .or_else(|| require(config.draws > 0, "`draws` above 0"))
            .or_else(|| space_problem(space, config)),
        move |inputs| check_rate_not_above(inputs, controller, than, &name),
    )
    .about(move |_, claim| {
        matches!(&claim.property, Property::FailsLessOften { than: other } if other.name == *than)
    })
}

fn itself_problem(controller: &str, than: &str) -> Option<FieldError> {
    let problem = "is the controller itself: name another one";
    (controller == than).then(|| FieldError::new("than", problem))
}

/// Returns the space that a gate names, or else the first one of `distributions`.
pub(super) fn named_or_only(space: &Option<String>, config: &AssessConfig) -> String {
    let space = space.clone();
    space
        .or_else(|| config.rate_spaces().into_iter().next())
        .unwrap_or_default()
}

fn space_problem(space: &Option<String>, config: &AssessConfig) -> Option<FieldError> {
    let spaces = config.rate_spaces();
    match space {
        _ if spaces.is_empty() => Some(FieldError::new("require", "needs `distributions`")),
        Some(space) if !spaces.contains(space) => Some(FieldError::new(
            "space",
            format!("`{space}` is not among `distributions`"),
        )),
        None if spaces.len() > 1 => Some(FieldError::new(
            "space",
            "must be named, because there are several `distributions`",
        )),
        _ => None,
    }
}

/// Uses the strongest known bound, with or without a certificate.
fn check_rate_at_most(
    inputs: &GateInputs<'_>,
    controller: &str,
    percent: f64,
    space: &str,
) -> GateVerdict {
    let Some(claim) = rate_claim(inputs, controller, percent, space) else {
        return GateVerdict::fails("no random scenario was simulated");
    };
    let status = inputs.evidence.claim_status(&claim);
    let verdict = GateVerdict::new(
        matches!(status.strength, Strength::Bounded { .. }),
        status.describe(),
    );
    match status.strength.rate_bounds() {
        Some(bounds) => verdict
            .with_value(bounds.upper_percent())
            .with_interval(Some(interval(bounds))),
        None => verdict,
    }
}

fn interval(bounds: RateBounds) -> IndicatorInterval {
    IndicatorInterval {
        lower: Rounded::new(bounds.lower_percent()),
        upper: Rounded::new(bounds.upper_percent()),
        confidence_percent: Rounded::new(bounds.confidence_percent()),
    }
}

fn rate_claim(
    inputs: &GateInputs<'_>,
    controller: &str,
    percent: f64,
    space: &str,
) -> Option<AssuranceClaim> {
    let plan = inputs.plan;
    let named = plan.rate_spaces.get(inputs.space_index(space)?)?;
    let mut controllers = plan.controllers.iter();
    let index = controllers.position(|other| other.name == controller)?;
    Some(AssuranceClaim {
        subject: plan.claim_subject(index, plan.config.estimator)?,
        property: Property::RateAtMost {
            percent: claimed_percent(percent),
        },
        domain: Domain::Space {
            space: named.content_id.clone(),
        },
    })
}

/// Returns the limit of a claim for that of a gate, rounded down: never in favour of the controller.
pub(super) fn claimed_percent(percent: f64) -> Rounded<2> {
    Rounded::down(percent)
}

impl GateInputs<'_> {
    fn space_index(&self, space: &str) -> Option<usize> {
        let mut spaces = self.plan.rate_spaces.iter();
        spaces.position(|named| named.name == space)
    }

    /// Returns the random scenarios of a space, if any were simulated.
    pub(super) fn sample(&self, space: &str) -> Option<&SpaceSample> {
        let sample = self
            .results
            .rate_spaces
            .spaces
            .get(self.space_index(space)?)?;
        (sample.random_scenarios > 0).then_some(sample)
    }
}

fn check_rate_not_above(
    inputs: &GateInputs<'_>,
    controller: &str,
    than: &str,
    space: &str,
) -> GateVerdict {
    let Some(sample) = inputs.sample(space) else {
        return GateVerdict::fails("no random scenario was simulated");
    };
    match (sample.find(controller), sample.find(than)) {
        (Some(own), Some(other)) => {
            // A certificate counts runs without an answer as failures, those of the other controller too.
            let is_answered = other.ends.unanswered.is_none();
            let counted = is_answered.then(|| compare_counts(inputs, controller, than, space));
            counted
                .flatten()
                .unwrap_or_else(|| compare_samples(own, other, sample))
        }
        _ => GateVerdict::fails("it has no run in this space"),
    }
}

/// Compares by the counted runs of a certificate, which are more than the random scenarios of the report; `None`
/// without such a count.
fn compare_counts(
    inputs: &GateInputs<'_>,
    controller: &str,
    than: &str,
    space: &str,
) -> Option<GateVerdict> {
    let named = inputs.plan.rate_spaces.get(inputs.space_index(space)?)?;
    let counted = inputs
        .results
        .proofs
        .counted_pairs(controller, than, &named.content_id)?;
    let [own, other] = counted.only_one_failed;
    let reason = format!(
        "in {own} of the same {} counted runs, {controller} fails and {than} does not; in {other}, {than} fails and \
         {controller} does not{}",
        counted.runs, counted.unanswered
    );
    let [own_count, other_count] = [own, other].map(|events| EventCount { events, unknown: 0 });
    let interval =
        IndicatorInterval::of_difference(own_count, other_count, counted.runs, counted.confidence);
    let space = named.content_id.clone();
    Some(
        GateVerdict::new(own <= other, reason)
            .with_value(percent_difference([own, other], counted.runs))
            .with_interval(Some(interval))
            .with_domain(Domain::Space { space }),
    )
}

/// Counts a run that ended early against the controller.
fn compare_samples(
    own: &ControllerSample,
    other: &ControllerSample,
    sample: &SpaceSample,
) -> GateVerdict {
    let scenarios = sample.random_scenarios;
    let own = &own.ends;
    let other = &other.ends;
    let is_known = own.ended_by_others < scenarios && other.unanswered_runs() < scenarios;
    let against = own.failures() + own.ended_by_others;
    let is_not_above = against <= other.collisions;
    let own_count = EventCount {
        events: own.failures(),
        unknown: own.ended_by_others,
    };
    let other_count = EventCount {
        events: other.collisions,
        unknown: other.unanswered_runs() + other.ended_by_others,
    };
    let confidence = 0.5 * (1.0 + sample.confidence);
    let interval = IndicatorInterval::of_difference(own_count, other_count, scenarios, confidence);
    let reason = describe_samples(own, other, scenarios);
    GateVerdict::new(is_known && is_not_above, reason)
        .with_value(percent_difference([against, other.collisions], scenarios))
        .with_interval(Some(interval))
        .with_domain(sample.draws_domain())
}

fn describe_samples(own: &RunEnds, other: &RunEnds, scenarios: u64) -> String {
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
    reason
}

/// Returns the difference of two counts, as a share of the runs in percent.
fn percent_difference([own, other]: [u64; 2], runs: u64) -> f64 {
    100.0 * (own as f64 - other as f64) / runs as f64
}
