//! Assessments of controllers.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use crumple_core::observer::RunProgress;
use crumple_core::text_file;
use crumple_report::assessment::{
    self as report, AssessConfig, AssessConfigError, AssessmentPlan, EarlierAssessment,
    EvidenceCache, RunInfo,
};
use crumple_store::program;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};
use serde_json::Value;

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::threads::parse_threads;
use crate::values::{json_to_python, serialize_to_python};

/// Commit from which a released package was built, by `.ci/release`.
const PACKAGE_COMMIT: Option<&str> = option_env!("CRUMPLE_COMMIT");

/// Result of an assessment.
#[pyclass(name = "Assessment", frozen, module = "crumple")]
pub(crate) struct PyAssessment(AssessmentForm);

/// Forms of an assessment.
enum AssessmentForm {
    /// Results that this process gathered.
    Gathered(Box<report::AssessmentReport>),
    /// Files and texts from a pickle.
    Written(WrittenAssessment),
}

/// Files of a report, and the texts that are shown.
struct WrittenAssessment {
    files: BTreeMap<String, Vec<u8>>,
    first_page_html: String,
    text: String,
    controllers: Vec<String>,
    gates: Value,
    has_passed: bool,
}

impl WrittenAssessment {
    fn file_text(&self, name: &str) -> String {
        let contents = self.files.get(name).map(Vec::as_slice);
        String::from_utf8_lossy(contents.unwrap_or_default()).into_owned()
    }
}

#[pymethods]
impl PyAssessment {
    /// Restores a pickled assessment.
    #[new]
    fn from_pickle(
        files: BTreeMap<String, Vec<u8>>,
        first_page_html: String,
        text: String,
        controllers: Vec<String>,
        gates: &str,
        has_passed: bool,
    ) -> PyResult<Self> {
        Ok(Self(AssessmentForm::Written(WrittenAssessment {
            files,
            first_page_html,
            text,
            controllers,
            gates: parse_json(gates)?,
            has_passed,
        })))
    }

    /// Returns the arguments of the constructor, for pickles.
    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        (
            self.files(py)?,
            self.first_page_html(),
            self.__str__(),
            self.controllers(),
            self.gates_value()?.to_string(),
            self.passed(),
        )
            .into_pyobject(py)
    }

    /// Returns the content of `assessment.json`.
    #[getter]
    fn evidence<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        match &self.0 {
            AssessmentForm::Gathered(report) => serialize_to_python(py, report),
            AssessmentForm::Written(written) => {
                json_to_python(py, &parse_json(&written.file_text("assessment.json"))?)
            }
        }
    }

    /// Returns the gates of the configuration: condition, result, and reason.
    #[getter]
    fn gates<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json_to_python(py, &self.gates_value()?)
    }

    /// True if every gate holds.
    #[getter]
    fn passed(&self) -> bool {
        match &self.0 {
            AssessmentForm::Gathered(report) => report.summary.gates.iter().all(|gate| gate.holds),
            AssessmentForm::Written(written) => written.has_passed,
        }
    }

    /// Returns the report as one page of HTML.
    fn html(&self) -> String {
        match &self.0 {
            AssessmentForm::Gathered(report) => report.to_html(),
            AssessmentForm::Written(written) => written.file_text("assessment.html"),
        }
    }

    /// Returns the report as Markdown, without figures.
    fn markdown(&self) -> String {
        match &self.0 {
            AssessmentForm::Gathered(report) => report.to_markdown(),
            AssessmentForm::Written(written) => written.file_text("assessment.md"),
        }
    }

    /// Returns every file of the report by its path in the report's folder.
    fn files<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        match &self.0 {
            AssessmentForm::Gathered(report) => {
                let files = report
                    .files()
                    .map_err(|error| assessment_error(py, &error))?;
                for (name, contents) in files {
                    dict.set_item(name, PyBytes::new(py, &contents))?;
                }
            }
            AssessmentForm::Written(written) => {
                for (name, contents) in &written.files {
                    dict.set_item(name, PyBytes::new(py, contents))?;
                }
            }
        }
        Ok(dict)
    }

    /// Writes every file of the report into a folder, as the command line does.
    fn _write(&self, py: Python<'_>, folder: PathBuf) -> PyResult<()> {
        let written = match &self.0 {
            AssessmentForm::Gathered(report) => {
                let files = report
                    .files()
                    .map_err(|error| assessment_error(py, &error))?;
                py.detach(|| write_files(&folder, &files))
            }
            AssessmentForm::Written(written) => {
                let files: Vec<_> = written.files.clone().into_iter().collect();
                py.detach(|| write_files(&folder, &files))
            }
        };
        written.map_err(|error| assessment_error(py, &error))
    }

    /// Returns the first page for a notebook. A frame separates the styles of page and notebook.
    fn _repr_html_(&self) -> String {
        let page = self.first_page_html();
        let quoted = page.replace('&', "&amp;").replace('"', "&quot;");
        format!(
            "<iframe srcdoc=\"{quoted}\" sandbox style=\"width:100%;height:30em;border:0\"></iframe>"
        )
    }

    fn __str__(&self) -> String {
        match &self.0 {
            AssessmentForm::Gathered(report) => report.to_text(),
            AssessmentForm::Written(written) => written.text.clone(),
        }
    }

    fn __repr__(&self) -> String {
        format!("<crumple.Assessment of {}>", self.controllers().join(", "))
    }
}

