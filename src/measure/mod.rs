//! How it was: surrogate safety measures and formulas over traces.

pub mod stl;
