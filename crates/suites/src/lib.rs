//! Test suites after regulations and consumer tests: what a document asks for as data, run on scenarios, told as a matrix.
//!
//! A suite is a TOML file ([`SuiteSpec`]): a document and its edition, clauses, and tests with grids of figures, each of which says
//! whether the document states it. [`TestSuite`] is a spec that was found valid. [`run`] makes every point of every grid a scenario,
//! simulates it, and says how far each test can be pushed until it fails.
//!
//! It is after a document, on point masses in one lane. It certifies nothing: [`DISCLAIMER`] goes with every result.

mod check;
mod crash_map;
mod margin;
mod parameter;
mod prevention;
mod result;
mod rows;
mod run;
mod scenario;
mod shard;
mod situation;
mod spec;
mod worst_in_tolerance;

use std::path::Path;

pub use check::{InvalidSuite, SuiteError, SuiteProblem};
pub use crash_map::{CrashCell, CrashMap, CrashMapSpec, MapPanel, MapProblem};
pub use margin::{Margin, MarginEnd, SweepFailure};
pub use parameter::{ImpactLimit, Origin, ParameterKind, ParameterUnit, TestParameter, TestParameters};
pub use prevention::{Prevention, ReferenceRun};
pub use result::{ClauseResult, ControllerResult, DISCLAIMER, FailedPoint, SuiteResult, TestResult, TestVerdict};
pub use run::{SuiteRunError, run};
pub use shard::{MergedSuite, SUITE_SHARD_KIND, SuiteShardError, UnavailableController, run_shard};
pub use situation::{Boundary, CrashMapAxis, CrashMapSituation};
pub use spec::{ClauseSpec, LeadManeuver, MarginSweep, SuiteSpec, TestSpec};
pub use worst_in_tolerance::WorstInTolerance;

/// The version of the suite file format this release reads.
pub(crate) const SUITE_VERSION: u32 = 1;

/// A valid suite.
#[derive(Debug, Clone, PartialEq)]
pub struct TestSuite {
    spec: SuiteSpec,
}

impl TestSuite {
    /// Accepts a spec if it is valid: every point of every grid is a scenario then, and so is every end of a margin.
    ///
    /// # Errors
    /// [`InvalidSuite`] names the first field that is not valid.
    pub fn new(spec: SuiteSpec) -> Result<Self, InvalidSuite> {
        check::check(&spec)?;
        Ok(Self { spec })
    }

    /// The suite in a file.
    ///
    /// # Errors
    /// [`SuiteError`] names file, line and field.
    pub fn load(path: &Path) -> Result<Self, SuiteError> {
        let text = crumple_world::scenario::file::read(path)?;
        Self::from_toml(&text, path)
    }

    /// The suite in a text; `path` only names it in errors.
    ///
    /// # Errors
    /// [`SuiteError`] names file, line and field.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, SuiteError> {
        use crumple_world::scenario::file;
        let spec = file::parse_toml(text, path)?;
        Self::new(spec).map_err(|InvalidSuite { field, problem }| {
            let line = file::line_in_toml(text, &field);
            SuiteError::Invalid { path: path.to_owned(), line, field, problem: problem.into() }
        })
    }

    /// The suite that is shipped under a name.
    #[must_use]
    pub fn shipped(name: &str) -> Option<Result<Self, SuiteError>> {
        let (name, text) = SHIPPED_SUITES.iter().find(|(shipped, _)| *shipped == name)?;
        Some(Self::from_toml(text, Path::new(name)))
    }

    /// The data of the suite.
    #[must_use]
    pub fn spec(&self) -> &SuiteSpec {
        &self.spec
    }
}

/// Name and text of every suite that is shipped.
pub const SHIPPED_SUITES: [(&str, &str); 6] = [
    ("fmvss-127", include_str!("shipped/fmvss-127.toml")),
    ("euro-ncap-2023", include_str!("shipped/euro-ncap-2023.toml")),
    ("euro-ncap-2026", include_str!("shipped/euro-ncap-2026.toml")),
    ("un-r152", include_str!("shipped/un-r152.toml")),
    ("un-r157", include_str!("shipped/un-r157.toml")),
    ("afgbv-cut-in", include_str!("shipped/afgbv-cut-in.toml")),
];

/// Documents that were looked for and have no suite, and why not.
pub const UNSHIPPED_DOCUMENTS: [(&str, &str); 1] = [(
    "ISO 15622:2018",
    "its text could not be read: public copies end with the table of contents, and those who quote its figures contradict each other",
)];

/// The JSON Schema of suite files.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(SuiteSpec).to_value()
}
