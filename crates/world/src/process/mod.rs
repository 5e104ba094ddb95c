//! Programs that are asked line by line: how they are started, how long they may take, and how they end with all that they started.
//!
//! Needs Unix, and the feature `process`: elsewhere no program starts.

mod problem;
pub(crate) mod protocol;
#[cfg(all(unix, feature = "process"))]
mod stderr_tail;
#[cfg(all(unix, feature = "process"))]
mod unix;
#[cfg(not(all(unix, feature = "process")))]
mod unsupported;

pub(crate) use problem::escaped_excerpt;
pub use problem::{ProcessFailure, ProcessProblem};
#[cfg(all(unix, feature = "process"))]
pub(crate) use unix::ChildProcess;
#[cfg(not(all(unix, feature = "process")))]
pub(crate) use unsupported::ChildProcess;
