//! crumple
pub mod cli;
pub mod control;
pub mod estimate;
pub mod export;
pub mod random;
pub mod scenario;
pub mod sim;
