//! An invalid field of a file or a configuration.

use std::fmt::{Debug, Display};

/// An invalid field, with its path and its problem.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct FieldError<P: Debug + Display = String> {
    /// Path of the field in the file, such as `vehicles[1].position_m`.
    pub field: String,
    /// Problem of the field, as the end of a sentence.
    pub problem: P,
}

impl<P: Debug + Display> FieldError<P> {
    /// Creates the error of a field.
    pub fn new(field: impl Into<String>, problem: impl Into<P>) -> Self {
        Self {
            field: field.into(),
            problem: problem.into(),
        }
    }

    /// Puts the path of the structure that contains the field before its path: `inputs[2]` before `.scale`.
    #[must_use]
    pub fn within(self, structure: &str) -> Self {
        Self {
            field: structure.to_owned() + &self.field,
            problem: self.problem,
        }
    }
}
