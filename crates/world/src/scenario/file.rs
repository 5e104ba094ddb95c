//! Scenario files in TOML or JSON, by extension, with errors that name file, line and field.

use std::fmt;
use std::fs;
use std::io::{self, Read as _};
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use super::named_fields::NamedFields;
use super::{FieldProblem, InvalidField, Scenario, ScenarioSpec};
use crumple_core::regular_file;

/// An error of a scenario file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// The file could not be opened or read.
    #[error("{}: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// An extension other than `.toml` and `.json`.
    #[error("{}: a scenario file ends in .toml or .json", path.display())]
    Extension {
        /// Path of the file.
        path: PathBuf,
    },
    /// Malformed text, or a missing, unknown or mistyped field.
    #[error("{}:{line}: {message}", path.display())]
    Syntax {
        /// Path of the file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Message, with the field.
        message: String,
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

impl FileError {
    /// Creates the error for an invalid `field` in the TOML text of a file.
    #[must_use]
    pub fn from_field(path: &Path, text: &str, field: &str, problem: impl fmt::Display) -> Self {
        Self::Syntax {
            path: path.to_owned(),
            line: line_in_toml(text, field),
            message: format!("{field}: {problem}"),
        }
    }

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
/// [`FileError`] for a file that cannot be read, parsed or accepted.
pub fn load(path: &Path) -> Result<Scenario, FileError> {
    let format = ScenarioFileFormat::from_path(path).ok_or_else(|| FileError::Extension {
        path: path.to_owned(),
    })?;
    parse(&read(path)?, format, path)
}

/// Reads the scenario file at `path`, or all scenario files of the folder `path`, in order of their names. Skips other
/// extensions and [`LEGACY_EXPECTED_FILE_NAME`].
///
/// # Errors
/// [`FileError`] for the first file that cannot be read, parsed or accepted, and for a folder with more than
/// `MAX_FILES` files or `MAX_FOLDER_BYTES` bytes.
pub fn load_all(path: &Path) -> Result<Vec<(PathBuf, Scenario)>, FileError> {
    if !path.is_dir() {
        return Ok(vec![(path.to_owned(), load(path)?)]);
    }
    let unreadable = |source| FileError::Read {
        path: path.to_owned(),
        source,
    };
    let entries = fs::read_dir(path)
        .map_err(unreadable)?
        .collect::<Result<Vec<_>, _>>()
        .map_err(unreadable)?;
    let is_scenario = |path: &PathBuf| {
        ScenarioFileFormat::from_path(path).is_some()
            && path.file_name() != Some(LEGACY_EXPECTED_FILE_NAME.as_ref())
    };
    let mut files: Vec<_> = entries
        .iter()
        .map(fs::DirEntry::path)
        .filter(is_scenario)
        .collect();
    files.sort();
    let bytes: u64 = files
        .iter()
        .flat_map(fs::metadata)
        .map(|found| found.len())
        .sum();
    if files.len() > MAX_FILES || bytes > MAX_FOLDER_BYTES {
        let most = MAX_FOLDER_BYTES >> 20;
        let problem = format!(
            "holds more than {MAX_FILES} scenario files, or more than {most} MiB: too much at once"
        );
        return Err(unreadable(io::Error::new(
            io::ErrorKind::InvalidData,
            problem,
        )));
    }
    files
        .into_iter()
        .map(|path| load(&path).map(|scenario| (path, scenario)))
        .collect()
}

/// Name of the TOML file with the recorded verdicts of a folder of scenarios. The extension keeps it out of `*.toml`.
pub const EXPECTED_FILE_NAME: &str = "expected.verdicts";

/// Name of the file of verdicts in version 0.1.0.
pub const LEGACY_EXPECTED_FILE_NAME: &str = "expected.toml";

/// Maximum number of files that one command reads from a folder.
pub const MAX_FILES: usize = 10_000;

/// Maximum number of bytes of scenario files that one command reads from a folder.
pub const MAX_FOLDER_BYTES: u64 = 64 << 20;

/// Maximum bytes of a text file: ten times a scripted motion of one minute at the finest step. Parsed JSON needs 16 MB.
pub const MAX_BYTES: u64 = 8 << 20;

/// Maximum number of bytes of TOML, which needs up to 80 times its size in memory: 240 MB.
pub const MAX_TOML_BYTES: u64 = 3 << 20;

/// Reads a text file.
///
/// # Errors
/// [`FileError::Read`] for a file that cannot be read or exceeds [`MAX_BYTES`]; [`FileError::Syntax`] with the line for
/// text that is not UTF-8.
pub fn read(path: &Path) -> Result<String, FileError> {
    read_at_most(path, MAX_BYTES)
}

/// Reads a text file of at most `most` bytes.
///
/// # Errors
/// [`FileError`], as for [`read`].
pub fn read_at_most(path: &Path, most: u64) -> Result<String, FileError> {
    let unreadable = |source| FileError::Read {
        path: path.to_owned(),
        source,
    };
    let mut bytes = Vec::new();
    regular_file::open(path)
        .and_then(|file| file.take(most.saturating_add(1)).read_to_end(&mut bytes))
        .map_err(unreadable)?;
    if bytes.len() as u64 > most {
        let size = if most < 1 << 20 {
            format!("{} KiB", most >> 10)
        } else {
            format!("{} MiB", most >> 20)
        };
        let problem = format!("holds more than {size}, too much for such a file");
        return Err(unreadable(io::Error::new(
            io::ErrorKind::InvalidData,
            problem,
        )));
    }
    let text = String::from_utf8(bytes).map_err(|error| {
        let whole = error.utf8_error().valid_up_to();
        let message = "is not UTF-8 text from here on: save it as UTF-8".to_owned();
        FileError::Syntax {
            path: path.to_owned(),
            line: line_at(error.as_bytes(), whole),
            message,
        }
    })?;
    Ok(text
        .strip_prefix('\u{feff}')
        .map(str::to_owned)
        .unwrap_or(text))
}

/// Reads a scenario from TOML text; `path` only names it in errors.
///
/// # Errors
/// [`FileError`] for text that is not a valid scenario.
pub fn from_toml(text: &str, path: &Path) -> Result<Scenario, FileError> {
    parse(text, ScenarioFileFormat::Toml, path)
}

/// Reads a scenario from JSON text; `path` only names it in errors.
///
/// # Errors
/// [`FileError`] for text that is not a valid scenario.
pub fn from_json(text: &str, path: &Path) -> Result<Scenario, FileError> {
    parse(text, ScenarioFileFormat::Json, path)
}

fn parse(text: &str, format: ScenarioFileFormat, path: &Path) -> Result<Scenario, FileError> {
    let mut spec: ScenarioSpec = match format {
        ScenarioFileFormat::Toml => parse_toml(text, path)?,
        ScenarioFileFormat::Json => parse_json(text, path)?,
    };
    let drivers = spec.read_drivers(path.parent().unwrap_or(Path::new("")));
    drivers
        .and_then(|()| Scenario::new(spec))
        .map_err(|invalid| {
            let span = match format {
                ScenarioFileFormat::Toml => locate_in_toml(text, &invalid.field),
                ScenarioFileFormat::Json => locate_in_json(text, &invalid.field),
            };
            FileError::Invalid {
                path: path.to_owned(),
                line: line_at(text, span.start),
                invalid,
            }
        })
}

/// Parses a value from TOML text, with errors that name line and field.
pub fn parse_toml<T: DeserializeOwned>(text: &str, path: &Path) -> Result<T, FileError> {
    let misread = |field: String, error: toml::de::Error| {
        // For an entry of an array of tagged tables, the span is that of the whole array.
        let start = error
            .span()
            .map_or(0, |span| span.start)
            .max(locate_in_toml(text, &field).start);
        let message = prefix_field(&field, &simplify_message(error.message()));
        FileError::Syntax {
            path: path.to_owned(),
            line: line_at(text, start),
            message,
        }
    };
    if text.len() as u64 > MAX_TOML_BYTES {
        let most = MAX_TOML_BYTES >> 20;
        let message = format!(
            "holds more than {most} MiB of TOML, too much to parse (a scenario may have {} MiB as JSON)",
            MAX_BYTES >> 20
        );
        return Err(FileError::Syntax {
            path: path.to_owned(),
            line: 1,
            message,
        });
    }
    let parsed = toml::Deserializer::parse(text).map_err(|error| misread(String::new(), error))?;
    serde_path_to_error::deserialize(NamedFields(parsed))
        .map_err(|error| misread(error.path().to_string(), error.into_inner()))
}

/// Parses a text of a format of which only version 1 exists.
///
/// # Errors
/// [`FileError`] if the text has another form or version.
pub fn parse_first_version<T: DeserializeOwned>(
    text: &str,
    path: &Path,
    version: impl Fn(&T) -> u32,
) -> Result<T, FileError> {
    let parsed = parse_toml(text, path)?;
    match version(&parsed) {
        1 => Ok(parsed),
        other => Err(FileError::Syntax {
            path: path.to_owned(),
            line: line_in_toml(text, "version"),
            message: format!("version {other} is not supported: this release reads version 1"),
        }),
    }
}

/// Parses a value from JSON text, with errors that name line and field.
pub fn parse_json<T: DeserializeOwned>(text: &str, path: &Path) -> Result<T, FileError> {
    let mut parsed = serde_json::Deserializer::from_str(text);
    let misread = |field: String, error: serde_json::Error| FileError::Syntax {
        path: path.to_owned(),
        line: error.line().max(1),
        message: prefix_field(
            &field,
            &simplify_message(
                error
                    .to_string()
                    .split(" at line ")
                    .next()
                    .unwrap_or_default(),
            ),
        ),
    };
    let value = serde_path_to_error::deserialize(NamedFields(&mut parsed))
        .map_err(|error| misread(error.path().to_string(), error.into_inner()))?;
    parsed
        .end()
        .map_err(|error| misread(String::new(), error))?;
    Ok(value)
}

/// Returns the line, from 1, of a field in TOML text.
pub fn line_in_toml(text: &str, field: &str) -> usize {
    line_at(text, locate_in_toml(text, field).start)
}

/// Returns the source text of a field's value in TOML; `None` if the text lacks the field.
#[must_use]
pub fn raw_toml_value<'t>(text: &'t str, field: &str) -> Option<&'t str> {
    let (span, is_whole) = find_in_toml(text, field);
    text.get(span).filter(|_| is_whole)
}

