//! Gates on drives in everyday traffic, and on lines of vehicles.

use super::{ConfigProblem, GateInputs, GateRule, GateVerdict, require, share_problem};
use crate::assessment::{AssessConfig, ControllerUsefulness};

pub(super) fn unnecessary_braking_at_most<'a>(
    config: &AssessConfig,
    controller: &'a str,
    &percent: &'a f64,
) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: unnecessary braking in at most {percent} % of drives in `traffic`"),
        share_problem(percent).or_else(|| drives_problem(config)),
        move |inputs| {
            check_drives_at_most(inputs, controller, percent, |useful| {
                useful.unnecessary_braking
            })
        },
    )
}

pub(super) fn left_behind_at_most<'a>(
    config: &AssessConfig,
    controller: &'a str,
    &percent: &'a f64,
) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: falls behind in at most {percent} % of drives in `traffic`"),
        share_problem(percent).or_else(|| drives_problem(config)),
        move |inputs| {
            check_drives_at_most(inputs, controller, percent, |useful| useful.left_behind)
        },
    )
}

pub(super) fn string_stable<'a>(config: &AssessConfig, controller: &'a str) -> GateRule<'a> {
    GateRule::new(
        format!("{controller}: no speed oscillation grows from vehicle to vehicle"),
        drives_problem(config),
        |inputs| check_string_stable(inputs, controller),
    )
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
    GateVerdict::new(
        share <= percent,
        format!("{counted} of {drives} drives{note}"),
    )
}

fn check_string_stable(inputs: &GateInputs<'_>, controller: &str) -> GateVerdict {
    let report = inputs.results.usefulness.as_ref();
    match report.and_then(|report| report.find(controller)) {
        Some(useful) => GateVerdict::new(
            useful.oscillation_gain.damps_all(),
            useful.oscillation_gain.describe(),
        ),
        None => GateVerdict::fails("no gain was measured"),
    }
}
