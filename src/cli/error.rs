//! Errors of subcommands, and their exit codes.

use std::error::Error;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use super::output;
use crumple_core::quoting::shorten_message;
use crumple_core::text_file::FileError;
use crumple_evidence::InvalidRate;
use crumple_evidence::rare::RareError;
use crumple_exchange::recording::RecordingError;
use crumple_learn::retrain::RetrainError;
use crumple_learn::tune::TuneError;
use crumple_report::assessment::{AssessConfigError, AssessError, CacheError, ReportFolderError};
use crumple_search::falsify::campaign::CampaignError;
use crumple_sim::engine::{RefusedController, RunError};
use crumple_sim::scenario::file::ScenarioFileError;
use crumple_store::disk::DiskError;
use crumple_store::output_folder::OutputError;
use crumple_store::run_folder::RunFolderError;
use crumple_suites::SuiteError;

#[derive(Debug, thiserror::Error)]
pub(super) enum CliError {
    /// A gate of an assessment did not hold: exit code 1.
    #[error("{}", shorten_message(.0))]
    Gate(String),
    /// The result is not the expected or the required one: exit code 1.
    #[error("{}", shorten_message(.0))]
    Unmet(String),
    /// The input holds nothing to work with: exit code 1.
    #[error("{}", shorten_message(.0))]
    NothingFound(String),
    /// Arguments or input are unusable: exit code 2.
    #[error("{}", shorten_message(.0))]
    Input(String),
    /// The environment failed: exit code 3.
    #[error("{}", shorten_message(.0))]
    Environment(String),
}

/// Returns true if the environment caused an error of a file, such as a full disk or a missing permission, and not the
/// name or the content of the file.
fn is_of_environment(error: &io::Error) -> bool {
    !matches!(
        error.kind(),
        io::ErrorKind::NotFound
            | io::ErrorKind::IsADirectory
            | io::ErrorKind::NotADirectory
            | io::ErrorKind::InvalidFilename
            | io::ErrorKind::InvalidInput
            | io::ErrorKind::InvalidData
            | io::ErrorKind::UnexpectedEof
            | io::ErrorKind::AlreadyExists
            | io::ErrorKind::Other
    )
}

/// Returns true if the environment caused an error, directly or through the errors that caused it.
pub(super) fn is_caused_by_environment(error: &(dyn Error + 'static)) -> bool {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if error.downcast_ref().is_some_and(is_of_environment) {
            return true;
        }
        cause = error.source();
    }
    false
}

/// Returns true if a message contains an error of the system for a full, damaged or protected disk. Errors of files
/// that other files name, and those of other processes, contain it as text only.
pub(super) fn states_disk_failure(message: &str) -> bool {
    /// `EIO`, which has no kind.
    const INPUT_OUTPUT_ERROR: i32 = 5;
    let codes = message.split("(os error ").skip(1);
    let codes = codes.filter_map(|rest| rest.split(')').next()?.parse::<i32>().ok());
    codes.map(io::Error::from_raw_os_error).any(|error| {
        let is_damaged = error.raw_os_error() == Some(INPUT_OUTPUT_ERROR);
        is_damaged
            || matches!(
                error.kind(),
                io::ErrorKind::StorageFull
                    | io::ErrorKind::QuotaExceeded
                    | io::ErrorKind::FileTooLarge
                    | io::ErrorKind::ReadOnlyFilesystem
                    | io::ErrorKind::PermissionDenied
            )
    })
}

impl CliError {
    /// Converts any error into one of unusable input.
    pub(super) fn input(error: impl fmt::Display) -> Self {
        Self::Input(error.to_string())
    }

    /// Converts an error: a failed environment if the disk is its cause, otherwise unusable input.
    pub(super) fn from_cause(error: impl Error + 'static) -> Self {
        if is_caused_by_environment(&error) {
            Self::Environment(error.to_string())
        } else {
            Self::input(error)
        }
    }

