//! The preset of a training: a committed one by its name, or a file like theirs.

use std::path::{Path, PathBuf};

use super::{CliError, file_kind};
use crumple_learn::rl::{PRESETS, TrainingConfig, TrainingConfigError};
use crumple_world::scenario::file;

/// A configuration with the file that says it, so that what turns out to be wrong later still has a line.
pub(super) struct TrainingPreset {
    pub(super) config: TrainingConfig,
    text: String,
    path: PathBuf,
}

impl TrainingPreset {
    /// The committed preset of that name, or the one in a file.
    pub(super) fn find(name: &str) -> Result<Self, CliError> {
        if let Some(preset) = Self::from_file(name)? {
            return Ok(preset);
        }
        let text = TrainingConfig::preset_text(name).map_err(|_| unknown_preset_error(name, None))?.to_owned();
        Ok(Self { config: TrainingConfig::preset(name).map_err(CliError::input)?, text, path: PathBuf::from(name) })
    }

    /// As [`Self::find`], for a command that has a preset of its own besides, which is not the one of that name.
    pub(super) fn find_with_own(own: &str, name: &str) -> Result<Self, CliError> {
        match Self::from_file(name)? {
            Some(preset) => Ok(preset),
            None if TrainingConfig::preset_text(name).is_ok() => Self::find(name),
            None => Err(unknown_preset_error(name, Some(own))),
        }
    }

    /// Its configuration, if its spaces are there to be drawn from.
    pub(super) fn into_checked_config(self) -> Result<TrainingConfig, CliError> {
        self.config.scenario_source().map_err(|error| self.error_at_line(error))?;
        Ok(self.config)
    }

    /// The preset in a file; none where the name can only be that of a committed one.
    pub(super) fn from_file(name: &str) -> Result<Option<Self>, CliError> {
        let path = Path::new(name);
        // A committed preset's name is its own, whatever lies in the folder.
        if path.extension().is_none() && (TrainingConfig::preset_text(name).is_ok() || !path.exists()) {
            return Ok(None);
        }
        if let Some(what) = file_kind::detect(path) {
            return Err(CliError::Input(format!("{}: is no preset, but {what}", path.display())));
        }
        let text = file::read(path)?;
        let config = TrainingConfig::parse(&text, path).map_err(CliError::input)?;
        Ok(Some(Self { config, text, path: path.to_owned() }))
    }

    /// An error in what the configuration names, with the line that names it.
    pub(super) fn error_at_line(&self, error: TrainingConfigError) -> CliError {
        CliError::input(error.with_location(&self.text, &self.path))
    }
}

/// What presets there are instead, with the command's own.
fn unknown_preset_error(name: &str, own: Option<&str>) -> CliError {
    if name.trim().is_empty() {
        return CliError::Input("--preset: none is named".to_owned());
    }
    let names: Vec<&str> = own.into_iter().chain(PRESETS.iter().map(|(name, _)| *name)).collect();
    let hint = if own.is_none() && RETRAIN_PRESET_NAMES.contains(&name) {
        ": it is the preset of `crumple retrain`"
    } else {
        ""
    };
    CliError::Input(format!("there is no preset `{name}`, and no such file{hint}; there are {}", names.join(", ")))
}

/// The preset of `crumple retrain`, and what it was called before.
pub(super) const RETRAIN_PRESET_NAMES: [&str; 2] = ["retrain", "harden"];
