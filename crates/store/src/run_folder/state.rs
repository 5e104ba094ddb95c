//! Recorded state of a file, and the check of the file against it.

use std::fs;
use std::io::Read;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::RunFolderError;
use crate::disk::{self, DiskError, none_if_missing};
use crumple_core::digest::{Sha256, sha256};
use crumple_core::regular_file;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum FileState {
    /// Begins with this prefix. The records after it have their own checksums.
    Growing(Prefix),
    /// Has these contents.
    Whole { bytes: u64, sha256: String },
}

/// Prefix of an append-only file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prefix {
    /// Length of the prefix.
    pub bytes: u64,
    /// SHA-256 of the prefix.
    pub sha256: String,
}

impl Prefix {
    pub(super) fn empty() -> Self {
        Self {
            bytes: 0,
            sha256: sha256(""),
        }
    }

    /// Checks that a file begins with the prefix; the file may be missing if the prefix is empty. Reads in chunks,
    /// because the file may be larger than memory.
    pub(super) fn check_file(&self, path: &Path) -> Result<Result<(), String>, DiskError> {
        let unreadable = DiskError::at(path);
        let mut file = match none_if_missing(regular_file::open(path)).map_err(unreadable)? {
            Some(file) => file.take(self.bytes),
            None if self.bytes == 0 => return Ok(Ok(())),
            None => return Ok(Err(MISSING_FILE_MESSAGE.to_owned())),
        };
        let mut digest = Sha256::default();
        let mut part = vec![0; 1 << 16];
        let mut left = self.bytes;
        loop {
            let count = file.read(&mut part).map_err(unreadable)?;
            if count == 0 {
                break;
            }
            digest.update(part.get(..count).unwrap_or_default());
            left = left.saturating_sub(count as u64);
        }
        Ok(match (left, digest.hexadecimal() == self.sha256) {
            (0, true) => Ok(()),
            (0, false) => Err(format!(
                "its first {} bytes have changed since they were written",
                self.bytes
            )),
            _ => Err(format!(
                "shorter than the {} bytes that were written",
                self.bytes
            )),
        })
    }
}

pub(super) const MISSING_FILE_MESSAGE: &str = "the file is missing";

impl FileState {
    pub(super) fn from_contents(contents: &[u8]) -> Self {
        Self::Whole {
            bytes: contents.len() as u64,
            sha256: sha256(contents),
        }
    }

    pub(super) fn max_bytes(&self) -> u64 {
        match self {
            Self::Growing(_) => u64::MAX,
            Self::Whole { bytes, .. } => *bytes,
        }
    }

    pub(super) fn matches_contents(&self, contents: &[u8]) -> bool {
        match self {
            // `Prefix::check_file` checks these.
            Self::Growing(_) => true,
            Self::Whole {
                bytes,
                sha256: expected,
            } => *bytes == contents.len() as u64 && sha256(contents) == *expected,
        }
    }

    pub(super) fn matches_file(&self, path: &Path) -> bool {
        matches!(read_regular_file(path, self.max_bytes()), Ok(Some(contents)) if self.matches_contents(&contents))
    }
}

/// Returns the length of a file; `None` if it does not exist. A link, folder or pipe is an error.
pub(super) fn regular_file_len(path: &Path) -> Result<Option<u64>, RunFolderError> {
    match none_if_missing(fs::symlink_metadata(path)).map_err(DiskError::at(path))? {
        Some(metadata) if !metadata.is_file() => Err(RunFolderError::damaged(
            path,
            "is not a plain file: crumple keeps results in plain files only",
        )),
        metadata => Ok(metadata.map(|metadata| metadata.len())),
    }
}

/// Reads a regular file of at most `most` bytes; returns `None` if it does not exist.
pub(super) fn read_regular_file(path: &Path, most: u64) -> Result<Option<Vec<u8>>, RunFolderError> {
    match regular_file_len(path)? {
        Some(bytes) if bytes > most => Err(RunFolderError::damaged(
            path,
            "has changed since it was written: it is longer",
        )),
        Some(_) => Ok(disk::read(path, most)?),
        None => Ok(None),
    }
}
