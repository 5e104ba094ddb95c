//! crumple
pub mod random;
pub mod recording;
pub mod scenario;
pub mod sim;
