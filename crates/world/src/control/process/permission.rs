//! Permission to start programs: the user named the program, or allowed programs that files name.

use std::sync::atomic::{AtomicBool, Ordering};

/// Origin of the name of a controller; decides if crumple may start its program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NameOrigin {
    /// The user: an argument of the command line, a configuration or controller file that it names, or calling code.
    User,
    /// Any other file: a scenario, space, suite, campaign, certificate or report.
    File,
}

/// Permission to start the program of one controller. Only `NameOrigin::permission` creates it, and
/// [`ProcessController::new`](super::ProcessController::new) requires it.
#[derive(Debug, Clone, Copy)]
pub struct StartPermission(());

/// Refusal to start a program, or to load an FMU, that only a file names.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{location}: a file names a program or an FMU, and crumple does not run it without permission: add \
    --allow-external if you trust the file"
)]
pub struct StartRefusal {
    /// Place that names the program: file, line and field, or the name itself.
    pub location: String,
}

/// Never cleared: the permission holds for the whole process.
static IS_EXTERNAL_ALLOWED: AtomicBool = AtomicBool::new(false);

/// Allows this process to start programs and load FMUs that files name (`--allow-external`); cannot be undone.
pub fn allow_external() {
    IS_EXTERNAL_ALLOWED.store(true, Ordering::Relaxed);
}

/// Returns true after [`allow_external`].
#[must_use]
pub fn is_external_allowed() -> bool {
    IS_EXTERNAL_ALLOWED.load(Ordering::Relaxed)
}

impl NameOrigin {
    /// Returns the permission to start a program; `place` describes where it is named.
    ///
    /// # Errors
    /// [`StartRefusal`] for a name from a file, unless [`allow_external`] was called.
    pub(crate) fn permission(
        self,
        place: impl FnOnce() -> String,
    ) -> Result<StartPermission, StartRefusal> {
        match self {
            Self::User => Ok(StartPermission(())),
            Self::File if is_external_allowed() => Ok(StartPermission(())),
            Self::File => Err(StartRefusal { location: place() }),
        }
    }
}
