//! Checks certificates.
pub mod kernel;
pub mod polynomial;
pub mod rate;
pub mod rational;
