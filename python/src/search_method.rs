//! Search methods written in Python.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use crumple_search::falsify::{CustomMethod, Method, SearchAlgorithm, UnitCube};
use pyo3::prelude::*;

use crate::errors::{self, ExceptionClass};

/// First exception of the search methods of a call, which ends the search.
#[derive(Debug, Clone, Default)]
pub(crate) struct RaisedException(Arc<Mutex<Option<PyErr>>>);

impl RaisedException {
    fn set(&self, error: PyErr) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get_or_insert(error);
    }

    /// Fails with the exception, if there is one.
    pub(crate) fn take(&self) -> PyResult<()> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
            .map_or(Ok(()), Err)
    }
}

/// Resolves a name as on the command line, or a `crumple.SearchMethod`.
pub(crate) fn resolve_method(
    method: &Bound<'_, PyAny>,
    raised: &RaisedException,
) -> PyResult<Method> {
    let py = method.py();
    if let Ok(name) = method.extract::<String>() {
        return name
            .parse()
            .map_err(|error| errors::exception(py, ExceptionClass::Campaign, &error));
    }
    let name: String = method.getattr("name")?.extract()?;
    let start = method.getattr("start")?.unbind();
    let raised = raised.clone();
    let custom = CustomMethod::new(
        &name,
        move |cube: &UnitCube, seed| -> Box<dyn SearchAlgorithm> {
            let search = Python::attach(|py| start.call1(py, (cube.dimension(), seed)));
            let search = search.map_err(|error| raised.set(error)).ok();
            Box::new(PythonSearch {
                search,
                raised: raised.clone(),
            })
        },
    );
    custom
        .map(Method::Custom)
        .map_err(|error| errors::exception(py, ExceptionClass::Campaign, &error))
}

struct PythonSearch {
    /// `None` if it could not be started.
    search: Option<Py<PyAny>>,
    raised: RaisedException,
}

impl fmt::Debug for PythonSearch {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("PythonSearch")
    }
}

impl PythonSearch {
    /// Calls the search. After an exception it returns nothing, and a campaign ends without points.
    fn call<T: Default>(&self, call: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<T>) -> T {
        let Some(search) = &self.search else {
            return T::default();
        };
        Python::attach(|py| call(search.bind(py)))
            .map_err(|error| self.raised.set(error))
            .unwrap_or_default()
    }
}

impl SearchAlgorithm for PythonSearch {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        self.call(|search| {
            let points = search
                .py()
                .import("numpy")?
                .call_method1("asarray", (search.call_method0("ask")?, "float64"))?;
            points.call_method0("tolist")?.extract()
        })
    }

    fn tell(&mut self, robustness: &[f64]) {
        self.call(|search| {
            search
                .call_method1("tell", (robustness.to_vec(),))
                .map(drop)
        });
    }
}
