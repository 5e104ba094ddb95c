//! Permission to start programs: the user named the program, or allowed programs that files name.

use crumple_sim::control::StartRefusal;

/// Programs and FMUs that only a file names: a scenario, space, suite, campaign, certificate or report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ExternalPrograms {
    /// They are not started.
    #[default]
    Refused,
    /// They are started (`--allow-external`).
    Allowed,
}

/// Origin of the name of a controller; decides if crumple may start its program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NameOrigin {
    /// The user: an argument of the command line, a configuration or controller file that it names, or calling code.
    User,
    /// Any other file.
    File(ExternalPrograms),
}

/// Permission to start the program of one controller. Only [`NameOrigin::permission`] creates it, and
/// [`ProcessController::new`](super::ProcessController::new) requires it.
#[derive(Debug, Clone, Copy)]
pub struct StartPermission(());

impl NameOrigin {
    /// Returns the permission to start a program; `location` describes where it is named.
    ///
    /// # Errors
    /// [`StartRefusal`] for a name from a file, unless the user allows external programs.
    pub fn permission(
        self,
        location: impl FnOnce() -> String,
    ) -> Result<StartPermission, StartRefusal> {
        match self {
            Self::User | Self::File(ExternalPrograms::Allowed) => Ok(StartPermission(())),
            Self::File(ExternalPrograms::Refused) => Err(StartRefusal {
                location: location(),
            }),
        }
    }
}
