//! crumple
pub mod draw;
pub mod random;
pub mod scenario;
pub mod sim;
