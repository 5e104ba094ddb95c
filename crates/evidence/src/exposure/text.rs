//! Rates per hour and per 1000 km as text.

use std::fmt::Write;

use super::{FailureRates, RatePerExposure, WithDataUncertainty};
use crumple_core::quoting::TerminalText;

impl RatePerExposure {
    /// Returns the rates for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let Self {
            episodes,
            clusters,
            hours,
            kilometres,
            ..
        } = self;
        writeln!(
            out,
            "on the road: {episodes} episodes in {clusters} clusters were observed in {hours:.3} h and {kilometres:.1} \
             km of following:"
        )?;
        if self.undescribed_brakings > 0 {
            let all = episodes + self.undescribed_brakings;
            writeln!(
                out,
                "  {episodes} of {all} brakings could be used; rates per hour and per 1000 km count all {all} and \
                 assume that the others fail as often"
            )?;
        }
        let percent = 100.0 * self.confidence;
        writeln!(
            out,
            "  at {percent} %, assuming that the fitted space is exact: intervals of the count and of the \
             probability, each at {} %",
            100.0 - 0.5 * (100.0 - percent)
        )?;
        self.fitted.write(out)?;
        match (&self.with_data_uncertainty, &self.data_uncertainty_missing) {
            (Some(with_data), _) => with_data.write(percent, out),
            (None, missing) => {
                let reason = missing.as_deref().unwrap_or("no resampling was done");
                let reason = TerminalText(reason);
                writeln!(out, "  without the uncertainty of the data: {reason}")
            }
        }
    }
}

impl WithDataUncertainty {
    fn write(&self, percent: f64, out: &mut String) -> std::fmt::Result {
        let resamples = self.resamples;
        let runs = match self.runs_each {
            Some(runs) => format!("{runs} new runs in each"),
            None => "a smaller estimate in each".to_owned(),
        };
        writeln!(
            out,
            "  at {percent} %, with the uncertainty of the data: {resamples} resamples of the episodes, with the space \
             fitted to each; {runs}"
        )?;
        self.rates.write(out)?;
        if self.failed_fits > 0 {
            writeln!(
                out,
                "    for {} resamples no space could be fitted; crumple replaced them with other resamples",
                self.failed_fits
            )?;
        }
        writeln!(
            out,
            "    relative standard deviation of failures per hour: {} from the number of episodes, {} from their \
             parameters, {} from the runs",
            format_deviation(Some(self.counting_variance)),
            format_deviation(self.data_variance),
            format_deviation(self.sampling_variance)
        )
    }
}

impl FailureRates {
    fn write(&self, out: &mut String) -> std::fmt::Result {
        writeln!(out, "    failures per episode  {}", self.per_episode)?;
        writeln!(out, "    failures per hour     {}", self.per_hour)?;
        writeln!(out, "    failures per 1000 km  {}", self.per_1000_km)
    }
}

/// Formats the relative standard deviation of a relative variance; without a failure it is unknown.
fn format_deviation(variance: Option<f64>) -> String {
    variance.map_or("unknown (no failure)".to_owned(), |variance| {
        format!("{:.1} %", 100.0 * variance.sqrt())
    })
}
