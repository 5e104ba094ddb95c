//! Failures of a controller on recorded drives, the severest first.

use serde::Serialize;

use super::drive_report::{DriveReport, EventRate};
use super::drives::{DriveEnd, DriveError, DriveRun, DriveRuns, DriveSet};
use crumple_core::digits::format_rounded;
use crumple_core::observer::{Observer, RunProgress};
use crumple_core::quoting::TerminalText;
use crumple_measure::{Specification, SpecificationError};
use crumple_sim::engine::RunOptions;

/// Maximum number of failures that the text lists.
const MAX_LISTED: usize = 20;

/// Reason why drives cannot be searched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DriveSearchError {
    /// A controller that cannot drive, or an observer that stopped.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// A formula that does not fit a drive.
    #[error("{drive}: {source}")]
    Specification {
        /// Name of the drive.
        drive: String,
        /// Problem of the formula.
        source: SpecificationError,
    },
}

/// A drive in which a controller fails.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriveFailure {
    /// Index in the set of drives.
    #[serde(skip)]
    pub index: usize,
    /// Name of the drive.
    pub name: String,
    /// Robustness; for collisions the negative impact speed, in m/s.
    pub robustness: f64,
    /// End of the drive, as text.
    pub description: String,
}

/// All failures of a controller on a set of drives, each of which it drove once.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriveSearch {
    /// Specification that a failure violates.
    pub specification: String,
    /// Drives that violate it, with their rate.
    pub violations: EventRate,
    /// These drives, the severest first.
    pub failures: Vec<DriveFailure>,
    /// Counts of all drives.
    pub counts: DriveReport,
}

impl DriveSearch {
    /// Lets a controller drive each drive once. Without collisions that blame it, a drive satisfies
    /// [`Specification::NoCollision`]. `name` is the name of the controller, and `text` that of the specification.
    ///
    /// # Errors
    /// [`DriveSearchError`] if a drive cannot be simulated, or a formula does not fit it.
    pub fn run(
        drives: &DriveSet,
        (name, options): (&str, RunOptions),
        (text, specification): (&str, &Specification),
        observer: &dyn Observer<RunProgress>,
    ) -> Result<Self, DriveSearchError> {
        let options = options.with_after_collision(specification.after_collision());
        let evaluated = drives.run_with(&options, observer, &|drive, run, simulated| {
            let verdict = specification.evaluate(run, simulated);
            (DriveRun::new(drive, simulated), verdict)
        })?;
        let mut runs = Vec::with_capacity(evaluated.len());
        let mut failures = Vec::new();
        for (index, (run, verdict)) in evaluated.into_iter().enumerate() {
            let verdict = verdict.map_err(|source| DriveSearchError::Specification {
                drive: run.name.clone(),
                source,
            })?;
            let blames = *specification != Specification::NoCollision || run.end.is_failure();
            if verdict.robustness < 0.0 && blames {
                failures.push(DriveFailure {
                    index,
                    name: run.name.clone(),
                    robustness: verdict.robustness,
                    description: run.describe_end(),
                });
            }
            runs.push(run);
        }
        failures.sort_by(|a, b| a.robustness.total_cmp(&b.robustness));
        let runs = DriveRuns {
            driven: runs,
            alone: None,
        };
        let counts = DriveReport::new(name, &runs, drives);
        let driven = [counts.comfort.hours, counts.comfort.kilometres];
        Ok(Self {
            specification: text.to_owned(),
            violations: EventRate::new(failures.len() as u64, driven),
            failures,
            counts,
        })
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = self.counts.to_text();
        text += &self.violations.row("failed drives");
        for failure in self.failures.iter().take(MAX_LISTED) {
            let line = format!("{}: {}", failure.name, failure.description);
            text += &format!(
                "    {:>9}  {}\n",
                format_rounded(failure.robustness, 3),
                TerminalText(&line)
            );
        }
        if self.failures.len() > MAX_LISTED {
            let more = self.failures.len() - MAX_LISTED;
            text += &format!("    {more} more with --format json\n");
        }
        text
    }
}

impl DriveRun {
    /// Describes the end of the drive.
    pub(super) fn describe_end(&self) -> String {
        match &self.end {
            DriveEnd::Complete => "driven to its end".to_owned(),
            DriveEnd::Collision(_, collision) => collision.to_string(),
            DriveEnd::NoAnswer(failed) => failed.reason(),
        }
    }
}
