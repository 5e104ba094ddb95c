//! Test suites that are modelled on regulations and consumer tests.
//!
//! A suite is a TOML file ([`SuiteSpec`]): a document and its edition, clauses, and tests with grids of parameters.
//! Each parameter states its origin. [`TestSuite`] is a spec that passed validation. [`run`] simulates every point of
//! every grid and finds the margin of each test: the largest change of a parameter that still passes.
//!
//! The model has point masses in one lane. It certifies nothing: [`DISCLAIMER`] goes with every result.

mod check;
mod list;
mod margin;
mod parameter;
mod prevention;
mod result;
mod run;
mod scenario;
mod spec;
mod worst_in_tolerance;

use std::path::Path;

pub use check::{InvalidSuite, SuiteError, SuiteProblem};
pub use list::{ShippedSuite, SuiteList, UnshippedDocument};
pub use margin::{Margin, MarginEnd, SweepFailure};
pub use parameter::{
    ImpactLimit, Origin, ParameterKind, ParameterUnit, TestParameter, TestParameters,
};
pub use prevention::{Prevention, ReferenceRun};
pub use result::{
    ClauseResult, ControllerResult, DISCLAIMER, FailedPoint, SuiteResult, TestResult, TestVerdict,
    WarningOrigin,
};
pub use run::{SuiteRunError, run};
pub use spec::{ClauseSpec, LeadManeuver, MarginSweep, SuiteSpec, TestSpec};
pub use worst_in_tolerance::WorstInTolerance;

pub(crate) const SUITE_VERSION: u32 = 1;

/// A valid suite.
#[derive(Debug, Clone, PartialEq)]
pub struct TestSuite {
    spec: SuiteSpec,
}

impl TestSuite {
    /// Checks a spec. Every point of every grid of a valid suite, and every end of a margin, makes a scenario.
    ///
    /// # Errors
    /// [`InvalidSuite`] names the first field that is not valid.
    pub fn new(spec: SuiteSpec) -> Result<Self, InvalidSuite> {
        check::check(&spec)?;
        Ok(Self { spec })
    }

    /// Reads a suite from a file.
    ///
    /// # Errors
    /// [`SuiteError`] names file, line and field.
    pub fn load(path: &Path) -> Result<Self, SuiteError> {
        let text = crumple_core::text_file::read(path)?;
        Self::from_toml(&text, path)
    }

    /// Parses a suite; `path` only names the text in errors.
    ///
    /// # Errors
    /// [`SuiteError`] names file, line and field.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, SuiteError> {
        use crumple_core::{old_names, text_file};
        let spec = text_file::parse_toml(text, path)?;
        old_names::SUITE.warn(text, path);
        Self::new(spec).map_err(|invalid| SuiteError::Invalid {
            path: path.to_owned(),
            line: text_file::line_in_toml(text, &invalid.field),
            invalid: invalid.into(),
        })
    }

    /// Returns the shipped suite of this name; `None` for an unknown name.
    #[must_use]
    pub fn shipped(name: &str) -> Option<Result<Self, SuiteError>> {
        let (name, text) = SHIPPED_SUITES
            .iter()
            .find(|(shipped, _)| *shipped == name)?;
        Some(Self::from_toml(text, Path::new(name)))
    }

    /// Returns the data of the suite.
    #[must_use]
    pub fn spec(&self) -> &SuiteSpec {
        &self.spec
    }
}

/// Names and texts of all shipped suites.
pub const SHIPPED_SUITES: [(&str, &str); 6] = [
    ("fmvss-127", include_str!("shipped/fmvss-127.toml")),
    (
        "euro-ncap-2023",
        include_str!("shipped/euro-ncap-2023.toml"),
    ),
    (
        "euro-ncap-2026",
        include_str!("shipped/euro-ncap-2026.toml"),
    ),
    ("un-r152", include_str!("shipped/un-r152.toml")),
    ("un-r157", include_str!("shipped/un-r157.toml")),
    ("afgbv-cut-in", include_str!("shipped/afgbv-cut-in.toml")),
];

/// Documents without a shipped suite, each with the reason.
pub const UNSHIPPED_DOCUMENTS: [(&str, &str); 1] = [(
    "ISO 15622:2018",
    "its text could not be read: public copies end with the table of contents, and those who quote its figures \
     contradict each other",
)];

/// Returns the JSON Schema of suite files.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(SuiteSpec).to_value()
}
