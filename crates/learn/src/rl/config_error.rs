//! Errors of a training configuration, with the field.

use std::path::Path;

use crumple_core::field_error::FieldError;
use crumple_core::text_file;

/// Reason why a configuration is invalid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrainingConfigError {
    /// There is no such preset.
    #[error("there is no preset `{0}`, and no such file; there are fast, paper, paper-net, road")]
    UnknownPreset(String),
    /// A text is no valid configuration: its file, line, field and problem.
    #[error("{0}")]
    Located(String),
    /// A field contradicts another field, or names a space that cannot be trained on.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// A number is out of range.
    #[error("{field}: must be between {low} and {high}, found {found}")]
    Range {
        /// Path of the field.
        field: String,
        /// Minimum.
        low: f64,
        /// Maximum.
        high: f64,
        /// Number as written.
        found: f64,
    },
}

impl TrainingConfigError {
    pub(super) fn field(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Field(FieldError::new(field, problem))
    }

    /// Adds the file and the line of the field, and reports numbers as written, because `found` may have been rounded.
    #[must_use]
    pub fn with_location(self, text: &str, path: &Path) -> Self {
        let (field, message) = match &self {
            Self::UnknownPreset(_) | Self::Located(_) => return self,
            Self::Field(invalid) => (&invalid.field, self.to_string()),
            Self::Range {
                field, low, high, ..
            } => {
                let written = text_file::raw_toml_value(text, field);
                let written = written.map(|value| {
                    format!("{field}: must be between {low} and {high}, found {value}")
                });
                (field, written.unwrap_or_else(|| self.to_string()))
            }
        };
        Self::Located(format!(
            "{}:{}: {message}",
            path.display(),
            text_file::line_in_toml(text, field)
        ))
    }
}

pub(super) fn check_range(
    field: &str,
    found: f64,
    [low, high]: [f64; 2],
) -> Result<(), TrainingConfigError> {
    if (low..=high).contains(&found) {
        Ok(())
    } else {
        Err(TrainingConfigError::Range {
            field: field.to_owned(),
            low,
            high,
            found,
        })
    }
}
