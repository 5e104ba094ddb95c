//! Text output of failures per hour and per 1000 km.

use std::fmt::Write;

use crumple_core::digits::format_rounded;
use crumple_core::quoting::TerminalText;
use crumple_evidence::exposure::{
    FailureRates, IntervalEstimate, MIN_RESAMPLES, RatePerExposure, WithDataUncertainty,
};

/// Parses the option `--resamples`: 0, or enough for an interval.
pub(super) fn parse_resamples(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(found @ (0 | MIN_RESAMPLES..=2000)) => Ok(found),
        _ => Err(format!(
            "must be 0 or from {MIN_RESAMPLES} to 2000, found {text}"
        )),
    }
}

pub(super) fn format_rate(rate: &RatePerExposure) -> String {
    let mut text = String::new();
    let _ = write_rate(rate, &mut text);
    text
}

fn write_rate(rate: &RatePerExposure, out: &mut String) -> std::fmt::Result {
    let RatePerExposure {
        episodes,
        undescribed_brakings,
        clusters,
        hours,
        kilometres,
        confidence,
        fitted,
        with_data_uncertainty: with_data,
        data_uncertainty_missing: without_data,
    } = rate;
    let percent = 100.0 * confidence;
    writeln!(
        out,
        "on the road: {episodes} episodes in {clusters} waves were observed in {hours:.3} h and {kilometres:.1} km of \
         following:"
    )?;
    if *undescribed_brakings > 0 {
        let all = episodes + undescribed_brakings;
        writeln!(
            out,
            "  {episodes} of {all} brakings could be used; rates per hour and per 1000 km count all {all} and assume \
             that the others fail as often"
        )?;
    }
    let shown = |IntervalEstimate {
                     estimate,
                     lower,
                     upper,
                 }: IntervalEstimate| {
        format!(
            "{} ({} to {})",
            format_rounded(estimate, 4),
            format_rounded(lower, 3),
            format_rounded(upper, 3)
        )
    };
    let figures = |figures: &FailureRates, out: &mut String| {
        let FailureRates {
            per_episode,
            per_hour,
            per_1000_km,
        } = *figures;
        writeln!(out, "    failures per episode  {}", shown(per_episode))?;
        writeln!(out, "    failures per hour     {}", shown(per_hour))?;
        writeln!(out, "    failures per 1000 km  {}", shown(per_1000_km))
    };
    writeln!(
        out,
        "  at {percent} %, assuming that the fitted space is exact: intervals of the count and of the probability, \
         each at {} %",
        100.0 - 0.5 * (100.0 - percent)
    )?;
    figures(fitted, out)?;
    let Some(with_data) = with_data else {
        let why = without_data.as_deref().unwrap_or("no resampling was done");
        return writeln!(
            out,
            "  without the uncertainty of the data: {}",
            TerminalText(why)
        );
    };
    let WithDataUncertainty {
        resamples,
        failed_fits: unfit,
        runs_each,
        ..
    } = with_data;
    let how = match runs_each {
        Some(runs) => format!("{runs} new runs in each"),
        None => "a smaller estimate in each".to_owned(),
    };
    writeln!(
        out,
        "  at {percent} %, with the uncertainty of the data: {resamples} resamples of the episodes, with the space \
         fitted to each; {how}"
    )?;
    figures(&with_data.rates, out)?;
    if *unfit > 0 {
        writeln!(
            out,
            "    for {unfit} resamples no space could be fitted; crumple replaced them with other resamples"
        )?;
    }
    let part = |variance: Option<f64>| {
        variance.map_or("unknown (no failure)".to_owned(), |variance| {
            format!("{:.1} %", 100.0 * variance.sqrt())
        })
    };
    writeln!(
        out,
        "    relative standard deviation of failures per hour: {} from the number of episodes, {} from their \
         parameters, {} from the runs",
        part(Some(with_data.counting_variance)),
        part(with_data.data_variance),
        part(with_data.sampling_variance)
    )
}