/// Rewrites messages of serde and toml in terms of the file.
fn simplify_message(message: &str) -> std::borrow::Cow<'_, str> {
    match message {
        "wanted exactly 1 element, more than 1 element" => {
            "several kinds are given, and exactly one is required".into()
        }
        "wanted exactly 1 element, found 0 elements" => "no kind is given".into(),
        "invalid type: sequence, expected a string" => {
            "must be one text in quotation marks, not a list".into()
        }
        "integer number overflowed" => {
            "a whole number this large must be written with a point or an exponent".into()
        }
        "invalid type: unit variant, expected newtype variant" => {
            "a name alone is not enough: its settings belong in a table".into()
        }
        other => match single_item(other) {
            Some(item) => format!("must be a list in square brackets, as in `[{item}]`").into(),
            // Serde appends this for an item without settings.
            None => other
                .strip_suffix(", there are no fields")
                .unwrap_or(other)
                .into(),
        },
    }
}

/// Returns the text or number that a message of serde names where a list is required.
fn single_item(message: &str) -> Option<&str> {
    let found = message
        .strip_prefix("invalid type: ")?
        .strip_suffix(", expected a sequence")?;
    let number = |kind: &str| found.strip_prefix(kind)?.strip_suffix('`');
    found
        .strip_prefix("string ")
        .or_else(|| number("integer `"))
        .or_else(|| number("floating point `"))
}

