//! Failures per hour and per 1000 km, in spaces fitted to recorded episodes.

use super::sampling::{SpaceSample, run_samples};
use crate::assessment::AssessError;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::NamedSpace;
use crate::assessment::table::{ReportCell, ReportTable};
use crumple_core::digits::format_rounded;
use crumple_evidence::exposure::{
    FailureProbability, IntervalEstimate, RatePerExposure, WithDataUncertainty, count_on_resamples,
};
use crumple_world::scenario::space::ScenarioSpace;
use crumple_world::sim::NamedController;

/// Number of resamples of the episodes that a space was fitted to.
const RESAMPLES: u32 = 100;
/// Maximum number of runs per controller and resample; `draws`, if smaller, limits it further.
const MAX_RUNS_PER_RESAMPLE: u32 = 200;

/// Returns a table of a space's controllers and its caption; `None` if the space states no exposure.
pub(super) fn exposure_table(drawn: &SpaceSample) -> Option<(String, ReportTable)> {
    let rates: Vec<(&str, &RatePerExposure)> = drawn
        .controllers
        .iter()
        .filter_map(|sampled| Some((sampled.controller.as_str(), sampled.rate_per_exposure.as_ref()?)))
        .collect();
    let (_, first) = rates.first()?;
    let mut words = format!(
        "Exposure: the recordings have {} episodes in {} waves in {:.3} h and {:.1} km of following{}. Intervals are \
         joint ones at {} %, for the number of episodes and the probability of a failure (Bonferroni).",
        first.episodes,
        first.clusters,
        first.hours,
        first.kilometres,
        match first.undescribed_brakings {
            0 => String::new(),
            left_out => format!(
                ", and {left_out} further episodes that the space does not describe; rates assume the same failure \
                 probability for them"
            ),
        },
        100.0 * first.confidence
    );
    if let Some(data) = first.with_data_uncertainty {
        words += &format!(
            " With data: {} resamples of the episodes, with a space fitted to each and {} runs each.",
            data.resamples,
            data.runs_each.unwrap_or(0)
        );
    }
    if let Some(why) = &first.data_uncertainty_missing {
        words += &format!(" The uncertainty of the data is not stated: {why}.");
    }
    let interval =
        |figure: IntervalEstimate| format!("{} – {}", format_rounded(figure.lower, 3), format_rounded(figure.upper, 3));
    let shown = |figure: IntervalEstimate| {
        ReportCell::number(format!("{} ({})", format_rounded(figure.estimate, 3), interval(figure)))
    };
    let data = |rate: &RatePerExposure, of: fn(&WithDataUncertainty) -> IntervalEstimate| {
        ReportCell::optional(rate.with_data_uncertainty.map(|data| interval(of(&data))))
    };
    let percent = |variance: Option<f64>| variance.map_or("–".to_owned(), |v| format!("{:.0} %", 100.0 * v.sqrt()));
    let parts = |data: WithDataUncertainty| {
        [Some(data.counting_variance), data.data_variance, data.sampling_variance].map(percent).join(", ")
    };
    let table = ReportTable::from_items(
        rates,
        &[
            ("controller", &|(controller, _)| ReportCell::text(controller)),
            ("failures per hour", &|(_, rate)| shown(rate.fitted.per_hour)),
            ("with data", &|(_, rate)| data(rate, |data| data.rates.per_hour)),
            ("failures per 1000 km", &|(_, rate)| shown(rate.fitted.per_1000_km)),
            ("with data", &|(_, rate)| data(rate, |data| data.rates.per_1000_km)),
            ("deviation from count, data, runs", &|(_, rate)| {
                ReportCell::optional(rate.with_data_uncertainty.map(parts))
            }),
        ],
    );
    Some((words, table))
}

pub(super) fn rate_per_exposure(
    named: &NamedSpace,
    controller: &NamedController,
    known: FailureProbability<'_>,
    work: &GatherContext<'_>,
) -> Result<Option<RatePerExposure>, AssessError> {
    let plan = work.plan;
    if named.space.spec().exposure.is_none() {
        return Ok(None);
    }
    let mut failures = |space: &ScenarioSpace, seed: u64, runs: u64| -> Result<u64, AssessError> {
        // Between two batches, so that the user can interrupt.
        work.add_runs(0)?;
        let scenarios = (0..runs).map(|index| space.draw(seed, index)).collect::<Result<Vec<_>, _>>()?;
        let results = run_samples(&scenarios, controller, plan)?;
        Ok(results.iter().filter(|run| run.verdict.is_failure()).count() as u64)
    };
    let runs_each = u32::try_from(plan.config.draws).unwrap_or(MAX_RUNS_PER_RESAMPLE).clamp(1, MAX_RUNS_PER_RESAMPLE);
    let resamples = count_on_resamples(&named.space, plan.config.seed, RESAMPLES, runs_each, &mut failures)?;
    Ok(RatePerExposure::new(&named.space, known, resamples.as_ref()))
}
