//! crumple
pub mod falsify;
pub mod measure;
pub mod random;
pub mod scenario;
pub mod sim;
