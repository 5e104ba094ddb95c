//! External programs that answer queries line by line: start, timeouts and termination of the process group.
//!
//! Needs Unix and the feature `process`; otherwise no program starts.

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
