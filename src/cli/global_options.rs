//! Options of every subcommand.

use crumple_controllers::Controllers;

/// Options of every subcommand.
#[derive(Debug, Clone, Copy)]
pub(super) struct GlobalOptions {
    /// Print no progress and no notes.
    pub(super) quiet: bool,
    /// Opens the controllers that files name, with the permission of `--allow-external`.
    pub(super) controllers: Controllers,
}
