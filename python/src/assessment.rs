//! Assessments of controllers.

use std::path::{Path, PathBuf};

use crumple_core::observer::RunProgress;
use crumple_core::text_file;
use crumple_report::assessment::{
    self as report, AssessConfig, AssessConfigError, AssessmentPlan, EarlierAssessment,
    EvidenceCache,
};
use crumple_store::program;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::values::serialize_to_python;

/// Result of an assessment.
#[pyclass(name = "Assessment", frozen, module = "crumple")]
pub(crate) struct PyAssessment(report::AssessmentReport);

#[pymethods]
impl PyAssessment {
    /// Returns the content of `assessment.json`.
    #[getter]
    fn evidence<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        serialize_to_python(py, &self.0)
    }

    /// Returns the gates of the configuration: condition, result, and reason.
    #[getter]
    fn gates<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        serialize_to_python(py, &self.0.summary.gates)
    }

    /// True if every gate holds.
    #[getter]
    fn passed(&self) -> bool {
        self.0.summary.gates.iter().all(|gate| gate.holds)
    }

    /// Returns the report as one page of HTML.
    fn html(&self) -> String {
        self.0.to_html()
    }

    /// Returns the report as Markdown, without figures.
    fn markdown(&self) -> String {
        self.0.to_markdown()
    }

    /// Returns every file of the report by its path in the report's folder.
    fn files<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let files = self
            .0
            .files()
            .map_err(|error| errors::exception(py, ExceptionClass::Assessment, &error))?;
        let dict = PyDict::new(py);
        for (name, contents) in files {
            dict.set_item(name, PyBytes::new(py, &contents))?;
        }
        Ok(dict)
    }

    /// Returns the first page for a notebook. A frame separates the styles of page and notebook.
    fn _repr_html_(&self) -> String {
        let page = self.0.first_page_to_html();
        let quoted = page.replace('&', "&amp;").replace('"', "&quot;");
        format!(
            "<iframe srcdoc=\"{quoted}\" sandbox style=\"width:100%;height:30em;border:0\"></iframe>"
        )
    }

    fn __str__(&self) -> String {
        self.0.first_page.to_plain_text() + &self.0.summary.gates_to_plain_text()
    }

    fn __repr__(&self) -> String {
        format!(
            "<crumple.Assessment of {}>",
            self.0.provenance.config.controllers.join(", ")
        )
    }
}

/// Gathers the evidence of a configuration: a file, a text in TOML or JSON, or by default the built-in one.
#[pyfunction]
#[expect(
    clippy::too_many_arguments,
    reason = "the Python half names every argument"
)]
pub(crate) fn assess(
    py: Python<'_>,
    path: Option<PathBuf>,
    toml: Option<String>,
    json: Option<String>,
    controllers: Vec<Bound<'_, PyAny>>,
    against: Option<PathBuf>,
    evidence: Option<PathBuf>,
    fresh: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<PyAssessment> {
    let stop = StopFlag::default();
    let own = controllers
        .iter()
        .map(|controller| controller::resolve_controller(controller, &stop))
        .collect::<PyResult<Vec<_>>>()?;
    let plan = match &path {
        Some(path) if own.is_empty() => AssessmentPlan::load(path, controller::controllers()),
        _ => {
            let mut config = read_config(py, path.as_deref(), toml, json)?;
            config.controllers_of_files = controller::controllers();
            let folder = path.as_deref().and_then(Path::parent);
            AssessmentPlan::new(config, own, folder.unwrap_or(Path::new("")))
        }
    };
    let plan = plan.map_err(|error| config_exception(py, &error))?;
    let against = against
        .as_deref()
        .map(EarlierAssessment::load)
        .transpose()
        .map_err(|error| assessment_error(py, &error))?;
    if against.is_none() && plan.needs_earlier_assessment() {
        return Err(assessment_error(
            py,
            &"the gate `nothing-worse` needs an earlier assessment: against",
        ));
    }
    let cache = match evidence {
        None => EvidenceCache::disabled(),
        Some(folder) => {
            let identity = program::identity().map_err(|error| assessment_error(py, &error))?;
            EvidenceCache::open(&folder, identity, fresh)
                .map_err(|error| assessment_error(py, &error))?
        }
    };
    let runs = plan.runs();
    let assessment = run_interruptible(py, &stop, progress.as_ref(), |say| {
        report::assess(&plan, &cache, against.as_ref(), &|state: &RunProgress| {
            say((state.done, runs, 0))
        })
    })?;
    Ok(PyAssessment(
        assessment.map_err(|error| assessment_error(py, &error))?,
    ))
}

fn assessment_error(py: Python<'_>, error: &impl std::fmt::Display) -> PyErr {
    errors::exception(py, ExceptionClass::Assessment, error)
}

/// Reads the configuration from a file or a text.
fn read_config(
    py: Python<'_>,
    path: Option<&Path>,
    toml: Option<String>,
    json: Option<String>,
) -> PyResult<AssessConfig> {
    let config = if let Some(path) = path {
        text_file::read(path).and_then(|text| text_file::parse_toml(&text, path))
    } else if let Some(text) = toml {
        text_file::parse_toml(&text, Path::new("<toml>"))
    } else if let Some(text) = json {
        text_file::parse_json(&text, Path::new("<dict>"))
    } else {
        return Ok(AssessConfig::default());
    };
    config.map_err(|error| errors::file_exception(py, ExceptionClass::Assessment, &error))
}

fn config_exception(py: Python<'_>, error: &AssessConfigError) -> PyErr {
    match error {
        AssessConfigError::File(error) => {
            errors::file_exception(py, ExceptionClass::Assessment, error)
        }
        AssessConfigError::Scenario(error) => {
            errors::scenario_file_exception(py, ExceptionClass::Assessment, error)
        }
        AssessConfigError::Field {
            path, line, field, ..
        } => errors::exception_at(
            py,
            ExceptionClass::Assessment,
            error,
            (Some(path), Some(*line), Some(field)),
        ),
        other => errors::exception(py, ExceptionClass::Assessment, other),
    }
}
