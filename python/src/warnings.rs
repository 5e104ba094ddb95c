//! Warnings of the libraries, as warnings of Python.

use std::ffi::CString;

use pyo3::exceptions::PyFutureWarning;
use pyo3::prelude::*;

/// Passes warnings of crumple's libraries to `warnings.warn`, whose filters decide what is shown.
struct PythonWarnings;

impl log::Log for PythonWarnings {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        metadata.level() <= log::Level::Warn && metadata.target().starts_with("crumple")
    }

    fn log(&self, record: &log::Record<'_>) {
        if !self.enabled(record.metadata()) {
            return;
        }
        let Ok(text) = CString::new(record.args().to_string()) else {
            return;
        };
        Python::attach(|py| {
            let category = py.get_type::<PyFutureWarning>();
            // A filter that turns warnings into errors cannot stop a library that only logs: the warning is printed.
            if let Err(error) = PyErr::warn(py, &category, &text, 1) {
                error.print(py);
            }
        });
    }

    fn flush(&self) {}
}

/// Starts to pass warnings on.
pub(crate) fn show_logged_warnings() {
    // Fails only if another logger is set, which then receives the warnings.
    let _ = log::set_logger(&PythonWarnings);
    log::set_max_level(log::LevelFilter::Warn);
}
