//! A cache of evidence: evidence whose inputs have not changed is not gathered again.
//!
//! A cache entry is a file under the SHA-256 of the program, the evidence's name and its inputs, so an interrupted
//! assessment resumes. An entry holds the hash of its evidence. Evidence of a truncated, edited or swapped entry is
//! gathered again, and the entry is reported. One assessment at a time uses a folder. The hashes ensure integrity, not
//! authenticity: an author who recomputes them is trusted, hence `--fresh`. Results of the checker are not cached:
//! every run checks certificates.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::plan::slug;
use crumple_core::digest::sha256;
use crumple_core::regular_file;
use crumple_store::disk::{self, DiskError};
use crumple_store::run_folder::FolderLock;

/// A piece of evidence: its name, and the hashes of its inputs and its content.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EvidenceHash {
    /// Name of the evidence.
    pub name: String,
    /// SHA-256 of the inputs, without the program.
    pub inputs_sha256: String,
    /// SHA-256 of the evidence itself, as JSON.
    pub evidence_sha256: String,
}

/// Maximum size of a cache entry that is read; the largest of the built-in assessment is below one hundredth of it.
const MAX_ENTRY_BYTES: u64 = 256 << 20;

/// A cache of evidence in a folder, or a disabled one.
#[derive(Debug, Default)]
pub struct EvidenceCache {
    folder: Option<PathBuf>,
    program: String,
    is_fresh: bool,
    log: Mutex<CacheLog>,
    _lock: Option<FolderLock>,
}

#[derive(Debug, Default)]
struct CacheLog {
    hashes: Vec<EvidenceHash>,
    reused_count: usize,
    damaged_files: Vec<PathBuf>,
}

/// An error of the evidence cache.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CacheError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// Another process uses the folder.
    #[error("{}: another assessment uses this folder; wait until it ends, or use another --out", .0.display())]
    InUse(PathBuf),
    /// Evidence, or its inputs, cannot be encoded.
    #[error("cannot encode a piece of evidence: {0}")]
    Encoding(String),
    /// The files of a process cannot be copied into the report.
    #[error("cannot copy the files of the controller `{controller}` into the report: {problem}")]
    Copy {
        /// Name of the controller.
        controller: String,
        /// Reason.
        problem: std::io::Error,
    },
}

impl CacheError {
    pub(super) fn encoding(error: impl std::fmt::Display) -> Self {
        Self::Encoding(error.to_string())
    }
}

#[derive(Debug)]
pub(super) struct ScratchFolder {
    path: PathBuf,
    /// Removes the folder when dropped.
    _temporary: Option<tempfile::TempDir>,
}

