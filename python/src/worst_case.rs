//! Worst-case braking of the leader.

use crumple_core::observer::RunProgress;
use crumple_search::worst_case::{
    AttackObjective, AttackReport, Envelope, MAX_SIMULATIONS, attack,
};
use crumple_sim::engine::RunOptions;
use pyo3::prelude::*;

use crate::controller;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::scenario::PyScenario;
use crate::simulation::ESTIMATORS;
use crate::threads::parse_threads;
use crate::values::{parse_choice, serialize_to_python};

/// Searches for a braking profile of the leader. Returns its scenario, and the report of `crumple worst-case` as data
/// and as text.
#[pyfunction]
#[expect(
    clippy::too_many_arguments,
    reason = "the Python half names every argument"
)]
pub(crate) fn worst_case<'py>(
    py: Python<'py>,
    scenario: PyRef<'py, PyScenario>,
    controller: &Bound<'py, PyAny>,
    aim: &str,
    estimator: &str,
    max_brake_mps2: Option<f64>,
    jerk_mps3: Option<f64>,
    budget: u32,
    #[pyo3(from_py_with = parse_threads)] threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Option<PyScenario>, Bound<'py, PyAny>, String)> {
    if !(1..=MAX_SIMULATIONS).contains(&budget) {
        let problem = format!("budget: must be from 1 to {MAX_SIMULATIONS}, found {budget}");
        return Err(errors::exception(py, ExceptionClass::Run, &problem));
    }
    let stop = StopFlag::default();
    let controller = controller::resolve_controller(controller, &stop)?;
    let estimator = parse_choice("estimator", estimator, &ESTIMATORS)?;
    let aim = parse_choice(
        "aim",
        aim,
        &AttackObjective::ALL.map(|aim| (aim.name(), aim)),
    )?;
    let scenario = scenario.0.clone();
    let typical = Envelope::from_scenario(&scenario);
    let envelope = Envelope {
        max_brake_mps2: max_brake_mps2.unwrap_or(typical.max_brake_mps2),
        jerk_mps3: jerk_mps3.unwrap_or(typical.jerk_mps3),
    };
    let options = RunOptions::new(controller.source.clone()).with_estimator(estimator);
    let result = run_interruptible(py, &stop, progress.as_ref(), threads, |say| {
        attack(
            &scenario,
            &options,
            aim,
            envelope,
            budget as usize,
            &|simulations: &RunProgress| say((simulations.done, u64::from(budget), 0)),
        )
    })?;
    let name = &scenario.spec().name;
    let result = result
        .map_err(|error| errors::exception(py, ExceptionClass::Run, &format!("{name}: {error}")))?;
    let budget = budget as usize;
    let report = AttackReport::new(name, &controller, estimator, aim, budget, &result);
    Ok((
        result.attack.map(|attack| PyScenario(attack.scenario)),
        serialize_to_python(py, &report)?,
        report.to_text(),
    ))
}
