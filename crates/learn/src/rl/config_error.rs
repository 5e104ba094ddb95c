//! Errors of a training configuration, with the field.

use std::path::Path;

use crumple_world::scenario::file;

/// A reason why a configuration cannot be trained with.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrainingConfigError {
    /// No such preset.
    #[error("there is no preset `{0}`, and no such file; there are fast, paper, paper-net, road")]
    UnknownPreset(String),
    /// A text is none: its file, line and field, and what is wrong.
    #[error("{0}")]
    Located(String),
    /// A field contradicts another, or names what cannot be trained on.
    #[error("{field}: {problem}")]
    Field {
        /// Path of the field.
        field: String,
        /// Problem, as the end of a sentence.
        problem: String,
    },
    /// A number is out of range.
    #[error("{field}: must be between {low} and {high}, found {found}")]
    Range {
        /// Path of the field.
        field: String,
        /// The least that it may be.
        low: f64,
        /// The most.
        high: f64,
        /// Number as written.
        found: f64,
    },
}

impl TrainingConfigError {
    /// With the file and the line of its field, and numbers as they are written there: `found` may have been rounded since.
    #[must_use]
    pub fn with_location(self, text: &str, path: &Path) -> Self {
        let (field, said) = match &self {
            Self::UnknownPreset(_) | Self::Located(_) => return self,
            Self::Field { field, .. } => (field, self.to_string()),
            Self::Range { field, low, high, .. } => {
                let written = file::raw_toml_value(text, field);
                let written = written.map(|found| format!("{field}: must be between {low} and {high}, found {found}"));
                (field, written.unwrap_or_else(|| self.to_string()))
            }
        };
        Self::Located(format!("{}:{}: {said}", path.display(), file::line_in_toml(text, field)))
    }
}

/// Refuses a number that is not within its range.
pub(super) fn check_range(field: &str, found: f64, [low, high]: [f64; 2]) -> Result<(), TrainingConfigError> {
    if (low..=high).contains(&found) {
        Ok(())
    } else {
        Err(TrainingConfigError::Range { field: field.to_owned(), low, high, found })
    }
}
