//! Simulation: exact motion, collisions by root finding, and three step loops with identical results.
//!
//! - `stepper` steps one run of any kind.
//! - `stepper/short_line` keeps a line of two to four vehicles without possible collisions in registers, for training.
//! - `lockstep/block` steps up to 64 runs of the same shape in SIMD lanes, for [`simulate_batch`].

mod actuator;
#[cfg(test)]
mod after_collision_tests;
mod lane;
mod lockstep;
mod motion;
mod multi_body;
mod named;
mod outcome;
mod platoon;
mod recorder;
mod run;
mod scalar;
mod shielding;
mod stepper;
mod trace;

pub use crate::control::ShieldRefusal;
pub use lane::TIME_TOLERANCE_S;
pub use lockstep::simulate_batch;
pub use motion::{Motion, closest_gap_m};
pub use named::{NamedController, NotStarted, RefusedController};
pub use outcome::{
    AfterCollision, Collision, FailedController, FailedControllerRuns, HELD_BRAKE_MPS2, Impact,
    Outcome, SimulationResult, VehicleSummary,
};
pub use recorder::{RecordingLevel, ttc_s};
pub use run::{OpenLoopController, Run, RunError, RunOptions};
pub use scalar::simulate;
pub use shielding::Intervention;
pub use stepper::{StepView, Stepper};
pub use trace::{Trace, Track, VehiclePair};

pub use crate::control::ShieldedSource;
