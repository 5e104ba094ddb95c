//! Scenarios and scenario spaces as Python objects.

use std::path::{Path, PathBuf};

use super::controller::controllers;
use crumple_search::falsify::campaign::MAX_SEED;
use crumple_sim::scenario::{self, built_in_scenario, built_in_scenario_names, file};
use crumple_spaces::find_space;
use pyo3::prelude::*;

use crate::errors::{self, ExceptionClass};
use crate::values::{parse_whole_number, serialize_to_python};

/// Valid scenario.
#[pyclass(name = "Scenario", frozen, eq, module = "crumple")]
#[derive(PartialEq)]
pub(crate) struct PyScenario(pub(crate) scenario::Scenario);

#[pymethods]
impl PyScenario {
    /// Finds a built-in scenario by name, or loads a file.
    #[staticmethod]
    fn find(py: Python<'_>, name: &str) -> PyResult<Self> {
        if let Some(scenario) = built_in_scenario(name) {
            return Ok(Self(scenario));
        }
        if Path::new(name).extension().is_none() && !Path::new(name).exists() {
            let names: Vec<_> = built_in_scenario_names()
                .iter()
                .map(|(name, _)| *name)
                .collect();
            let message = format!(
                "`{name}` is neither a built-in scenario ({}) nor a file",
                names.join(", ")
            );
            return Err(errors::exception(py, ExceptionClass::Scenario, &message));
        }
        Self::load(py, PathBuf::from(name))
    }

    /// Loads a scenario from a file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Self::from_read(py, file::load(&path, &controllers()))
    }

    /// Parses a scenario from TOML.
    #[staticmethod]
    fn from_toml(py: Python<'_>, text: &str) -> PyResult<Self> {
        Self::from_read(
            py,
            file::from_toml(text, Path::new("<toml>"), &controllers()),
        )
    }

    /// Parses a scenario from JSON.
    #[staticmethod]
    fn from_json(py: Python<'_>, text: &str) -> PyResult<Self> {
        Self::from_read(
            py,
            file::from_json(text, Path::new("<dict>"), &controllers()),
        )
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.spec().name
    }

    #[getter]
    fn seed(&self) -> u64 {
        self.0.spec().seed
    }

    #[getter]
    fn duration_s(&self) -> f64 {
        self.0.spec().duration_s
    }

    #[getter]
    fn step_s(&self) -> f64 {
        self.0.spec().step_s
    }

    fn with_seed(&self, seed: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = seed.py();
        let seed = parse_whole_number("seed", seed, [0, MAX_SEED], ExceptionClass::Scenario)?;
        self.0
            .edited(|spec| spec.seed = seed)
            .map(Self)
            .map_err(|error| errors::field_exception(py, &error))
    }

    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        serialize_to_python(py, self.0.spec())
    }

    fn to_toml(&self, py: Python<'_>) -> PyResult<String> {
        file::to_toml(&self.0)
            .map_err(|error| errors::exception(py, ExceptionClass::Scenario, &error))
    }

    /// Pickles the TOML text.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        Ok((
            py.import("crumple")?.getattr("scenario")?,
            (self.to_toml(py)?,),
        ))
    }

    fn __len__(&self) -> usize {
        self.0.vehicles().len()
    }

    fn __repr__(&self) -> String {
        format!(
            "<crumple.Scenario {:?}, {} vehicles>",
            self.name(),
            self.0.vehicles().len()
        )
    }
}

impl PyScenario {
    fn from_read(
        py: Python<'_>,
        read: Result<scenario::Scenario, file::ScenarioFileError>,
    ) -> PyResult<Self> {
        read.map(Self)
            .map_err(|error| errors::scenario_file_exception(py, ExceptionClass::Scenario, &error))
    }
}

/// Scenario space whose points are all valid scenarios.
#[pyclass(name = "Space", frozen, module = "crumple")]
pub(crate) struct PySpace(pub(crate) crumple_spaces::ScenarioSpace);

#[pymethods]
impl PySpace {
    /// Finds a built-in space by name, or loads a file.
    #[staticmethod]
    fn find(py: Python<'_>, name: &str) -> PyResult<Self> {
        find_space(name, &controllers())
            .map(Self)
            .map_err(|error| errors::space_exception(py, &error))
    }

    /// Parses a space from TOML. A base scenario in a file is relative to the working directory.
    #[staticmethod]
    fn from_toml(py: Python<'_>, text: &str) -> PyResult<Self> {
        let read = crumple_spaces::file::from_toml(text, Path::new("<toml>"), &controllers());
        read.map(Self)
            .map_err(|error| errors::scenario_file_exception(py, ExceptionClass::Space, &error))
    }

    #[getter]
    fn name(&self) -> &str {
        self.0.name()
    }

    #[getter]
    fn coordinate_names(&self) -> Vec<String> {
        self.0.coordinate_names()
    }

    /// Returns the scenario at a point of the unit cube.
    fn at(&self, py: Python<'_>, point: Vec<f64>) -> PyResult<PyScenario> {
        self.0
            .scenario_at(&point)
            .map(PyScenario)
            .map_err(|error| errors::field_exception(py, &error))
    }

    /// Returns the scenario with nominal parameters.
    fn nominal(&self, py: Python<'_>) -> PyResult<PyScenario> {
        self.0
            .scenario(&self.0.nominal())
            .map(PyScenario)
            .map_err(|error| errors::field_exception(py, &error))
    }

    /// Returns the random scenario with this index.
    fn draw(&self, seed: &Bound<'_, PyAny>, index: &Bound<'_, PyAny>) -> PyResult<PyScenario> {
        let py = seed.py();
        let [seed, index] = [("seed", seed), ("index", index)].map(|(name, value)| {
            parse_whole_number(name, value, [0, u64::MAX], ExceptionClass::Space)
        });
        self.0
            .draw(seed?, index?)
            .map(PyScenario)
            .map_err(|error| errors::field_exception(py, &error))
    }

    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        serialize_to_python(py, self.0.spec())
    }

    /// Pickles the TOML text, with its base scenario.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let text = crumple_spaces::file::to_toml(&self.0);
        let text = text.map_err(|error| errors::exception(py, ExceptionClass::Space, &error))?;
        Ok((py.import("crumple")?.getattr("space")?, (text,)))
    }

    fn __len__(&self) -> usize {
        self.0.dimension()
    }

    fn __repr__(&self) -> String {
        format!(
            "<crumple.Space {:?}, {} coordinates>",
            self.name(),
            self.0.dimension()
        )
    }
}
