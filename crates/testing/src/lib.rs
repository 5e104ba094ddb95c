//! Property tests of driving controllers.

pub mod generator;
