//! What is known of a file, and whether the one that is there is it.

use std::fs;
use std::io::{ErrorKind, Read};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::RunFolderError;
use crate::disk::{self, DiskError};
use crumple_core::digest::{Sha256, sha256};

/// What a file is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum FileState {
    /// It begins with this; what follows has come since, and its records have checks of their own.
    #[serde(rename = "growing")]
    AppendOnly(Prefix),
    /// It has these contents.
    Whole { bytes: u64, sha256: String },
}

/// The first bytes of a file that grows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prefix {
    /// How many there are.
    pub bytes: u64,
    /// Their SHA-256.
    pub sha256: String,
}

impl Prefix {
    /// That of a file of which nothing has to be there.
    pub(super) fn empty() -> Self {
        Self { bytes: 0, sha256: sha256("") }
    }

    /// Whether a file begins so. Read piece by piece, for it may be larger than memory.
    pub(super) fn check_file(&self, path: &Path) -> Result<Result<(), String>, DiskError> {
        let unreadable = DiskError::at(path);
        let mut file = match fs::File::open(path) {
            Ok(file) => file.take(self.bytes),
            Err(error) if error.kind() == ErrorKind::NotFound && self.bytes == 0 => return Ok(Ok(())),
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Err(MISSING_FILE_MESSAGE.to_owned())),
            Err(error) => return Err(unreadable(error)),
        };
        let (mut digest, mut part, mut left) = (Sha256::default(), vec![0; 1 << 16], self.bytes);
        loop {
            match file.read(&mut part).map_err(unreadable)? {
                0 => break,
                count => {
                    digest.update(part.get(..count).unwrap_or_default());
                    left = left.saturating_sub(count as u64);
                }
            }
        }
        Ok(match (left, digest.hexadecimal() == self.sha256) {
            (0, true) => Ok(()),
            (0, false) => Err(format!("its first {} bytes are not as they were written", self.bytes)),
            _ => Err(format!("shorter than the {} bytes that were written", self.bytes)),
        })
    }
}

/// What is said of a file that is not there.
pub(super) const MISSING_FILE_MESSAGE: &str = "the file is missing";

impl FileState {
    pub(super) fn from_contents(contents: &[u8]) -> Self {
        Self::Whole { bytes: contents.len() as u64, sha256: sha256(contents) }
    }

    /// Bytes of a file in this state, at most.
    pub(super) fn max_bytes(&self) -> u64 {
        match self {
            Self::AppendOnly(_) => u64::MAX,
            Self::Whole { bytes, .. } => *bytes,
        }
    }

    /// Whether a file of these bytes is in this state.
    pub(super) fn matches_contents(&self, found: &[u8]) -> bool {
        match self {
            // `Prefix::begins` looks.
            Self::AppendOnly(_) => true,
            Self::Whole { bytes, sha256: expected } => *bytes == found.len() as u64 && sha256(found) == *expected,
        }
    }

    /// Whether the file at a place is in this state.
    pub(super) fn matches_file(&self, path: &Path) -> bool {
        matches!(read_regular_file(path, self.max_bytes()), Ok(Some(found)) if self.matches_contents(&found))
    }
}

/// How long a file is; none if there is none. A link, a folder or a pipe in its place is not what was written.
pub(super) fn regular_file_len(path: &Path) -> Result<Option<u64>, RunFolderError> {
    match fs::symlink_metadata(path) {
        Ok(found) if !found.is_file() => {
            Err(RunFolderError::damaged(path, "no file of its own: work is kept in plain files"))
        }
        Ok(found) => Ok(Some(found.len())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(source) => Err(DiskError::at(path)(source).into()),
    }
}

/// The bytes of a plain file of at most so many; none if there is none. What is longer is not read.
pub(super) fn read_regular_file(path: &Path, most: u64) -> Result<Option<Vec<u8>>, RunFolderError> {
    match regular_file_len(path)? {
        Some(bytes) if bytes > most => Err(RunFolderError::damaged(path, "not as it was written: longer than it was")),
        Some(_) => Ok(disk::read(path, most)?),
        None => Ok(None),
    }
}
