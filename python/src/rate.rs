//! Failure rates.

use std::path::PathBuf;

use crumple_core::observer::RunProgress;
use crumple_evidence::exposure::{MIN_RESAMPLES, RatePerExposure};
use crumple_evidence::{
    CERTIFICATE_FILE, CountProgress, CountReport, CountResult, RateConfig, RateFolderError,
    RatePlan,
};
use crumple_store::study::Study;
use pyo3::prelude::*;

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::scenario::PySpace;
use crate::simulation::ESTIMATORS;
use crate::values::{parse_choice, serialize_to_python};

/// Runs in each resample, as on the command line.
const RUNS_PER_RESAMPLE: u32 = 500;

/// Fields of the Python class `Rate`.
#[derive(IntoPyObject)]
pub(crate) struct RateFields<'py> {
    tally: Bound<'py, PyAny>,
    /// Certificate, if the counts show anything.
    certificate: Option<Bound<'py, PyAny>>,
    /// Conclusion of the checker, or the reason why the counts show nothing.
    words: String,
    /// Output of `crumple verify rate --format json`.
    data: Bound<'py, PyAny>,
    /// Output of `crumple verify rate`.
    text: String,
}

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
    resamples: u32,
    folder: PathBuf,
    resume: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<RateFields<'py>> {
    let stop = StopFlag::default();
    let controller = controller::resolve_controller(controller, &stop)?;
    let config = RateConfig {
        second_controller: against
            .map(|against| controller::resolve_controller(against, &stop))
            .transpose()?,
        seed,
        estimator: parse_choice("estimator", estimator, &ESTIMATORS)?,
        confidence,
        ..RateConfig::new(controller, space.0.clone(), runs)
    };
    let plan = RatePlan::new(config)
        .map_err(|error| rate_error(py, &error))?
        .with_resampling(check_resamples(py, resamples)?, RUNS_PER_RESAMPLE);
    let counted = run_interruptible(py, &stop, progress.as_ref(), |say| {
        plan.run(&folder, resume, &|state: &CountProgress| {
            say((state.runs, runs, state.failures))
        })
    })?
    .map_err(|error: RateFolderError| rate_error(py, &error))?;
    let exposed = rate_per_exposure(py, &plan, &counted, &stop, progress.as_ref())?;
    let path = folder.join(CERTIFICATE_FILE);
    let report = CountReport::new(&plan, &counted, folder, path).with_exposure(exposed);
    RateFields::new(py, &counted, &report)
}

/// Returns failures per hour and per 1000 km, as `crumple verify rate` does after a proved count.
fn rate_per_exposure(
    py: Python<'_>,
    plan: &RatePlan,
    counted: &CountResult,
    stop: &StopFlag,
    progress: Option<&Py<PyAny>>,
) -> PyResult<Option<RatePerExposure>> {
    if counted.certificate.is_err() || plan.resampling().is_none() {
        return Ok(None);
    }
    let tally = &counted.tally;
    run_interruptible(py, stop, progress, |say| {
        // The count is complete; a call may still stop the work.
        plan.rate_per_exposure(tally, &|_: &RunProgress| {
            say((tally.runs, tally.runs, tally.failures))
        })
    })?
    .map_err(|error| rate_error(py, &error))
}

impl<'py> RateFields<'py> {
    fn new(py: Python<'py>, counted: &CountResult, report: &CountReport) -> PyResult<Self> {
        let certificate = counted.certificate.as_ref();
        let words = match certificate {
            Ok(_) => report.conclusion().unwrap_or_default().to_owned(),
            Err(rejection) => rejection.to_string(),
        };
        Ok(Self {
            tally: serialize_to_python(py, &counted.tally)?,
            certificate: certificate
                .ok()
                .map(|certificate| serialize_to_python(py, certificate))
                .transpose()?,
            words,
            data: serialize_to_python(py, report)?,
            text: report.to_text(),
        })
    }
}

fn check_resamples(py: Python<'_>, resamples: u32) -> PyResult<u32> {
    if (1..MIN_RESAMPLES).contains(&resamples) {
        let problem =
            format!("resamples: must be 0 or at least {MIN_RESAMPLES}, found {resamples}");
        return Err(rate_error(py, &problem));
    }
    Ok(resamples)
}

fn rate_error(py: Python<'_>, error: &dyn std::fmt::Display) -> PyErr {
    errors::exception(py, ExceptionClass::Rate, &error.to_string())
}
