//! Results as Python values.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyList, PyString};
use serde_json::Value;

use crate::errors::{self, ExceptionClass};

/// Converts JSON to dictionaries, lists, numbers and strings; numbers keep every bit.
pub(crate) fn json_to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(value) => PyBool::new(py, *value).to_owned().into_any(),
        Value::Number(number) => match (number.as_u64(), number.as_i64()) {
            (Some(whole), _) => whole.into_pyobject(py)?.into_any(),
            (None, Some(whole)) => whole.into_pyobject(py)?.into_any(),
            (None, None) => PyFloat::new(py, number.as_f64().unwrap_or(f64::NAN)).into_any(),
        },
        Value::String(text) => PyString::new(py, text).into_any(),
        Value::Array(items) => {
            let list = PyList::empty(py);
            for item in items {
                list.append(json_to_python(py, item)?)?;
            }
            list.into_any()
        }
        Value::Object(fields) => {
            let dict = PyDict::new(py);
            for (name, value) in fields {
                dict.set_item(name, json_to_python(py, value)?)?;
            }
            dict.into_any()
        }
    })
}

pub(crate) fn serialize_to_python<'py>(
    py: Python<'py>,
    value: &impl serde::Serialize,
) -> PyResult<Bound<'py, PyAny>> {
    let value =
        serde_json::to_value(value).map_err(|error| PyValueError::new_err(error.to_string()))?;
    json_to_python(py, &value)
}

/// Parses an argument that is a whole number, with the error of `whole_number` of the Python half.
pub(crate) fn parse_whole_number(
    name: &str,
    value: &Bound<'_, PyAny>,
    [min, max]: [u64; 2],
    class: ExceptionClass,
) -> PyResult<u64> {
    let py = value.py();
    let numbers = py.import("crumple._numbers")?;
    let error = errors::class(py, class)?;
    numbers
        .call_method1("whole_number", (name, value, min, max, error))?
        .extract()
}

/// Parses a value that is one of a few words.
pub(crate) fn parse_choice<T: Copy>(what: &str, word: &str, choices: &[(&str, T)]) -> PyResult<T> {
    choices
        .iter()
        .find(|(name, _)| *name == word)
        .map(|(_, value)| *value)
        .ok_or_else(|| {
            let names: Vec<_> = choices
                .iter()
                .map(|(name, _)| format!("'{name}'"))
                .collect();
            PyValueError::new_err(format!(
                "{what} must be {}, found {word:?}",
                names.join(" or ")
            ))
        })
}
