//! A shard of a count in a folder: `shard.json` says all that decides it, `progress.json` what its blocks came to.

use std::ops::{ControlFlow, Range};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::RatePlan;
use super::exposed::own_resamples;
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
    own_resamples: Range<u64>,
}

/// The file `shard.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShardFile {
    version: u32,
    shard: Shard,
    count: CountRecord,
    /// Where failures are stated per hour: resamples of the episodes, and new runs in each.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    resampling: Option<(u32, u32)>,
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
        let resampling = self.resampling();
        let own_resamples = own_resamples(resampling.map_or(0, |(resamples, _)| resamples), &blocks, self.blocks());
        let file = ShardFile { version: VERSION, shard, count: self.record().clone(), resampling };
        let configuration = json(&folder.join(SHARD), &file)?;
        let work = shard::open_shard(folder, SHARD_OF_A_COUNT, &configuration, PROGRESS, resume)?;
        let counting = Counting::in_folder(self, blocks, &work)?;
        Ok(RateShard { work, counting, own_resamples })
    }
}

impl RateShard<'_> {
    /// Counts what is left, and makes the new runs in its share of the resamples. `progress` hears how many runs are done, after every
    /// thousand.
    ///
    /// # Errors
    /// [`RateFolderError`] if a run cannot be made or a file not written.
    pub fn count(&mut self, progress: &mut dyn FnMut(u64)) -> Result<(), RateFolderError> {
        if self.work.is_complete() {
            return Ok(());
        }
        self.counting.count(&self.work, &mut |runs, _| {
            progress(runs);
            ControlFlow::Continue(())
        })?;
        let mut done = self.counting.runs();
        let told = &mut |runs| {
            done += runs;
            progress(done);
        };
        self.counting.resample(&self.work, self.own_resamples.clone(), told)?;
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

    /// How many runs it takes, those in resamples among them.
    #[must_use]
    pub fn runs(&self) -> u64 {
        self.counting.runs() + self.counting.runs_in(&self.own_resamples)
    }
}

/// A shard that was counted, as it is read from its folder.
pub(super) struct CountedShard {
    pub(super) shard: Shard,
    pub(super) record: CountRecord,
    pub(super) resampling: Option<(u32, u32)>,
    /// Its blocks; as many as the tally holds.
    pub(super) blocks: Range<u64>,
    pub(super) tally: Tally,
}

impl CountedShard {
    /// Reads it, and checks whatever can be checked without the controllers.
    pub(super) fn read(found: &Finished) -> Result<Self, WorkError> {
        let unreadable = |name: &'static str| move |error: serde_json::Error| found.unreadable(name, &error);
        let ShardFile { shard, count: record, resampling, .. } = shard::read_shard(found, VERSION)?;
        if let Some(problem) = record.problem() {
            return Err(found.damaged(SHARD, format!("count.{problem}")));
        }
        let blocks = shard.range(record.blocks(), "blocks of runs").map_err(|error| found.damaged(SHARD, error))?;
        let tally: Tally = serde_json::from_str(&found.read(PROGRESS)?).map_err(unreadable(PROGRESS))?;
        let (resamples, runs_each) = resampling.unwrap_or_default();
        let most = length(&own_resamples(resamples, &blocks, record.blocks()));
        // There are fewer where no space could be fitted to some.
        let may_be_resampled = tally.resampled.len() as u64 <= most
            && tally.resampled.iter().all(|failures| *failures <= u64::from(runs_each));
        if tally.blocks.len() as u64 != length(&blocks) || !record.is_sound(&blocks, &tally) || !may_be_resampled {
            return Err(found.damaged(PROGRESS, format!("not what shard {shard} of that count comes to")));
        }
        Ok(Self { shard, record, resampling, blocks, tally })
    }
}
