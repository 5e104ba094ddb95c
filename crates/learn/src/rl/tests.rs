//! Tests of several parts together.

mod training;
mod update;
