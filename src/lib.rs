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
//! One way through, each module using only those above it:
//!
//! | module | what it holds |
//! |---|---|
//! | `digest` | SHA-256, as it stands in files and reports |
//! | [`random`] | seeded streams: one seed decides everything |
//! | [`scenario`] | what may happen: vehicles, drivers, lead profiles, the file format, the paper's scenarios |
//! | [`estimate`] | what the ego knows: sensors and the Kalman filter |
//! | [`policy`] | the actor network and its file: acting, one state or many |
//! | [`control`] | who decides: one trait, one file for each controller |
//! | [`sim`] | how it happens: exact steps, contact times, two engines with one meaning, the trace |
//! | [`measure`] | how it was: surrogate safety measures; formulas of signal temporal logic and their monitor |
//! | [`recording`] | recorded traffic turned into scenarios |
//! | [`export`], [`draw`] | traces as tables and as pictures |
//! | [`rl`] | learning to drive: DDPG, its environment, its presets |
//! | [`worst_case`] | convex programs: could anyone have avoided it, how little does it take; certificates |
//! | [`falsify`] | search methods that look for failures, campaigns, counterexamples, and the public benchmark they are measured on |
//! | [`evidence`] | claims with certificates: kernels of shields, failure rates; estimates of rare failures |
//! | [`report`] | the assessment and its renderings |
//! | [`harden`] | search, train on what could have been avoided, accept what breaks nothing; again |
//! | [`trial`] | crash tests of crumple itself: any scenario, and laws that hold in it |
//! | [`cli`] | the command line |
//!
//! ## Example
//!
//! ```
//! use crumple::scenario::{ControllerSpec, built_in};
//! use crumple::sim::{Keep, Outcome, Run, RunOptions, simulate};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scenario = built_in("paper-1").ok_or("not built in")?;
//! let baseline = ControllerSpec::named("baseline").ok_or("not built in")?;
//! let run = Run::new(&scenario, RunOptions::new(baseline))?;
//! let result = simulate(&run, Keep::Summary);
//! // The baseline spares the vehicle ahead and is hit from behind.
//! assert!(matches!(result.outcome, Outcome::Collision(contact) if contact.rear_vehicle == 2));
//! # Ok(())
//! # }
//! ```

pub mod cli;
pub mod control;
mod digest;
pub mod draw;
pub mod estimate;
pub mod evidence;
pub mod export;
pub mod falsify;
pub mod harden;
pub mod measure;
pub mod policy;
pub mod random;
pub mod recording;
pub mod report;
pub mod rl;
pub mod scenario;
pub mod sim;
#[doc(hidden)]
pub mod trial;
pub mod worst_case;
