//! Results of tests: counts, or the reason why a test fails.

use std::fmt::{self, Write};
use std::io;
use std::path::PathBuf;

use crumple_sim::scenario::Scenario;
use crumple_sim::scenario::file::ScenarioFileError;

use super::ScenariosError;

/// Counts of a test without a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CheckSummary {
    /// Evaluated scenarios, times properties.
    pub evaluated: usize,
    /// Those that did not test the property.
    pub not_applicable: usize,
}

/// Reason why a test fails.
#[derive(thiserror::Error)]
#[non_exhaustive]
pub enum CheckError {
    /// A property is violated.
    #[error(transparent)]
    Violated(#[from] Box<PropertyFailure>),
    /// There are no such scenarios.
    #[error(transparent)]
    Scenarios(#[from] ScenariosError),
    /// A scenario of the corpus cannot be read.
    #[error(transparent)]
    Corpus(#[from] ScenarioFileError),
    /// A failure cannot be written.
    #[error("{}: {source}", path.display())]
    Write {
        /// The folder.
        path: PathBuf,
        /// The error.
        source: io::Error,
    },
    /// An environment variable is no whole number in its range.
    #[error("{variable}: must be a whole number, found `{value}`")]
    Variable {
        /// Name of the variable.
        variable: &'static str,
        /// Value of the variable.
        value: String,
    },
    /// No scenario tests a property.
    #[error("no scenario tests the property `{property}`: {reason}")]
    NotTested {
        /// Name of the property.
        property: String,
        /// Reason in the last scenario.
        reason: String,
    },
}

/// Prints the message, so that a test that returns the error shows it.
impl fmt::Debug for CheckError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, out)
    }
}

/// A violated property, with the simplest scenario found.
#[derive(Debug, thiserror::Error)]
#[error("{}", self.to_text())]
#[non_exhaustive]
pub struct PropertyFailure {
    /// Name of the property.
    pub property: String,
    /// Description of the violation.
    pub finding: String,
    /// The scenario, after shrinking.
    pub scenario: Scenario,
    /// The scenario's file, which the next run evaluates first; empty if the failure does not recur.
    pub file: PathBuf,
    /// Numbers that differ from the nominal scenario; empty for a scenario of the corpus.
    pub changes: Vec<String>,
    /// Share of the cases that violate the property, in words.
    pub count: String,
    /// Commands that repeat the failure.
    pub replay: Vec<String>,
    /// Gaps and speeds as text. The SVG file beside the scenario has them, too.
    pub drawing: String,
}

impl PropertyFailure {
    fn to_text(&self) -> String {
        let Self {
            property,
            finding,
            count,
            file,
            changes,
            replay,
            drawing,
            ..
        } = self;
        let mut text = format!("property violated: {property}\n  {finding}\n  {count}\n");
        if file.as_os_str().is_empty() {
            return text;
        }
        text += &format!("scenario: {}\n", file.display());
        if !changes.is_empty() {
            // Writing to a string does not fail.
            let _ = writeln!(text, "differs from nominal: {}", changes.join(", "));
        }
        for command in replay {
            let _ = writeln!(text, "replay: {command}");
        }
        text + "drawing: an SVG file beside the scenario\n" + drawing
    }
}
