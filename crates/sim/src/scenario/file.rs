//! Scenario files in TOML or JSON, by extension, with errors that name file, line and field.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::{FieldProblem, InvalidField, OpenDriver, Scenario, ScenarioSpec};
use crumple_core::text_file::{
    FileError, line_in_json, line_in_toml, parse_json, parse_toml, read,
};

/// An error of a scenario file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioFileError {
    /// The file could not be read, or its text is malformed.
    #[error(transparent)]
    File(#[from] FileError),
    /// An extension other than `.toml` and `.json`.
    #[error("{}: a scenario file ends in .toml or .json", path.display())]
    Extension {
        /// Path of the file.
        path: PathBuf,
    },
    /// A field out of range, or in contradiction to another.
    #[error("{}:{line}: {invalid}", path.display())]
    Invalid {
        /// Path of the file.
        path: PathBuf,
        /// Line of the field, from 1.
        line: usize,
        /// Field and problem.
        invalid: InvalidField,
    },
}

impl ScenarioFileError {
    /// Returns true if the only error is a driver program that crumple may not start.
    #[must_use]
    pub fn is_start_refused(&self) -> bool {
        matches!(
            self,
            Self::Invalid {
                invalid: InvalidField {
                    problem: FieldProblem::StartRefused(_),
                    ..
                },
                ..
            }
        )
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ScenarioFileFormat {
    Toml,
    Json,
}

impl ScenarioFileFormat {
    fn from_path(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()? {
            "toml" => Some(Self::Toml),
            "json" => Some(Self::Json),
            _ => None,
        }
    }
}

/// Reads and checks a scenario file.
///
/// # Errors
/// [`ScenarioFileError`] for a file that cannot be read, parsed or accepted.
pub fn load(path: &Path, opener: &dyn OpenDriver) -> Result<Scenario, ScenarioFileError> {
    let format =
        ScenarioFileFormat::from_path(path).ok_or_else(|| ScenarioFileError::Extension {
            path: path.to_owned(),
        })?;
    parse(&read(path)?, format, path, opener)
}

/// Reads the scenario file at `path`, or all scenario files of the folder `path`, in order of their names. Skips other
/// extensions and [`LEGACY_EXPECTED_FILE_NAME`].
///
/// # Errors
/// [`ScenarioFileError`] for the first file that cannot be read, parsed or accepted, and for a folder with more than
/// `MAX_FILES` files or `MAX_FOLDER_BYTES` bytes.
pub fn load_all(
    path: &Path,
    opener: &dyn OpenDriver,
) -> Result<Vec<(PathBuf, Scenario)>, ScenarioFileError> {
    list(path)?
        .into_iter()
        .map(|path| load(&path, opener).map(|scenario| (path, scenario)))
        .collect()
}

/// Returns `path`, or the scenario files of the folder `path`, as [`load_all`] reads them.
///
/// # Errors
/// [`ScenarioFileError`] for a folder that cannot be read, or with more than `MAX_FILES` files or `MAX_FOLDER_BYTES`
/// bytes.
pub fn list(path: &Path) -> Result<Vec<PathBuf>, ScenarioFileError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = fs::read_dir(path)
        .and_then(Iterator::collect::<io::Result<Vec<_>>>)
        .map_err(|source| read_error(path, source))?;
    let mut files: Vec<_> = entries
        .iter()
        .map(fs::DirEntry::path)
        .filter(|path| {
            ScenarioFileFormat::from_path(path).is_some()
                && path.file_name() != Some(LEGACY_EXPECTED_FILE_NAME.as_ref())
        })
        .collect();
    files.sort();
    let bytes: u64 = files
        .iter()
        .flat_map(fs::metadata)
        .map(|metadata| metadata.len())
        .sum();
    if files.len() > MAX_FILES || bytes > MAX_FOLDER_BYTES {
        let max_mib = MAX_FOLDER_BYTES >> 20;
        let problem = format!(
            "holds more than {MAX_FILES} scenario files, or more than {max_mib} MiB: too much at once"
        );
        let too_much = io::Error::new(io::ErrorKind::InvalidData, problem);
        return Err(read_error(path, too_much));
    }
    Ok(files)
}

fn read_error(path: &Path, source: io::Error) -> ScenarioFileError {
    ScenarioFileError::File(FileError::Read {
        path: path.to_owned(),
        source,
    })
}

/// Name of the TOML file with the recorded verdicts of a folder of scenarios. The extension keeps it out of `*.toml`.
pub const EXPECTED_FILE_NAME: &str = "expected.verdicts";

/// Name of the file of verdicts in version 0.1.0.
pub const LEGACY_EXPECTED_FILE_NAME: &str = "expected.toml";

/// Maximum number of files that one command reads from a folder.
pub const MAX_FILES: usize = 10_000;

/// Maximum number of bytes of scenario files that one command reads from a folder.
pub const MAX_FOLDER_BYTES: u64 = 64 << 20;

/// Reads a scenario from TOML text; `path` only names it in errors.
///
/// # Errors
/// [`ScenarioFileError`] for text that is not a valid scenario.
pub fn from_toml(
    text: &str,
    path: &Path,
    opener: &dyn OpenDriver,
) -> Result<Scenario, ScenarioFileError> {
    parse(text, ScenarioFileFormat::Toml, path, opener)
}

/// Reads a scenario from JSON text; `path` only names it in errors.
///
/// # Errors
/// [`ScenarioFileError`] for text that is not a valid scenario.
pub fn from_json(
    text: &str,
    path: &Path,
    opener: &dyn OpenDriver,
) -> Result<Scenario, ScenarioFileError> {
    parse(text, ScenarioFileFormat::Json, path, opener)
}

fn parse(
    text: &str,
    format: ScenarioFileFormat,
    path: &Path,
    opener: &dyn OpenDriver,
) -> Result<Scenario, ScenarioFileError> {
    let mut spec: ScenarioSpec = match format {
        ScenarioFileFormat::Toml => parse_toml(text, path)?,
        ScenarioFileFormat::Json => parse_json(text, path)?,
    };
    let drivers = spec.read_drivers(path.parent().unwrap_or(Path::new("")), opener);
    drivers
        .and_then(|()| Scenario::new(spec))
        .map_err(|invalid| {
            let line = match format {
                ScenarioFileFormat::Toml => line_in_toml(text, &invalid.field),
                ScenarioFileFormat::Json => line_in_json(text, &invalid.field),
            };
            ScenarioFileError::Invalid {
                path: path.to_owned(),
                line,
                invalid,
            }
        })
}

/// Serializes the scenario as TOML.
///
/// # Errors
/// None for a valid scenario; passes on the error of the serializer.
pub fn to_toml(scenario: &Scenario) -> Result<String, toml::ser::Error> {
    toml::to_string(scenario.spec())
}

#[cfg(test)]
mod tests;
