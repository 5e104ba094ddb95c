//! Errors as exceptions of `crumple.errors`, with file, line and field if known.

use std::path::Path;

use crumple_core::quoting::shorten_message;
use crumple_core::text_file::FileError;
use crumple_sim::scenario::InvalidField;
use crumple_sim::scenario::file::ScenarioFileError;
use crumple_spaces::FindSpaceError;
use crumple_store::run_folder::RunFolderError;
use pyo3::prelude::*;

/// Exceptions, without the end `Error` of their names.
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

/// File, line and field of an error, if known.
pub(crate) type ErrorLocation<'a> = (Option<&'a Path>, Option<usize>, Option<&'a str>);

/// Creates an exception without a location.
pub(crate) fn exception(
    py: Python<'_>,
    class: ExceptionClass,
    error: &impl std::fmt::Display,
) -> PyErr {
    exception_at(py, class, error, (None, None, None))
}

/// Creates an exception for a file that cannot be used.
pub(crate) fn file_exception(py: Python<'_>, class: ExceptionClass, error: &FileError) -> PyErr {
    let location = match error {
        FileError::Read { path, .. } => (Some(path.as_path()), None, None),
        FileError::Syntax {
            path,
            line,
            message,
        } => {
            let field = message
                .split_once(": ")
                .map(|(field, _)| field)
                .filter(|field| !field.contains(' '));
            (Some(path.as_path()), Some(*line), field)
        }
        _ => (None, None, None),
    };
    exception_at(py, class, error, location)
}

/// Creates an exception for a scenario or space file that cannot be used.
pub(crate) fn scenario_file_exception(
    py: Python<'_>,
    class: ExceptionClass,
    error: &ScenarioFileError,
) -> PyErr {
    let location = match error {
        ScenarioFileError::File(error) => return file_exception(py, class, error),
        ScenarioFileError::Extension { path } => (Some(path.as_path()), None, None),
        ScenarioFileError::Invalid {
            path,
            line,
            invalid,
        } => (Some(path.as_path()), Some(*line), Some(&*invalid.field)),
        _ => (None, None, None),
    };
    if error.is_start_refused() {
        let words = format!("{error} (in Python: crumple.allow_external())");
        return exception_at(py, class, &words, location);
    }
    exception_at(py, class, error, location)
}

/// Creates an exception for a space that cannot be found.
pub(crate) fn space_exception(py: Python<'_>, error: &FindSpaceError) -> PyErr {
    match error {
        FindSpaceError::File(error) => scenario_file_exception(py, ExceptionClass::Space, error),
        other => exception(py, ExceptionClass::Space, other),
    }
}

pub(crate) fn field_exception(py: Python<'_>, error: &InvalidField) -> PyErr {
    exception_at(
        py,
        ExceptionClass::Scenario,
        error,
        (None, None, Some(&error.field)),
    )
}

/// Creates an exception with a location.
pub(crate) fn exception_at(
    py: Python<'_>,
    class: ExceptionClass,
    error: &impl std::fmt::Display,
    (file, line, field): ErrorLocation<'_>,
) -> PyErr {
    let message = shorten_message(&error.to_string()).into_owned();
    let file = file.map(|file| file.display().to_string());
    let field = field.map(|field| shorten_message(field).into_owned());
    self::class(py, class)
        .and_then(|class| class.call1((message, file, line, field)))
        .map_or_else(|error| error, PyErr::from_value)
}

/// Returns the Python class of an exception.
pub(crate) fn class(py: Python<'_>, class: ExceptionClass) -> PyResult<Bound<'_, PyAny>> {
    py.import("crumple.errors")?
        .getattr(format!("{class:?}Error"))
}

/// Creates an exception for a run folder that cannot be used. It names the arguments of Python in place of options;
/// `argument` is that of the folder.
pub(crate) fn run_folder_exception(
    py: Python<'_>,
    class: ExceptionClass,
    error: &RunFolderError,
    argument: &str,
) -> PyErr {
    match error {
        RunFolderError::AlreadyExists { folder, kind } => {
            let problem = format!(
                "{argument}: {} already holds a {kind}: use resume=True or another {argument}",
                folder.display()
            );
            exception_at(
                py,
                class,
                &problem,
                (Some(folder.as_path()), None, Some(argument)),
            )
        }
        RunFolderError::NoIdentity { controller, kind } => {
            let problem = format!(
                "identity: the controller `{controller}` states none, so its {kind} cannot be resumed; start again \
                 without resume=True, with another {argument}"
            );
            exception_at(py, class, &problem, (None, None, Some("identity")))
        }
        other => exception(py, class, other),
    }
}
