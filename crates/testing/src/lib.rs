//! Property tests of driving controllers, for `cargo test` and for fuzzers.
//!
//! | item | content |
//! |---|---|
//! | [`check`] | tests a controller in scenarios, in a plain `#[test]` |
//! | [`Scenarios`] | families of scenarios: a strategy of proptest, and scenarios from the bytes of a fuzzer |
//! | [`Property`] | properties that a controller must have in every scenario |
//! | [`generator`] | the generator of arbitrary scenarios, for crumple's own tests, too |
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
mod serve;
mod shrink;

pub use check::{ControllerCheck, check};
pub use controller::{ControllerUnderTest, StatelessController, stateless};
pub use crumple_world as world;
pub use failure::{CheckError, CheckSummary, PropertyFailure};
pub use metamorphic::MetamorphicRelation;
pub use property::{Property, PropertyVerdict};
pub use scenarios::{ScenarioTree, Scenarios, ScenariosError};
pub use serve::{ServingError, serve};