/// Prefixes the message with its field, if the parser knows the field.
fn prefix_field(field: &str, message: &str) -> String {
    // `serde_path_to_error` ends the path with `?` where the text ends.
    let field = field
        .strip_suffix('?')
        .map_or(field, |known| known.strip_suffix('.').unwrap_or(known));
    if field.is_empty() || field == "." {
        message.to_owned()
    } else {
        format!("{field}: {message}")
    }
}

/// Serializes the scenario as TOML.
///
/// # Errors
/// None for a valid scenario; passes on the error of the serializer.
pub fn to_toml(scenario: &Scenario) -> Result<String, toml::ser::Error> {
    toml::to_string(scenario.spec())
}

/// Returns the line, from 1, of a byte offset.
fn line_at(text: impl AsRef<[u8]>, offset: usize) -> usize {
    1 + text
        .as_ref()
        .iter()
        .take(offset)
        .filter(|&&byte| byte == b'\n')
        .count()
}

/// Splits a path such as `vehicles[1].driver.brake` into steps.
fn path_steps(field: &str) -> impl Iterator<Item = PathStep<'_>> {
    field.split('.').flat_map(|part| {
        let (name, indices) = part
            .split_once('[')
            .map_or((part, ""), |(name, rest)| (name, rest));
        let index = indices
            .strip_suffix(']')
            .and_then(|digits| digits.parse().ok());
        std::iter::once(PathStep::Field(name)).chain(index.map(PathStep::Index))
    })
}

