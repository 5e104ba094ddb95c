//! crumple
pub mod random;
pub mod scenario;
pub mod sim;
