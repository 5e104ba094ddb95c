//! Presets of trainings: built-in ones and files.

use std::path::{Path, PathBuf};

use super::drives::load_drives;
use super::{CliError, file_kind};
use crumple_controllers::Controllers;
use crumple_core::text_file;
use crumple_learn::rl::{PRESETS, TrainingConfig, TrainingConfigError};

/// A configuration with the text of its file, so that later errors can state a line.
pub(super) struct TrainingPreset {
    pub(super) config: TrainingConfig,
    text: String,
    path: PathBuf,
}

impl TrainingPreset {
    pub(super) fn find(name: &Path) -> Result<Self, CliError> {
        if let Some(preset) = Self::from_file(name)? {
            return Ok(preset);
        }
        let name = &*name.to_string_lossy();
        let text = TrainingConfig::preset_text(name)
            .map_err(|_| unknown_preset_error(name, None))?
            .to_owned();
        Ok(Self {
            config: TrainingConfig::preset(name).map_err(CliError::input)?,
            text,
            path: PathBuf::from(name),
        })
    }

    /// Finds a preset as [`Self::find`] does, for a command with a special preset `own`, which is not found by that
    /// name.
    pub(super) fn find_with_own(own: &str, name: &Path) -> Result<Self, CliError> {
        match Self::from_file(name)? {
            Some(preset) => Ok(preset),
            None if is_built_in(name) => Self::find(name),
            None => Err(unknown_preset_error(&name.to_string_lossy(), Some(own))),
        }
    }

    /// Returns the configuration, if its scenario spaces are available.
    pub(super) fn into_checked_config(
        mut self,
        controllers: Controllers,
        drives: Option<&str>,
    ) -> Result<TrainingConfig, CliError> {
        self.config.controllers = controllers;
        self.config
            .scenario_source()
            .map_err(|error| self.error_at_line(error))?;
        self.with_drives(self.config.clone(), drives)
    }

    /// Replaces the recorded drives of a configuration by those of `--drives`, if given, and states their SHA-256.
    pub(super) fn with_drives(
        &self,
        mut config: TrainingConfig,
        drives: Option<&str>,
    ) -> Result<TrainingConfig, CliError> {
        match drives {
            Some(folder) => replace_drives(config, folder),
            None => match config.state_drives() {
                Ok(()) => Ok(config),
                Err(error) => Err(self.error_at_line(error)),
            },
        }
    }

    /// Loads the preset from a file; `None` if the name can only be that of a built-in preset.
    pub(super) fn from_file(path: &Path) -> Result<Option<Self>, CliError> {
        // A built-in name takes precedence over a file.
        if path.extension().is_none() && (is_built_in(path) || !path.exists()) {
            return Ok(None);
        }
        if let Some(what) = file_kind::detect(path) {
            return Err(CliError::at(path, format!("is not a preset, but {what}")));
        }
        let text = text_file::read(path)?;
        let config = TrainingConfig::parse(&text, path).map_err(CliError::input)?;
        Ok(Some(Self {
            config,
            text,
            path: path.to_owned(),
        }))
    }

    pub(super) fn error_at_line(&self, error: TrainingConfigError) -> CliError {
        CliError::input(error.with_location(&self.text, &self.path))
    }
}

/// Replaces the recorded drives of a configuration by those of `--drives`.
pub(super) fn replace_drives(
    mut config: TrainingConfig,
    folder: &str,
) -> Result<TrainingConfig, CliError> {
    let drives = load_drives(Path::new(folder), config.controllers)?;
    config.evaluation.drives = Some(folder.to_owned());
    config.evaluation.drives_sha256 = Some(drives.identity().to_owned());
    match config.check() {
        Ok(()) => Ok(config),
        Err(TrainingConfigError::Field(invalid)) => {
            Err(CliError::Input(format!("--drives: {}", invalid.problem)))
        }
        Err(error) => Err(CliError::input(error)),
    }
}

fn is_built_in(name: &Path) -> bool {
    name.to_str()
        .is_some_and(|name| TrainingConfig::preset_text(name).is_ok())
}

fn unknown_preset_error(name: &str, own: Option<&str>) -> CliError {
    if name.trim().is_empty() {
        return CliError::Input("--preset: the name of the preset is empty".to_owned());
    }
    let names: Vec<&str> = own
        .into_iter()
        .chain(PRESETS.iter().map(|(name, _)| *name))
        .collect();
    if own.is_none() && RETRAIN_PRESET_NAMES.contains(&name) {
        return CliError::Input(format!(
            "`{name}` is the preset of `crumple retrain`; `train` has {}. `crumple show retrain` prints it as a file",
            names.join(", ")
        ));
    }
    CliError::Input(format!(
        "there is no preset `{name}`, and no such file; there are {}",
        names.join(", ")
    ))
}

/// Preset of `crumple retrain`, and its former name.
pub(super) const RETRAIN_PRESET_NAMES: [&str; 2] = ["retrain", "harden"];
