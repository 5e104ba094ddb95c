//! Errors as the exceptions of `crumple.errors`, with file, line and field where there are any.

use std::path::Path;

use crumple_world::scenario::InvalidField;
use crumple_world::scenario::file::FileError;
use crumple_world::scenario::space::UnknownSpace;
use pyo3::prelude::*;

/// The classes of `crumple.errors`.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Class {
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

impl Class {
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

/// Where in which file something is wrong.
#[derive(Debug, Default)]
struct Place<'a> {
    file: Option<&'a Path>,
    line: Option<usize>,
    field: Option<&'a str>,
}

/// An exception that says what is wrong.
pub(crate) fn raised(py: Python<'_>, class: Class, error: &impl std::fmt::Display) -> PyErr {
    with_place(py, class, error, &Place::default())
}

/// An exception that says which file cannot be used, and why.
pub(crate) fn of_file(py: Python<'_>, class: Class, error: &FileError) -> PyErr {
    let place = match error {
        FileError::Read { path, .. } | FileError::Extension { path } => Place { file: Some(path), ..Place::default() },
        FileError::Syntax { path, line, message } => {
            let field = message.split_once(": ").map(|(field, _)| field).filter(|field| !field.contains(' '));
            Place { file: Some(path), line: Some(*line), field }
        }
        FileError::Invalid { path, line, invalid } => {
            Place { file: Some(path), line: Some(*line), field: Some(&invalid.field) }
        }
        _ => Place::default(),
    };
    if error.is_start_refused() {
        let words = format!("{error} (in Python: crumple.allow_external())");
        return with_place(py, class, &words, &place);
    }
    with_place(py, class, error, &place)
}

/// An exception that says which space there is none of.
pub(crate) fn of_space(py: Python<'_>, error: &UnknownSpace) -> PyErr {
    match error {
        UnknownSpace::File(error) => of_file(py, Class::Space, error),
        other => raised(py, Class::Space, other),
    }
}

/// An exception that names a field.
pub(crate) fn of_field(py: Python<'_>, error: &InvalidField) -> PyErr {
    with_place(py, Class::Scenario, error, &Place { field: Some(&error.field), ..Place::default() })
}

/// An exception that says where something is wrong: file, line and field.
pub(crate) fn of_place(
    py: Python<'_>,
    class: Class,
    error: &impl std::fmt::Display,
    (file, line, field): (&Path, usize, &str),
) -> PyErr {
    with_place(py, class, error, &Place { file: Some(file), line: Some(line), field: Some(field) })
}

fn with_place(py: Python<'_>, class: Class, error: &impl std::fmt::Display, place: &Place<'_>) -> PyErr {
    let file = place.file.map(|file| file.display().to_string());
    let made = py
        .import("crumple.errors")
        .and_then(|module| module.getattr(class.name()))
        .and_then(|class| class.call1((error.to_string(), file, place.line, place.field)));
    made.map_or_else(|error| error, PyErr::from_value)
}
