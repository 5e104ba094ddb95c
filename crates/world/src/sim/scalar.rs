//! The scalar engine: simulates one run, step by step. Written for readability.
//!
//! The lockstep engine gives bit-identical results.

use super::{RecordingLevel, Run, SimulationResult, Stepper};

/// Simulates a run.
///
/// ```
/// use crumple_world::control::BuiltInController;
/// use crumple_world::scenario::built_in_scenario;
/// use crumple_world::sim::{RecordingLevel, Run, RunOptions, simulate};
///
/// let scenario = built_in_scenario("paper-1").unwrap();
/// let run = Run::new(&scenario, RunOptions::new(BuiltInController::from_name("baseline").unwrap())).unwrap();
/// let result = simulate(&run, RecordingLevel::Trace);
/// assert_eq!(result.trace.unwrap().vehicles.len(), 3);
/// ```
#[must_use]
pub fn simulate(run: &Run, keep: RecordingLevel) -> SimulationResult {
    let mut stepper = Stepper::new(run, keep);
    while !stepper.has_ended() {
        stepper.step();
    }
    stepper.finish()
}
