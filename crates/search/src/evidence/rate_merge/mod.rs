//! Shards of a count, put together: in any order, some perhaps twice, some perhaps missing.
//!
//! Whole blocks are counted, each with a hash of what came of its runs, and a shard is a range of them. Put together they are the blocks
//! of a count by one machine, in order, and so are the sums, the bound and the certificate: there is nothing to be combined that could
//! round. Memory grows with the number of blocks, of which there are at most ten thousand, and not with the number of runs.

use std::ops::Range;
use std::path::{Path, PathBuf};

use crumple_verify::Certificate;
use serde::Serialize;

use super::rate_folder::RateFolderError;
use super::rate_shard::CountedShard;
use super::record::{CountRecord, Tally, length};
use crate::shard::{MergeError, Parts};
use crate::work::Finished;

/// Shards of one count.
#[derive(Debug)]
pub struct MergedCount {
    record: CountRecord,
    /// Of blocks.
    parts: Parts<Tally>,
}

/// What shards come to, all of them or not.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SoFar {
    /// Digest of the registration.
    pub registration_sha256: String,
    /// Runs that were registered.
    pub registered_runs: u64,
    /// Runs in the shards.
    pub runs: u64,
    /// Runs in which the controller failed; of two, both.
    pub failures: u64,
    /// Of two controllers: runs in which only the first failed.
    pub only_first_failed: u64,
    /// Runs in which only the second failed.
    pub only_second_failed: u64,
    /// Shards that are there.
    pub shards: u64,
    /// Shards that were given more than once, with the same results.
    pub duplicates: u64,
    /// Runs that are missing, as ranges: the first, and the one after the last.
    pub missing_runs: Vec<[u64; 2]>,
    /// The shards that are missing, where all are of the same number.
    pub missing_shards: Vec<u32>,
    /// Of how many; none where shards are of several numbers.
    pub of_shards: Option<u32>,
    /// Of one controller: the bound that holds at the registered confidence whatever the missing runs come to, for it takes all of them
    /// as failures.
    pub rate_at_most: Option<f64>,
}

impl MergedCount {
    /// Begins with a shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn of(folder: &Path, found: &Finished) -> Result<Self, MergeError> {
        let shard = CountedShard::read(found)?;
        let mut merged = Self { record: shard.record.clone(), parts: Parts::of(folder) };
        merged.parts.place(folder, shard.shard, shard.blocks, shard.tally)?;
        Ok(merged)
    }

    /// Takes in another shard. After an error it is as it was.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or does not go with the others.
    pub fn take(&mut self, folder: &Path, found: &Finished) -> Result<(), MergeError> {
        let shard = CountedShard::read(found)?;
        match self.difference(&shard.record) {
            Some(field) => Err(self.parts.foreign(folder, field)),
            None => self.parts.place(folder, shard.shard, shard.blocks, shard.tally),
        }
    }

    /// In what another record differs.
    fn difference(&self, other: &CountRecord) -> Option<String> {
        let (own, other) = (self.record.registration(), other.registration());
        let keys = own.configuration.keys().chain(other.configuration.keys());
        let differs = |key: &&String| own.configuration.get(*key) != other.configuration.get(*key);
        let fields = [
            ("runs", own.runs != other.runs),
            ("confidence", own.confidence != other.confidence),
            ("block_runs", own.block_runs != other.block_runs),
        ];
        let key = keys.into_iter().find(differs).map(|key| format!("configuration.{key}"));
        key.or_else(|| fields.iter().find(|(_, differs)| *differs).map(|(name, _)| (*name).to_owned()))
    }

    /// What was fixed before the first run.
    #[must_use]
    pub fn record(&self) -> &CountRecord {
        &self.record
    }

    /// Blocks that no shard has.
    fn missing(&self) -> Vec<Range<u64>> {
        self.parts.missing(self.record.blocks())
    }

    /// Whether every run was counted.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.missing().is_empty()
    }

    /// What the shards come to.
    #[must_use]
    pub fn so_far(&self) -> SoFar {
        let sum = |of: fn(&Tally) -> u64| self.parts.contents().map(of).sum::<u64>();
        let missing: Vec<Range<u64>> = self.missing().into_iter().map(|blocks| self.record.runs_of(blocks)).collect();
        let (of_shards, missing_shards) = self.parts.missing_shards();
        let open: u64 = missing.iter().map(length).sum();
        let failures = sum(|tally| tally.failures);
        let worst = failures.saturating_add(open);
        SoFar {
            registration_sha256: self.record.registration().digest(),
            registered_runs: self.record.registration().runs,
            runs: sum(|tally| tally.runs),
            failures,
            only_first_failed: sum(|tally| tally.only_first_failed),
            only_second_failed: sum(|tally| tally.only_second_failed),
            shards: self.parts.shards(),
            duplicates: self.parts.duplicates(),
            missing_runs: missing.iter().map(|runs| [runs.start, runs.end]).collect(),
            missing_shards,
            of_shards,
            rate_at_most: (!self.record.is_of_two()).then(|| self.record.rate_at_most(worst)),
        }
    }

    /// The tally of all runs; none while some are missing.
    #[must_use]
    pub fn tally(&self) -> Option<Tally> {
        if !self.is_complete() {
            return None;
        }
        let mut tally = self.record.tally();
        for (index, block) in (0..).zip(self.parts.contents().flat_map(|part| &part.blocks)) {
            tally.add(length(&self.record.runs_of(index..index + 1)), block.clone());
        }
        Some(tally)
    }

    /// Writes the folder of the whole count, the same as that of a count by one machine, to the byte, and says where its certificate is;
    /// none while runs are missing: then nothing is written.
    ///
    /// # Errors
    /// [`RateFolderError`] if the folder cannot be used, holds something else, or nothing is shown.
    pub fn write_in(&self, folder: &Path) -> Result<Option<(PathBuf, Certificate)>, RateFolderError> {
        self.tally().map(|tally| self.record.write_in(folder, &tally)).transpose()
    }
}

#[cfg(test)]
mod tests;
