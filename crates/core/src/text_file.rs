//! Text files of users, in TOML or JSON: limited reading, and errors that name file, line and field.

mod named_fields;
mod position;

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::format_version::check_version;
use crate::old_names::{old_names_of, present_names};
use crate::regular_file;
use named_fields::NamedFields;
use position::{line_at, locate_in_toml};

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
    let path_of_field = match field_with_old_name(error.message()) {
        Some(name) if field.is_empty() => name.to_owned(),
        Some(name) => format!("{field}.{name}"),
        None => field.to_owned(),
    };
    // For an entry of an array of tagged tables, the span is that of the whole array.
    let start = error
        .span()
        .map_or(0, |span| span.start)
        .max(locate_in_toml(text, &path_of_field).start);
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
        other => rewrite_names(other).unwrap_or_else(|| {
            // Serde appends this for an item without settings.
            let message = other.strip_suffix(", there are no fields");
            message.unwrap_or(other).into()
        }),
    }
}

/// Rewrites a message of serde about an item in place of a list, about a field that is given by two names, or with a
/// list of names, which then has no old ones.
fn rewrite_names(message: &str) -> Option<std::borrow::Cow<'_, str>> {
    if let Some(item) = single_item(message) {
        return Some(format!("must be a list in square brackets, as in `[{item}]`").into());
    }
    if let Some(field) = field_with_old_name(message) {
        let old: Vec<_> = old_names_of(field).map(|old| format!("`{old}`")).collect();
        let old = old.join(" or ");
        return Some(format!("`{field}` is given twice, once by its old name {old}").into());
    }
    let (start, list) = message.split_once("expected one of ")?;
    let names: Vec<_> = list.split(", ").collect();
    let is_present = |name: &&&str| {
        let mut new = present_names(name.trim_matches('`'));
        !new.any(|new| names.iter().any(|name| name.trim_matches('`') == new))
    };
    let present: Vec<_> = names.iter().filter(is_present).copied().collect();
    Some(format!("{start}expected one of {}", present.join(", ")).into())
}

/// Returns the field that is given by two names, if that is the message. The parser of TOML itself refuses one name
/// that is given twice.
fn field_with_old_name(message: &str) -> Option<&str> {
    let field = message
        .strip_prefix("duplicate field `")?
        .strip_suffix('`')?;
    old_names_of(field).next().map(|_| field)
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

/// Returns true if a field is 1. Writers leave such a field out if that is its default.
pub fn is_one<T: From<u8> + PartialEq>(value: &T) -> bool {
    *value == T::from(1)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use serde::Deserialize;

    use super::{line_in_toml, parse_toml};

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only errors are read")]
    struct Renamed {
        #[serde(alias = "says")]
        summary: String,
        #[serde(default)]
        clauses: Vec<Renamed>,
    }

    #[test]
    fn errors_of_fields_with_old_names_have_the_right_line() {
        let error = |text: &str| {
            let parsed = parse_toml::<Renamed>(text, Path::new("a.toml"));
            parsed.unwrap_err().to_string()
        };
        assert_eq!(
            error("summary = \"a\"\n[[clauses]]\nsays = \"b\"\nsummary = \"c\"\n"),
            "a.toml:4: clauses[0]: `summary` is given twice, once by its old name `says`"
        );
        assert_eq!(
            error("summary = \"a\"\nsentence = \"b\"\n"),
            "a.toml:2: sentence: unknown field `sentence`, expected one of `summary`, `clauses`"
        );
        let text = "summary = \"a\"\n\n[[clauses]]\n\nsays = \"b\"\n";
        assert_eq!(line_in_toml(text, "clauses[0].summary"), 5);
    }
}
