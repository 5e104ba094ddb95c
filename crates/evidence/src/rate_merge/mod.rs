//! Merge of the shards of a count, in any order; duplicates and gaps are allowed. A shard is a range of blocks, each
//! with a hash of its runs. The merged blocks, sums, bound and certificate are those of an undivided count, without
//! rounding. Memory grows with the number of blocks, at most ten thousand, not of runs.

use std::ops::Range;
use std::path::{Path, PathBuf};

use crumple_verify::Certificate;
use serde::Serialize;

use super::rate::BLOCKS_NAME;
use super::rate_folder::{PROGRESS_FILE, RateFolderError};
use super::rate_shard::{SHARD_FILE, ShardFile};
use super::record::{CountRecord, CountTally, range_len};
use crumple_store::run_folder::CompletedRun;
use crumple_store::shard::{MergeError, MissingShards, Parts};

/// Shards of one count, for merging.
#[derive(Debug)]
pub struct MergedCount {
    record: CountRecord,
    parts: Parts<CountTally>,
}

/// Result of some or all shards.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartialCount {
    /// Digest of the registration.
    pub registration_sha256: String,
    /// Number of registered runs.
    pub registered_runs: u64,
    /// Number of runs in the shards.
    pub runs: u64,
    /// Runs in which the controller failed; with two controllers, both.
    pub failures: u64,
    /// Runs in which only the first of two controllers failed.
    pub only_first_failed: u64,
    /// Runs in which only the second failed.
    pub only_second_failed: u64,
    /// Number of shards.
    pub shards: u64,
    /// Number of duplicates of these shards.
    pub duplicates: u64,
    /// Missing runs, as ranges: the first, and the one after the last.
    pub missing_runs: Vec<[u64; 2]>,
    /// Missing shards, if all shards are of the same division.
    pub missing_shards: Vec<u32>,
    /// Number of shards of the division; `None` with several divisions.
    #[serde(rename = "of_shards")]
    pub shard_count: Option<u32>,
    /// Bound for one controller at the registered confidence level, with all missing runs taken as failures.
    pub rate_at_most: Option<f64>,
}

impl MergedCount {
    /// Starts with the first shard.
    ///
    /// # Errors
    /// [`MergeError`] if the shard cannot be read.
    pub fn new(folder: &Path, found: &CompletedRun) -> Result<Self, MergeError> {
        let mut merged = Self { record: ShardFile::read(found)?.count, parts: Parts::new(folder) };
        merged.add_shard(folder, found)?;
        Ok(merged)
    }

    /// Adds another shard. After an error nothing has changed.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or is not a shard of the same count.
    pub fn add_shard(&mut self, folder: &Path, found: &CompletedRun) -> Result<(), MergeError> {
        let ShardFile { shard, count, .. } = ShardFile::read(found)?;
        let blocks = shard.range(count.block_count(), BLOCKS_NAME);
        let blocks = blocks.map_err(|error| found.damaged_error(SHARD_FILE, error))?;
        if let Some(field) = self.record.differing_field(&count) {
            return Err(self.parts.foreign_error(folder, field));
        }
        let text = found.read(PROGRESS_FILE)?;
        let tally = serde_json::from_str(&text).map_err(|error| found.unreadable_error(PROGRESS_FILE, &error))?;
        if !count.is_shard_tally(&blocks, &tally) {
            let problem = format!("inconsistent with shard {shard} of that count");
            return Err(found.damaged_error(PROGRESS_FILE, problem).into());
        }
        self.parts.insert(folder, shard, blocks, tally)
    }

    /// Returns the registration with the space.
    #[must_use]
    pub fn record(&self) -> &CountRecord {
        &self.record
    }

    fn missing_blocks(&self) -> Vec<Range<u64>> {
        self.parts.missing_ranges(self.record.block_count())
    }

    /// Returns the result of the shards.
    #[must_use]
    pub fn partial_count(&self) -> PartialCount {
        let sum = |of: fn(&CountTally) -> u64| self.parts.contents().map(of).sum::<u64>();
        let missing: Vec<Range<u64>> =
            self.missing_blocks().into_iter().map(|blocks| self.record().run_range(blocks)).collect();
        let MissingShards { shard_count: of_shards, missing_shards } = self.parts.missing_shards();
        let open: u64 = missing.iter().map(range_len).sum();
        let failures = sum(|tally| tally.failures);
        let worst = failures.saturating_add(open);
        PartialCount {
            registration_sha256: self.record().registration.digest(),
            registered_runs: self.record().registration.runs,
            runs: sum(|tally| tally.runs),
            failures,
            only_first_failed: sum(|tally| tally.only_first_failed),
            only_second_failed: sum(|tally| tally.only_second_failed),
            shards: self.parts.shard_count(),
            duplicates: self.parts.duplicates(),
            missing_runs: missing.iter().map(|runs| [runs.start, runs.end]).collect(),
            missing_shards,
            shard_count: of_shards,
            rate_at_most: match (self.record().is_comparison(), missing.is_empty()) {
                (true, _) => None,
                (false, true) => Some(self.record().rate_at_most(failures)),
                (false, false) => Some(self.record().uncertified_rate_at_most(worst)),
            },
        }
    }

    /// Returns the tally of all runs; `None` while some are missing.
    #[must_use]
    pub fn tally(&self) -> Option<CountTally> {
        if !self.missing_blocks().is_empty() {
            return None;
        }
        let mut tally = self.record().empty_tally();
        for (index, block) in (0..).zip(self.parts.contents().flat_map(|part| &part.blocks)) {
            tally.add_block(range_len(&self.record().run_range(index..index + 1)), block.clone());
        }
        Some(tally)
    }

    /// Writes the folder of the whole count, byte for byte as an undivided count would, and returns the path of its
    /// certificate. `None` while runs are missing: then nothing is written.
    ///
    /// # Errors
    /// [`RateFolderError`] if the folder cannot be used or has other content, or if the certificate is rejected.
    pub fn write_in(&self, folder: &Path) -> Result<Option<(PathBuf, Certificate)>, RateFolderError> {
        self.tally().map(|tally| self.record().write_in(folder, &tally)).transpose()
    }
}

#[cfg(test)]
mod tests;
