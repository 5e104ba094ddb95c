//! Programs that are asked line by line: how they are started, how long they may take, and how they end with all that they started.
//!
//! Needs Unix, and the feature `process`: elsewhere no program starts.

#[cfg(not(all(unix, feature = "process")))]
mod elsewhere;
#[cfg(all(unix, feature = "process"))]
mod last_words;
mod problem;
pub(crate) mod protocol;
#[cfg(all(unix, feature = "process"))]
mod unix;

#[cfg(not(all(unix, feature = "process")))]
pub(crate) use elsewhere::Program;
pub(crate) use problem::shortened;
pub use problem::{ProcessFailure, ProcessProblem};
#[cfg(all(unix, feature = "process"))]
pub(crate) use unix::Program;
