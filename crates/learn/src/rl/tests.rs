//! Tests of several modules together.

mod presets;
mod training;
mod update;
