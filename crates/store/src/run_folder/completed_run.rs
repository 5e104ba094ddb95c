//! Reading a completed run, without a lock and without writing to its folder, which may thus be read-only.

use std::io;
use std::path::{Path, PathBuf};

use super::lock::LOCK_FILE;
use super::manifest::{MAX_BYTES, Manifest, sorted_entries};
use super::{MANIFEST_FILE, PREVIOUS_FOLDER, RunFolderError, UNLISTED_FILE_MESSAGE};
use crate::disk::{self, DiskError};
use crate::program;
use crumple_core::digest::sha256;

/// State of a folder.
#[derive(Debug)]
pub enum RunState {
    /// No run; perhaps temporary files of a process that ended before it wrote its first file.
    Missing,
    /// An incomplete run.
    InProgress {
        /// Kind of the run.
        kind: String,
        /// True if this build of crumple may resume it.
        is_of_this_build: bool,
    },
    /// A completed run.
    Complete(CompletedRun),
}

/// A completed run. Its files are checked when they are read.
#[derive(Debug)]
pub struct CompletedRun {
    folder: PathBuf,
    manifest: Manifest,
}

/// Reads the state of a folder.
///
/// # Errors
/// [`RunFolderError`] if there is no such folder, it contains files that belong to no run, or its manifest is damaged.
pub fn read_state(folder: &Path) -> Result<RunState, RunFolderError> {
    if !folder.is_dir() {
        return Err(RunFolderError::damaged(folder, "there is no such folder"));
    }
    let path = folder.join(MANIFEST_FILE);
    let Some(manifest) = Manifest::read(&path)? else {
        let mut entries = sorted_entries(folder)?.into_iter();
        let is_empty = entries.all(|path| {
            disk::is_unfinished(&path)
                || path.ends_with(LOCK_FILE)
                || path.ends_with(PREVIOUS_FOLDER)
        });
        return match is_empty {
            true => Ok(RunState::Missing),
            false => Err(RunFolderError::missing(&path)),
        };
    };
    if let Some(program) = &manifest.program {
        return Ok(RunState::InProgress {
            is_of_this_build: program == program::identity()?,
            kind: manifest.kind,
        });
    }
    match manifest.unlisted_files(folder)?.first() {
        Some(unlisted_file) => Err(RunFolderError::damaged(
            unlisted_file,
            UNLISTED_FILE_MESSAGE,
        )),
        None => Ok(RunState::Complete(CompletedRun {
            folder: folder.to_owned(),
            manifest,
        })),
    }
}

impl CompletedRun {
    /// Returns the kind of the run.
    #[must_use]
    pub fn kind(&self) -> &str {
        &self.manifest.kind
    }

    /// Reads one of its files as text.
    ///
    /// # Errors
    /// [`RunFolderError`] if it is missing, is not as it was written, or is not UTF-8.
    pub fn read(&self, name: &str) -> Result<String, RunFolderError> {
        String::from_utf8(self.read_bytes(name)?).map_err(|error| {
            let path = self.folder.join(name);
            let error = io::Error::new(io::ErrorKind::InvalidData, error);
            RunFolderError::Disk(DiskError::at(&path)(error))
        })
    }

    /// Returns the names of its files, without the manifest.
    #[must_use]
    pub fn file_names(&self) -> Vec<String> {
        self.manifest.file_names()
    }

    /// Reads one of its files.
    ///
    /// # Errors
    /// [`RunFolderError`] if it is missing, or is not as it was written.
    pub fn read_bytes(&self, name: &str) -> Result<Vec<u8>, RunFolderError> {
        let path = self.folder.join(name);
        if self
            .manifest
            .whole_file_state(name)
            .is_some_and(|state| state.max_bytes() > MAX_BYTES)
        {
            let problem = format!("longer than {MAX_BYTES} bytes, the limit for such a file");
            return Err(RunFolderError::damaged(&path, problem));
        }
        let bytes = self.manifest.read_contents(&self.folder, name)?;
        self.manifest
            .check(name, bytes.as_deref())
            .map_err(|problem| RunFolderError::damaged(&path, problem))?;
        bytes.ok_or_else(|| RunFolderError::missing(&path))
    }

    /// Reads the configuration file.
    ///
    /// # Errors
    /// [`RunFolderError`] as for [`Self::read`], and if the run used another configuration.
    pub fn read_configuration(&self, name: &str) -> Result<String, RunFolderError> {
        let text = self.read(name)?;
        match sha256(&text) == self.manifest.configuration_sha256 {
            true => Ok(text),
            false => Err(self.damaged_error(
                name,
                "the run in the same folder has a different configuration",
            )),
        }
    }

    fn damaged_error(&self, name: &str, problem: impl std::fmt::Display) -> RunFolderError {
        RunFolderError::damaged(&self.folder.join(name), problem.to_string())
    }
}
