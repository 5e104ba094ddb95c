//! Finished shards, in any order and perhaps duplicated.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{ShardId, format_ranges};
use crate::run_folder::RunFolderError;

/// An error of merging shards.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MergeError {
    /// A folder cannot be read, or something in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// A shard of another run.
    #[error("{}: this shard belongs to another run than {}: {field} differs", folder.display(), first.display())]
    Foreign {
        /// Folder of the shard.
        folder: PathBuf,
        /// Folder of the first shard.
        first: PathBuf,
        /// Field that differs.
        field: String,
    },
    /// Two divisions of the run overlap.
    #[error("{}: shard {shard} repeats work of shard {other_shard} in {}", folder.display(), other_folder.display())]
    Overlapping {
        /// Folder of the shard.
        folder: PathBuf,
        /// Number of the shard.
        shard: ShardId,
        /// Folder of the other shard.
        other_folder: PathBuf,
        /// Number of the other shard.
        other_shard: ShardId,
    },
    /// A repeated shard with different results: one of them is wrong.
    #[error(
        "{}: shard {shard} has a different result in {}: one of them was made by another configuration or build",
        folder.display(), other_folder.display()
    )]
    Contradicting {
        /// Folder of the shard.
        folder: PathBuf,
        /// Number of the shard.
        shard: ShardId,
        /// Folder of the other copy.
        other_folder: PathBuf,
    },
}

/// Numbers of the missing shards.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MissingShards {
    /// Number of shards; `None` if the shards are of several divisions.
    #[serde(rename = "of_shards")]
    pub shard_count: Option<u32>,
    /// Missing shards, if all are of one division.
    pub missing_shards: Vec<u32>,
}

/// Writes the end of a sentence about missing parts.
impl fmt::Display for MissingShards {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.shard_count {
            Some(of) => write!(out, ", shards {} of {of}", format_ranges(&self.missing_shards)),
            None => Ok(()),
        }
    }
}

/// The completed parts of a run, each with its shard. They do not overlap.
#[derive(Debug)]
pub struct Parts<T> {
    first_folder: PathBuf,
    /// Parts by the start of their ranges.
    parts: BTreeMap<u64, ShardPart<T>>,
    duplicates: u64,
}

#[derive(Debug)]
struct ShardPart<T> {
    folder: PathBuf,
    shard: ShardId,
    range: Range<u64>,
    contents: T,
}

impl<T: PartialEq> Parts<T> {
    /// Creates an empty set. Errors name `first` as the folder for comparison.
    #[must_use]
    pub fn new(first: &Path) -> Self {
        Self { first_folder: first.to_owned(), parts: BTreeMap::new(), duplicates: 0 }
    }

    /// Returns the error about a shard that differs from the first.
    #[must_use]
    pub fn foreign_error(&self, folder: &Path, field: String) -> MergeError {
        MergeError::Foreign { folder: folder.to_owned(), first: self.first_folder.clone(), field }
    }

    /// Returns an error about a file with equal content in all shards. It names the folder of the first shard.
    #[must_use]
    pub fn damaged_error(&self, name: &str, problem: String) -> MergeError {
        RunFolderError::damaged(&self.first_folder.join(name), problem).into()
    }

    /// Adds the results of a shard. After an error nothing has changed.
    ///
    /// # Errors
    /// [`MergeError`] if the range overlaps another shard, or the same shard has other results.
    pub fn insert(&mut self, folder: &Path, shard: ShardId, range: Range<u64>, contents: T) -> Result<(), MergeError> {
        let folder = folder.to_owned();
        // The last part that begins before the end of the range. Stored parts do not overlap, so if this one does not
        // overlap the range, none does.
        let before = self.parts.range(..range.end).next_back().map(|(_, part)| part);
        match before.filter(|part| part.range.end > range.start) {
            Some(same) if same.shard == shard && same.contents == contents => self.duplicates += 1,
            Some(same) if same.shard == shard => {
                return Err(MergeError::Contradicting { folder, shard, other_folder: same.folder.clone() });
            }
            Some(part) => {
                let (taken, other) = (part.folder.clone(), part.shard);
                return Err(MergeError::Overlapping { folder, shard, other_folder: taken, other_shard: other });
            }
            None => {
                self.parts.insert(range.start, ShardPart { folder, shard, range, contents });
            }
        }
        Ok(())
    }

    /// Returns the ranges of `parts` parts that no shard contains.
    #[must_use]
    pub fn missing_ranges(&self, parts: u64) -> Vec<Range<u64>> {
        let (mut missing, mut end) = (Vec::new(), 0);
        for part in self.parts.values() {
            missing.push(end..part.range.start);
            end = part.range.end;
        }
        missing.push(end..parts);
        missing.retain(|range| !range.is_empty());
        missing
    }

    /// Returns the missing shards.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        let mut numbers = self.parts.values().map(|part| part.shard.count());
        let of_shards = numbers.next().filter(|of| numbers.all(|other| other == *of));
        let present: BTreeSet<u32> = self.parts.values().map(|part| part.shard.index()).collect();
        let missing = |of: u32| (1..=of).filter(|index| !present.contains(index)).collect();
        MissingShards { shard_count: of_shards, missing_shards: of_shards.map_or_else(Vec::new, missing) }
    }

    /// Returns the results, in order of the parts.
    pub fn contents(&self) -> impl Iterator<Item = &T> {
        self.parts.values().map(|part| &part.contents)
    }

    /// Returns the number of distinct shards.
    #[must_use]
    pub fn shard_count(&self) -> u64 {
        self.parts.len() as u64
    }

    /// Returns the number of duplicates.
    #[must_use]
    pub fn duplicates(&self) -> u64 {
        self.duplicates
    }
}
