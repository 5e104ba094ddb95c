//! FMUs. The program `crumple-fmu` runs each as a controller process, connected to the variables of the FMU.

#[cfg(feature = "process")]
mod setup;
#[cfg(feature = "process")]
mod units;

use std::collections::BTreeMap;

use crumple_networks::{InputMapping, InvalidMapping, OutputMapping};
#[cfg(feature = "process")]
pub use setup::find_fmu_host;

/// Configuration of an FMU in a controller file; empty by default.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FmuConfig {
    /// Inputs; default: each input of the FMU by its name.
    pub inputs: Option<Vec<InputMapping>>,
    /// Meaning of the answer.
    pub output: Option<OutputMapping>,
    /// Output that is above 0.5 while the FMU warns of a collision.
    pub warning: Option<String>,
    /// Start values of parameters; Booleans are 0 or 1.
    pub parameters: BTreeMap<String, f64>,
    /// Time between decisions, and step of the FMU, in seconds; default: the step of the scenario.
    pub decision_interval_s: Option<f64>,
}

/// Reason why an FMU cannot drive.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FmuProblem {
    /// An unusable file.
    #[cfg(feature = "process")]
    #[error(transparent)]
    Fmu(#[from] crumple_fmu::FmuError),
    /// The program that runs FMUs is missing.
    #[error(
        "needs the program `crumple-fmu`, which is installed with crumple but was found neither in the same folder nor \
        on the path; set the variable CRUMPLE_FMU to its path"
    )]
    MissingHost,
    /// A build without controller processes.
    #[error("FMUs need the feature `process` of crumple-sim or crumple-testing")]
    ProcessFeatureDisabled,
    /// A mapping that does not fit the FMU.
    #[error(transparent)]
    Mapping(#[from] InvalidMapping),
}

impl FmuProblem {
    /// Describes the problem with the path of the FMU.
    pub fn describe(&self, path: &std::path::Path) -> String {
        let path = path.display();
        match self {
            #[cfg(feature = "process")]
            Self::Fmu(crumple_fmu::FmuError::Read(source))
                if source.kind() == std::io::ErrorKind::NotFound =>
            {
                format!("there is no file {path}")
            }
            #[cfg(feature = "process")]
            Self::Fmu(crumple_fmu::FmuError::Description(_)) => format!("{path}: {self}"),
            Self::ProcessFeatureDisabled | Self::Mapping(_) => format!("{path}: {self}"),
            #[cfg(feature = "process")]
            Self::Fmu(_) => format!("{path} {self}"),
            Self::MissingHost => format!("{path} {self}"),
        }
    }
}

#[cfg(not(feature = "process"))]
impl super::ProcessSetup {
    /// Refuses the FMU, because this build lacks the feature `process`.
    ///
    /// # Errors
    /// Always [`FmuProblem`], which names the feature.
    pub fn from_fmu(_: &std::path::Path, _: &str, _: FmuConfig) -> Result<Self, FmuProblem> {
        Err(FmuProblem::ProcessFeatureDisabled)
    }
}
