//! Errors of an import.

use std::io;
use std::path::{Path, PathBuf};

use crumple_core::observer::Stopped;
use crumple_sim::scenario::InvalidField;

/// An error of importing OpenSCENARIO. Each names the file, and the line if there is one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioImportError {
    /// A file could not be opened or read.
    #[error("{}: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// A text that is not well-formed XML, or exceeds a limit.
    #[error("{}:{line}: {problem}", path.display())]
    Syntax {
        /// Path of the file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Problem in words.
        problem: String,
    },
    /// Content that a scenario on one lane cannot represent, or that contradicts other content.
    #[error("{}:{line}: {element}: {reason}", path.display())]
    Refused {
        /// Path of the file.
        path: PathBuf,
        /// Line of the element, from 1.
        line: u32,
        /// Name of the element.
        element: String,
        /// Reason in words.
        reason: String,
    },
    /// An import that needs more work than all variations may have together.
    #[error("{}:{line}: {element}: {reason}", path.display())]
    TooMuchWork {
        /// Path of the file.
        path: PathBuf,
        /// Line of the element, from 1.
        line: u32,
        /// Name of the element.
        element: String,
        /// Reason in words.
        reason: String,
    },
    /// Values of parameters that violate a constraint of the file.
    #[error("{}:{line}: ParameterDeclaration: `{parameter}` = `{value}` violates its constraints", path.display())]
    Constraint {
        /// Path of the file.
        path: PathBuf,
        /// Line of the declaration, from 1.
        line: u32,
        /// Name of the parameter.
        parameter: String,
        /// Value.
        value: String,
    },
    /// A scenario outside the ranges of crumple.
    #[error("{}:{line}: {element}: the scenario is outside the ranges of crumple: {invalid}", path.display())]
    Invalid {
        /// Path of the file.
        path: PathBuf,
        /// Line of the element that states the value, from 1.
        line: u32,
        /// Name of the element.
        element: String,
        /// Field and problem.
        invalid: Box<InvalidField>,
    },
    /// The observer stopped the import.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

impl ScenarioImportError {
    pub(super) fn read(path: &Path, source: io::Error) -> Self {
        Self::Read {
            path: path.to_owned(),
            source,
        }
    }
}
