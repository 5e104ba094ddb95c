//! Failure rates.

use std::path::PathBuf;

use crumple_evidence::{CountProgress, RateConfig, RateFolderError, RatePlan};
use crumple_store::study::Study;
use crumple_verify::check;
use pyo3::prelude::*;

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::scenario::PySpace;
use crate::simulation::ESTIMATORS;
use crate::values::{parse_choice, serialize_to_python};

/// Tally, certificate if anything is shown, and the checker's conclusion or the reason why nothing is shown.
type RateResult<'py> = (Bound<'py, PyAny>, Option<Bound<'py, PyAny>>, String);

/// Counts the failures of a controller, or of two on the same random scenarios, and certifies the result.
#[pyfunction]
#[expect(
    clippy::too_many_arguments,
    reason = "the Python half names every argument"
)]
pub(crate) fn rate<'py>(
    py: Python<'py>,
    controller: &Bound<'py, PyAny>,
    against: Option<&Bound<'py, PyAny>>,
    space: PyRef<'py, PySpace>,
    runs: u64,
    confidence: f64,
    seed: u64,
    estimator: &str,
    folder: PathBuf,
    resume: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<RateResult<'py>> {
    let stop = StopFlag::default();
    let wrong = |error: &dyn std::fmt::Display| {
        errors::exception(py, ExceptionClass::Rate, &error.to_string())
    };
    let second_controller = against
        .map(|against| controller::resolve_controller(against, &stop))
        .transpose()?;
    let plan = RatePlan::new(RateConfig {
        second_controller,
        seed,
        estimator: parse_choice("estimator", estimator, &ESTIMATORS)?,
        confidence,
        ..RateConfig::new(
            controller::resolve_controller(controller, &stop)?,
            space.0.clone(),
            runs,
        )
    })
    .map_err(|error| wrong(&error))?;
    let counted = run_interruptible(py, &stop, progress.as_ref(), |say| {
        plan.run(&folder, resume, &|state: &CountProgress| {
            say((state.runs, runs, state.failures))
        })
    })?
    .map_err(|error: RateFolderError| wrong(&error))?;
    let tally = serialize_to_python(py, &counted.tally)?;
    Ok(match counted.certificate {
        Ok(certificate) => {
            let words = check(&certificate)
                .map(|accepted| accepted.to_string())
                .unwrap_or_default();
            (tally, Some(serialize_to_python(py, &certificate)?), words)
        }
        Err(rejection) => (tally, None, rejection.to_string()),
    })
}
