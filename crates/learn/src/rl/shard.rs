//! Shards of a training with several seeds, for several machines, and their merge.
//!
//! A shard's folder holds a folder for each seed, and `shard.json` with shard, seeds and configuration.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::folder::{CONFIGURATION, config_toml, read_finished_trainings, seed_folder, training_identity};
use super::{TrainingConfig, TrainingError};
use crumple_core::digest::sha256;
use crumple_store::disk;
use crumple_store::run_folder::{CompletedRun, MANIFEST_FILE, RunFolderError, RunState, read_state};
use crumple_store::shard::{MergeError, MissingShards, Parts, ShardId, TooManyShards};

const SHARD_FILE: &str = "shard.json";
const VERSION: u32 = 1;
const MAX_BYTES: u64 = 1 << 20;
const MAX_SEEDS: u64 = 100_000;

/// Reason why trainings cannot be merged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MergeTrainingsError {
    /// A folder is damaged or cannot be written.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// The shards belong to different trainings.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// There are more shards than seeds.
    #[error(transparent)]
    TooManyShards(#[from] TooManyShards),
    /// A training cannot be read.
    #[error(transparent)]
    Training(#[from] TrainingError),
}

/// The file `shard.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingShard {
    version: u32,
    shard: ShardId,
    seeds: u64,
    configuration: String,
    /// SHA-256 of the file with an empty string in this field.
    sha256: String,
}

impl TrainingShard {
    /// Creates a shard of a training with the seeds 0 to `seeds` - 1.
    ///
    /// # Errors
    /// [`TrainingError`] if the configuration cannot be encoded.
    pub fn new(shard: ShardId, seeds: u64, config: &TrainingConfig) -> Result<Self, TrainingError> {
        let whole = Self { version: VERSION, shard, seeds, configuration: config_toml(config)?, sha256: String::new() };
        Ok(Self { sha256: sha256(whole.to_json()?), ..whole })
    }

    fn to_json(&self) -> Result<String, TrainingError> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Writes `shard.json` into a folder of trainings, unless it is there already.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if it cannot be written, or the folder holds another shard.
    pub fn write_to(&self, folder: &Path) -> Result<(), MergeTrainingsError> {
        let path = folder.join(SHARD_FILE);
        match path.exists() {
            true if Self::read(folder)? == *self => Ok(()),
            true => Err(RunFolderError::damaged(&path, "the folder holds another shard: use another --out").into()),
            false => Ok(disk::write(&path, self.to_json()?).map_err(RunFolderError::from)?),
        }
    }

    /// Reads `shard.json` of a folder of trainings.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if the file is missing or damaged.
    pub fn read(folder: &Path) -> Result<Self, MergeTrainingsError> {
        let path = folder.join(SHARD_FILE);
        let bytes = disk::read(&path, MAX_BYTES).map_err(RunFolderError::from)?;
        let damaged = |problem: &str| RunFolderError::damaged(&path, problem);
        let bytes = bytes.ok_or_else(|| damaged("the file is missing, so the folder is not a shard of trainings"))?;
        let read: Self = serde_json::from_slice(&bytes).map_err(|error| {
            damaged(&format!("line {}, column {}: not as crumple writes it", error.line(), error.column()))
        })?;
        let whole = Self { sha256: String::new(), ..read.clone() }.to_json()?;
        if read.version != VERSION || read.sha256 != sha256(whole) || read.to_json()?.into_bytes() != bytes {
            return Err(damaged("has changed since it was written").into());
        }
        if read.seeds > MAX_SEEDS {
            return Err(damaged("seeds: exceed the allowed number").into());
        }
        read.seed_range().map_err(|error| damaged(&error.to_string()))?;
        Ok(read)
    }

    /// Returns the seeds of the shard.
    ///
    /// # Errors
    /// [`TooManyShards`] if there are fewer seeds than shards.
    pub(crate) fn seed_range(&self) -> Result<Range<u64>, TooManyShards> {
        self.shard.range(self.seeds, "seeds")
    }

    /// Returns the configuration.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if it is invalid.
    pub fn config(&self, folder: &Path) -> Result<TrainingConfig, MergeTrainingsError> {
        let path = folder.join(SHARD_FILE);
        let config = TrainingConfig::parse(&self.configuration, &path);
        Ok(config.map_err(|error| RunFolderError::damaged(&path, error.to_string()))?)
    }
}

