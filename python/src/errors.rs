//! Errors as exceptions of `crumple.errors`, with file, line and field if known.

use std::path::Path;

use crumple_world::scenario::InvalidField;
use crumple_world::scenario::file::FileError;
use crumple_world::scenario::space::FindSpaceError;
use pyo3::prelude::*;

#[derive(Debug, Clone, Copy)]
pub(crate) enum ExceptionClass {
    Scenario,
    Space,
    Controller,
    Run,
    Campaign,
    Formula,
    Rate,
    Assessment,
    Training,
}

impl ExceptionClass {
    fn name(self) -> &'static str {
        match self {
            Self::Scenario => "ScenarioError",
            Self::Space => "SpaceError",
            Self::Controller => "ControllerError",
            Self::Run => "RunError",
            Self::Campaign => "CampaignError",
            Self::Formula => "FormulaError",
            Self::Rate => "RateError",
            Self::Assessment => "AssessmentError",
            Self::Training => "TrainingError",
        }
    }
}

#[derive(Debug, Default)]
struct ErrorLocation<'a> {
    file: Option<&'a Path>,
    line: Option<usize>,
    field: Option<&'a str>,
}

/// Creates an exception without a location.
pub(crate) fn exception(py: Python<'_>, class: ExceptionClass, error: &impl std::fmt::Display) -> PyErr {
    new_exception(py, class, error, &ErrorLocation::default())
}

/// Creates an exception for a file that cannot be used.
pub(crate) fn file_exception(py: Python<'_>, class: ExceptionClass, error: &FileError) -> PyErr {
    let place = match error {
        FileError::Read { path, .. } | FileError::Extension { path } => {
            ErrorLocation { file: Some(path), ..ErrorLocation::default() }
        }
        FileError::Syntax { path, line, message } => {
            let field = message.split_once(": ").map(|(field, _)| field).filter(|field| !field.contains(' '));
            ErrorLocation { file: Some(path), line: Some(*line), field }
        }
        FileError::Invalid { path, line, invalid } => {
            ErrorLocation { file: Some(path), line: Some(*line), field: Some(&invalid.field) }
        }
        _ => ErrorLocation::default(),
    };
    if error.is_start_refused() {
        let words = format!("{error} (in Python: crumple.allow_external())");
        return new_exception(py, class, &words, &place);
    }
    new_exception(py, class, error, &place)
}

/// Creates an exception for a space that cannot be found.
pub(crate) fn space_exception(py: Python<'_>, error: &FindSpaceError) -> PyErr {
    match error {
        FindSpaceError::File(error) => file_exception(py, ExceptionClass::Space, error),
        other => exception(py, ExceptionClass::Space, other),
    }
}

pub(crate) fn field_exception(py: Python<'_>, error: &InvalidField) -> PyErr {
    new_exception(
        py,
        ExceptionClass::Scenario,
        error,
        &ErrorLocation { field: Some(&error.field), ..ErrorLocation::default() },
    )
}

/// Creates an exception with file, line and field.
pub(crate) fn exception_at(
    py: Python<'_>,
    class: ExceptionClass,
    error: &impl std::fmt::Display,
    (file, line, field): (&Path, usize, &str),
) -> PyErr {
    new_exception(py, class, error, &ErrorLocation { file: Some(file), line: Some(line), field: Some(field) })
}

fn new_exception(
    py: Python<'_>,
    class: ExceptionClass,
    error: &impl std::fmt::Display,
    place: &ErrorLocation<'_>,
) -> PyErr {
    let file = place.file.map(|file| file.display().to_string());
    let made = py
        .import("crumple.errors")
        .and_then(|module| module.getattr(class.name()))
        .and_then(|class| class.call1((error.to_string(), file, place.line, place.field)));
    made.map_or_else(|error| error, PyErr::from_value)
}
