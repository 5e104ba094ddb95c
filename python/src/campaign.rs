//! Searches for failures.

use std::path::PathBuf;

use crumple_search::falsify::campaign::{Campaign, CampaignOptions, CampaignProgress};
use crumple_search::falsify::{FailureCriterion, Relation};
use crumple_world::measure::Specification;
use pyo3::prelude::*;

use crate::controller;
use crate::errors::{self, Class};
use crate::scenario::Space;
use crate::simulation::ESTIMATORS;
use crate::values::{choice, written};
use crate::interruptible::{Stop, watched};

/// Searches a space for failures of a controller; the campaign's summary, and the same as text.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the Python half names every argument")]
pub(crate) fn falsify<'py>(
    py: Python<'py>,
    controller: &Bound<'py, PyAny>,
    space: PyRef<'py, Space>,
    spec: &str,
    beside: (Option<Bound<'py, PyAny>>, Option<String>),
    method: &str,
    aim: &str,
    budget: u64,
    seed: u64,
    estimator: &str,
    folder: PathBuf,
    resume: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, String)> {
    let stop = Stop::default();
    let wrong = |error: &dyn std::fmt::Display| errors::raised(py, Class::Campaign, &error.to_string());
    let space = space.0.clone();
    let nominal = space.scenario(&space.nominal()).map_err(|error| errors::of_field(py, &error))?;
    let contrast = match beside {
        (None, None) => None,
        (Some(other), None) => Some(FailureCriterion::Against(controller::named(&other, &stop)?)),
        (None, Some(relation)) => {
            Some(FailureCriterion::Metamorphic(relation.parse::<Relation>().map_err(|error| wrong(&error))?))
        }
        (Some(_), Some(_)) => return Err(wrong(&"against and metamorphic do not go together")),
    };
    let campaign = Campaign {
        contrast,
        controller: controller::named(controller, &stop)?,
        estimator: choice("estimator", estimator, &ESTIMATORS)?,
        space,
        specification: Specification::parse(spec, &nominal).map_err(|error| wrong(&format!("spec: {error}")))?,
        method: method.parse().map_err(|error| wrong(&error))?,
        aim: aim.parse().map_err(|error| wrong(&error))?,
        budget,
        seed,
    };
    let total = budget.saturating_mul(campaign.methods().len() as u64);
    let summary = watched(py, &stop, progress.as_ref(), |say| {
        let options = CampaignOptions { resume, ..CampaignOptions::default() };
        campaign.run(&folder, options, &|state: &CampaignProgress| say((state.evaluations, total, state.failures)))
    })?;
    let summary = summary.map_err(|error| wrong(&error))?;
    Ok((written(py, &summary)?, summary.to_text()))
}
