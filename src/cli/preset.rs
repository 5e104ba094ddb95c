//! The preset of a training: a committed one by its name, or a file like theirs.

use std::path::{Path, PathBuf};

use super::Failure;
use crumple_learn::rl::{ConfigError, TrainingConfig};
use crumple_world::scenario::file;

/// A configuration with the file that says it, so that what turns out to be wrong later still has a line.
pub(super) struct Preset {
    pub(super) config: TrainingConfig,
    text: String,
    path: PathBuf,
}

impl Preset {
    /// The committed preset of that name, or the one in a file.
    pub(super) fn find(name: &str) -> Result<Self, Failure> {
        if let Some(preset) = Self::in_file(name)? {
            return Ok(preset);
        }
        let text = TrainingConfig::preset_text(name).map_err(Failure::input)?.to_owned();
        Ok(Self { config: TrainingConfig::preset(name).map_err(Failure::input)?, text, path: PathBuf::from(name) })
    }

    /// The preset in a file; none where the name can only be that of a committed one.
    pub(super) fn in_file(name: &str) -> Result<Option<Self>, Failure> {
        let path = Path::new(name);
        // A committed preset's name is its own, whatever lies in the folder.
        if path.extension().is_none() && (TrainingConfig::preset_text(name).is_ok() || !path.exists()) {
            return Ok(None);
        }
        let text = file::read(path)?;
        let config = TrainingConfig::parse(&text, path).map_err(Failure::input)?;
        Ok(Some(Self { config, text, path: path.to_owned() }))
    }

    /// An error in what the configuration names, with the line that names it.
    pub(super) fn failure(&self, error: ConfigError) -> Failure {
        Failure::input(error.in_text(&self.text, &self.path))
    }
}
