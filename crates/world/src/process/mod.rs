//! Programs that are asked line by line: how they are started, how long they may take, and how they end with all that they started.
//!
//! Needs Unix: elsewhere no program starts.

#[cfg(not(unix))]
mod elsewhere;
mod last_words;
mod problem;
pub(crate) mod protocol;
#[cfg(unix)]
mod unix;

#[cfg(not(unix))]
pub(crate) use elsewhere::Program;
pub(crate) use last_words::shortened;
pub use problem::{ProcessFailure, ProcessProblem};
#[cfg(unix)]
pub(crate) use unix::Program;