/// Shards of one training with several seeds. All shards are read before the first file is written.
#[derive(Debug)]
pub struct MergedTrainings {
    reference: TrainingShard,
    config: TrainingConfig,
    shards: Parts<()>,
    finished_seeds: BTreeMap<u64, (PathBuf, CompletedRun)>,
}

impl MergedTrainings {
    /// Starts with one shard.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if it cannot be read.
    pub fn from_shard(folder: &Path) -> Result<Self, MergeTrainingsError> {
        let whole = TrainingShard::read(folder)?;
        let config = whole.config(folder)?;
        let mut merged = Self { reference: whole, config, shards: Parts::new(folder), finished_seeds: BTreeMap::new() };
        merged.add_shard(folder)?;
        Ok(merged)
    }

    /// Adds another shard, finished or not.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if it is damaged, of another training, or contradicts a shard added before.
    pub fn add_shard(&mut self, folder: &Path) -> Result<(), MergeTrainingsError> {
        let shard = TrainingShard::read(folder)?;
        let foreign = |field: &str| MergeTrainingsError::from(self.shards.foreign_error(folder, field.to_owned()));
        if shard.configuration != self.reference.configuration {
            return Err(foreign("the configuration"));
        }
        if shard.seeds != self.reference.seeds {
            return Err(foreign("the number of seeds"));
        }
        self.shards.insert(folder, shard.shard, shard.seed_range()?, ())?;
        for seed in shard.seed_range()? {
            let place = seed_folder(folder, seed);
            if !place.is_dir() {
                continue;
            }
            let RunState::Complete(found) = read_state(&place)? else { continue };
            let is_own = found.has_configuration(&training_identity(&self.config, seed)?)
                && found.read(CONFIGURATION)? == shard.configuration;
            if !is_own {
                let problem = "differs from the configuration or seed of the shard";
                return Err(RunFolderError::damaged(&place.join(CONFIGURATION), problem).into());
            }
            found.check()?;
            match self.finished_seeds.get(&seed) {
                Some((taken, other)) if !other.is_identical_to(&found) => {
                    let (folder, taken) = (folder.to_owned(), taken.clone());
                    return Err(MergeError::Contradicting { folder, shard: shard.shard, other_folder: taken }.into());
                }
                Some(_) => {}
                None => drop(self.finished_seeds.insert(seed, (folder.to_owned(), found))),
            }
        }
        Ok(())
    }

    /// Returns the configuration.
    #[must_use]
    pub fn config(&self) -> &TrainingConfig {
        &self.config
    }

    /// Returns the number of seeds of the whole training, which start at 0.
    #[must_use]
    pub fn seed_count(&self) -> u64 {
        self.reference.seeds
    }

    /// Returns the missing shards. An added shard may still have unfinished seeds.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        self.shards.missing_shards()
    }

    /// Copies the finished seeds to the folder of the whole training.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if that folder holds other files; then nothing is written.
    pub fn write_to(&self, out: &Path) -> Result<(), MergeTrainingsError> {
        for (seed, (_, found)) in &self.finished_seeds {
            found.is_present_in(&seed_folder(out, *seed))?;
        }
        if out.is_dir() {
            read_finished_trainings(out, &self.config)?;
        }
        disk::make_folder(out).map_err(RunFolderError::from)?;
        for (seed, (_, found)) in &self.finished_seeds {
            found.copy_to(&seed_folder(out, *seed))?;
        }
        Ok(())
    }
}

/// True if a folder holds trainings: it has no manifest, but a `shard.json` with seeds, or folders of seeds.
#[must_use]
pub fn is_trainings_folder(folder: &Path) -> bool {
    let is_seed = |path: PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_prefix("seed-"));
        name.is_some_and(|number| number.parse::<u64>().is_ok()) && path.is_dir()
    };
    let entries = || std::fs::read_dir(folder).into_iter().flatten().flatten();
    let says_seeds = || {
        let bytes = disk::read(&folder.join(SHARD_FILE), MAX_BYTES).ok().flatten();
        let text = bytes.and_then(|bytes| serde_json::from_slice::<serde_json::Value>(&bytes).ok());
        text.is_some_and(|text| text.get("seeds").is_some())
    };
    !folder.join(MANIFEST_FILE).exists() && (says_seeds() || entries().any(|entry| is_seed(entry.path())))
}
