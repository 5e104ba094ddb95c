//! Errors of a tuning.

use crumple_core::observer::Stopped;
use crumple_search::falsify::InvalidPoints;
use crumple_sim::control::{BuiltInController, InvalidSetting};
use crumple_sim::engine::RunError;
use crumple_sim::scenario::InvalidField;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::RunFolderError;

/// Reason why a tuning cannot start, or stops.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TuneError {
    /// The controller is not built in: a file, a process, a controller behind a shield, or an unknown name.
    #[error("`{0}` is not a built-in controller; those with settings are {names}", names = tunable_controllers())]
    NotBuiltIn(String),
    /// The built-in controller has no settings.
    #[error("`{0}` has no settings to tune; the controllers with settings are {names}", names = tunable_controllers())]
    NoSettings(&'static str),
    /// The controller has an invalid setting.
    #[error(transparent)]
    Controller(#[from] InvalidSetting),
    /// The controller fixes all its settings.
    #[error("no setting is left to tune: `{0}` fixes all of them")]
    AllFixed(String),
    /// A requested setting is unknown, fixed, requested twice, or has an invalid range.
    #[error("{setting}: {problem}")]
    Setting {
        /// Name of the setting.
        setting: String,
        /// Problem with it.
        problem: String,
    },
    /// A space has an invalid weight, occurs twice, or has no vehicle under test.
    #[error("{space}: {problem}")]
    Space {
        /// Name of the space; empty if there is none.
        space: String,
        /// Problem with it.
        problem: &'static str,
    },
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// The folder cannot be used, or a file in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// A scenario cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A random scenario is invalid.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// The observer stopped the tuning.
    #[error("the tuning was {0}")]
    Stopped(#[from] Stopped),
    /// The search method proposes no point, or one outside the unit cube.
    #[error("the search method `{method}` {problem}")]
    Method {
        /// Name of the method.
        method: String,
        /// Problem of the points.
        problem: InvalidPoints,
    },
}

/// Returns the names of the built-in controllers with settings.
fn tunable_controllers() -> String {
    let all = BuiltInController::all();
    let names: Vec<_> = all
        .iter()
        .filter(|spec| !spec.fields().is_empty())
        .map(BuiltInController::name)
        .collect();
    names.join(", ")
}
