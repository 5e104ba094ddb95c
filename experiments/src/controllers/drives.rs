//! Recorded drives from a folder of recordings.

use std::path::Path;

use crate::ExperimentError;
use crate::openacc::listed_files;
use crumple::controllers::Controllers;
use crumple::evidence::drives::DriveSet;
use crumple::exchange::recording::{ImportOptions, ImportScope, import};

/// Digests and paths of the recordings.
const LIST: &str = include_str!("../../../examples/studies/openacc/files.sha256");

/// All drives of the listed recordings, as `crumple import --whole` writes them: a human drives the vehicle behind.
pub(super) struct ImportedDrives {
    pub(super) set: DriveSet,
    /// Number of recordings.
    pub(super) recordings: usize,
}

impl ImportedDrives {
    /// Reads the listed recordings of a folder.
    ///
    /// # Errors
    /// A missing or another file, or one that cannot be read.
    pub(super) fn import(folder: &Path) -> Result<Self, ExperimentError> {
        let paths = listed_files(folder, LIST)?;
        let options = ImportOptions {
            scope: ImportScope::WholeDrives,
            ..ImportOptions::default()
        };
        let scenarios = tempfile::tempdir()?;
        let mut written = Ok(());
        import(&paths, None, &options, None, &mut |scenario| {
            written = std::fs::write(scenarios.path().join(&scenario.file_name), &scenario.toml);
            written.is_ok()
        })?;
        written?;
        Ok(Self {
            set: DriveSet::load(scenarios.path(), &Controllers::default())?,
            recordings: paths.len(),
        })
    }
}
