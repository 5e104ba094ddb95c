//! Shards that come back, in any order, some perhaps twice, and where they go.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{ShardId, format_ranges};
use crate::run_folder::RunFolderError;

/// Why shards do not go together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MergeError {
    /// A folder cannot be read, or something in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// A shard of something else.
    #[error("{}: a shard of other work than {}: {field} differs", folder.display(), first.display())]
    Foreign {
        /// Its folder.
        folder: PathBuf,
        /// The folder that was taken first.
        first: PathBuf,
        /// In what they differ.
        field: String,
    },
    /// Two divisions of the work that do some of it twice.
    #[error("{}: shard {shard} has done what shard {other_shard} in {} has done, too", folder.display(), other_folder.display())]
    Overlapping {
        /// Its folder.
        folder: PathBuf,
        /// Which shard it is.
        shard: ShardId,
        /// The folder of the other.
        other_folder: PathBuf,
        /// Which shard that is.
        other_shard: ShardId,
    },
    /// The same shard twice, with different results: one of them is wrong.
    #[error(
        "{}: shard {shard} came to something else in {}: one of them was not made by this configuration and build",
        folder.display(), other_folder.display()
    )]
    Contradicting {
        /// Its folder.
        folder: PathBuf,
        /// Which shard it is.
        shard: ShardId,
        /// The folder of the other.
        other_folder: PathBuf,
    },
}

/// Which shards are missing.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MissingShards {
    /// Of how many; none where shards are of several numbers.
    #[serde(rename = "of_shards")]
    pub shard_count: Option<u32>,
    /// Those that are missing, where all are of one number.
    pub missing_shards: Vec<u32>,
}

/// As the end of a sentence about what is missing.
impl fmt::Display for MissingShards {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.shard_count {
            Some(of) => write!(out, ", shards {} of {of}", format_ranges(&self.missing_shards)),
            None => Ok(()),
        }
    }
}

/// The parts of work that were done, each by a shard; they do not overlap.
#[derive(Debug)]
pub struct Parts<T> {
    first_folder: PathBuf,
    /// By where each begins.
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
    /// None yet; the folder is the one that others are compared with.
    #[must_use]
    pub fn new(first: &Path) -> Self {
        Self { first_folder: first.to_owned(), parts: BTreeMap::new(), duplicates: 0 }
    }

    /// The error about a shard that differs from the first.
    #[must_use]
    pub fn foreign_error(&self, folder: &Path, field: String) -> MergeError {
        MergeError::Foreign { folder: folder.to_owned(), first: self.first_folder.clone(), field }
    }

    /// The error about something that all of them say, found out when all are there.
    #[must_use]
    pub fn damaged_error(&self, name: &str, problem: String) -> MergeError {
        RunFolderError::damaged(&self.first_folder.join(name), problem).into()
    }

    /// Takes in what a shard has come to. After an error all is as it was.
    ///
    /// # Errors
    /// [`MergeError`] if some of it was done by another shard, or the same shard came to something else.
    pub fn insert(&mut self, folder: &Path, shard: ShardId, range: Range<u64>, contents: T) -> Result<(), MergeError> {
        let folder = folder.to_owned();
        // Of those that begin before its end, the last: they do not overlap each other.
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

    /// What no shard has done, of work of that many parts.
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

    /// Which shards are missing.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        let mut numbers = self.parts.values().map(|part| part.shard.count());
        let of_shards = numbers.next().filter(|of| numbers.all(|other| other == *of));
        let present: BTreeSet<u32> = self.parts.values().map(|part| part.shard.index()).collect();
        let missing = |of: u32| (1..=of).filter(|index| !present.contains(index)).collect();
        MissingShards { shard_count: of_shards, missing_shards: of_shards.map_or_else(Vec::new, missing) }
    }

    /// What they came to, in order.
    pub fn contents(&self) -> impl Iterator<Item = &T> {
        self.parts.values().map(|part| &part.contents)
    }

    /// How many shards there are.
    #[must_use]
    pub fn shard_count(&self) -> u64 {
        self.parts.len() as u64
    }

    /// How many were given more than once.
    #[must_use]
    pub fn duplicates(&self) -> u64 {
        self.duplicates
    }
}
