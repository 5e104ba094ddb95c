//! Text files of users, in TOML or JSON: limited reading, and errors that name file, line and field.

mod named_fields;
mod position;

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::format_version::check_version;
use crate::regular_file;
use named_fields::NamedFields;
pub(crate) use position::line_at;
use position::locate_in_toml;

pub use position::{line_in_json, line_in_toml, raw_toml_value};

/// An error of a text file that a user names.
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
    /// Malformed text, or a missing, unknown, mistyped or invalid field.
    #[error("{}:{line}: {message}", path.display())]
    Syntax {
        /// Path of the file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Message, with the field.
        message: String,
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
}

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
/// Those of [`read`], with this limit.
pub fn read_at_most(path: &Path, most: u64) -> Result<String, FileError> {
    let bytes = regular_file::read(path, most).map_err(|source| FileError::Read {
        path: path.to_owned(),
        source,
    })?;
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

/// Parses a value from TOML text; `path` only names it in errors.
///
/// # Errors
/// [`FileError::Syntax`] with line and field, for a text of more than [`MAX_TOML_BYTES`] or of another form.
pub fn parse_toml<T: DeserializeOwned>(text: &str, path: &Path) -> Result<T, FileError> {
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
    let parsed =
        toml::Deserializer::parse(text).map_err(|error| toml_error(path, text, "", &error))?;
    serde_path_to_error::deserialize(NamedFields(parsed))
        .map_err(|error| toml_error(path, text, &error.path().to_string(), error.inner()))
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
    check_version(version(&parsed), 1).map_err(|unsupported| FileError::Syntax {
        path: path.to_owned(),
        line: line_in_toml(text, "version"),
        message: unsupported.to_string(),
    })?;
    Ok(parsed)
}

/// Parses a value from JSON text; `path` only names it in errors.
///
/// # Errors
/// [`FileError::Syntax`] with line and field, for a text of another form.
pub fn parse_json<T: DeserializeOwned>(text: &str, path: &Path) -> Result<T, FileError> {
    let mut parsed = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(NamedFields(&mut parsed))
        .map_err(|error| json_error(path, &error.path().to_string(), error.inner()))?;
    parsed.end().map_err(|error| json_error(path, "", &error))?;
    Ok(value)
}

fn json_error(path: &Path, field: &str, error: &serde_json::Error) -> FileError {
    let message = error.to_string();
    let message = message.split(" at line ").next().unwrap_or_default();
    FileError::Syntax {
        path: path.to_owned(),
        line: error.line().max(1),
        message: prefix_field(field, &simplify_message(message)),
    }
}

fn toml_error(path: &Path, text: &str, field: &str, error: &toml::de::Error) -> FileError {
    // For an entry of an array of tagged tables, the span is that of the whole array.
    let start = error
        .span()
        .map_or(0, |span| span.start)
        .max(locate_in_toml(text, field).start);
    FileError::Syntax {
        path: path.to_owned(),
        line: line_at(text, start),
        message: prefix_field(field, &simplify_message(error.message())),
    }
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
    let value = message
        .strip_prefix("invalid type: ")?
        .strip_suffix(", expected a sequence")?;
    if let Some(text) = value.strip_prefix("string ") {
        return Some(text);
    }
    value
        .strip_prefix("integer `")
        .or_else(|| value.strip_prefix("floating point `"))?
        .strip_suffix('`')
}

/// Prefixes the message with its field, if the parser knows the field.
fn prefix_field(field: &str, message: &str) -> String {
    // `serde_path_to_error` ends the path with `?` where the text ends.
    let field = field
        .strip_suffix('?')
        .map_or(field, |path| path.strip_suffix('.').unwrap_or(path));
    if field.is_empty() || field == "." {
        message.to_owned()
    } else {
        format!("{field}: {message}")
    }
}

/// Returns true if a field has its default. Writers leave such a field out (`skip_serializing_if`).
pub fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}
