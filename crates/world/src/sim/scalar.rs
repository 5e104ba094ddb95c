//! The engine to read: one run, step by step.
//!
//! The lockstep engine means exactly the same and agrees with this one to the last bit.

use super::{RecordingLevel, Run, SimulationResult, Stepper};

/// Runs a scenario.
///
/// ```
/// use crumple_world::control::ControllerSpec;
/// use crumple_world::scenario::built_in;
/// use crumple_world::sim::{RecordingLevel, Run, RunOptions, simulate};
///
/// let scenario = built_in("paper-1").unwrap();
/// let run = Run::new(&scenario, RunOptions::new(ControllerSpec::named("baseline").unwrap())).unwrap();
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
