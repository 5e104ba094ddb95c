//! Errors of subcommands, and their exit codes.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use super::output;
use crumple_evidence::InvalidRate;
use crumple_evidence::rare::RareError;
use crumple_exchange::recording::RecordingError;
use crumple_learn::retrain::RetrainError;
use crumple_learn::tune::TuneError;
use crumple_report::assessment::{AssessConfigError, AssessError, CacheError};
use crumple_search::falsify::campaign::CampaignError;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::RunFolderError;
use crumple_suites::SuiteError;
use crumple_world::scenario::file::FileError;
use crumple_world::sim::{RefusedController, RunError};

#[derive(Debug, thiserror::Error)]
pub(super) enum CliError {
    /// A gate did not hold: exit code 1.
    #[error("{0}")]
    Gate(String),
    /// The input holds nothing to work with: exit code 1.
    #[error("{0}")]
    NothingFound(String),
    /// Arguments or input are unusable: exit code 2.
    #[error("{0}")]
    Input(String),
    /// The environment failed: exit code 3.
    #[error(transparent)]
    Environment(DiskError),
}

impl CliError {
    /// Converts any error into one of unusable input.
    pub(super) fn input(error: impl fmt::Display) -> Self {
        Self::Input(error.to_string())
    }

    /// Returns an error of unusable input about a file or folder.
    pub(super) fn at(path: &Path, problem: impl fmt::Display) -> Self {
        Self::Input(format!("{}: {problem}", path.display()))
    }

    /// Returns the error of the gate if there is one, otherwise that of printing the results.
    pub(super) fn gate_first(gate: Result<(), Self>, printed: Result<(), Self>) -> Result<(), Self> {
        gate.and(printed)
    }

    #[must_use]
    pub(super) fn exit_code(&self) -> ExitCode {
        match self {
            Self::Gate(_) | Self::NothingFound(_) => ExitCode::from(1),
            Self::Input(_) => ExitCode::from(2),
            Self::Environment(_) => ExitCode::from(3),
        }
    }

    /// Prints the error to standard error, in one line, so that quoted file content cannot imitate further messages.
    pub(super) fn print(&self) {
        let kind = if let Self::Gate(_) = self { "gate" } else { "error" };
        output::note(&format!("{kind}: {self}"), false);
    }

    /// Converts an error of reading a file: unusable input if the file is missing or not text, otherwise a failed
    /// environment.
    pub(super) fn from_read_error(path: PathBuf, source: io::Error) -> Self {
        match source.kind() {
            io::ErrorKind::NotFound
            | io::ErrorKind::IsADirectory
            | io::ErrorKind::NotADirectory
            | io::ErrorKind::InvalidData => Self::at(&path, source),
            _ => Self::Environment(DiskError { path, source }),
        }
    }
}

impl From<DiskError> for CliError {
    fn from(error: DiskError) -> Self {
        match error.source.kind() {
            io::ErrorKind::AlreadyExists => Self::input(error),
            _ => Self::Environment(error),
        }
    }
}

impl From<InvalidRate> for CliError {
    fn from(error: InvalidRate) -> Self {
        match error {
            InvalidRate::Runs { .. } | InvalidRate::Confidence { .. } => Self::Input(format!("--{error}")),
            other => Self::input(other),
        }
    }
}

impl From<FileError> for CliError {
    fn from(error: FileError) -> Self {
        match error {
            FileError::Read { path, source } => Self::from_read_error(path, source),
            other => Self::input(other),
        }
    }
}

impl From<RecordingError> for CliError {
    fn from(error: RecordingError) -> Self {
        match error {
            RecordingError::Read { path, source } => Self::from_read_error(path, source),
            RecordingError::Map(error) => (*error).into(),
            other => Self::input(other),
        }
    }
}

/// Converts errors. Those of the named variants have separate exit codes; all others mean unusable input.
macro_rules! from_errors {
    ($($error:ident { $($inner:ident),* })*) => {$(
        impl From<$error> for CliError {
            fn from(error: $error) -> Self {
                match error {
                    $($error::$inner(error) => error.into(),)*
                    other => Self::input(other),
                }
            }
        }
    )*};
}

from_errors! {
    AssessError { Cache, Campaign }
    CampaignError { Disk, Work }
    AssessConfigError { File }
    RareError { RunFolder }
    RefusedController {}
    RetrainError { Disk, RunFolder, Campaign, Training }
    RunError {}
    CacheError { Disk }
    SuiteError { File }
    RunFolderError { Disk }
    TuneError { Disk, RunFolder }
}