    /// Converts an error about the value of an option, as [`Self::from_cause`] does.
    pub(super) fn about(option: &str, error: impl Error + 'static) -> Self {
        let message = format!("{option}: {error}");
        if is_caused_by_environment(&error) {
            Self::Environment(message)
        } else {
            Self::Input(message)
        }
    }

    /// Returns an error of unusable input about a file or folder.
    pub(super) fn at(path: &Path, problem: impl fmt::Display) -> Self {
        Self::Input(format!("{}: {problem}", path.display()))
    }

    /// Returns the error of the verdict if there is one, otherwise that of printing the results.
    pub(super) fn verdict_first(
        verdict: Result<(), Self>,
        printed: Result<(), Self>,
    ) -> Result<(), Self> {
        verdict.and(printed)
    }

    #[must_use]
    pub(super) fn exit_code(&self) -> ExitCode {
        match self {
            Self::Gate(_) | Self::Unmet(_) | Self::NothingFound(_) => ExitCode::from(1),
            Self::Input(message) if states_disk_failure(message) => ExitCode::from(3),
            Self::Input(_) => ExitCode::from(2),
            Self::Environment(_) => ExitCode::from(3),
        }
    }

    /// Prints the error to standard error, in one line, so that quoted file content cannot imitate further messages.
    pub(super) fn print(&self) {
        let kind = match self {
            Self::Gate(_) => "gate",
            Self::Unmet(_) => "failed",
            Self::NothingFound(_) | Self::Input(_) | Self::Environment(_) => "error",
        };
        output::note(&format!("{kind}: {self}"), false);
    }

    /// Converts an error of reading a file: unusable input if the file is missing or has another form, otherwise a
    /// failed environment.
    pub(super) fn from_read_error(path: PathBuf, source: io::Error) -> Self {
        Self::from_cause(DiskError { path, source })
    }
}

impl From<DiskError> for CliError {
    fn from(error: DiskError) -> Self {
        match error.source.kind() {
            io::ErrorKind::AlreadyExists
            | io::ErrorKind::InvalidInput
            | io::ErrorKind::IsADirectory => Self::input(error),
            _ => Self::Environment(error.to_string()),
        }
    }
}

impl From<InvalidRate> for CliError {
    fn from(error: InvalidRate) -> Self {
        match error {
            InvalidRate::OutOfRange(field) => Self::Input(format!("--{field}")),
            other => Self::input(other),
        }
    }
}

impl From<FileError> for CliError {
    fn from(error: FileError) -> Self {
        match error {
            FileError::Read { path, source } => Self::from_read_error(path, source),
            other => Self::from_cause(other),
        }
    }
}

impl From<ScenarioFileError> for CliError {
    fn from(error: ScenarioFileError) -> Self {
        match error {
            ScenarioFileError::File(error) => error.into(),
            other => Self::from_cause(other),
        }
    }
}

impl From<RecordingError> for CliError {
    fn from(error: RecordingError) -> Self {
        match error {
            RecordingError::Read { path, source } => Self::from_read_error(path, source),
            RecordingError::Map(error) => (*error).into(),
            // Whatever its kind, no argument or file is the reason.
            RecordingError::Spill { .. } => Self::Environment(error.to_string()),
            other => Self::from_cause(other),
        }
    }
}

/// Converts errors. Those of the named variants have separate exit codes; all others are converted by their cause.
macro_rules! from_errors {
    ($($error:ident { $($inner:ident),* })*) => {$(
        impl From<$error> for CliError {
            fn from(error: $error) -> Self {
                match error {
                    $($error::$inner(error) => error.into(),)*
                    other => Self::from_cause(other),
                }
            }
        }
    )*};
}

from_errors! {
    AssessError { Cache, Campaign }
    CampaignError { Disk, Work }
    AssessConfigError { File, Scenario }
    RareError { RunFolder }
    RefusedController {}
    RetrainError { Disk, RunFolder, Campaign, Training }
    RunError {}
    CacheError { Disk }
    SuiteError { File }
    RunFolderError { Disk }
    OutputError { Disk, Listing }
    ReportFolderError { Output }
    TuneError { Disk, RunFolder }
}
