//! FMUs: each is driven by the program `crumple-fmu`, a process like any other, wired to what the FMU has.

#[cfg(feature = "process")]
mod setup;
#[cfg(feature = "process")]
mod units;

use std::collections::BTreeMap;

use crate::control::{InputMapping, InvalidMapping, OutputMapping};
#[cfg(feature = "process")]
pub use setup::find_fmu_host;

/// What a controller file may say of an FMU, by default nothing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FmuConfig {
    /// What is seen; each input of the FMU by its name, if nothing is said.
    pub inputs: Option<Vec<InputMapping>>,
    /// What its answer means.
    pub output: Option<OutputMapping>,
    /// What its parameters begin with; Booleans are 0 or 1.
    pub parameters: BTreeMap<String, f64>,
    /// Time between decisions, and of its steps, in seconds; at each step of the scenario, if nothing is said.
    pub decision_interval_s: Option<f64>,
}

/// Why an FMU cannot drive.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FmuProblem {
    /// The file.
    #[cfg(feature = "process")]
    #[error(transparent)]
    Fmu(#[from] crumple_fmu::FmuError),
    /// The program that runs it is not there.
    #[error(
        "needs the program `crumple-fmu`, which is installed with crumple and was found neither beside it nor on the path; \
         the variable CRUMPLE_FMU may say where it is"
    )]
    MissingHost,
    /// A process has to run it.
    #[error("FMUs need a build with the feature `process`")]
    ProcessFeatureDisabled,
    /// What does not fit it.
    #[error(transparent)]
    Mapping(#[from] InvalidMapping),
}

#[cfg(not(feature = "process"))]
impl super::ProcessSetup {
    pub(crate) fn from_fmu(_: &std::path::Path, _: &str, _: FmuConfig) -> Result<Self, FmuProblem> {
        Err(FmuProblem::ProcessFeatureDisabled)
    }
}
