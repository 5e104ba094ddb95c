//! crumple
pub mod control;
pub mod estimate;
pub mod random;
pub mod scenario;
pub mod sim;
