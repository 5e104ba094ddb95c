//! Collisions found, one scenario file for each kind of them.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::{TestCase, behaviour};
use crumple_world::sim::SimulationResult;

/// A folder of scenario files, each named after the collision in it.
#[derive(Debug, Clone)]
pub(crate) struct CollisionCorpus {
    folder: PathBuf,
}

impl CollisionCorpus {
    /// The collection in a folder, which is made if it is not there.
    ///
    /// # Errors
    /// What the system says if it cannot be made.
    pub(crate) fn open(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// Writes the scenario of a run in which a vehicle under test collided, unless one of its kind is there already.
    ///
    /// # Errors
    /// What the system says if it cannot be written.
    pub(crate) fn insert(&self, test_case: &TestCase, result: &SimulationResult) -> io::Result<Option<PathBuf>> {
        let Some(kind) = behaviour::collision_kind(test_case, result) else { return Ok(None) };
        let path = self.folder.join(format!("{kind}.toml"));
        if path.exists() {
            return Ok(None);
        }
        let about = format!("Found by `cargo fuzz run scenario` under {}.", test_case.setup.controller.name());
        let named = test_case.scenario.edited(|spec| (spec.name, spec.about) = (kind, about));
        let scenario = named.unwrap_or_else(|_| test_case.scenario.clone());
        fs::write(&path, TestCase { scenario, setup: test_case.setup.clone() }.reproducer())?;
        Ok(Some(path))
    }
}
