//! A shard of a count in a folder: `shard.json` says all that decides it, `progress.json` what its blocks came to.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::exposure::resample_range;
use super::rate_folder::{BlockCounter, PROGRESS_FILE, RateFolderError};
use super::record::{CountRecord, CountTally, range_len};
use super::{CountProgress, RatePlan};
use crumple_core::observer::{Observer, ProgressCounter, RunProgress};
use crumple_store::run_folder::RunFolder;
use crumple_store::shard::{Mergeable, ShardId, Sharded, open_shard};

/// What a folder of one is called in its `work.json`.
pub const COUNT_SHARD_KIND: &str = "shard of a count";

/// A shard of a count that is on record in a folder.
pub struct RateShard<'a> {
    run_folder: RunFolder,
    block_counter: BlockCounter<'a>,
    resample_range: Range<u64>,
}

/// Everything that decides a count that is divided.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardedCount {
    pub(super) count: CountRecord,
    /// Resamples of the episodes and new runs in each, if failures are stated per hour.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) resampling: Option<(u32, u32)>,
}

impl Sharded for ShardedCount {
    const KIND: &'static str = COUNT_SHARD_KIND;
    const VERSION: u32 = 1;
    const RESULTS_FILE: &'static str = PROGRESS_FILE;
    const PARTS_NAME: &'static str = "blocks of runs";
    const IS_PRETTY: bool = true;

    fn part_count(&self) -> u64 {
        self.count.block_count()
    }

    fn differing_field(&self, other: &Self) -> Option<String> {
        let (own, foreign) = (self.count.registration(), other.count.registration());
        let keys = own.configuration.keys().chain(foreign.configuration.keys());
        let differs = |key: &&String| own.configuration.get(*key) != foreign.configuration.get(*key);
        let fields = [
            ("runs", own.runs != foreign.runs),
            ("confidence", own.confidence != foreign.confidence),
            ("block_runs", own.block_runs != foreign.block_runs),
            ("resampling", self.resampling != other.resampling),
        ];
        let key = keys.into_iter().find(differs).map(|key| format!("configuration.{key}"));
        key.or_else(|| fields.iter().find(|(_, differs)| *differs).map(|(name, _)| (*name).to_owned()))
    }

    fn problem(&self) -> Option<String> {
        self.count.problem().map(|problem| format!("count.{problem}"))
    }
}

impl Mergeable for ShardedCount {
    type File = CountTally;
    type Results = CountTally;

    fn check(&self, tally: CountTally, shard: ShardId, blocks: &Range<u64>) -> Result<CountTally, String> {
        let (resamples, runs_each) = self.resampling.unwrap_or_default();
        let most = range_len(&resample_range(resamples, blocks, self.part_count()));
        // There are fewer where no space could be fitted to some.
        let may_be_resampled = tally.resample_failures.len() as u64 <= most
            && tally.resample_failures.iter().all(|failures| *failures <= u64::from(runs_each));
        match tally.blocks.len() as u64 == range_len(blocks)
            && self.count.is_consistent(blocks, &tally)
            && may_be_resampled
        {
            true => Ok(tally),
            false => Err(format!("not what shard {shard} of that count comes to")),
        }
    }
}

impl RatePlan {
    /// Puts a shard of the plan on record in `folder`, as [`Self::register_in`] does with the whole.
    ///
    /// # Errors
    /// [`RateFolderError`] if there are fewer blocks than shards, or the folder cannot be used, or holds something else.
    pub fn register_shard_in(
        &self,
        shard: ShardId,
        folder: &Path,
        resume: bool,
    ) -> Result<RateShard<'_>, RateFolderError> {
        let blocks = self.shard_blocks(shard)?;
        let resampling = self.resampling();
        let own_resamples =
            resample_range(resampling.map_or(0, |(resamples, _)| resamples), &blocks, self.block_count());
        let sharded = ShardedCount { count: self.record().clone(), resampling };
        let work = open_shard(&sharded, shard, folder, resume)?;
        let counting = BlockCounter::load(self, blocks, &work)?;
        Ok(RateShard { run_folder: work, block_counter: counting, resample_range: own_resamples })
    }
}

impl RateShard<'_> {
    /// Counts what is left, and makes the new runs in its share of the resamples. If `observer` stops the shard, the folder keeps what was
    /// counted.
    ///
    /// # Errors
    /// [`RateFolderError`] if a run cannot be made, a file not written, or `observer` stops the shard.
    pub fn count(&mut self, observer: &dyn Observer<RunProgress>) -> Result<(), RateFolderError> {
        if self.run_folder.is_complete() {
            return Ok(());
        }
        let (counted, total) = (self.block_counter.run_count(), Some(self.run_count()));
        let counting = |progress: &CountProgress| observer.observe(&RunProgress { done: progress.runs, total });
        self.block_counter.count(&self.run_folder, &counting)?;
        let resampling =
            |progress: &RunProgress| observer.observe(&RunProgress { done: counted + progress.done, total });
        self.block_counter.resample(
            &self.run_folder,
            self.resample_range.clone(),
            &ProgressCounter::new(&resampling, None),
        )?;
        Ok(self.run_folder.finish()?)
    }

    /// What has been counted so far.
    #[must_use]
    pub fn tally(&self) -> &CountTally {
        self.block_counter.tally()
    }

    #[cfg(test)]
    pub(super) fn run_folder(&self) -> &RunFolder {
        &self.run_folder
    }

    /// How many runs it takes, those in resamples among them.
    #[must_use]
    pub fn run_count(&self) -> u64 {
        self.block_counter.run_count() + self.block_counter.resample_run_count(&self.resample_range)
    }
}
