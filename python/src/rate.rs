//! Failure rates.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use crumple_core::observer::{RunProgress, Stopped};
use crumple_evidence::exposure::{DEFAULT_RUNS_PER_RESAMPLE, MIN_RESAMPLES, RatePerExposure};
use crumple_evidence::{
    BlockSource, CERTIFICATE_FILE, CountProgress, CountReport, CountResult, CountedBlock,
    CountedBlocks, InvalidRate, PoolCheck, RateConfig, RateFolderError, RatePlan, RemoteCountError,
};
use crumple_store::study::Study;
use crumple_verify::{Certificate, Rejection, WorkLimit};
use pyo3::prelude::*;

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{ReportProgress, StopFlag, run_interruptible, wait_interruptible};
use crate::scenario::PySpace;
use crate::simulation::ESTIMATORS;
use crate::threads::parse_threads;
use crate::values::{parse_choice, serialize_to_python};

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

/// Parameters of the registration of a count.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct CountParameters<'py> {
    controller: Bound<'py, PyAny>,
    against: Option<Bound<'py, PyAny>>,
    space: PyRef<'py, PySpace>,
    runs: u64,
    confidence: f64,
    seed: u64,
    estimator: String,
}

impl CountParameters<'_> {
    fn to_plan(&self, py: Python<'_>, stop: &StopFlag) -> PyResult<RatePlan> {
        let controller = controller::resolve_controller(&self.controller, stop)?;
        let against = self.against.as_ref();
        let config = RateConfig {
            second_controller: against
                .map(|against| controller::resolve_controller(against, stop))
                .transpose()?,
            seed: self.seed,
            estimator: parse_choice("estimator", &self.estimator, &ESTIMATORS)?,
            confidence: self.confidence,
            ..RateConfig::new(controller, self.space.0.clone(), self.runs)
        };
        RatePlan::new(config).map_err(|error| match error {
            InvalidRate::NoIdentity { controller } => {
                let problem = format!("identity: the controller `{controller}` states none");
                rate_error_of(py, &format!("{problem}; {NEEDED_IDENTITY}"), "identity")
            }
            InvalidRate::OutOfRange(error) => rate_error_of(py, &error, &error.field),
            other => rate_error(py, &other),
        })
    }
}

/// Counts the failures of a controller, or of two on the same random scenarios, and certifies the result. With
/// `counter`, takes the counted blocks from it: see [`PythonBlockSource`]. The result does not name a temporary folder.
#[pyfunction]
#[expect(
    clippy::too_many_arguments,
    reason = "the Python half names every argument"
)]
pub(crate) fn rate<'py>(
    py: Python<'py>,
    parameters: CountParameters<'py>,
    resamples: u32,
    folder: PathBuf,
    is_temporary: bool,
    resume: bool,
    #[pyo3(from_py_with = parse_threads)] threads: Option<usize>,
    counter: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<RateFields<'py>> {
    let stop = StopFlag::default();
    let mut plan = parameters
        .to_plan(py, &stop)?
        .with_resampling(check_resamples(py, resamples)?, DEFAULT_RUNS_PER_RESAMPLE);
    let source = counter.map(|poll| Arc::new(PythonBlockSource::new(poll, &stop)));
    if let Some(source) = &source {
        plan = plan.with_block_source(Arc::clone(source) as Arc<dyn BlockSource>);
    }
    let count = |say: ReportProgress<'_>| {
        plan.run(&folder, resume, &|state: &CountProgress| {
            say((state.runs, state.total, state.failures))
        })
    };
    let counted = match &source {
        None => run_interruptible(py, &stop, progress.as_ref(), threads, count)?,
        Some(source) => {
            let counted = wait_interruptible(py, &stop, progress.as_ref(), count)?;
            source.raise()?;
            counted
        }
    };
    let counted = counted.map_err(|error: RateFolderError| match error {
        RateFolderError::RunFolder(error) => {
            errors::run_folder_exception(py, ExceptionClass::Rate, &error, "folder")
        }
        other => rate_error(py, &other),
    })?;
    let exposed = rate_per_exposure(py, &plan, &counted, &stop, threads, progress.as_ref())?;
    let path = folder.join(CERTIFICATE_FILE);
    let report = CountReport::new(&plan, &counted, folder, path).with_exposure(exposed);
    let report = match is_temporary {
        true => report.without_folder(),
        false => report,
    };
    RateFields::new(py, &counted, &report)
}

/// Counts blocks of a plan for [`rate`] in another process. Returns [`CountedBlocks`] as JSON.
#[pyfunction]
pub(crate) fn count_blocks(
    py: Python<'_>,
    parameters: CountParameters<'_>,
    first: u64,
    end: u64,
    #[pyo3(from_py_with = parse_threads)] threads: Option<usize>,
) -> PyResult<String> {
    let stop = StopFlag::default();
    let plan = parameters.to_plan(py, &stop)?;
    let counted = run_interruptible(py, &stop, None, threads, |say| {
        CountedBlocks::count(&plan, first..end, &|state: &RunProgress| {
            say((state.done, 0, 0))
        })
    })?;
    let counted = counted.map_err(|error| rate_error(py, &error))?;
    serde_json::to_string(&counted).map_err(|error| rate_error(py, &error))
}

