//! Rollouts for benches: random scenarios of the paper's distribution with its noise; every vehicle but the leader is
//! under test.

use crumple_sim::control::{BuiltInController, ControllerSource, IntoSource};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, SimulationResult, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, PaperDistribution, Scenario};
use std::sync::Arc;

pub fn scenarios(count: u64) -> Vec<Scenario> {
    let draw = |index| {
        let drawn = PaperDistribution { seed: 1 }.draw(index).expect("valid");
        drawn
            .edited(|spec| spec.vehicles[2].driver = Driver::UnderTest)
            .expect("still valid")
    };
    (0..count).map(draw).collect()
}

pub fn built_in(controller: &str) -> Arc<dyn ControllerSource> {
    BuiltInController::from_name(controller)
        .expect("built in")
        .into_source()
}

pub fn runs(
    scenarios: &[Scenario],
    controller: impl IntoSource,
    estimator: EstimatorKind,
) -> Vec<Run> {
    let options = RunOptions::new(controller).with_estimator(estimator);
    scenarios
        .iter()
        .map(|scenario| Run::new(scenario, options.clone()).expect("valid"))
        .collect()
}

/// Returns the number of steps of a run, up to its collision.
pub fn steps(run: &Run, result: &SimulationResult) -> usize {
    let step_s = run.scenario().spec().step_s;
    result
        .outcome
        .collision()
        .map_or(run.scenario().steps(), |collision| {
            (collision.time_s / step_s) as usize + 1
        })
}

pub fn vehicle_steps(runs: &[Run]) -> usize {
    let made = |index: usize, result: SimulationResult| {
        steps(&runs[index], &result) * runs[index].scenario().vehicles().len()
    };
    simulate_batch(runs, RecordingLevel::Summary, made)
        .into_iter()
        .sum()
}
