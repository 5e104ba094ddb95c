//! Validation errors of spaces.

use crumple_core::field_error::FieldError;
use crumple_sim::control::StartRefusal;
use crumple_sim::scenario::FieldProblem;

/// An invalid field of a space, with its path, such as `parameters[1].distribution`, and its problem.
pub type InvalidSpace = FieldError<SpaceProblem>;

/// A problem of a field of a space.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SpaceProblem {
    /// A value that no space may have.
    #[error("{0}")]
    Unusable(String),
    /// A program of the base scenario that must not be started.
    #[error(transparent)]
    StartRefused(#[from] StartRefusal),
}

impl From<String> for SpaceProblem {
    fn from(problem: String) -> Self {
        Self::Unusable(problem)
    }
}

impl From<&str> for SpaceProblem {
    fn from(problem: &str) -> Self {
        Self::Unusable(problem.to_owned())
    }
}

impl From<FieldProblem> for SpaceProblem {
    fn from(problem: FieldProblem) -> Self {
        match problem {
            FieldProblem::StartRefused(refusal) => Self::StartRefused(refusal),
            other => Self::Unusable(other.to_string()),
        }
    }
}

pub(super) fn reject<T>(
    field: impl Into<String>,
    problem: impl Into<SpaceProblem>,
) -> Result<T, InvalidSpace> {
    Err(InvalidSpace::new(field, problem))
}
