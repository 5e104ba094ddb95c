//! # crumple
//!
//! A line of n vehicles drives one lane. Vehicle 0 leads; xᵢ is vehicle i's front bumper, vᵢ its speed, lᵢ its length,
//!
//! ```text
//! gᵢ = xᵢ₋₁ − lᵢ₋₁ − xᵢ          the bumper gap ahead of vehicle i, and gᵢ ≤ 0 is contact;
//! x⁺ = x + v h + ½ a h²           over a step h in which acceleration a is held,
//! v⁺ = v + a h                    unless v⁺ < 0: then x⁺ = x + v² / 2|a| and v⁺ = 0.
//! ```
//!
//! A leader brakes by a script, traffic drives by rules, and the vehicles under test are driven by a controller u = π(o)
//! that sees eight noisy numbers o: the gaps ahead and behind, and the speeds and accelerations of itself and both
//! neighbours. crumple asks for which scenarios the vehicles touch, how badly, and which controller is the safer one.
//!
//! ## Map
//!
//! Crates depend downwards only, and the compiler sees to it. Each has its own map.
//!
//! | crate | what it holds |
//! |---|---|
//! | [`core`] | digests, rounded numbers, quoted text |
//! | [`store`] | run folders: atomic files, manifests, shards |
//! | [`world`] | scenarios, drivers, estimators, two engines with one meaning, measures, recordings |
//! | [`search`] | worst cases, falsification |
//! | [`evidence`] | failure rates and claims with certificates, spaces fitted to recordings |
//! | [`suites`] | tests after regulations |
//! | [`learn`] | training, and retraining against counterexamples |
//! | [`report`] | figures, tables, the assessment |
//!
//! ## Example
//!
//! ```
//! use crumple::{ControllerSpec, RecordingLevel, Outcome, Run, RunOptions, simulate};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scenario = crumple::world::scenario::built_in("paper-1").ok_or("not built in")?;
//! let baseline = ControllerSpec::named("baseline").ok_or("not built in")?;
//! let run = Run::new(&scenario, RunOptions::new(baseline))?;
//! let result = simulate(&run, RecordingLevel::Summary);
//! // The baseline spares the vehicle ahead and is hit from behind.
//! assert!(matches!(result.outcome, Outcome::Collision(contact) if contact.rear_vehicle == 2));
//! # Ok(())
//! # }
//! ```

pub use crumple_core as core;
pub use crumple_evidence as evidence;
pub use crumple_learn as learn;
pub use crumple_report as report;
pub use crumple_search as search;
pub use crumple_store as store;
pub use crumple_suites as suites;
pub use crumple_world as world;

pub use crumple_evidence::RatePlan;
pub use crumple_learn::rl::{TrainingConfig, train};
pub use crumple_report::assessment::{Assessment, AssessmentPlan, assess};
pub use crumple_search::falsify::campaign::Campaign;
pub use crumple_search::worst_case::{attack, avoid};
pub use crumple_world::control::{Controller, ControllerFailure, ControllerSource, ControllerSpec};
pub use crumple_world::measure::Specification;
pub use crumple_world::scenario::Scenario;
pub use crumple_world::scenario::space::Space;
pub use crumple_world::sim::{NamedController, Outcome, RecordingLevel, Run, RunOptions, simulate, simulate_batch};
