//! A shard of a count in a run folder: `shard.json` has its configuration, `progress.json` the results of its blocks.

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

/// Kind of the run folder in its `work.json`.
pub const COUNT_SHARD_KIND: &str = "shard of a count";

/// A shard of a count that is registered in a folder.
pub struct RateShard<'a> {
    pub(super) run_folder: RunFolder,
    block_counter: BlockCounter<'a>,
    resample_range: Range<u64>,
}

/// Configuration of a count that is divided into shards.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardedCount {
    pub(super) count: CountRecord,
    /// Number of resamples of the episodes, and of runs in each, if failures are stated per hour.
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
        let (own, foreign) = (&self.count.registration, &other.count.registration);
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
        let may_be_resampled = tally.resample_failures.len() as u64 <= most
            && tally.resample_failures.iter().all(|failures| *failures <= u64::from(runs_each));
        match tally.blocks.len() as u64 == range_len(blocks)
            && self.count.is_consistent(blocks, &tally)
            && may_be_resampled
        {
            true => Ok(tally),
            false => Err(format!("inconsistent with shard {shard} of that count")),
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
    /// Counts the remaining runs, including those of its resamples. If `observer` stops the shard, the folder keeps the
    /// tally.
    ///
    /// # Errors
    /// [`RateFolderError`] if a run fails, a file cannot be written, or `observer` stops the shard.
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

    /// Returns the tally so far.
    #[must_use]
    pub fn tally(&self) -> &CountTally {
        &self.block_counter.tally
    }

    /// Returns the number of runs, including those of resamples.
    #[must_use]
    pub fn run_count(&self) -> u64 {
        self.block_counter.run_count() + self.block_counter.resample_run_count(&self.resample_range)
    }
}
