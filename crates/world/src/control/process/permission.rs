//! Rule for starting programs: the user of this run named the program, or allowed those that files name.

use std::sync::atomic::{AtomicBool, Ordering};

/// Origin of the name of a controller. Decides if crumple may start the program that the name stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NameOrigin {
    /// The user: an argument of this command line, a configuration or controller file that such an argument names, or code
    /// that constructs the controller.
    User,
    /// Any other file: a scenario, space, suite, shard, campaign, certificate or report.
    File,
}

/// Permission to start the program of one controller. `NameOrigin::permission` alone hands it out, and
/// [`ProcessController::new`](super::ProcessController::new) takes it.
#[derive(Debug, Clone, Copy)]
pub struct StartPermission(());

/// Refusal to start a program, or to load an FMU, that only a file names.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{location}: crumple starts no program, and loads no FMU, that only a file names: add --allow-external if you trust the file"
)]
pub struct StartRefusal {
    /// Place that names the program: file, line and field, or the name itself.
    pub location: String,
}

/// Set once, never cleared: the user's answer holds for the whole run.
static IS_EXTERNAL_ALLOWED: AtomicBool = AtomicBool::new(false);

/// Allows this process to start the programs and to load the FMUs that any file names, as `--allow-external` does. Cannot be
/// undone.
pub fn allow_external() {
    IS_EXTERNAL_ALLOWED.store(true, Ordering::Relaxed);
}

/// Returns true after [`allow_external`].
#[must_use]
pub fn is_external_allowed() -> bool {
    IS_EXTERNAL_ALLOWED.load(Ordering::Relaxed)
}

impl NameOrigin {
    /// Returns the permission to start a program; `place` says where it is named.
    ///
    /// # Errors
    /// [`StartRefusal`] for a name from a file, unless [`allow_external`] was called.
    pub(crate) fn permission(self, place: impl FnOnce() -> String) -> Result<StartPermission, StartRefusal> {
        match self {
            Self::User => Ok(StartPermission(())),
            Self::File if is_external_allowed() => Ok(StartPermission(())),
            Self::File => Err(StartRefusal { location: place() }),
        }
    }
}
