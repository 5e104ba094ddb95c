//! Property tests of driving controllers, for `cargo test` and for fuzzers.
//!
//! | item | content |
//! |---|---|
//! | [`check`] | tests a controller in scenarios, in a plain `#[test]` |
//! | [`Scenarios`] | families of scenarios: a strategy of proptest, and scenarios from the bytes of a fuzzer |
//! | [`Property`] | properties that a controller must have in every scenario |
//! | [`generator`] | the generator of arbitrary scenarios, for crumple's own tests, too |
//!
//! The test of a controller that a function computes, with a property of the crate and one of its own:
//!
//! ```
//! use crumple_testing::{Property, PropertyVerdict, check, stateless};
//!
//! let follower = stateless(|seen| seen.ahead.map_or(0.0, |ahead| 0.5 * (ahead.speed_mps - seen.speed_mps)));
//! let soft = Property::new("brakes by at most 6 m/s²", |controller, scenario| {
//!     let vehicle_under_test = &controller.simulate(scenario)?.vehicles[1];
//!     Ok(match vehicle_under_test.max_brake_mps2 {
//!         brake_mps2 if brake_mps2 > 6.0 => PropertyVerdict::Violated(format!("it brakes by {brake_mps2:.1} m/s²")),
//!         _ => PropertyVerdict::Holds,
//!     })
//! });
//! let summary = check(follower).on("traffic").property(Property::deterministic()).property(soft).cases(20).run();
//! assert_eq!(summary.unwrap().evaluated, 40);
//! ```
//!
//! A failing test writes the simplest scenario found to a folder, which the next run evaluates first
//! ([`ControllerCheck::corpus`]).
//!
//! The feature `process` adds controllers that are processes or FMUs, by name or file
//! ([`find_for_user`](crumple_controllers::find_for_user)). It needs Unix.
#![cfg_attr(doctest, doc = include_str!("../../../docs/testing.md"))]

mod check;
mod controller;
mod drawing;
mod failure;
pub mod generator;
mod metamorphic;
mod near;
mod property;
mod scenarios;
mod shrink;

pub use check::{ControllerCheck, check};
pub use controller::ControllerUnderTest;
pub use crumple_controllers as controllers;
pub use crumple_measure as measure;
pub use crumple_sim as sim;
pub use crumple_sim::control::{ServingError, StatelessController, serve, stateless};
pub use crumple_spaces as spaces;
pub use failure::{CheckError, CheckSummary, PropertyFailure};
pub use metamorphic::MetamorphicRelation;
pub use property::{Property, PropertyVerdict};
pub use scenarios::{ScenarioTree, Scenarios, ScenariosError};
