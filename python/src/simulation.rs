//! Simulations: outcomes, and traces as arrays.

use std::sync::Arc;

use crumple_measure::Specification;
use crumple_sim::engine::{
    self, AfterContact, Outcome, RecordingLevel, Run, RunOptions, SimulationResult, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::figure::PyFigure;
use crate::interruptible::{StopFlag, run_interruptible};
use crate::scenario::PyScenario;
use crate::table;
use crate::values::{parse_choice, serialize_to_python};

/// Number of runs between two checks for an interrupt.
const BATCH_SIZE: usize = 512;

pub(crate) const ESTIMATORS: [(&str, EstimatorKind); 2] = [
    ("kalman", EstimatorKind::Kalman),
    ("truth", EstimatorKind::Truth),
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
        let array = |samples: Vec<f64>| PyArray1::from_vec(py, samples).unbind();
        let track = |track: engine::Track| {
            let track = PyTrack {
                length_m: track.length_m,
                mass_kg: track.mass_kg,
                position_m: array(track.position_m),
                speed_mps: array(track.speed_mps),
                acceleration_mps2: array(track.acceleration_mps2),
                in_lane_s: track.in_lane_s,
            };
            Py::new(py, track)
        };
        Ok(Self {
            time_s: array(trace.time_s),
            vehicles: trace
                .vehicles
                .into_iter()
                .map(track)
                .collect::<PyResult<_>>()?,
        })
    }

    /// Copies the present samples; the caller may have changed the arrays.
    fn to_native(&self, py: Python<'_>) -> PyResult<engine::Trace> {
        let samples = |array: &Py<PyArray1<f64>>| {
            Ok::<_, PyErr>(array.bind(py).try_readonly()?.as_array().to_vec())
        };
        let track = |track: &Py<PyTrack>| {
            let track = track.get();
            Ok(engine::Track {
                length_m: track.length_m,
                mass_kg: track.mass_kg,
                position_m: samples(&track.position_m)?,
                speed_mps: samples(&track.speed_mps)?,
                acceleration_mps2: samples(&track.acceleration_mps2)?,
                in_lane_s: track.in_lane_s,
            })
        };
        let vehicles = self.vehicles.iter().map(track).collect::<PyResult<_>>()?;
        Ok(engine::Trace {
            time_s: samples(&self.time_s)?,
            vehicles,
        })
    }
}

#[pymethods]
impl PyTrace {
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
    options: RunOptions,
    result: SimulationResult,
    #[pyo3(get)]
    trace: Option<Py<PyTrace>>,
}

#[pymethods]
impl Simulation {
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
    fn contact<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.result
            .outcome
            .contact()
            .map(|contact| serialize_to_python(py, contact))
            .transpose()
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
        let wrong = |error: &dyn std::fmt::Display| {
            errors::exception(py, ExceptionClass::Formula, &error.to_string())
        };
        let specification =
            Specification::parse(spec, &self.scenario).map_err(|error| wrong(&error))?;
        let judged_until_contact = self.options.after_contact != specification.after_contact();
        if judged_until_contact && self.result.outcome.contact().is_some() {
            let how = if specification.recording_level() == RecordingLevel::Trace {
                "continue"
            } else {
                "stop"
            };
            return Err(wrong(&format!(
                "`{spec}` is evaluated on a run with after_contact=\"{how}\""
            )));
        }
        let run = Run::new(&self.scenario, self.options.clone()).map_err(|error| wrong(&error))?;
        let mut simulated = self.result.clone();
        if specification.recording_level() == RecordingLevel::Trace {
            simulated.trace = Some(self.native_trace(py)?);
        }
        specification
            .evaluate(&run, &simulated)
            .map(|verdict| verdict.robustness)
            .map_err(|error| wrong(&error))
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
    fn native_trace(&self, py: Python<'_>) -> PyResult<engine::Trace> {
        let missing = "the simulation kept no trace: simulate with trace=True";
        match &self.trace {
            Some(trace) => trace.get().to_native(py),
            None => Err(errors::exception(py, ExceptionClass::Run, &missing)),
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
    after_contact: &str,
    trace: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<Simulation>> {
    let stop = StopFlag::default();
    let controller = controller::resolve_controller(controller, &stop)?;
    let known = [
        ("stop", AfterContact::Stop),
        ("continue", AfterContact::Continue),
    ];
    let mut options = RunOptions::new(controller.source.clone())
        .with_estimator(parse_choice("estimator", estimator, &ESTIMATORS)?)
        .with_after_contact(parse_choice("after_contact", after_contact, &known)?);
    options.dt_s = dt_s;
    let scenarios: Vec<_> = scenarios
        .iter()
        .map(|scenario| scenario.0.clone())
        .collect();
    let run = |scenario: &Scenario| {
        let wrong = |error| {
            errors::exception(
                py,
                ExceptionClass::Run,
                &format!("{}: {error}", scenario.spec().name),
            )
        };
        Run::new(scenario, options.clone()).map_err(wrong)
    };
    let runs = scenarios.iter().map(run).collect::<PyResult<Vec<_>>>()?;
    let keep = if trace {
        RecordingLevel::Trace
    } else {
        RecordingLevel::Summary
    };
    let results = run_interruptible(py, &stop, progress.as_ref(), |say| {
        let (mut results, mut failures) = (Vec::with_capacity(runs.len()), 0);
        for some in runs.chunks(BATCH_SIZE) {
            let of_some = simulate_batch(some, keep, |_, simulated| simulated);
            failures += of_some
                .iter()
                .filter(|simulated| !simulated.outcome.is_safe())
                .count();
            results.extend(of_some);
            if say((results.len() as u64, runs.len() as u64, failures as u64)).is_break() {
                break;
            }
        }
        results
    })?;
    drop(runs);
    let name: Arc<str> = controller.name.into();
    let simulation = |(scenario, mut simulated): (_, SimulationResult)| {
        let trace = simulated
            .trace
            .take()
            .map(|trace| Py::new(py, PyTrace::new(py, trace)?))
            .transpose()?;
        Ok(Simulation {
            scenario,
            controller: Arc::clone(&name),
            options: options.clone(),
            result: simulated,
            trace,
        })
    };
    scenarios.into_iter().zip(results).map(simulation).collect()
}
