//! How little lead braking makes a controller collide.

use crumple_core::observer::Progress;
use crumple_search::worst_case::{Aim, AttackReport, Envelope, attack};
use crumple_world::sim::RunOptions;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::controller;
use crate::errors::{self, Class};
use crate::scenario::Scenario;
use crate::simulation::ESTIMATORS;
use crate::values::{choice, written};
use crate::interruptible::{Stop, watched};

/// Most simulations that may be asked for.
const MAX_SIMULATIONS: u32 = 10_000_000;

/// Looks for a braking profile of the leader; what was found as a scenario, and what `crumple worst-case` says of it.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the Python half names every argument")]
pub(crate) fn worst_case<'py>(
    py: Python<'py>,
    scenario: PyRef<'py, Scenario>,
    controller: &Bound<'py, PyAny>,
    aim: &str,
    estimator: &str,
    max_brake_mps2: Option<f64>,
    jerk_mps3: Option<f64>,
    budget: u32,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Option<Scenario>, Bound<'py, PyAny>)> {
    if !(1..=MAX_SIMULATIONS).contains(&budget) {
        return Err(PyValueError::new_err(format!("budget must be 1 to {MOST_SIMULATIONS}, found {budget}")));
    }
    let stop = Stop::default();
    let controller = controller::named(controller, &stop)?;
    let estimator = choice("estimator", estimator, &ESTIMATORS)?;
    let aim = choice("aim", aim, &Aim::ALL.map(|aim| (aim.name(), aim)))?;
    let scenario = scenario.0.clone();
    let usual = Envelope::of(&scenario);
    let envelope = Envelope {
        max_brake_mps2: max_brake_mps2.unwrap_or(usual.max_brake_mps2),
        jerk_mps3: jerk_mps3.unwrap_or(usual.jerk_mps3),
    };
    let options = RunOptions::new(controller.kind.clone()).with_estimator(estimator);
    let result = watched(py, &stop, progress.as_ref(), |say| {
        let observer = |simulations: &Progress| say((simulations.done, u64::from(budget), 0));
        attack(&scenario, &options, aim, envelope, budget as usize, &observer)
    })?;
    let name = &scenario.spec().name;
    let result = result.map_err(|error| errors::raised(py, Class::Run, &format!("{name}: {error}")))?;
    let report = written(py, &AttackReport::new(name, &controller, estimator, aim, &result))?;
    Ok((result.found.map(|attack| Scenario(attack.scenario)), report))
}
