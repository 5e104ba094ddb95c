//! # crumple
//!
//! A line of n vehicles drives in one lane. Vehicle 0 leads; xᵢ is vehicle i's front bumper, vᵢ its speed, lᵢ its
//! length,
//!
//! ```text
//! gᵢ = xᵢ₋₁ − lᵢ₋₁ − xᵢ          the bumper gap ahead of vehicle i, and gᵢ ≤ 0 is a collision;
//! x⁺ = x + v h + ½ a h²           over a step h in which acceleration a is held,
//! v⁺ = v + a h                    unless v⁺ < 0: then x⁺ = x + v² / 2|a| and v⁺ = 0.
//! ```
//!
//! A script brakes the leader, models drive the traffic, and a controller u = π(o) drives the vehicles under test. It
//! observes eight noisy numbers o: the gaps ahead and behind, and the speeds and accelerations of itself and both
//! neighbours. crumple finds the scenarios in which vehicles collide, measures the severity, and compares controllers.
//!
//! ## Map
//!
//! This crate re-exports the crates of this table, and the names that a first program needs. `docs/architecture.md`
//! states which crate uses which others. `crumple-core` (digests, progress, quoted text) has no short name here,
//! because that is the name of Rust's `core`.
//!
//! | crate | contents |
//! |---|---|
//! | [`store`] | studies in run folders: atomic files, manifests, resumption |
//! | [`sim`] | scenarios, built-in controllers, estimators, engines with identical results |
//! | [`networks`] | networks as controllers |
//! | [`controllers`] | controllers by name: built-in, policies, networks, programs, FMUs, shields |
//! | [`measure`] | measures of a run, signal temporal logic |
//! | [`spaces`] | scenario spaces: parameters with ranges and distributions |
//! | [`exchange`] | scenarios from recordings and from OpenSCENARIO |
//! | [`search`] | worst cases, falsification |
//! | [`evidence`] | failure rates and claims with certificates, scenario spaces fitted to recordings |
//! | [`suites`] | tests modelled on regulations |
//! | [`learn`] | training, retraining on counterexamples, tuning of settings |
//! | [`report`] | figures, tables, the assessment |
//! | [`verify`] | the checker of certificates |
//!
//! ## Example
//!
//! ```
//! use crumple::{BuiltInController, RecordingLevel, Outcome, Run, RunOptions, simulate};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scenario = crumple::built_in_scenario("paper-1").ok_or("not built in")?;
//! let baseline = BuiltInController::from_name("baseline").ok_or("not built in")?;
//! let run = Run::new(&scenario, RunOptions::new(baseline))?;
//! let result = simulate(&run, RecordingLevel::Summary);
//! // The baseline avoids the vehicle ahead and is hit from behind, by a lorry that `baseline` drives, too.
//! assert!(matches!(result.outcome, Outcome::Collision(collision) if collision.rear_vehicle == 2));
//! # Ok(())
//! # }
//! ```

pub use crumple_controllers as controllers;
pub use crumple_evidence as evidence;
pub use crumple_exchange as exchange;
pub use crumple_learn as learn;
pub use crumple_measure as measure;
pub use crumple_networks as networks;
pub use crumple_report as report;
pub use crumple_search as search;
pub use crumple_sim as sim;
pub use crumple_spaces as spaces;
pub use crumple_store as store;
pub use crumple_suites as suites;
pub use crumple_verify as verify;

pub use crumple_core::digest::sha256;
pub use crumple_core::observer::{Observer, Quiet};
pub use crumple_search::falsify::campaign::Campaign;
pub use crumple_sim::control::{
    BuiltInController, Controller, ControllerFailure, ControllerSource,
};
pub use crumple_sim::engine::{
    NamedController, Outcome, RecordingLevel, Run, RunOptions, SimulationResult, simulate,
};
pub use crumple_sim::observation::{EstimatorKind, Observation};
pub use crumple_sim::scenario::{Scenario, built_in_scenario};
pub use crumple_spaces::{ScenarioSpace, built_in_space};
pub use crumple_store::study::Study;
