//! Simulations: outcomes, and traces as arrays.

use std::ops::ControlFlow;
use std::sync::Arc;

use crumple_evidence::describe_followers;
use crumple_measure::{ReportedController, RunReport, Specification};
use crumple_sim::control::{BuiltInController, NoSettings, TwoSidedSettings};
use crumple_sim::engine::{
    self, AfterCollision, Impact, Intervention, Outcome, RecordingLevel, Run, RunError, RunOptions,
    SimulationResult, VehicleSummary, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::{PyFutureWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyTuple};
use serde::{Deserialize, Serialize};

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::figure::PyFigure;
use crate::interruptible::{ProgressCounts, StopFlag, run_interruptible};
use crate::scenario::PyScenario;
use crate::table;
use crate::threads::parse_threads;
use crate::values::{parse_choice, serialize_to_python};

const MISSING_TRACE: &str = "the simulation kept no trace: simulate with trace=True";

/// Number of runs between two checks for an interrupt.
const BATCH_SIZE: usize = 512;

pub(crate) const ESTIMATORS: [(&str, EstimatorKind); 2] = [
    ("kalman", EstimatorKind::Kalman),
    ("truth", EstimatorKind::Truth),
];

const AFTER_COLLISION: [(&str, AfterCollision); 2] = [
    ("stop", AfterCollision::Stop),
    ("continue", AfterCollision::Continue),
];

/// Motion of one vehicle: arrays with one entry per sample.
#[pyclass(name = "Track", frozen, get_all, module = "crumple")]
pub(crate) struct PyTrack {
    length_m: f64,
    mass_kg: f64,
    position_m: Py<PyArray1<f64>>,
    speed_mps: Py<PyArray1<f64>>,
    acceleration_mps2: Py<PyArray1<f64>>,
    in_lane_s: [f64; 2],
}

/// Motion of all vehicles of a run.
#[pyclass(name = "Trace", frozen, get_all, module = "crumple")]
pub(crate) struct PyTrace {
    time_s: Py<PyArray1<f64>>,
    vehicles: Vec<Py<PyTrack>>,
}

impl PyTrace {
    /// Moves the samples without a copy.
    fn new(py: Python<'_>, trace: engine::Trace) -> PyResult<Self> {
        Ok(Self {
            time_s: PyArray1::from_vec(py, trace.time_s).unbind(),
            vehicles: trace
                .vehicles
                .into_iter()
                .map(|track| Py::new(py, PyTrack::new(py, track)))
                .collect::<PyResult<_>>()?,
        })
    }

    /// Copies the present samples; the caller may have changed the arrays.
    fn to_native(&self, py: Python<'_>) -> PyResult<engine::Trace> {
        let vehicles = self
            .vehicles
            .iter()
            .map(|track| track.get().to_native(py))
            .collect::<PyResult<_>>()?;
        Ok(engine::Trace {
            time_s: copy_samples(py, &self.time_s)?,
            vehicles,
        })
    }
}

impl PyTrack {
    fn new(py: Python<'_>, track: engine::Track) -> Self {
        Self {
            length_m: track.length_m,
            mass_kg: track.mass_kg,
            position_m: PyArray1::from_vec(py, track.position_m).unbind(),
            speed_mps: PyArray1::from_vec(py, track.speed_mps).unbind(),
            acceleration_mps2: PyArray1::from_vec(py, track.acceleration_mps2).unbind(),
            in_lane_s: track.in_lane_s,
        }
    }

    fn to_native(&self, py: Python<'_>) -> PyResult<engine::Track> {
        Ok(engine::Track {
            length_m: self.length_m,
            mass_kg: self.mass_kg,
            position_m: copy_samples(py, &self.position_m)?,
            speed_mps: copy_samples(py, &self.speed_mps)?,
            acceleration_mps2: copy_samples(py, &self.acceleration_mps2)?,
            in_lane_s: self.in_lane_s,
        })
    }
}

fn copy_samples(py: Python<'_>, array: &Py<PyArray1<f64>>) -> PyResult<Vec<f64>> {
    Ok(array.bind(py).try_readonly()?.as_array().to_vec())
}

#[pymethods]
impl PyTrack {
    #[new]
    fn from_samples(
        length_m: f64,
        mass_kg: f64,
        position_m: Py<PyArray1<f64>>,
        speed_mps: Py<PyArray1<f64>>,
        acceleration_mps2: Py<PyArray1<f64>>,
        in_lane_s: [f64; 2],
    ) -> Self {
        Self {
            length_m,
            mass_kg,
            position_m,
            speed_mps,
            acceleration_mps2,
            in_lane_s,
        }
    }

    /// Returns the arguments of the constructor, for pickles.
    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let arrays = [&self.position_m, &self.speed_mps, &self.acceleration_mps2];
        let [position_m, speed_mps, acceleration_mps2] = arrays.map(|array| array.bind(py));
        (
            self.length_m,
            self.mass_kg,
            position_m,
            speed_mps,
            acceleration_mps2,
            self.in_lane_s,
        )
            .into_pyobject(py)
    }
}

