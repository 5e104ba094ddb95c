//! Gates on drives in everyday traffic, and on lines of vehicles.

use super::{
    GateInputs, GateMetric, GateRule, GateVerdict, IndicatorInterval, is_in_space, require,
    share_problem,
};
use crate::assessment::AssessConfig;
use crate::assessment::claims::{AssuranceClaim, Domain, MAX_GAIN, Property};
use crate::assessment::config::{EVERYDAY_SPACE, TRAFFIC_SPACE};
use crumple_core::field_error::FieldError;
use crumple_sim::engine::FailedControllerRuns;

pub(super) fn unnecessary_braking_at_most<'a>(
    config: &AssessConfig,
    controller: &'a str,
    &percent: &'a f64,
    space: &'a Option<String>,
) -> GateRule<'a> {
    let space = drives_space(space);
    GateRule::new(
        format!("{controller}: unnecessary braking in at most {percent} % of drives in `{space}`"),
        GateMetric::percent(
            "drives with unnecessary braking, or without an answer",
            percent,
        ),
        share_problem(percent).or_else(|| space_problem(config, space)),
        move |inputs| {
            let drives = CountedDrives::find(inputs, controller, space);
            check_drives_at_most(drives, percent, |drives| drives.unnecessary_braking)
        },
    )
    .about(move |_, claim| is_about(claim, Property::NoUnnecessaryBraking, space))
}

pub(super) fn left_behind_at_most<'a>(
    config: &AssessConfig,
    controller: &'a str,
    &percent: &'a f64,
    space: &'a Option<String>,
) -> GateRule<'a> {
    let space = drives_space(space);
    GateRule::new(
        format!("{controller}: falls behind in at most {percent} % of drives in `{space}`"),
        GateMetric::percent("drives that fall behind, or without an answer", percent),
        share_problem(percent).or_else(|| space_problem(config, space)),
        move |inputs| {
            let drives = CountedDrives::find(inputs, controller, space);
            check_drives_at_most(drives, percent, |drives| drives.left_behind)
        },
    )
    .about(move |_, claim| is_about(claim, Property::KeepsUp, space))
}

/// Returns the space of a gate on drives.
fn drives_space(space: &Option<String>) -> &str {
    space.as_deref().unwrap_or(TRAFFIC_SPACE)
}

fn space_problem(config: &AssessConfig, space: &str) -> Option<FieldError> {
    if [TRAFFIC_SPACE, EVERYDAY_SPACE].contains(&space) {
        return drives_problem(config);
    }
    let problem = format!("must be `{TRAFFIC_SPACE}` or `{EVERYDAY_SPACE}`, found `{space}`");
    Some(FieldError::new("space", problem))
}

fn is_about(claim: &AssuranceClaim, property: Property, space: &str) -> bool {
    let is_drawn = matches!(claim.domain, Domain::Draws { .. });
    claim.property == property && is_drawn && is_in_space(claim, space)
}

pub(super) fn string_stable<'a>(config: &AssessConfig, controller: &'a str) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: no speed oscillation grows from vehicle to vehicle"),
        GateMetric::number("largest gain from vehicle to vehicle", MAX_GAIN),
        drives_problem(config),
        |inputs| check_string_stable(inputs, controller),
    )
    .about(|_, claim| claim.property == Property::NoGrowingOscillation)
}

fn drives_problem(config: &AssessConfig) -> Option<FieldError> {
    require(config.everyday_draws > 0, "`everyday_draws` above 0")
}

/// Counts of the drives of a controller in a space.
struct CountedDrives<'a> {
    drives: u64,
    /// Confidence level of intervals.
    confidence: f64,
    unnecessary_braking: u64,
    left_behind: u64,
    unanswered: Option<&'a FailedControllerRuns>,
}

impl<'a> CountedDrives<'a> {
    fn find(inputs: &GateInputs<'a>, controller: &str, space: &str) -> Option<Self> {
        if space != TRAFFIC_SPACE {
            return Self::with_every_follower(inputs, controller, space);
        }
        let report = inputs.results.usefulness.as_ref()?;
        let useful = report.find(controller)?;
        Some(Self {
            drives: report.random_scenarios,
            confidence: report.confidence,
            unnecessary_braking: useful.unnecessary_braking,
            left_behind: useful.left_behind,
            unanswered: useful.unanswered[0].as_ref(),
        })
    }

    fn with_every_follower(inputs: &GateInputs<'a>, controller: &str, space: &str) -> Option<Self> {
        let space = inputs.results.followers.as_ref()?.find_space(space)?;
        let counts = &space.find(controller)?.all;
        Some(Self {
            drives: counts.random_scenarios,
            confidence: space.confidence,
            unnecessary_braking: counts.unnecessary_braking,
            left_behind: counts.left_behind,
            unanswered: counts.ends.unanswered.as_ref(),
        })
    }
}

fn check_drives_at_most(
    counted: Option<CountedDrives<'_>>,
    percent: f64,
    count: impl Fn(&CountedDrives<'_>) -> u64,
) -> GateVerdict {
    let Some(counted) = counted else {
        return GateVerdict::fails("no drive was simulated");
    };
    let drives = counted.drives;
    let violating = count(&counted);
    // The result of a drive without an answer is unknown: count it as the worse.
    let unanswered = counted.unanswered.map_or(0, |failed| failed.runs);
    let share = 100.0 * (violating + unanswered) as f64 / drives as f64;
    let note = counted.unanswered.map_or(String::new(), |failed| {
        format!("; {}", failed.describe(drives))
    });
    let confidence = 0.5 * (1.0 + counted.confidence);
    let interval = IndicatorInterval::of_share(violating + unanswered, drives, confidence);
    GateVerdict::new(
        share <= percent,
        format!("{violating} of {drives} drives{note}"),
    )
    .with_value(share)
    .with_interval(Some(interval))
}

fn check_string_stable(inputs: &GateInputs<'_>, controller: &str) -> GateVerdict {
    let report = inputs.results.usefulness.as_ref();
    match report.and_then(|report| report.find(controller)) {
        Some(useful) => {
            let gain = &useful.oscillation_gain;
            let verdict = GateVerdict::new(gain.damps_all(), gain.describe());
            match gain.largest {
                Some(largest) => verdict.with_value(largest.gain.value()),
                None => verdict,
            }
        }
        None => GateVerdict::fails("no gain was measured"),
    }
}
