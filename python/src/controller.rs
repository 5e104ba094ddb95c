//! Controllers written in Python.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crumple_controllers::find_for_user;
use crumple_controllers::{Controllers, ExternalPrograms};
use crumple_sim::control::{BatchController, Controller, ControllerFailure, ControllerSource, Ego};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::{Neighbour, Observation as Seen};
use numpy::{AllowTypeChange, PyArray1, PyArrayLike1, PyArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::errors::{self, ExceptionClass};
use crate::interruptible::StopFlag;

/// Maximum number of characters of a traceback in a failure, which keeps the end.
const MAX_TRACEBACK_CHARS: usize = 4000;

const ROW_WIDTH: usize = 8;

/// Observation of a controller. Values of an absent vehicle are None.
#[pyclass(name = "Observation", frozen, get_all, module = "crumple")]
#[derive(Debug)]
pub(crate) struct PyObservation {
    speed_mps: f64,
    acceleration_mps2: f64,
    gap_ahead_m: Option<f64>,
    speed_ahead_mps: Option<f64>,
    acceleration_ahead_mps2: Option<f64>,
    gap_behind_m: Option<f64>,
    speed_behind_mps: Option<f64>,
    acceleration_behind_mps2: Option<f64>,
}

#[pymethods]
impl PyObservation {
    #[new]
    #[pyo3(signature = (
        *, speed_mps, acceleration_mps2, gap_ahead_m = None, speed_ahead_mps = None, acceleration_ahead_mps2 = None,
        gap_behind_m = None, speed_behind_mps = None, acceleration_behind_mps2 = None
    ))]
    #[expect(
        clippy::too_many_arguments,
        reason = "the arguments are the eight quantities"
    )]
    fn from_quantities(
        speed_mps: f64,
        acceleration_mps2: f64,
        gap_ahead_m: Option<f64>,
        speed_ahead_mps: Option<f64>,
        acceleration_ahead_mps2: Option<f64>,
        gap_behind_m: Option<f64>,
        speed_behind_mps: Option<f64>,
        acceleration_behind_mps2: Option<f64>,
    ) -> Self {
        Self {
            speed_mps,
            acceleration_mps2,
            gap_ahead_m,
            speed_ahead_mps,
            acceleration_ahead_mps2,
            gap_behind_m,
            speed_behind_mps,
            acceleration_behind_mps2,
        }
    }

    /// Returns the arguments of the constructor, for pickles.
    fn __getnewargs_ex__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyTuple>, Bound<'py, PyDict>)> {
        let quantities = PyDict::new(py);
        quantities.set_item("speed_mps", self.speed_mps)?;
        quantities.set_item("acceleration_mps2", self.acceleration_mps2)?;
        quantities.set_item("gap_ahead_m", self.gap_ahead_m)?;
        quantities.set_item("speed_ahead_mps", self.speed_ahead_mps)?;
        quantities.set_item("acceleration_ahead_mps2", self.acceleration_ahead_mps2)?;
        quantities.set_item("gap_behind_m", self.gap_behind_m)?;
        quantities.set_item("speed_behind_mps", self.speed_behind_mps)?;
        quantities.set_item("acceleration_behind_mps2", self.acceleration_behind_mps2)?;
        Ok((PyTuple::empty(py), quantities))
    }

    fn __repr__(&self) -> String {
        format!("{self:?}")
    }
}

impl PyObservation {
    fn new(seen: &Seen) -> Self {
        Self {
            speed_mps: seen.speed_mps,
            acceleration_mps2: seen.acceleration_mps2,
            gap_ahead_m: seen.ahead.map(|ahead| ahead.gap_m),
            speed_ahead_mps: seen.ahead.map(|ahead| ahead.speed_mps),
            acceleration_ahead_mps2: seen.ahead.map(|ahead| ahead.acceleration_mps2),
            gap_behind_m: seen.behind.map(|behind| behind.gap_m),
            speed_behind_mps: seen.behind.map(|behind| behind.speed_mps),
            acceleration_behind_mps2: seen.behind.map(|behind| behind.acceleration_mps2),
        }
    }

