//! Controllers that are programs or FMUs. A program answers queries line by line.
//!
//! Programs need Unix and the feature `process`; otherwise none starts. Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | `protocol` | the messages |
//! | `child` | start, time limits and termination of a group of processes |
//! | `permission` | the permission without which no program starts |
//! | `setup` | the command of a program, its mapping and its limits |
//! | `fmu` | the command that runs an FMU |
//! | `controller` | a pool of processes as a source of controllers |

#[cfg(all(unix, feature = "process"))]
#[path = "unix.rs"]
mod child;
#[cfg(not(all(unix, feature = "process")))]
#[path = "unsupported.rs"]
mod child;
mod controller;
mod fmu;
mod permission;
mod protocol;
mod setup;
#[cfg(all(unix, feature = "process"))]
mod stderr_tail;

pub use controller::ProcessController;
#[cfg(feature = "process")]
pub use fmu::find_fmu_host;
pub use fmu::{FmuConfig, FmuProblem};
pub use permission::{ExternalPrograms, NameOrigin, StartPermission};
pub use setup::ProcessSetup;
