//! Collection of collisions, with one scenario file per kind.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::{TestCase, behaviour};
use crumple_world::sim::SimulationResult;

#[derive(Debug, Clone)]
pub(crate) struct CollisionCorpus {
    folder: PathBuf,
}

impl CollisionCorpus {
    /// Opens or creates a collection.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub(crate) fn open(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// Writes the scenario if a vehicle under test collided and no collision of this kind is there.
    ///
    /// # Errors
    /// The file cannot be written.
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