    /// Returns the row of a batch in the paper's order; values of an absent vehicle are NaN.
    fn row(seen: &Seen) -> [f64; ROW_WIDTH] {
        const ABSENT: Neighbour = Neighbour {
            gap_m: f64::NAN,
            speed_mps: f64::NAN,
            acceleration_mps2: f64::NAN,
        };
        let [ahead, behind] = [seen.ahead, seen.behind].map(|vehicle| vehicle.unwrap_or(ABSENT));
        [
            ahead.gap_m,
            behind.gap_m,
            ahead.speed_mps,
            seen.speed_mps,
            behind.speed_mps,
            ahead.acceleration_mps2,
            seen.acceleration_mps2,
            behind.acceleration_mps2,
        ]
    }
}

/// Allows this process to start the programs and to load the FMUs that files name, like `--allow-external`. Without it,
/// only controllers that a call names start. Cannot be undone.
#[pyfunction]
pub(crate) fn allow_external() {
    IS_EXTERNAL_ALLOWED.store(true, Ordering::Relaxed);
}

/// True after [`allow_external`]: Python code has no value that its calls could pass on.
static IS_EXTERNAL_ALLOWED: AtomicBool = AtomicBool::new(false);

/// Returns the opener of controllers that files name.
pub(crate) fn controllers() -> Controllers {
    let external = match IS_EXTERNAL_ALLOWED.load(Ordering::Relaxed) {
        true => ExternalPrograms::Allowed,
        false => ExternalPrograms::Refused,
    };
    Controllers { external }
}