#[pymethods]
impl PyTrace {
    #[new]
    fn from_tracks(time_s: Py<PyArray1<f64>>, vehicles: Vec<Py<PyTrack>>) -> Self {
        Self { time_s, vehicles }
    }

    /// Returns the arguments of the constructor, for pickles.
    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let vehicles: Vec<_> = self.vehicles.iter().map(|track| track.bind(py)).collect();
        (self.time_s.bind(py), vehicles).into_pyobject(py)
    }

    /// Returns the table of `crumple simulate --trace` as an Arrow stream. Ignores a requested schema.
    #[pyo3(signature = (requested_schema = None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema;
        let stream = table::arrow_stream(&self.to_native(py)?)
            .map_err(|error| errors::exception(py, ExceptionClass::Run, &error))?;
        PyCapsule::new_with_value(py, stream, c"arrow_array_stream")
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.time_s.bind(py).len().unwrap_or_default()
    }
}

/// Result of a run.
#[pyclass(frozen, module = "crumple")]
pub(crate) struct Simulation {
    scenario: Scenario,
    controller: Arc<str>,
    is_deterministic: bool,
    has_two_sided_shield: bool,
    estimator: EstimatorKind,
    dt_s: Option<f64>,
    after_collision: AfterCollision,
    /// Settings of the levels that the report has; `None` for a report without levels.
    level_settings: Option<String>,
    /// Result without its trace.
    result: SimulationResult,
    #[pyo3(get)]
    trace: Option<Py<PyTrace>>,
}

/// Parts of a result without its trace, for pickles.
#[derive(Serialize, Deserialize)]
struct PickledResult {
    is_deterministic: bool,
    has_two_sided_shield: bool,
    estimator: String,
    dt_s: Option<f64>,
    after_collision: AfterCollision,
    level_settings: Option<String>,
    outcome: Outcome,
    impacts: Vec<Impact>,
    vehicles: Vec<VehicleSummary>,
    interventions: Vec<Intervention>,
}

#[pymethods]
impl Simulation {
    /// Restores a pickled simulation.
    #[new]
    fn from_pickle(
        scenario: PyRef<'_, PyScenario>,
        controller: &str,
        result: &str,
        trace: Option<Py<PyTrace>>,
    ) -> PyResult<Self> {
        let parts: PickledResult = serde_json::from_str(result)
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok(Self {
            scenario: scenario.0.clone(),
            controller: controller.into(),
            is_deterministic: parts.is_deterministic,
            has_two_sided_shield: parts.has_two_sided_shield,
            estimator: parse_choice("estimator", &parts.estimator, &ESTIMATORS)?,
            dt_s: parts.dt_s,
            after_collision: parts.after_collision,
            level_settings: parts.level_settings,
            result: SimulationResult {
                outcome: parts.outcome,
                impacts: parts.impacts,
                vehicles: parts.vehicles,
                interventions: parts.interventions,
                trace: None,
            },
            trace,
        })
    }

