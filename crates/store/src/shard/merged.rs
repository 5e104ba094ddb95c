//! Shards of one work, whatever it is.

use std::ops::Range;
use std::path::Path;

use serde::de::DeserializeOwned;

use super::{MergeError, MissingShards, Parts, Shard, Sharded, read_shard};
use crate::work::Finished;

/// Work whose shards are kept in memory until all of them are there.
pub trait Mergeable: Sharded {
    /// Content of the file of results.
    type File: DeserializeOwned;
    /// Results of a shard.
    type Results: PartialEq;

    /// Returns the results of a shard with the parts `own`, or the reason why no such shard produces that file.
    ///
    /// # Errors
    /// The reason, as the end of a sentence that names the file.
    fn check(&self, file: Self::File, shard: Shard, own: &Range<u64>) -> Result<Self::Results, String>;

    /// Returns the result that differs although all shards of this work have the same one.
    fn contradiction(_one: &Self::Results, _other: &Self::Results) -> Option<String> {
        None
    }
}

/// Shards of one work, in any order.
#[derive(Debug)]
pub struct Merged<W: Mergeable> {
    work: W,
    parts: Parts<W::Results>,
}

impl<W: Mergeable> Merged<W> {
    /// Begins with a shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn of(folder: &Path, found: &Finished) -> Result<Self, MergeError> {
        let (_, work, _) = read_shard(found)?;
        let mut merged = Self { work, parts: Parts::of(folder) };
        merged.take(folder, found)?;
        Ok(merged)
    }

    /// Adds another shard. After an error nothing has changed.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or is not a shard of the same work.
    pub fn take(&mut self, folder: &Path, found: &Finished) -> Result<(), MergeError> {
        let (shard, work, own) = read_shard::<W>(found)?;
        if let Some(field) = self.work.difference(&work) {
            return Err(self.parts.foreign(folder, field));
        }
        let text = found.read(W::RESULTS)?;
        let file = serde_json::from_str(&text).map_err(|error| found.unreadable(W::RESULTS, &error))?;
        let results = self.work.check(file, shard, &own).map_err(|problem| found.damaged(W::RESULTS, problem))?;
        let first = self.parts.contents().next();
        if let Some(field) = first.and_then(|first| W::contradiction(first, &results)) {
            return Err(self.parts.foreign(folder, field));
        }
        self.parts.place(folder, shard, own, results)
    }

    /// Returns the results by their parts.
    pub fn parts(&self) -> &Parts<W::Results> {
        &self.parts
    }

    /// Returns everything that decides the work.
    pub fn work(&self) -> &W {
        &self.work
    }

    /// Returns the results of the shards, in the order of their parts.
    pub fn results(&self) -> impl Iterator<Item = &W::Results> {
        self.parts.contents()
    }

    /// Returns the parts that no shard has, counted from 0.
    #[must_use]
    pub fn missing(&self) -> Vec<Range<u64>> {
        self.parts.missing(self.work.parts())
    }

    /// Returns the number of parts that no shard has.
    #[must_use]
    pub fn missing_parts(&self) -> u64 {
        self.missing().iter().map(|range| range.end - range.start).sum()
    }

    /// Returns the shards that are missing.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        self.parts.missing_shards()
    }
}