/// Interval at which a waiting count asks for blocks.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

/// Blocks from a Python callable. It takes the index of the next block, the number of all blocks and that of runs in a
/// block, and returns [`CountedBlocks`] as JSON, or None while there are none.
struct PythonBlockSource {
    poll: Py<PyAny>,
    stop: StopFlag,
    raised: Mutex<Option<PyErr>>,
}

impl PythonBlockSource {
    fn new(poll: Py<PyAny>, stop: &StopFlag) -> Self {
        Self {
            poll,
            stop: stop.clone(),
            raised: Mutex::new(None),
        }
    }

    /// Returns the exception of the callable as an error, if it raised one.
    fn raise(&self) -> PyResult<()> {
        let mut raised = self.raised.lock().unwrap_or_else(PoisonError::into_inner);
        raised.take().map_or(Ok(()), Err)
    }

    fn ask(&self, plan: &RatePlan, first: u64) -> Result<Option<String>, RemoteCountError> {
        let block_runs = plan.registration().block_runs.unwrap_or_default();
        let asked = Python::attach(|py| {
            let answer = self.poll.call1(py, (first, plan.block_count(), block_runs));
            answer?.extract::<Option<String>>(py)
        });
        asked.map_err(|error| {
            let problem = error.to_string();
            let mut raised = self.raised.lock().unwrap_or_else(PoisonError::into_inner);
            *raised = Some(error);
            RemoteCountError::Source(problem)
        })
    }
}

impl BlockSource for PythonBlockSource {
    fn next_blocks(
        &self,
        plan: &RatePlan,
        first: u64,
    ) -> Result<Vec<CountedBlock>, RemoteCountError> {
        while !self.stop.is_set() {
            if let Some(text) = self.ask(plan, first)? {
                let counted: CountedBlocks = serde_json::from_str(&text)
                    .map_err(|error| RemoteCountError::Source(error.to_string()))?;
                return counted.into_blocks_of(plan, first);
            }
            thread::sleep(POLL_INTERVAL);
        }
        Err(RemoteCountError::Stopped(Stopped))
    }
}

/// Pools certificates of several seeds, each as JSON. `seeds` are the first and the last expected seed. Returns the
/// report of `crumple check --pool --format json`, and its text.
#[pyfunction]
pub(crate) fn pool<'py>(
    py: Python<'py>,
    certificates: Vec<String>,
    seeds: Option<(u64, u64)>,
) -> PyResult<(Bound<'py, PyAny>, String)> {
    let mut pool = PoolCheck::new(WorkLimit::default(), controller::controllers());
    if let Some((first, last)) = seeds {
        pool = pool.with_expected_seeds(first..=last);
    }
    for (index, text) in certificates.iter().enumerate() {
        let refuse = |error: &dyn std::fmt::Display| {
            rate_error(py, &format!("certificate {index} of the pool: {error}"))
        };
        let certificate: Certificate =
            serde_json::from_str(text).map_err(|error| refuse(&error))?;
        pool.add(&certificate).map_err(|error| refuse(&error))?;
    }
    let report = pool.conclude().map_err(|error| rate_error(py, &error))?;
    Ok((serialize_to_python(py, &report)?, report.to_text()))
}

/// Returns failures per hour and per 1000 km, as `crumple verify rate` does after a proved count.
fn rate_per_exposure(
    py: Python<'_>,
    plan: &RatePlan,
    counted: &CountResult,
    stop: &StopFlag,
    threads: Option<usize>,
    progress: Option<&Py<PyAny>>,
) -> PyResult<Option<RatePerExposure>> {
    if counted.certificate.is_err() || plan.resampling().is_none() {
        return Ok(None);
    }
    let tally = &counted.tally;
    run_interruptible(py, stop, progress, threads, |say| {
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
            Err(rejection) => describe_rejection(rejection),
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
        return Err(rate_error_of(py, &problem, "resamples"));
    }
    Ok(resamples)
}

/// Rule for the identity of a controller in Python whose failures are counted.
const NEEDED_IDENTITY: &str = "a count has a certificate only if the `identity` of each controller in Python is a \
    SHA-256 (64 hexadecimal digits in lower case), for example of the file that defines it";

/// Returns the reason why there is no certificate.
fn describe_rejection(rejection: &Rejection) -> String {
    match rejection {
        Rejection::Invalid { field, .. } if CONTROLLER_HASHES.contains(&field.as_str()) => {
            format!("{rejection}: {NEEDED_IDENTITY}")
        }
        other => other.to_string(),
    }
}

/// Fields of a registration with the identities of controllers.
const CONTROLLER_HASHES: [&str; 2] = [
    "registration.configuration.controller_sha256",
    "registration.configuration.against_sha256",
];

/// Creates the exception of an argument.
fn rate_error_of(py: Python<'_>, error: &impl std::fmt::Display, argument: &str) -> PyErr {
    let location = (None, None, Some(argument));
    errors::exception_at(py, ExceptionClass::Rate, error, location)
}

fn rate_error(py: Python<'_>, error: &dyn std::fmt::Display) -> PyErr {
    errors::exception(py, ExceptionClass::Rate, &error.to_string())
}