enum PathStep<'a> {
    Field(&'a str),
    Index(usize),
}

/// Returns the span of a field in TOML text; for an absent field (an invalid default), that of its deepest parent.
fn locate_in_toml(text: &str, field: &str) -> Range<usize> {
    find_in_toml(text, field).0
}

/// Returns the span as [`locate_in_toml`] does, and true if the text contains the field.
fn find_in_toml(text: &str, field: &str) -> (Range<usize>, bool) {
    let mut span = 0..0;
    let Ok(root) = toml::de::DeTable::parse(text) else {
        return (span, false);
    };
    let mut table = Some(root.get_ref());
    let mut array = None;
    for step in path_steps(field) {
        let value = match step {
            PathStep::Field(name) => table.and_then(|table| table.get(name)),
            PathStep::Index(index) => {
                array.and_then(|array: &toml::de::DeArray<'_>| array.get(index))
            }
        };
        let Some(value) = value else {
            return (span, false);
        };
        span = value.span();
        table = value.get_ref().as_table();
        array = value.get_ref().as_array();
    }
    (span, true)
}

/// Returns the span of a field in JSON text, as [`locate_in_toml`] does for TOML.
fn locate_in_json(text: &str, field: &str) -> Range<usize> {
    use jsonc_parser::common::Ranged;
    let parsed = jsonc_parser::parse_to_ast(text, &Default::default(), &Default::default());
    let mut value = parsed.ok().and_then(|result| result.value);
    let mut span = 0..0;
    for step in path_steps(field) {
        let next = match (step, value) {
            (PathStep::Field(name), Some(jsonc_parser::ast::Value::Object(mut object))) => {
                object.take(name).map(|property| property.value)
            }
            (PathStep::Index(index), Some(jsonc_parser::ast::Value::Array(array))) => {
                array.elements.into_iter().nth(index)
            }
            _ => None,
        };
        let Some(found) = next else { break };
        span = found.start()..found.end();
        value = Some(found);
    }
    span
}

#[cfg(test)]
mod tests;