impl ScratchFolder {
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Removes the folder; call this once the evidence is complete.
    pub(super) fn remove(self) -> Result<(), CacheError> {
        Ok(fs::remove_dir_all(&self.path).map_err(DiskError::at(&self.path))?)
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub(super) struct CacheEntry {
    name: String,
    inputs_sha256: String,
    program: String,
    evidence_sha256: String,
    evidence: String,
}

impl CacheEntry {
    /// True if `program` gathered the entry and its hash matches.
    pub(super) fn is_intact(&self, program: &str) -> bool {
        self.program == program && sha256(&self.evidence) == self.evidence_sha256
    }
}

impl EvidenceCache {
    /// Creates a cache that stores nothing.
    #[must_use]
    pub fn disabled() -> Self {
        Self::default()
    }

    /// Opens or creates a cache in `folder`. `program` is the hash of the executable, which stands for everything else
    /// that could change the evidence. With `fresh`, existing entries are ignored.
    ///
    /// # Errors
    /// [`CacheError`] if the folder cannot be created, or is in use.
    pub fn open(folder: &Path, program: &str, fresh: bool) -> Result<Self, CacheError> {
        disk::make_folder(folder)?;
        let lock =
            FolderLock::try_acquire(folder)?.ok_or_else(|| CacheError::InUse(folder.to_owned()))?;
        Ok(Self {
            folder: Some(folder.to_owned()),
            program: program.to_owned(),
            is_fresh: fresh,
            log: Mutex::default(),
            _lock: Some(lock),
        })
    }

    /// Returns the cached evidence of that name and these inputs, or the result of `gather`, which is then stored.
    ///
    /// # Errors
    /// The error of `gather`, or [`CacheError`].
    pub(super) fn get_or_gather<T, E>(
        &self,
        name: &str,
        inputs: &impl Serialize,
        gather: impl FnOnce() -> Result<T, E>,
    ) -> Result<T, E>
    where
        T: Serialize + DeserializeOwned,
        E: From<CacheError>,
    {
        let inputs_sha256 = sha256(to_json(inputs)?);
        let file = format!("{}.json", self.file_stem(name, &inputs_sha256));
        let path = self.folder.as_ref().map(|folder| folder.join(file));
        if let Some((evidence, value)) = path
            .as_deref()
            .filter(|_| !self.is_fresh)
            .and_then(|path| self.read_entry(path, name, &inputs_sha256))
        {
            self.record(name, inputs_sha256, &evidence, true);
            return Ok(value);
        }
        let value = gather()?;
        let evidence = to_json(&value)?;
        if let Some(path) = path {
            let entry = CacheEntry {
                name: name.to_owned(),
                inputs_sha256: inputs_sha256.clone(),
                program: self.program.clone(),
                evidence_sha256: sha256(&evidence),
                evidence: evidence.clone(),
            };
            disk::write(&path, to_json(&entry)?).map_err(CacheError::from)?;
        }
        self.record(name, inputs_sha256, &evidence, false);
        Ok(value)
    }

    /// Returns a folder in which to gather the evidence. Unless the cache is fresh, it has the files of an interrupted
    /// run.
    ///
    /// # Errors
    /// [`CacheError`] if the folder cannot be created.
    pub(super) fn scratch_folder(
        &self,
        name: &str,
        inputs: &impl Serialize,
    ) -> Result<ScratchFolder, CacheError> {
        let Some(folder) = &self.folder else {
            let temporary = tempfile::tempdir().map_err(DiskError::at(&std::env::temp_dir()))?;
            return Ok(ScratchFolder {
                path: temporary.path().to_owned(),
                _temporary: Some(temporary),
            });
        };
        let path = folder.join(self.file_stem(name, &sha256(to_json(inputs)?)));
        if self.is_fresh && path.is_dir() {
            fs::remove_dir_all(&path).map_err(DiskError::at(&path))?;
        }
        disk::make_folder(&path)?;
        Ok(ScratchFolder {
            path,
            _temporary: None,
        })
    }

    fn file_stem(&self, name: &str, inputs_sha256: &str) -> String {
        let key = sha256(format!("{}\n{name}\n{inputs_sha256}", self.program));
        format!("{}-{}", slug(name), key.get(..16).unwrap_or_default())
    }

    /// Returns the text and value of an entry if the file exists and matches its name.
    fn read_entry<T: DeserializeOwned>(
        &self,
        path: &Path,
        name: &str,
        inputs_sha256: &str,
    ) -> Option<(String, T)> {
        let metadata = fs::symlink_metadata(path).ok()?;
        let is_plain = metadata.is_file() && metadata.len() <= MAX_ENTRY_BYTES;
        let value = is_plain
            .then(|| self.read_verified(path, name, inputs_sha256))
            .flatten();
        if value.is_none() {
            self.lock_log().damaged_files.push(path.to_owned());
        }
        value
    }

    fn read_verified<T: DeserializeOwned>(
        &self,
        path: &Path,
        name: &str,
        inputs_sha256: &str,
    ) -> Option<(String, T)> {
        let entry: CacheEntry =
            serde_json::from_slice(&regular_file::read(path, MAX_ENTRY_BYTES).ok()?).ok()?;
        let is_requested = entry.name == name && entry.inputs_sha256 == inputs_sha256;
        let value = (is_requested && entry.is_intact(&self.program))
            .then(|| serde_json::from_str(&entry.evidence).ok())
            .flatten()?;
        Some((entry.evidence, value))
    }

    fn record(&self, name: &str, inputs_sha256: String, evidence: &str, reused: bool) {
        let hash = EvidenceHash {
            name: name.to_owned(),
            inputs_sha256,
            evidence_sha256: sha256(evidence),
        };
        let mut gathered = self.lock_log();
        gathered.hashes.push(hash);
        gathered.reused_count += usize::from(reused);
    }

    pub(super) fn hashes(&self) -> Vec<EvidenceHash> {
        let mut hashes = self.lock_log().hashes.clone();
        hashes.sort();
        hashes
    }

    /// Returns the number of pieces of evidence, and how many of them were reused.
    #[must_use]
    pub fn reuse_counts(&self) -> (usize, usize) {
        let gathered = self.lock_log();
        (gathered.hashes.len(), gathered.reused_count)
    }

    /// Returns the damaged files, whose evidence was gathered again.
    #[must_use]
    pub fn damaged_files(&self) -> Vec<PathBuf> {
        self.lock_log().damaged_files.clone()
    }

    fn lock_log(&self) -> MutexGuard<'_, CacheLog> {
        // Every update under this lock is complete, so a panic elsewhere leaves the log valid.
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn to_json(value: &impl Serialize) -> Result<String, CacheError> {
    serde_json::to_string(value).map_err(CacheError::encoding)
}

#[cfg(test)]
mod tests;
