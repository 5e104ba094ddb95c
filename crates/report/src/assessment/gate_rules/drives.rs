//! Gates on drives in everyday traffic, and on lines of vehicles.

use super::{
    ConfigProblem, GateInputs, GateMetric, GateRule, GateVerdict, IndicatorInterval, require,
    share_problem,
};
use crate::assessment::claims::{Domain, MAX_GAIN, Property};
use crate::assessment::{AssessConfig, ControllerUsefulness};
use crumple_evidence::RateInterval;

pub(super) fn unnecessary_braking_at_most<'a>(
    config: &AssessConfig,
    controller: &'a str,
    &percent: &'a f64,
) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: unnecessary braking in at most {percent} % of drives in `traffic`"),
        GateMetric::percent(
            "drives with unnecessary braking, or without an answer",
            percent,
        ),
        share_problem(percent).or_else(|| drives_problem(config)),
        move |inputs| {
            check_drives_at_most(inputs, controller, percent, |useful| {
                useful.unnecessary_braking
            })
        },
    )
    .about(|_, claim| {
        claim.property == Property::NoUnnecessaryBraking
            && matches!(claim.domain, Domain::Draws { .. })
    })
}

pub(super) fn left_behind_at_most<'a>(
    config: &AssessConfig,
    controller: &'a str,
    &percent: &'a f64,
) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: falls behind in at most {percent} % of drives in `traffic`"),
        GateMetric::percent("drives that fall behind, or without an answer", percent),
        share_problem(percent).or_else(|| drives_problem(config)),
        move |inputs| {
            check_drives_at_most(inputs, controller, percent, |useful| useful.left_behind)
        },
    )
    .about(|_, claim| claim.property == Property::KeepsUp)
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

fn drives_problem(config: &AssessConfig) -> Option<ConfigProblem> {
    require(config.everyday_draws > 0, "`everyday_draws` above 0")
}

fn check_drives_at_most(
    inputs: &GateInputs<'_>,
    controller: &str,
    percent: f64,
    count: impl Fn(&ControllerUsefulness) -> u64,
) -> GateVerdict {
    let report = inputs.results.usefulness.as_ref();
    let Some((report, useful)) = report.and_then(|report| Some((report, report.find(controller)?)))
    else {
        return GateVerdict::fails("no drive was simulated");
    };
    let drives = report.random_scenarios;
    let counted = count(useful);
    // The result of a drive without an answer is unknown: count it as the worse.
    let [unanswered, _] = useful.unanswered_runs();
    let share = 100.0 * (counted + unanswered) as f64 / drives as f64;
    let note = useful.unanswered[0]
        .as_ref()
        .map_or(String::new(), |failed| {
            format!("; {}", failed.describe(drives))
        });
    let interval = RateInterval::clopper_pearson(counted + unanswered, drives, report.confidence);
    let confidence = 0.5 * (1.0 + report.confidence);
    let interval = IndicatorInterval::from_shares([interval.lower, interval.upper], confidence);
    GateVerdict::new(
        share <= percent,
        format!("{counted} of {drives} drives{note}"),
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
