//! Merging the shards of any run.

use std::ops::Range;
use std::path::Path;

use serde::de::DeserializeOwned;

use super::{MergeError, MissingShards, Parts, ShardId, Sharded, read_shard};
use crate::run_folder::CompletedRun;

/// A run whose shards are kept in memory until all are present.
pub trait Mergeable: Sharded {
    /// Content of the file of results.
    type File: DeserializeOwned;
    /// Results of a shard.
    type Results: PartialEq;

    /// Returns the results of a shard with the parts `own`, or the reason why no such shard produces that file.
    ///
    /// # Errors
    /// The reason, as the end of a sentence that names the file.
    fn check(&self, file: Self::File, shard: ShardId, own: &Range<u64>) -> Result<Self::Results, String>;

    /// Returns the name of a result that differs although all shards of this run have the same one.
    fn contradiction(_one: &Self::Results, _other: &Self::Results) -> Option<String> {
        None
    }
}

/// Shards of one run, in any order.
#[derive(Debug)]
pub struct MergedShards<W: Mergeable> {
    work: W,
    parts: Parts<W::Results>,
}

impl<W: Mergeable> MergedShards<W> {
    /// Creates a merge of one shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn new(folder: &Path, found: &CompletedRun) -> Result<Self, MergeError> {
        let (_, work, _) = read_shard(found)?;
        let mut merged = Self { work, parts: Parts::new(folder) };
        merged.add_shard(folder, found)?;
        Ok(merged)
    }

    /// Adds another shard. After an error nothing has changed.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or is not a shard of the same run.
    pub fn add_shard(&mut self, folder: &Path, found: &CompletedRun) -> Result<(), MergeError> {
        let (shard, work, own) = read_shard::<W>(found)?;
        if let Some(field) = self.work.differing_field(&work) {
            return Err(self.parts.foreign_error(folder, field));
        }
        let text = found.read(W::RESULTS_FILE)?;
        let file = serde_json::from_str(&text).map_err(|error| found.unreadable_error(W::RESULTS_FILE, &error))?;
        let results =
            self.work.check(file, shard, &own).map_err(|problem| found.damaged_error(W::RESULTS_FILE, problem))?;
        let first = self.parts.contents().next();
        if let Some(field) = first.and_then(|first| W::contradiction(first, &results)) {
            return Err(self.parts.foreign_error(folder, field));
        }
        self.parts.insert(folder, shard, own, results)
    }

    /// Returns the results by their parts.
    pub fn parts(&self) -> &Parts<W::Results> {
        &self.parts
    }

    /// Returns the undivided run.
    pub fn work(&self) -> &W {
        &self.work
    }

    /// Returns the results of the shards, in the order of their parts.
    pub fn results(&self) -> impl Iterator<Item = &W::Results> {
        self.parts.contents()
    }

    /// Returns the parts that no shard has, counted from 0.
    #[must_use]
    pub fn missing_ranges(&self) -> Vec<Range<u64>> {
        self.parts.missing_ranges(self.work.part_count())
    }

    /// Returns the number of parts that no shard has.
    #[must_use]
    pub fn missing_part_count(&self) -> u64 {
        self.missing_ranges().iter().map(|range| range.end - range.start).sum()
    }

    /// Returns the shards that are missing.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        self.parts.missing_shards()
    }
}
