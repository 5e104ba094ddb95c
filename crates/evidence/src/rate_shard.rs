//! A shard of a count in a run folder: `shard.json` has its configuration, `progress.json` the results of its blocks.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::rate_folder::{BlockCounter, PROGRESS_FILE, RateFolderError, to_json};
use super::record::{CountRecord, CountTally, range_len};
use super::{CountProgress, RatePlan};
use crumple_core::observer::{Observer, RunProgress};
use crumple_store::difference;
use crumple_store::run_folder::{CompletedRun, RunFolder, RunFolderError, RunFolderOptions};
use crumple_store::shard::ShardId;

/// Kind of the run folder in its `work.json`.
pub const COUNT_SHARD_KIND: &str = "shard of a count";

pub(super) const SHARD_FILE: &str = "shard.json";
const SHARD_VERSION: u32 = 1;

/// A shard of a count that is registered in a folder.
pub struct RateShard<'a> {
    pub(super) run_folder: RunFolder,
    block_counter: BlockCounter<'a>,
}

/// The file `shard.json`.
#[derive(Serialize, Deserialize)]
pub(super) struct ShardFile {
    version: u32,
    pub(super) shard: ShardId,
    pub(super) count: CountRecord,
}

/// Version in `shard.json`. The rest is read only if the version is known.
#[derive(Deserialize)]
struct ShardHeader {
    version: u32,
}

impl ShardFile {
    /// Reads `shard.json` of a completed shard.
    ///
    /// # Errors
    /// [`RunFolderError`] if the file is not as it was written, of another version, or invalid.
    pub(super) fn read(found: &CompletedRun) -> Result<Self, RunFolderError> {
        let text = found.read_configuration(SHARD_FILE)?;
        let unreadable = |error| found.unreadable_error(SHARD_FILE, &error);
        let ShardHeader { version } = serde_json::from_str(&text).map_err(unreadable)?;
        if version != SHARD_VERSION {
            let problem = format!("version: {version}, and this release reads {SHARD_VERSION}");
            return Err(found.damaged_error(SHARD_FILE, problem));
        }
        let file: Self = serde_json::from_str(&text).map_err(unreadable)?;
        match file.count.problem() {
            Some(problem) => Err(found.damaged_error(SHARD_FILE, format!("count.{problem}"))),
            None => Ok(file),
        }
    }
}

impl RatePlan {
    /// Registers a shard of the plan in `folder`, see [`Self::register_in`].
    ///
    /// # Errors
    /// [`RateFolderError`] if there are fewer blocks than shards, or the folder cannot be used or has other content.
    pub fn register_shard_in(
        &self,
        shard: ShardId,
        folder: &Path,
        resume: bool,
    ) -> Result<RateShard<'_>, RateFolderError> {
        let blocks = self.shard_blocks(shard)?;
        let file = ShardFile { version: SHARD_VERSION, shard, count: self.record().clone() };
        let text = to_json(&folder.join(SHARD_FILE), &file)?;
        let asked = RunFolderOptions {
            kind: COUNT_SHARD_KIND,
            configuration: &text,
            configuration_file: SHARD_FILE,
            resume,
            outputs: &[SHARD_FILE, PROGRESS_FILE],
        };
        let work = RunFolder::open(folder, asked).map_err(|error| match error {
            RunFolderError::OtherConfiguration { path, kind, found } => {
                RunFolderError::ConfigurationDiffers(difference::describe_json(&path, &kind, &found, &text))
            }
            other => other,
        })?;
        work.write(SHARD_FILE, text)?;
        let counting = BlockCounter::load(self, blocks, &work)?;
        Ok(RateShard { run_folder: work, block_counter: counting })
    }
}

impl RateShard<'_> {
    /// Counts the remaining runs. If `observer` stops the shard, the folder keeps the tally.
    ///
    /// # Errors
    /// [`RateFolderError`] if a run fails, a file cannot be written, or `observer` stops the shard.
    pub fn count(&mut self, observer: &dyn Observer<RunProgress>) -> Result<(), RateFolderError> {
        if self.run_folder.is_complete() {
            return Ok(());
        }
        let total = Some(self.run_count());
        let counting = |progress: &CountProgress| observer.observe(&RunProgress { done: progress.runs, total });
        self.block_counter.count(&self.run_folder, &counting)?;
        Ok(self.run_folder.finish()?)
    }

    /// Returns the tally so far.
    #[must_use]
    pub fn tally(&self) -> &CountTally {
        &self.block_counter.tally
    }

    /// Returns the number of runs.
    #[must_use]
    pub fn run_count(&self) -> u64 {
        self.block_counter.run_count()
    }
}

impl CountRecord {
    /// Returns the first field in which another count differs.
    pub(super) fn differing_field(&self, other: &Self) -> Option<String> {
        let (own, foreign) = (&self.registration, &other.registration);
        let keys = own.configuration.keys().chain(foreign.configuration.keys());
        let differs = |key: &&String| own.configuration.get(*key) != foreign.configuration.get(*key);
        let fields = [
            ("runs", own.runs != foreign.runs),
            ("confidence", own.confidence != foreign.confidence),
            ("block_runs", own.block_runs != foreign.block_runs),
        ];
        let key = keys.into_iter().find(differs).map(|key| format!("configuration.{key}"));
        key.or_else(|| fields.iter().find(|(_, differs)| *differs).map(|(name, _)| (*name).to_owned()))
    }

    /// Returns true if a shard with these blocks can have this tally.
    pub(super) fn is_shard_tally(&self, blocks: &Range<u64>, tally: &CountTally) -> bool {
        tally.blocks.len() as u64 == range_len(blocks) && self.is_consistent(blocks, tally)
    }
}
