//! A shard of a count in a folder: `shard.json` says all that decides it, `progress.json` what its blocks came to.

use std::ops::{ControlFlow, Range};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::RatePlan;
use super::rate_folder::{Counting, PROGRESS, RateFolderError, json};
use super::record::{CountRecord, Tally, length};
use crate::shard::{self, SHARD, Shard};
use crate::work::{Finished, Work, WorkError};

/// What a folder of one is called in its `work.json`.
pub const SHARD_OF_A_COUNT: &str = "shard of a count";

/// The version of that file.
const VERSION: u32 = 1;

/// A shard of a count that is on record in a folder.
pub struct RateShard<'a> {
    work: Work,
    counting: Counting<'a>,
}

/// The file `shard.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShardFile {
    version: u32,
    shard: Shard,
    count: CountRecord,
}

impl RatePlan {
    /// Puts a shard of the plan on record in `folder`, as [`Self::register_in`] does with the whole.
    ///
    /// # Errors
    /// [`RateFolderError`] if there are fewer blocks than shards, or the folder cannot be used, or holds something else.
    pub fn register_shard_in(
        &self,
        shard: Shard,
        folder: &Path,
        resume: bool,
    ) -> Result<RateShard<'_>, RateFolderError> {
        let blocks = self.blocks_of(shard)?;
        let file = ShardFile { version: VERSION, shard, count: self.record().clone() };
        let configuration = json(&folder.join(SHARD), &file)?;
        let work = shard::open_shard(folder, SHARD_OF_A_COUNT, &configuration, PROGRESS, resume);
        let work = work.map_err(|error| match error {
            WorkError::OtherConfiguration { path, .. } => RateFolderError::OtherRegistration { path },
            other => other.into(),
        })?;
        let counting = Counting::in_folder(self, blocks, &work)?;
        Ok(RateShard { work, counting })
    }
}

impl RateShard<'_> {
    /// Counts what is left. `progress` hears how many runs are done, after every thousand.
    ///
    /// # Errors
    /// [`RateFolderError`] if a run cannot be made or a file not written.
    pub fn count(&mut self, progress: &mut dyn FnMut(u64)) -> Result<(), RateFolderError> {
        self.counting.count(&self.work, &mut |runs, _| {
            progress(runs);
            ControlFlow::Continue(())
        })?;
        Ok(self.work.finish()?)
    }

    /// What has been counted so far.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        self.counting.tally()
    }

    #[cfg(test)]
    pub(super) fn work(&self) -> &Work {
        &self.work
    }

    /// How many runs it is of.
    #[must_use]
    pub fn runs(&self) -> u64 {
        self.counting.runs()
    }
}

/// A shard that was counted, as it is read from its folder.
pub(super) struct CountedShard {
    pub(super) shard: Shard,
    pub(super) record: CountRecord,
    /// Its blocks; as many as the tally holds.
    pub(super) blocks: Range<u64>,
    pub(super) tally: Tally,
}

impl CountedShard {
    /// Reads it, and checks whatever can be checked without the controllers.
    pub(super) fn read(found: &Finished) -> Result<Self, WorkError> {
        let unreadable = |name: &'static str| move |error: serde_json::Error| found.unreadable(name, &error);
        let file: ShardFile = shard::read_shard(found)?;
        let ShardFile { version, shard, count: record } = file;
        if version != VERSION {
            return Err(found.damaged(SHARD, format!("version: {version}, and this release reads {VERSION}")));
        }
        if let Some(problem) = record.problem() {
            return Err(found.damaged(SHARD, format!("count.{problem}")));
        }
        let blocks = shard.range(record.blocks(), "blocks of runs").map_err(|error| found.damaged(SHARD, error))?;
        let tally: Tally = serde_json::from_str(&found.read(PROGRESS)?).map_err(unreadable(PROGRESS))?;
        if tally.blocks.len() as u64 != length(&blocks) || !record.is_sound(&blocks, &tally) {
            return Err(found.damaged(PROGRESS, format!("not what shard {shard} of that count comes to")));
        }
        Ok(Self { shard, record, blocks, tally })
    }
}
