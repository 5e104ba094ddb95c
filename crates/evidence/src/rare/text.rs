//! An estimate as text.

use std::fmt::Write;

use super::{Level, MAX_LEVELS, PILOT_FACTORS, RareEstimate, RareReport};
use crumple_core::digits::{
    format_or_hyphen, format_rounded, format_rounded_down, format_rounded_up,
};
use crumple_core::quoting::TerminalText;

impl RareReport {
    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let subject = &self.subject;
        // Reports keep the wording of registrations, which are hashed.
        let failure = self.failure.replacen("vehicles touch", "collision", 1);
        writeln!(
            out,
            "{} in `{}`: {}, estimator {}, seed {}",
            TerminalText(&subject.controller),
            TerminalText(&subject.space),
            TerminalText(&failure),
            subject.estimator.name(),
            subject.seed
        )?;
        if subject.nondeterministic {
            writeln!(
                out,
                "  the controller declares that it is not deterministic: another run may give another estimate"
            )?;
        }
        self.estimate.write_probability(out)?;
        self.estimate.write_initial_scenarios(out)?;
        self.estimate.write_extinct_repetitions(out)?;
        writeln!(
            out,
            "  estimate by multilevel splitting, neither a bound nor a certificate; {} runs",
            self.estimate.evaluations
        )?;
        if let Some(rate) = &self.exposure {
            out.push_str(&rate.to_text());
        }
        self.write_levels(out)
    }

    /// Writes a table with a row for each level.
    fn write_levels(&self, out: &mut String) -> std::fmt::Result {
        let margin = if self.is_collision_failure() {
            "smallest gap"
        } else {
            "robustness"
        };
        writeln!(
            out,
            "\n  {margin:>14} {:>13} {:>9} {:>7} {:>11}",
            "probability", "share", "step", "acceptance"
        )?;
        for level in &self.estimate.levels {
            writeln!(
                out,
                "  {:>14} {:>13} {:>8.1} % {:>6} {:>11}",
                self.format_margin(level),
                format_rounded(level.probability, 4),
                100.0 * level.share,
                format_or_hyphen(level.step, 2),
                format_or_hyphen(level.acceptance, 2)
            )?;
        }
        if self.estimate.levels.len() == 1 && self.estimate.probability.is_some() {
            let runs = self.effort.samples * self.effort.repetition_count;
            writeln!(
                out,
                "  not rare: a single level, direct count of {runs} runs"
            )?;
        }
        Ok(())
    }

    fn format_margin(&self, level: &Level) -> String {
        match (level.step, self.is_collision_failure()) {
            (None, true) => "collision".to_owned(),
            (None, false) => "failure".to_owned(),
            (Some(_), true) => format!("<= {:.3} m", level.margin),
            (Some(_), false) => format!("<= {:.3}", level.margin),
        }
    }
}

impl RareEstimate {
    fn write_probability(&self, out: &mut String) -> std::fmt::Result {
        let repetitions = self.repetitions.len();
        match (
            self.probability,
            self.coefficient_of_variation,
            self.interval_95,
        ) {
            (None, ..) if self.levels.len() == MAX_LEVELS => writeln!(
                out,
                "  no failure after {MAX_LEVELS} levels, nor by any of {} pilots, each twice as large as the one \
                 before: no estimate, and no statement about the failure rate, since the levels may miss failures; \
                 more --samples may find them",
                PILOT_FACTORS.len()
            ),
            (None, ..) => writeln!(
                out,
                "  no failure, and no further level: no estimate, and no proof that no failure exists"
            ),
            (Some(probability), Some(variation), Some(interval)) => {
                writeln!(
                    out,
                    "  probability of a failure {}, coefficient of variation {variation:.2}",
                    format_rounded(probability, 4)
                )?;
                let [low, high] = interval;
                let low = format_rounded_down(low, 3);
                let high = format_rounded_up(high, 3);
                let source = self.interval_source();
                writeln!(out, "  95 % interval {low} to {high}, {source}")
            }
            (Some(_), ..) => writeln!(
                out,
                "  none of {repetitions} repetitions reached a failure: estimate 0; use more --samples"
            ),
        }
    }

    fn interval_source(&self) -> String {
        // With one level, runs are only counted.
        match self.levels.len() {
            1 => "Clopper-Pearson".to_owned(),
            _ => format!("from the spread of {} repetitions", self.repetitions.len()),
        }
    }

    /// Writes the interval that the initial random scenarios alone give, if the estimate has none.
    fn write_initial_scenarios(&self, out: &mut String) -> std::fmt::Result {
        let Some([low, high]) = self
            .independent_interval(0.95)
            .filter(|_| self.interval_95.is_none())
        else {
            return Ok(());
        };
        writeln!(
            out,
            "  {} of the {} initial random scenarios fail: between {} and {} at 95 %",
            self.independent_failures,
            self.independent_runs,
            format_rounded_down(low, 3),
            format_rounded_up(high, 4)
        )
    }

    fn write_extinct_repetitions(&self, out: &mut String) -> std::fmt::Result {
        let all = self.repetitions.len();
        let estimates = self.repetitions.iter();
        let extinct = estimates.filter(|estimate| **estimate == 0.0).count();
        if extinct == 0 || extinct == all {
            return Ok(());
        }
        writeln!(
            out,
            "  {extinct} of {all} repetitions died out and count as 0; more --samples would help"
        )
    }
}
