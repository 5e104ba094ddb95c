//! Falsification campaigns.

use std::path::PathBuf;

use crumple_search::falsify::FailureCriterion;
use crumple_search::falsify::campaign::{Campaign, CampaignOptions, CampaignProgress};
use crumple_world::measure::Specification;
use pyo3::prelude::*;

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::scenario::PySpace;
use crate::simulation::ESTIMATORS;
use crate::values::{parse_choice, serialize_to_python};

/// Searches a space for counterexamples. Returns the campaign's summary as data and as text.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the Python half names every argument")]
pub(crate) fn falsify<'py>(
    py: Python<'py>,
    controller: &Bound<'py, PyAny>,
    space: PyRef<'py, PySpace>,
    spec: &str,
    against: Option<Bound<'py, PyAny>>,
    method: &str,
    aim: &str,
    budget: u64,
    seed: u64,
    estimator: &str,
    folder: PathBuf,
    resume: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, String)> {
    let stop = StopFlag::default();
    let wrong = |error: &dyn std::fmt::Display| errors::exception(py, ExceptionClass::Campaign, &error.to_string());
    let space = space.0.clone();
    let nominal = space.scenario(&space.nominal()).map_err(|error| errors::field_exception(py, &error))?;
    let against = against.map(|other| controller::resolve_controller(&other, &stop)).transpose()?;
    let campaign = Campaign {
        failure_criterion: against.map(FailureCriterion::Differential),
        controller: controller::resolve_controller(controller, &stop)?,
        estimator: parse_choice("estimator", estimator, &ESTIMATORS)?,
        space,
        specification: Specification::parse(spec, &nominal).map_err(|error| wrong(&format!("spec: {error}")))?,
        method: method.parse().map_err(|error| wrong(&error))?,
        objective: aim.parse().map_err(|error| wrong(&error))?,
        budget,
        seed,
    };
    let total = budget.saturating_mul(campaign.methods().len() as u64);
    let summary = run_interruptible(py, &stop, progress.as_ref(), |say| {
        let options = CampaignOptions { resume, ..CampaignOptions::default() };
        campaign.run(&folder, options, &|state: &CampaignProgress| say((state.evaluations, total, state.failures)))
    })?;
    let summary = summary.map_err(|error| wrong(&error))?;
    Ok((serialize_to_python(py, &summary)?, summary.to_text()))
}