/// Resolves a name as on the command line, or a `crumple.Controller`.
pub(crate) fn resolve_controller(
    controller: &Bound<'_, PyAny>,
    stop: &StopFlag,
) -> PyResult<NamedController> {
    let py = controller.py();
    if let Ok(name) = controller.extract::<String>() {
        return find_for_user(&name, Path::new(""))
            .map_err(|error| errors::exception(py, ExceptionClass::Controller, &error));
    }
    let decide = controller.getattr("decide")?;
    if !decide.is_callable() {
        return Err(PyTypeError::new_err(
            "a controller is a name, a callable or a crumple.Controller",
        ));
    }
    let interval_s: Option<f64> = controller.getattr("interval_s")?.extract()?;
    if interval_s.is_some_and(|interval_s| !(interval_s > 0.0 && interval_s.is_finite())) {
        return Err(PyValueError::new_err(
            "interval_s must be a positive number of seconds, or None",
        ));
    }
    let mode = CallMode::from_controller(controller)?;
    let warns = controller.getattr("warns")?.is_truthy()?;
    if warns && mode == CallMode::Batch {
        return Err(PyValueError::new_err(
            "a batch reports no warnings: choose batch or warns",
        ));
    }
    let callable = Arc::new(PythonCallable {
        decide: decide.unbind(),
        mode,
        warns,
        stop: stop.clone(),
    });
    let identity = controller.getattr("identity")?.extract()?;
    let name: String = controller.getattr("name")?.extract()?;
    Ok(NamedController::from_source(
        &name,
        Arc::new(PythonSource {
            callable,
            interval_s,
            identity,
        }),
    ))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CallMode {
    /// Takes an observation.
    Single,
    /// Takes an array of observations.
    Batch,
    /// Creates, for each run, a callable that takes an observation.
    PerRun,
}

/// Callable that is not called any more once `stop` is set.
impl CallMode {
    fn from_controller(controller: &Bound<'_, PyAny>) -> PyResult<Self> {
        let is_batch = controller.getattr("batch")?.is_truthy()?;
        let is_per_run = controller.getattr("each_run")?.is_truthy()?;
        match [is_batch, is_per_run] {
            [false, false] => Ok(Self::Single),
            [true, false] => Ok(Self::Batch),
            [false, true] => Ok(Self::PerRun),
            [true, true] => Err(PyValueError::new_err(
                "a batch has no run of its own: choose batch or each_run",
            )),
        }
    }
}

struct PythonCallable {
    decide: Py<PyAny>,
    mode: CallMode,
    /// True if it returns an acceleration and whether it warns the driver.
    warns: bool,
    stop: StopFlag,
}

struct PythonSource {
    callable: Arc<PythonCallable>,
    interval_s: Option<f64>,
    identity: Option<String>,
}

impl ControllerSource for PythonSource {
    fn identity(&self) -> Option<String> {
        self.identity.clone()
    }

    fn interval_s(&self) -> Option<f64> {
        self.interval_s
    }

    fn batch_controller(&self) -> Option<&dyn BatchController> {
        (self.callable.mode == CallMode::Batch).then_some(&*self.callable)
    }

    fn start(&self, ego: &Ego, seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        if self.callable.mode != CallMode::PerRun {
            return Ok(Box::new(PythonDriver::new(Arc::clone(&self.callable))));
        }
        self.callable.check_stop()?;
        let decide = Python::attach(|py| {
            self.callable
                .decide
                .call1(py, (ego.vehicle, seed))
                .map_err(|error| failure_from_exception(py, &error))
        })?;
        let called = PythonCallable {
            decide,
            mode: CallMode::Single,
            warns: self.callable.warns,
            stop: self.callable.stop.clone(),
        };
        Ok(Box::new(PythonDriver::new(Arc::new(called))))
    }

    fn reports_warnings(&self) -> bool {
        self.callable.warns
    }
}

impl PythonCallable {
    fn check_stop(&self) -> Result<(), ControllerFailure> {
        if self.stop.is_set() {
            Err(failure("it was interrupted"))
        } else {
            Ok(())
        }
    }
}

impl BatchController for PythonCallable {
    fn decide_batch(
        &self,
        seen: &[Seen],
        answers_mps2: &mut [f64],
    ) -> Result<(), ControllerFailure> {
        self.check_stop()?;
        let rows: Vec<f64> = seen.iter().flat_map(PyObservation::row).collect();
        Python::attach(|py| {
            let rows = PyArray1::from_vec(py, rows)
                .reshape([seen.len(), ROW_WIDTH])
                .map_err(|error| failure_from_exception(py, &error))?;
            let answered = self
                .decide
                .bind(py)
                .call1((rows,))
                .map_err(|error| failure_from_exception(py, &error))?;
            let answered: PyArrayLike1<'_, f64, AllowTypeChange> = answered
                .extract()
                .map_err(|_| failure(format!("it answered no array of {} numbers", seen.len())))?;
            let answered = answered.as_array();
            if answered.len() != answers_mps2.len() {
                return Err(failure(format!(
                    "it answered {} numbers to {} rows",
                    answered.len(),
                    seen.len()
                )));
            }
            answers_mps2
                .iter_mut()
                .zip(answered)
                .for_each(|(answer_mps2, answered)| *answer_mps2 = *answered);
            Ok(())
        })
    }
}

/// Controller of one vehicle by a callable.
struct PythonDriver {
    callable: Arc<PythonCallable>,
    is_warning: bool,
}

impl PythonDriver {
    fn new(callable: Arc<PythonCallable>) -> Self {
        Self {
            callable,
            is_warning: false,
        }
    }
}

impl Controller for PythonDriver {
    fn decide(&mut self, seen: &Seen) -> Result<f64, ControllerFailure> {
        let callable = &self.callable;
        if callable.mode == CallMode::Batch {
            let mut answer_mps2 = [0.0];
            callable.decide_batch(std::slice::from_ref(seen), &mut answer_mps2)?;
            return Ok(answer_mps2[0]);
        }
        callable.check_stop()?;
        let (answer_mps2, is_warning) = Python::attach(|py| {
            let answered = callable.decide.bind(py).call1((PyObservation::new(seen),));
            answered
                .and_then(|answered| match callable.warns {
                    true => answered.extract::<(f64, bool)>(),
                    false => Ok((answered.extract()?, false)),
                })
                .map_err(|error| failure_from_exception(py, &error))
        })?;
        self.is_warning = is_warning;
        Ok(answer_mps2)
    }

    fn is_warning(&self) -> bool {
        self.is_warning
    }
}

fn failure(message: impl Into<String>) -> ControllerFailure {
    ControllerFailure::Died {
        message: message.into(),
    }
}

/// Returns a failure with the end of the exception's traceback.
fn failure_from_exception(py: Python<'_>, error: &PyErr) -> ControllerFailure {
    let traceback = error
        .traceback(py)
        .and_then(|traceback| traceback.format().ok())
        .unwrap_or_default();
    let text = format!("{traceback}{error}");
    let skipped = text.chars().count().saturating_sub(MAX_TRACEBACK_CHARS);
    failure(text.chars().skip(skipped).collect::<String>())
}