impl PyAssessment {
    fn first_page_html(&self) -> String {
        match &self.0 {
            AssessmentForm::Gathered(report) => report.first_page_to_html(),
            AssessmentForm::Written(written) => written.first_page_html.clone(),
        }
    }

    fn controllers(&self) -> Vec<String> {
        match &self.0 {
            AssessmentForm::Gathered(report) => report.provenance.config.controllers.clone(),
            AssessmentForm::Written(written) => written.controllers.clone(),
        }
    }

    fn gates_value(&self) -> PyResult<Value> {
        match &self.0 {
            AssessmentForm::Gathered(report) => serde_json::to_value(&report.summary.gates)
                .map_err(|error| PyValueError::new_err(error.to_string())),
            AssessmentForm::Written(written) => Ok(written.gates.clone()),
        }
    }
}

fn write_files(
    folder: &Path,
    files: &[(String, Vec<u8>)],
) -> Result<(), report::ReportFolderError> {
    report::ReportFolder::open(folder)?.write(files)
}

fn parse_json(text: &str) -> PyResult<Value> {
    serde_json::from_str(text).map_err(|error| PyValueError::new_err(error.to_string()))
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
    #[pyo3(from_py_with = parse_threads)] threads: Option<usize>,
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
    let begun = Instant::now();
    let identity = program::identity().map_err(|error| assessment_error(py, &error))?;
    let cache = match evidence {
        None => EvidenceCache::disabled(),
        Some(folder) => EvidenceCache::open(&folder, identity, fresh)
            .map_err(|error| assessment_error(py, &error))?,
    };
    let runs = plan.runs();
    let assessment = run_interruptible(py, &stop, progress.as_ref(), threads, |say| {
        report::assess(&plan, &cache, against.as_ref(), &|state: &RunProgress| {
            say((state.done, runs, 0))
        })
    })?;
    let gathered = assessment.map_err(|error| assessment_error(py, &error))?;
    let folder = path.as_deref().and_then(Path::parent);
    let folder = folder.unwrap_or(Path::new(""));
    let run_info = RunInfo::collect(folder, identity, PACKAGE_COMMIT, begun.elapsed());
    let gathered = gathered.with_run_info(run_info);
    Ok(PyAssessment(AssessmentForm::Gathered(Box::new(gathered))))
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
            path,
            line,
            invalid,
        } => errors::exception_at(
            py,
            ExceptionClass::Assessment,
            error,
            (Some(path), Some(*line), Some(&invalid.field)),
        ),
        other => errors::exception(py, ExceptionClass::Assessment, other),
    }
}
