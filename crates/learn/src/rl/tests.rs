//! Tests of several parts together.

mod presets;
mod training;
mod update;