    /// Returns the arguments of the constructor, for pickles. The controller is not needed any more.
    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let result = self.result.clone();
        let parts = PickledResult {
            is_deterministic: self.is_deterministic,
            has_two_sided_shield: self.has_two_sided_shield,
            estimator: self.estimator.name().to_owned(),
            dt_s: self.dt_s,
            after_collision: self.after_collision,
            level_settings: self.level_settings.clone(),
            outcome: result.outcome,
            impacts: result.impacts,
            vehicles: result.vehicles,
            interventions: result.interventions,
        };
        let text = serde_json::to_string(&parts)
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        let trace = self.trace.as_ref().map(|trace| trace.bind(py));
        (self.scenario(), &*self.controller, text, trace).into_pyobject(py)
    }

    #[getter]
    fn scenario(&self) -> PyScenario {
        PyScenario(self.scenario.clone())
    }

    #[getter]
    fn controller(&self) -> &str {
        &self.controller
    }

    #[getter]
    fn outcome(&self) -> &'static str {
        match self.result.outcome {
            Outcome::NoCollision => "no_collision",
            Outcome::Collision(_) => "collision",
            Outcome::ControllerFailed(_) => "controller_failed",
        }
    }

    #[getter]
    fn is_safe(&self) -> bool {
        self.result.outcome.is_safe()
    }

    #[getter]
    fn collision<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.result
            .outcome
            .collision()
            .map(|collision| serialize_to_python(py, collision))
            .transpose()
    }

    /// Returns [`Self::collision`] by its name in releases up to 0.3.0.
    #[getter]
    fn contact<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let message = c"`contact` is now `collision`; releases after 0.5 will have no `contact`";
        PyErr::warn(py, &py.get_type::<PyFutureWarning>(), message, 1)?;
        self.collision(py)
    }

    #[getter]
    fn failure(&self) -> Option<String> {
        self.result
            .outcome
            .failed_controller()
            .map(ToString::to_string)
    }

    #[getter]
    fn impacts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        serialize_to_python(py, &self.result.impacts)
    }

    #[getter]
    fn vehicles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        serialize_to_python(py, &self.result.vehicles)
    }

    #[getter]
    fn interventions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        serialize_to_python(py, &self.result.interventions)
    }

    /// Returns the robustness of a specification, as `crumple simulate --spec` does.
    fn robustness(&self, py: Python<'_>, spec: &str) -> PyResult<f64> {
        let specification = Specification::parse(spec, &self.scenario)
            .map_err(|error| errors::exception(py, ExceptionClass::Formula, &error))?;
        let has_other_end = self.after_collision != specification.after_collision();
        if has_other_end && self.result.outcome.collision().is_some() {
            let how = if specification.recording_level() == RecordingLevel::Trace {
                "continue"
            } else {
                "stop"
            };
            let problem = format!("`{spec}` is evaluated on a run with after_collision=\"{how}\"");
            return Err(errors::exception(py, ExceptionClass::Formula, &problem));
        }
        let run = self
            .run()
            .map_err(|error| errors::exception(py, ExceptionClass::Formula, &error))?;
        let mut simulated = self.result.clone();
        if specification.recording_level() == RecordingLevel::Trace {
            simulated.trace = Some(self.native_trace(py)?);
        }
        specification
            .evaluate(&run, &simulated)
            .map(|verdict| verdict.robustness)
            .map_err(|error| errors::exception(py, ExceptionClass::Formula, &error))
    }

    /// Returns the simulation with the level of each vehicle under test, as `crumple simulate --level` computes it.
    #[pyo3(signature = (settings = ""))]
    fn with_levels(&self, py: Python<'_>, settings: &str) -> PyResult<Self> {
        TwoSidedSettings::parse_for_levels(settings)
            .map_err(|error| errors::exception(py, ExceptionClass::Run, &error))?;
        let Some(trace) = &self.trace else {
            return Err(errors::exception(py, ExceptionClass::Run, &MISSING_TRACE));
        };
        Ok(Self {
            scenario: self.scenario.clone(),
            controller: Arc::clone(&self.controller),
            is_deterministic: self.is_deterministic,
            has_two_sided_shield: self.has_two_sided_shield,
            estimator: self.estimator,
            dt_s: self.dt_s,
            after_collision: self.after_collision,
            level_settings: Some(settings.to_owned()),
            result: self.result.clone(),
            trace: Some(trace.clone_ref(py)),
        })
    }

    /// Returns the levels, one dictionary for each vehicle; empty without [`Self::with_levels`].
    #[getter]
    fn levels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.with_report(py, |report| serialize_to_python(py, &report.levels))?
    }

    /// Draws position, speed and gap over time.
    #[pyo3(signature = (layout = "wide"))]
    fn plot(&self, py: Python<'_>, layout: &str) -> PyResult<PyFigure> {
        let title = format!("{}, {}", self.scenario.spec().name, self.controller);
        PyFigure::from_motion(
            &self.scenario,
            &title,
            &self.native_trace(py)?,
            &self.result.impacts,
            layout,
        )
    }

    /// Returns the output of `crumple simulate --format json`. Without a trace, it has no unnecessary braking.
    #[getter]
    fn data<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.with_report(py, |report| serialize_to_python(py, report))?
    }

    fn __str__(&self, py: Python<'_>) -> PyResult<String> {
        self.with_report(py, |report| report.to_text())
    }

    fn __repr__(&self) -> String {
        format!(
            "<crumple.Simulation {:?}, {}: {}>",
            self.scenario.spec().name,
            self.controller,
            self.outcome()
        )
    }
}

