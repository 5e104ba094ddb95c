//! Shards of a count, put together: in any order, some perhaps twice, some perhaps missing.
//!
//! Whole blocks are counted, each with a hash of what came of its runs, and a shard is a range of them. Put together they are the blocks
//! of a count by one machine, in order, and so are the sums, the bound and the certificate: there is nothing to be combined that could
//! round. Memory grows with the number of blocks, of which there are at most ten thousand, and not with the number of runs.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use crumple_verify::Certificate;
use serde::Serialize;

use super::rate_folder::RateFolderError;
use super::rate_shard::CountedShard;
use super::record::{CountRecord, Tally, length};
use crate::shard::Shard;
use crate::work::{Finished, WorkError};

/// Why shards do not go together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MergeError {
    /// A folder cannot be read, or something in it is damaged.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// A shard of something else.
    #[error("{}: a shard of another count than {}: {field} differs", folder.display(), first.display())]
    Foreign {
        /// Its folder.
        folder: PathBuf,
        /// The folder that was taken first.
        first: PathBuf,
        /// In what they differ.
        field: String,
    },
    /// Two divisions of the work that count some runs twice.
    #[error("{}: shard {shard} counts runs that shard {other} in {} has counted", folder.display(), taken.display())]
    Overlapping {
        /// Its folder.
        folder: PathBuf,
        /// Which shard it is.
        shard: Shard,
        /// The folder of the other.
        taken: PathBuf,
        /// Which shard that is.
        other: Shard,
    },
    /// The same shard twice, with different results: one of them is wrong.
    #[error(
        "{}: shard {shard} came to something else in {}: one of them was not made by this configuration and build",
        folder.display(), taken.display()
    )]
    Contradicting {
        /// Its folder.
        folder: PathBuf,
        /// Which shard it is.
        shard: Shard,
        /// The folder of the other.
        taken: PathBuf,
    },
}

/// Shards of one count.
#[derive(Debug)]
pub struct MergedCount {
    record: CountRecord,
    first: PathBuf,
    /// By the first block of each.
    parts: BTreeMap<u64, Part>,
    duplicates: u64,
}

#[derive(Debug)]
struct Part {
    folder: PathBuf,
    shard: Shard,
    blocks: Range<u64>,
    tally: Tally,
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
        let mut merged =
            Self { record: shard.record.clone(), first: folder.to_owned(), parts: BTreeMap::new(), duplicates: 0 };
        merged.place(folder, shard)?;
        Ok(merged)
    }

    /// Takes in another shard. After an error it is as it was.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or does not go with the others.
    pub fn take(&mut self, folder: &Path, found: &Finished) -> Result<(), MergeError> {
        let shard = CountedShard::read(found)?;
        match self.difference(&shard.record) {
            Some(field) => Err(MergeError::Foreign { folder: folder.to_owned(), first: self.first.clone(), field }),
            None => self.place(folder, shard),
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

    fn place(&mut self, folder: &Path, counted: CountedShard) -> Result<(), MergeError> {
        let CountedShard { shard, blocks, tally, .. } = counted;
        let folder = folder.to_owned();
        // Of those that begin before its end, the last; they do not overlap each other.
        let before = self.parts.range(..blocks.end).next_back().map(|(_, part)| part);
        match before.filter(|part| part.blocks.end > blocks.start) {
            Some(same) if same.shard == shard && same.tally == tally => self.duplicates += 1,
            Some(same) if same.shard == shard => {
                return Err(MergeError::Contradicting { folder, shard, taken: same.folder.clone() });
            }
            Some(part) => {
                let (taken, other) = (part.folder.clone(), part.shard);
                return Err(MergeError::Overlapping { folder, shard, taken, other });
            }
            None => {
                self.parts.insert(blocks.start, Part { folder, shard, blocks, tally });
            }
        }
        Ok(())
    }

    /// What was fixed before the first run.
    #[must_use]
    pub fn record(&self) -> &CountRecord {
        &self.record
    }

    /// Blocks that no shard has.
    fn missing(&self) -> Vec<Range<u64>> {
        let (mut missing, mut end) = (Vec::new(), 0);
        for part in self.parts.values() {
            missing.push(end..part.blocks.start);
            end = part.blocks.end;
        }
        missing.push(end..self.record.blocks());
        missing.retain(|blocks| !blocks.is_empty());
        missing
    }

    /// Whether every run was counted.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.missing().is_empty()
    }

    /// What the shards come to.
    #[must_use]
    pub fn so_far(&self) -> SoFar {
        let sum = |of: fn(&Tally) -> u64| self.parts.values().map(|part| of(&part.tally)).sum::<u64>();
        let missing: Vec<Range<u64>> = self.missing().into_iter().map(|blocks| self.record.runs_of(blocks)).collect();
        let numbers: Vec<u32> = self.parts.values().map(|part| part.shard.of()).collect();
        let of_shards = numbers.first().copied().filter(|of| numbers.iter().all(|other| other == of));
        let present: BTreeSet<u32> = self.parts.values().map(|part| part.shard.index()).collect();
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
            shards: self.parts.len() as u64,
            duplicates: self.duplicates,
            missing_runs: missing.iter().map(|runs| [runs.start, runs.end]).collect(),
            missing_shards: of_shards
                .map_or_else(Vec::new, |of| (1..=of).filter(|one| !present.contains(one)).collect()),
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
        for part in self.parts.values() {
            for (index, block) in (part.blocks.start..).zip(&part.tally.blocks) {
                tally.add(length(&self.record.runs_of(index..index.saturating_add(1))), block.clone());
            }
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
