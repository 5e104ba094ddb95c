//! Falsification campaigns, and comparisons of search methods.

use std::path::PathBuf;

use crumple_evidence::MethodComparison;
use crumple_measure::Specification;
use crumple_search::falsify::FailureCriterion;
use crumple_search::falsify::campaign::{
    Campaign, CampaignError, CampaignProgress, CampaignReport,
};
use crumple_store::study::Study;
use pyo3::prelude::*;

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::scenario::PySpace;
use crate::search_method::{RaisedException, resolve_method};
use crate::simulation::ESTIMATORS;
use crate::threads::parse_threads;
use crate::values::{parse_choice, serialize_to_python};

/// Searches a space for counterexamples. Returns the report of `crumple falsify` as data and as text.
#[pyfunction]
#[expect(
    clippy::too_many_arguments,
    reason = "the Python half names every argument"
)]
pub(crate) fn falsify<'py>(
    py: Python<'py>,
    controller: &Bound<'py, PyAny>,
    space: PyRef<'py, PySpace>,
    spec: &str,
    against: Option<Bound<'py, PyAny>>,
    method: &Bound<'py, PyAny>,
    aim: &str,
    budget: u64,
    seed: u64,
    estimator: &str,
    folder: PathBuf,
    resume: bool,
    #[pyo3(from_py_with = parse_threads)] threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, String)> {
    let stop = StopFlag::default();
    let raised = RaisedException::default();
    let campaign = Campaign {
        seed,
        ..campaign(py, controller, &space, spec, against, estimator, &stop)?
            .with_method(resolve_method(method, &raised)?)
            .with_objective(aim.parse().map_err(|error| wrong(py, &error))?)
            .with_budget(budget)
    };
    let total = budget.saturating_mul(campaign.methods().len() as u64);
    let summary = run_interruptible(py, &stop, progress.as_ref(), threads, |say| {
        campaign.run(&folder, resume, &|state: &CampaignProgress| {
            say((state.evaluations, total, state.failures))
        })
    })?;
    raised.take()?;
    let summary = summary.map_err(|error| campaign_error(py, &error))?;
    let report = CampaignReport::new(&summary);
    Ok((serialize_to_python(py, &report)?, summary.to_text()))
}

/// Compares search methods. Returns the results as data and as text.
#[pyfunction]
#[expect(
    clippy::too_many_arguments,
    reason = "the Python half names every argument"
)]
pub(crate) fn compare<'py>(
    py: Python<'py>,
    controller: &Bound<'py, PyAny>,
    space: PyRef<'py, PySpace>,
    spec: &str,
    against: Option<Bound<'py, PyAny>>,
    methods: Vec<Bound<'py, PyAny>>,
    seeds: u64,
    budget: u64,
    seed: u64,
    estimator: &str,
    #[pyo3(from_py_with = parse_threads)] threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, String)> {
    let stop = StopFlag::default();
    let raised = RaisedException::default();
    let campaign = Campaign {
        seed,
        ..campaign(py, controller, &space, spec, against, estimator, &stop)?.with_budget(budget)
    };
    let methods = methods
        .iter()
        .map(|method| resolve_method(method, &raised))
        .collect::<PyResult<Vec<_>>>()?;
    let compared = run_interruptible(py, &stop, progress.as_ref(), threads, |say| {
        let observe =
            |state: &CampaignProgress| say((state.evaluations, state.total, state.failures));
        MethodComparison::run(&campaign, &methods, seeds, &observe)
    })?;
    raised.take()?;
    let compared = compared.map_err(|error| campaign_error(py, &error))?;
    Ok((serialize_to_python(py, &compared)?, compared.to_text()))
}

/// Joins comparisons of consecutive seeds, each the data of [`compare`] as JSON. Returns the results as data and as
/// text.
#[pyfunction]
pub(crate) fn join_comparisons<'py>(
    py: Python<'py>,
    parts: Vec<String>,
) -> PyResult<(Bound<'py, PyAny>, String)> {
    let parts = parts
        .iter()
        .map(|part| serde_json::from_str(part))
        .collect::<Result<Vec<MethodComparison>, _>>()
        .map_err(|error| wrong(py, &error))?;
    let joined = MethodComparison::join(&parts)
        .ok_or_else(|| wrong(py, &"the comparisons of the seeds do not fit each other"))?;
    Ok((serialize_to_python(py, &joined)?, joined.to_text()))
}

/// Returns a campaign with the default method.
fn campaign<'py>(
    py: Python<'py>,
    controller: &Bound<'py, PyAny>,
    space: &PySpace,
    spec: &str,
    against: Option<Bound<'py, PyAny>>,
    estimator: &str,
    stop: &StopFlag,
) -> PyResult<Campaign> {
    let space = space.0.clone();
    let nominal = space
        .scenario(&space.nominal())
        .map_err(|error| errors::field_exception(py, &error))?;
    let against = against
        .map(|other| controller::resolve_controller(&other, stop))
        .transpose()?;
    Ok(Campaign {
        failure_criterion: against.map(FailureCriterion::Differential),
        estimator: parse_choice("estimator", estimator, &ESTIMATORS)?,
        specification: Specification::parse(spec, &nominal)
            .map_err(|error| wrong(py, &format!("spec: {error}")))?,
        ..Campaign::new(controller::resolve_controller(controller, stop)?, space)
    })
}

fn campaign_error(py: Python<'_>, error: &CampaignError) -> PyErr {
    match error {
        CampaignError::Work(error) => {
            errors::run_folder_exception(py, ExceptionClass::Campaign, error, "folder")
        }
        CampaignError::OutOfRange(error) => {
            let location = (None, None, Some(error.field.as_str()));
            errors::exception_at(py, ExceptionClass::Campaign, error, location)
        }
        other => wrong(py, other),
    }
}

fn wrong(py: Python<'_>, error: &dyn std::fmt::Display) -> PyErr {
    errors::exception(py, ExceptionClass::Campaign, &error.to_string())
}