impl Simulation {
    /// Creates the simulation of a run, and moves its trace to Python.
    fn new(
        py: Python<'_>,
        scenario: Scenario,
        (name, reported): (&Arc<str>, ReportedController<'_>),
        options: &RunOptions,
        mut result: SimulationResult,
    ) -> PyResult<Self> {
        let trace = result
            .trace
            .take()
            .map(|trace| Py::new(py, PyTrace::new(py, trace)?))
            .transpose()?;
        Ok(Self {
            scenario,
            controller: Arc::clone(name),
            is_deterministic: reported.is_deterministic,
            has_two_sided_shield: reported.has_two_sided_shield,
            estimator: options.estimator,
            dt_s: options.dt_s,
            after_collision: options.after_collision,
            level_settings: None,
            result,
            trace,
        })
    }

    /// Returns a run of the scenario, for measures of the result, which do not ask the controller.
    fn run(&self) -> Result<Run, RunError> {
        let mut options = RunOptions::new(BuiltInController::FullThrottle(NoSettings::default()))
            .with_estimator(self.estimator)
            .with_after_collision(self.after_collision);
        options.dt_s = self.dt_s;
        Run::new(&self.scenario, options)
    }

    /// Calls a function with the report of the run.
    fn with_report<T>(
        &self,
        py: Python<'_>,
        read: impl FnOnce(&RunReport<'_>) -> T,
    ) -> PyResult<T> {
        let run = self
            .run()
            .map_err(|error| errors::exception(py, ExceptionClass::Run, &error))?;
        let trace = self.trace.as_ref();
        let result = SimulationResult {
            trace: trace.map(|trace| trace.get().to_native(py)).transpose()?,
            ..self.result.clone()
        };
        let controller = ReportedController {
            name: &self.controller,
            is_deterministic: self.is_deterministic,
            has_two_sided_shield: self.has_two_sided_shield,
        };
        let report = RunReport::new(&run, controller, &result);
        let Some(settings) = &self.level_settings else {
            return Ok(read(&report));
        };
        let settings = TwoSidedSettings::parse_for_levels(settings)
            .map_err(|error| errors::exception(py, ExceptionClass::Run, &error))?;
        Ok(read(&report.with_levels(
            &run,
            &result,
            &settings,
            describe_followers,
        )))
    }

    fn native_trace(&self, py: Python<'_>) -> PyResult<engine::Trace> {
        match &self.trace {
            Some(trace) => trace.get().to_native(py),
            None => Err(errors::exception(py, ExceptionClass::Run, &MISSING_TRACE)),
        }
    }
}

/// Simulates scenarios; returns one result each, in their order.
#[pyfunction]
#[expect(
    clippy::too_many_arguments,
    reason = "the Python half names every argument"
)]
pub(crate) fn simulate(
    py: Python<'_>,
    scenarios: Vec<PyRef<'_, PyScenario>>,
    controller: &Bound<'_, PyAny>,
    estimator: &str,
    dt_s: Option<f64>,
    after_collision: &str,
    trace: bool,
    #[pyo3(from_py_with = parse_threads)] threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<Simulation>> {
    let stop = StopFlag::default();
    let controller = controller::resolve_controller(controller, &stop)?;
    let mut options = RunOptions::new(controller.source.clone())
        .with_estimator(parse_choice("estimator", estimator, &ESTIMATORS)?)
        .with_after_collision(parse_choice(
            "after_collision",
            after_collision,
            &AFTER_COLLISION,
        )?);
    options.dt_s = dt_s;
    let scenarios: Vec<_> = scenarios
        .iter()
        .map(|scenario| scenario.0.clone())
        .collect();
    let runs = create_runs(py, &scenarios, &options)?;
    let level = if trace {
        RecordingLevel::Trace
    } else {
        RecordingLevel::Summary
    };
    let results = run_interruptible(py, &stop, progress.as_ref(), threads, |say| {
        simulate_in_batches(&runs, level, say)
    })?;
    drop(runs);
    let reported = ReportedController::from(&controller);
    let name: Arc<str> = controller.name.as_str().into();
    let simulated = scenarios.into_iter().zip(results);
    simulated
        .map(|(scenario, result)| {
            Simulation::new(py, scenario, (&name, reported), &options, result)
        })
        .collect()
}

fn create_runs(py: Python<'_>, scenarios: &[Scenario], options: &RunOptions) -> PyResult<Vec<Run>> {
    scenarios
        .iter()
        .map(|scenario| {
            Run::new(scenario, options.clone()).map_err(|error| {
                let problem = format!("{}: {error}", scenario.spec().name);
                errors::exception(py, ExceptionClass::Run, &problem)
            })
        })
        .collect()
}

/// Simulates runs until `report_progress` ends the work.
fn simulate_in_batches(
    runs: &[Run],
    level: RecordingLevel,
    report_progress: &(dyn Fn(ProgressCounts) -> ControlFlow<()> + Sync),
) -> Vec<SimulationResult> {
    let mut results = Vec::with_capacity(runs.len());
    let mut failures = 0;
    for batch in runs.chunks(BATCH_SIZE) {
        let simulated = simulate_batch(batch, level, |_, result| result);
        failures += simulated
            .iter()
            .filter(|result| !result.outcome.is_safe())
            .count();
        results.extend(simulated);
        let counts = (results.len() as u64, runs.len() as u64, failures as u64);
        if report_progress(counts).is_break() {
            break;
        }
    }
    results
}
