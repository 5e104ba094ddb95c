//! Reading work that was finished: nothing is locked and nothing written, so that it may lie where nothing can be.

use std::io;
use std::path::{Path, PathBuf};

use super::lock::LOCK_FILE;
use super::manifest::{MAX_BYTES, Manifest, sorted_entries};
use super::{MANIFEST_FILE, PREVIOUS_FOLDER, RunFolderError, UNLISTED_FILE_MESSAGE};
use crate::disk::{self, DiskError};
use crumple_core::digest::sha256;

/// What a folder holds.
#[derive(Debug)]
pub enum RunState {
    /// No work, but perhaps what a process leaves that ended before its first file.
    Missing,
    /// Work of some kind that was not finished.
    InProgress(String),
    /// Work that was finished.
    Complete(CompletedRun),
}

/// Work that was finished. Its files are checked when they are read.
#[derive(Debug)]
pub struct CompletedRun {
    folder: PathBuf,
    manifest: Manifest,
}

/// Looks for finished work in a folder.
///
/// # Errors
/// [`WorkError`] if there is no such folder, there is something else in it, or its manifest is damaged.
pub fn read_state(folder: &Path) -> Result<RunState, RunFolderError> {
    if !folder.is_dir() {
        return Err(RunFolderError::damaged(folder, "there is no such folder"));
    }
    let path = folder.join(MANIFEST_FILE);
    let Some(manifest) = Manifest::read(&path)? else {
        let is_own = |path: &PathBuf| {
            disk::is_unfinished(path) || [LOCK_FILE, PREVIOUS_FOLDER].iter().any(|own| path.ends_with(own))
        };
        return match sorted_entries(folder)?.iter().all(is_own) {
            true => Ok(RunState::Missing),
            false => Err(RunFolderError::missing(&path)),
        };
    };
    if manifest.program.is_some() {
        return Ok(RunState::InProgress(manifest.kind));
    }
    match manifest.unlisted_files(folder)?.first() {
        Some(stranger) => Err(RunFolderError::damaged(stranger, UNLISTED_FILE_MESSAGE)),
        None => Ok(RunState::Complete(CompletedRun { folder: folder.to_owned(), manifest })),
    }
}

impl CompletedRun {
    /// What kind of work it is.
    #[must_use]
    pub fn kind(&self) -> &str {
        &self.manifest.kind
    }

    /// The text of one of its files.
    ///
    /// # Errors
    /// [`WorkError`] if it is not there, is not as it was written, or is no text.
    pub fn read(&self, name: &str) -> Result<String, RunFolderError> {
        let path = self.folder.join(name);
        let no_text =
            |error| RunFolderError::Disk(DiskError::at(&path)(io::Error::new(io::ErrorKind::InvalidData, error)));
        String::from_utf8(self.read_bytes(name)?).map_err(no_text)
    }

    /// The names of its files, but for the manifest.
    #[must_use]
    pub fn file_names(&self) -> Vec<String> {
        self.manifest.file_names()
    }

    /// The bytes of one of its files.
    ///
    /// # Errors
    /// [`WorkError`] if it is not there, or is not as it was written.
    pub fn read_bytes(&self, name: &str) -> Result<Vec<u8>, RunFolderError> {
        let path = self.folder.join(name);
        if self.manifest.whole_file_state(name).is_some_and(|state| state.max_bytes() > MAX_BYTES) {
            return Err(RunFolderError::damaged(
                &path,
                format!("longer than {MAX_BYTES} bytes, which no such file is"),
            ));
        }
        let bytes = self.manifest.read_contents(&self.folder, name)?;
        self.manifest.check(name, bytes.as_deref()).map_err(|problem| RunFolderError::damaged(&path, problem))?;
        bytes.ok_or_else(|| RunFolderError::missing(&path))
    }

    /// The text of the file that says what decides its results.
    ///
    /// # Errors
    /// As for [`Self::read`], and if it was done with another.
    pub fn read_configuration(&self, name: &str) -> Result<String, RunFolderError> {
        let text = self.read(name)?;
        match sha256(&text) == self.manifest.configuration_sha256 {
            true => Ok(text),
            false => {
                Err(RunFolderError::damaged(&self.folder.join(name), "the work beside it was configured otherwise"))
            }
        }
    }

    /// Whether that is what decides its results.
    #[must_use]
    pub fn has_configuration(&self, configuration: &str) -> bool {
        self.manifest.configuration_sha256 == sha256(configuration)
    }

    /// Whether every file is as it was written.
    ///
    /// # Errors
    /// [`WorkError`] names the first that is not.
    pub fn check(&self) -> Result<(), RunFolderError> {
        self.file_names().iter().try_for_each(|name| self.read_bytes(name).map(drop))
    }

    /// Whether other work was configured the same and came to the same.
    #[must_use]
    pub fn is_identical_to(&self, other: &Self) -> bool {
        self.manifest == other.manifest
    }

    /// Whether it is in a folder already, and need not be copied there.
    ///
    /// # Errors
    /// [`WorkError`] if there is other work.
    pub fn is_present_in(&self, folder: &Path) -> Result<bool, RunFolderError> {
        let path = folder.join(MANIFEST_FILE);
        let own = self.folder.display();
        match Manifest::read(&path)? {
            None => Ok(false),
            Some(there) if there == self.manifest => Ok(true),
            Some(there) if there.program.is_some() => Err(RunFolderError::damaged(
                &path,
                format!("the {} there is half done, and that in {own} is not", there.kind),
            )),
            Some(there) => Err(RunFolderError::damaged(
                &path,
                format!("the {} there came to something else than in {own}", there.kind),
            )),
        }
    }

    /// Copies it to a folder, every file checked on the way and the manifest last; where it is already, nothing is done.
    ///
    /// # Errors
    /// [`WorkError`] if a file is not as it was written, or there is other work in that folder.
    pub fn copy_to(&self, folder: &Path) -> Result<(), RunFolderError> {
        if self.is_present_in(folder)? {
            return Ok(());
        }
        disk::make_folder(folder)?;
        for name in self.file_names() {
            let place = folder.join(&name);
            place.parent().map_or(Ok(()), disk::make_folder)?;
            disk::write(&place, self.read_bytes(&name)?)?;
        }
        Ok(self.manifest.write(folder)?)
    }

    /// The error about one of its files that is no JSON of the right form.
    #[must_use]
    pub fn unreadable_error(&self, name: &str, error: &serde_json::Error) -> RunFolderError {
        self.damaged_error(name, format!("line {}, column {}: not as crumple writes it", error.line(), error.column()))
    }

    /// An error about one of its files.
    #[must_use]
    pub fn damaged_error(&self, name: &str, problem: impl std::fmt::Display) -> RunFolderError {
        RunFolderError::damaged(&self.folder.join(name), problem.to_string())
    }
}
