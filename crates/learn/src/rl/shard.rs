//! Seeds of a training that are divided over machines, and put together again.
//!
//! The folder of a shard is that of any training of several seeds, with `shard.json` beside them: which shard it is, of how many seeds, and
//! how they are trained.

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::folder::{CONFIGURATION, identity_of, seed_folder, text_of};
use super::{TrainingConfig, TrainingError};
use crumple_search::disk;
use crumple_search::shard::{MergeError, Shard, TooManyShards};
use crumple_search::work::{Found, MANIFEST, WorkError, find};
use crumple_world::digest::sha256;

const SHARD: &str = "shard.json";
const VERSION: u32 = 1;
/// The longest such file that is read.
const MOST_BYTES: u64 = 1 << 20;
/// The most seeds.
const MOST_SEEDS: u64 = 100_000;

/// Why trainings do not go together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GatherError {
    /// A folder is damaged, or cannot be written.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// Shards of several trainings.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// There are more shards than seeds.
    #[error(transparent)]
    Shards(#[from] TooManyShards),
    /// A training cannot be read.
    #[error(transparent)]
    Training(#[from] TrainingError),
}

/// The file `shard.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingShard {
    version: u32,
    shard: Shard,
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
    pub fn new(shard: Shard, seeds: u64, config: &TrainingConfig) -> Result<Self, TrainingError> {
        let whole = Self { version: VERSION, shard, seeds, configuration: text_of(config)?, sha256: String::new() };
        Ok(Self { sha256: sha256(whole.text()?), ..whole })
    }

    fn text(&self) -> Result<String, TrainingError> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Says in a folder of trainings what it is a shard of; another shard has to be the same.
    ///
    /// # Errors
    /// [`GatherError`] if it cannot be written, or another one is there.
    pub fn write_in(&self, folder: &Path) -> Result<(), GatherError> {
        let path = folder.join(SHARD);
        match path.exists() {
            true if Self::read(folder)? == *self => Ok(()),
            true => Err(damaged(&path, "there is another shard: use another --out").into()),
            false => Ok(disk::write(&path, self.text()?).map_err(WorkError::from)?),
        }
    }

    /// The shard that a folder of trainings is.
    ///
    /// # Errors
    /// [`GatherError`] if the file is not there, or not as it was written.
    pub fn read(folder: &Path) -> Result<Self, GatherError> {
        let path = folder.join(SHARD);
        let bytes = disk::read(&path, MOST_BYTES).map_err(WorkError::from)?;
        let bytes = bytes.ok_or_else(|| damaged(&path, "the file is missing: not a shard of trainings"))?;
        let read: Self = serde_json::from_slice(&bytes).map_err(|error| {
            let problem = format!("line {}, column {}: not as crumple writes it", error.line(), error.column());
            damaged(&path, &problem)
        })?;
        let whole = Self { sha256: String::new(), ..read.clone() }.text()?;
        if read.version != VERSION || read.sha256 != sha256(whole) || read.text()?.into_bytes() != bytes {
            return Err(damaged(&path, "not as it was written").into());
        }
        if read.seeds > MOST_SEEDS {
            return Err(damaged(&path, "seeds: more than are trained").into());
        }
        read.range().map_err(|error| damaged(&path, &error.to_string()))?;
        Ok(read)
    }

    /// Its seeds.
    ///
    /// # Errors
    /// [`TooManyShards`] if there are fewer seeds than shards.
    pub fn range(&self) -> Result<Range<u64>, TooManyShards> {
        self.shard.range(self.seeds, "seeds")
    }

    /// Of how many seeds, from 0.
    #[must_use]
    pub fn seeds(&self) -> u64 {
        self.seeds
    }

    /// How they are trained.
    ///
    /// # Errors
    /// [`GatherError`] if that is no configuration.
    pub fn config(&self, folder: &Path) -> Result<TrainingConfig, GatherError> {
        let path = folder.join(SHARD);
        let config = TrainingConfig::parse(&self.configuration, &path);
        Ok(config.map_err(|error| damaged(&path, &error.to_string()))?)
    }

    /// Copies the seeds of this shard that are finished in a folder to another, which is that of `first`, the shard that was taken first
    /// from its own folder.
    ///
    /// # Errors
    /// [`GatherError`] if they are seeds of another training, a file is damaged, or something else is in its place.
    pub fn gather(&self, folder: &Path, (first, of_first): (&Path, &Self), out: &Path) -> Result<(), GatherError> {
        let foreign = |field: &str| MergeError::Foreign {
            folder: folder.to_owned(),
            first: first.to_owned(),
            field: field.to_owned(),
        };
        if self.configuration != of_first.configuration {
            return Err(foreign("the configuration").into());
        }
        if self.seeds != of_first.seeds {
            return Err(foreign("the number of seeds").into());
        }
        let config = self.config(folder)?;
        for seed in self.range()? {
            let place = seed_folder(folder, seed);
            if !place.is_dir() {
                continue;
            }
            if let Found::Finished(found) = find(&place)? {
                let path = place.join(CONFIGURATION);
                let is_own =
                    found.is_of(&identity_of(&config, seed)?) && found.read(CONFIGURATION)? == self.configuration;
                if !is_own {
                    return Err(damaged(&path, "trained otherwise than the shard says, or with another seed").into());
                }
                found.copy_to(&seed_folder(out, seed))?;
            }
        }
        Ok(())
    }
}

/// Whether a folder holds seeds of a training, or says that it is to.
#[must_use]
pub fn is_of_trainings(folder: &Path) -> bool {
    let is_seed = |path: PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_prefix("seed-"));
        name.is_some_and(|number| number.parse::<u64>().is_ok()) && path.is_dir()
    };
    let entries = || std::fs::read_dir(folder).into_iter().flatten().flatten();
    let holds = folder.join(SHARD).exists() || entries().any(|entry| is_seed(entry.path()));
    !folder.join(MANIFEST).exists() && holds
}

fn damaged(path: &Path, problem: &str) -> WorkError {
    WorkError::Damaged { path: path.to_owned(), problem: problem.to_owned() }
}
