//! Seeds of a training that are divided over machines, and put together again.
//!
//! The folder of a shard is that of any training of several seeds, with `shard.json` beside them: which shard it is, of how many seeds, and
//! how they are trained.

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
/// The longest such file that is read.
const MAX_BYTES: u64 = 1 << 20;
/// The most seeds.
const MAX_SEEDS: u64 = 100_000;

/// Why trainings do not go together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MergeTrainingsError {
    /// A folder is damaged, or cannot be written.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// Shards of several trainings.
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
    /// Of how many seeds, from 0.
    seeds: u64,
    /// How they are trained, as TOML.
    configuration: String,
    /// Of the file with an empty string here.
    sha256: String,
}

impl TrainingShard {
    /// A shard of a training of the seeds 0 to `seeds` - 1.
    ///
    /// # Errors
    /// [`TrainingError`] in principle, if it cannot be encoded.
    pub fn new(shard: ShardId, seeds: u64, config: &TrainingConfig) -> Result<Self, TrainingError> {
        let whole = Self { version: VERSION, shard, seeds, configuration: config_toml(config)?, sha256: String::new() };
        Ok(Self { sha256: sha256(whole.to_json()?), ..whole })
    }

    fn to_json(&self) -> Result<String, TrainingError> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Says in a folder of trainings what it is a shard of; another shard has to be the same.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if it cannot be written, or another one is there.
    pub fn write_to(&self, folder: &Path) -> Result<(), MergeTrainingsError> {
        let path = folder.join(SHARD_FILE);
        match path.exists() {
            true if Self::read(folder)? == *self => Ok(()),
            true => Err(damaged_error(&path, "there is another shard: use another --out").into()),
            false => Ok(disk::write(&path, self.to_json()?).map_err(RunFolderError::from)?),
        }
    }

    /// The shard that a folder of trainings is.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if the file is not there, or not as it was written.
    pub fn read(folder: &Path) -> Result<Self, MergeTrainingsError> {
        let path = folder.join(SHARD_FILE);
        let bytes = disk::read(&path, MAX_BYTES).map_err(RunFolderError::from)?;
        let bytes = bytes.ok_or_else(|| damaged_error(&path, "the file is missing: not a shard of trainings"))?;
        let read: Self = serde_json::from_slice(&bytes).map_err(|error| {
            let problem = format!("line {}, column {}: not as crumple writes it", error.line(), error.column());
            damaged_error(&path, &problem)
        })?;
        let whole = Self { sha256: String::new(), ..read.clone() }.to_json()?;
        if read.version != VERSION || read.sha256 != sha256(whole) || read.to_json()?.into_bytes() != bytes {
            return Err(damaged_error(&path, "not as it was written").into());
        }
        if read.seeds > MAX_SEEDS {
            return Err(damaged_error(&path, "seeds: more than are trained").into());
        }
        read.seed_range().map_err(|error| damaged_error(&path, &error.to_string()))?;
        Ok(read)
    }

    /// Its seeds.
    ///
    /// # Errors
    /// [`TooManyShards`] if there are fewer seeds than shards.
    pub(crate) fn seed_range(&self) -> Result<Range<u64>, TooManyShards> {
        self.shard.range(self.seeds, "seeds")
    }

    /// How they are trained.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if that is no configuration.
    pub fn config(&self, folder: &Path) -> Result<TrainingConfig, MergeTrainingsError> {
        let path = folder.join(SHARD_FILE);
        let config = TrainingConfig::parse(&self.configuration, &path);
        Ok(config.map_err(|error| damaged_error(&path, &error.to_string()))?)
    }
}

/// Shards of one training of several seeds. Nothing is written before all of them were looked at.
#[derive(Debug)]
pub struct MergedTrainings {
    reference: TrainingShard,
    config: TrainingConfig,
    /// Of seeds.
    parts: Parts<()>,
    /// The seeds that are finished, each with the folder of its shard.
    finished_seeds: BTreeMap<u64, (PathBuf, CompletedRun)>,
}

impl MergedTrainings {
    /// Begins with a shard.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if it cannot be read.
    pub fn from_shard(folder: &Path) -> Result<Self, MergeTrainingsError> {
        let whole = TrainingShard::read(folder)?;
        let config = whole.config(folder)?;
        let mut merged = Self { reference: whole, config, parts: Parts::new(folder), finished_seeds: BTreeMap::new() };
        merged.add_shard(folder)?;
        Ok(merged)
    }

    /// Takes in another shard, finished or not.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if it is one of another training, a file is damaged, some of it was trained by another shard, or the same seed came
    /// to something else.
    pub fn add_shard(&mut self, folder: &Path) -> Result<(), MergeTrainingsError> {
        let shard = TrainingShard::read(folder)?;
        let foreign = |field: &str| MergeTrainingsError::from(self.parts.foreign_error(folder, field.to_owned()));
        if shard.configuration != self.reference.configuration {
            return Err(foreign("the configuration"));
        }
        if shard.seeds != self.reference.seeds {
            return Err(foreign("the number of seeds"));
        }
        self.parts.insert(folder, shard.shard, shard.seed_range()?, ())?;
        for seed in shard.seed_range()? {
            let place = seed_folder(folder, seed);
            if !place.is_dir() {
                continue;
            }
            let RunState::Complete(found) = read_state(&place)? else { continue };
            let is_own = found.has_configuration(&training_identity(&self.config, seed)?)
                && found.read(CONFIGURATION)? == shard.configuration;
            if !is_own {
                let problem = "trained otherwise than the shard says, or with another seed";
                return Err(damaged_error(&place.join(CONFIGURATION), problem).into());
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

    /// How they are trained.
    #[must_use]
    pub fn config(&self) -> &TrainingConfig {
        &self.config
    }

    /// Of how many seeds, from 0.
    #[must_use]
    pub fn seed_count(&self) -> u64 {
        self.reference.seeds
    }

    /// Which shards are missing. Of those that are there seeds may be missing.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        self.parts.missing_shards()
    }

    /// Copies the seeds that are finished to the folder of the whole, beside those that are there.
    ///
    /// # Errors
    /// [`MergeTrainingsError`] if there is something else: then nothing was written.
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

/// Whether a folder is one of trainings: its `shard.json` speaks of seeds, or it holds some. Other shards say in `work.json` what they are.
#[must_use]
pub fn is_trainings_folder(folder: &Path) -> bool {
    let is_seed = |path: PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_prefix("seed-"));
        name.is_some_and(|number| number.parse::<u64>().is_ok()) && path.is_dir()
    };
    let entries = || std::fs::read_dir(folder).into_iter().flatten().flatten();
    let said = || disk::read(&folder.join(SHARD_FILE), MAX_BYTES).ok().flatten();
    let says_seeds = || {
        let said = said().and_then(|bytes| serde_json::from_slice::<serde_json::Value>(&bytes).ok());
        said.is_some_and(|said| said.get("seeds").is_some())
    };
    !folder.join(MANIFEST_FILE).exists() && (says_seeds() || entries().any(|entry| is_seed(entry.path())))
}

fn damaged_error(path: &Path, problem: &str) -> RunFolderError {
    RunFolderError::Damaged { path: path.to_owned(), problem: problem.to_owned() }
}
