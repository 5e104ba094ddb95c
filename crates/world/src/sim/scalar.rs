//! The engine to read: one run, step by step.
//!
//! The lockstep engine means exactly the same and agrees with this one to the last bit.

use super::{RecordingLevel, Run, Simulated, Stepper};

/// Runs a scenario.
#[must_use]
pub fn simulate(run: &Run<'_>, keep: RecordingLevel) -> Simulated {
    let mut stepper = Stepper::new(run, keep);
    while !stepper.has_ended() {
        stepper.step();
    }
    stepper.finish()
}
