//! Reading work that was finished: nothing is locked and nothing written, so that it may lie where nothing can be.

use std::io;
use std::path::{Path, PathBuf};

use super::lock::LOCK;
use super::manifest::{MOST_BYTES, Manifest, entries_of};
use super::{MANIFEST, PREVIOUS, UNKNOWN, WorkError};
use crate::disk::{self, DiskError};
use crumple_core::digest::sha256;

/// What a folder holds.
#[derive(Debug)]
pub enum Found {
    /// No work, but perhaps what a process leaves that ended before its first file.
    Nothing,
    /// Work of some kind that was not finished.
    HalfDone(String),
    /// Work that was finished.
    Finished(Finished),
}

/// Work that was finished. Its files are checked when they are read.
#[derive(Debug)]
pub struct Finished {
    folder: PathBuf,
    manifest: Manifest,
}

/// Looks for finished work in a folder.
///
/// # Errors
/// [`WorkError`] if there is no such folder, there is something else in it, or its manifest is damaged.
pub fn find(folder: &Path) -> Result<Found, WorkError> {
    if !folder.is_dir() {
        return Err(WorkError::damaged(folder, "there is no such folder"));
    }
    let path = folder.join(MANIFEST);
    let Some(manifest) = Manifest::read(&path)? else {
        let is_own =
            |path: &PathBuf| disk::is_unfinished(path) || [LOCK, PREVIOUS].iter().any(|own| path.ends_with(own));
        return match entries_of(folder)?.iter().all(is_own) {
            true => Ok(Found::Nothing),
            false => Err(WorkError::missing(&path)),
        };
    };
    if manifest.program.is_some() {
        return Ok(Found::HalfDone(manifest.kind));
    }
    match manifest.strangers(folder)?.first() {
        Some(stranger) => Err(WorkError::damaged(stranger, UNKNOWN)),
        None => Ok(Found::Finished(Finished { folder: folder.to_owned(), manifest })),
    }
}

impl Finished {
    /// What kind of work it is.
    #[must_use]
    pub fn kind(&self) -> &str {
        &self.manifest.kind
    }

    /// The text of one of its files.
    ///
    /// # Errors
    /// [`WorkError`] if it is not there, is not as it was written, or is no text.
    pub fn read(&self, name: &str) -> Result<String, WorkError> {
        let path = self.folder.join(name);
        let no_text = |error| WorkError::Disk(DiskError::at(&path)(io::Error::new(io::ErrorKind::InvalidData, error)));
        String::from_utf8(self.read_bytes(name)?).map_err(no_text)
    }

    /// The names of its files, but for the manifest.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        self.manifest.names()
    }

    /// The bytes of one of its files.
    ///
    /// # Errors
    /// [`WorkError`] if it is not there, or is not as it was written.
    pub fn read_bytes(&self, name: &str) -> Result<Vec<u8>, WorkError> {
        let path = self.folder.join(name);
        if self.manifest.state(name).is_some_and(|state| state.bytes() > MOST_BYTES) {
            return Err(WorkError::damaged(&path, format!("longer than {MOST_BYTES} bytes, which no such file is")));
        }
        let bytes = self.manifest.contents(&self.folder, name)?;
        self.manifest.check(name, bytes.as_deref()).map_err(|problem| WorkError::damaged(&path, problem))?;
        bytes.ok_or_else(|| WorkError::missing(&path))
    }

    /// The text of the file that says what decides its results.
    ///
    /// # Errors
    /// As for [`Self::read`], and if it was done with another.
    pub fn read_configuration(&self, name: &str) -> Result<String, WorkError> {
        let text = self.read(name)?;
        match sha256(&text) == self.manifest.configuration_sha256 {
            true => Ok(text),
            false => Err(WorkError::damaged(&self.folder.join(name), "the work beside it was configured otherwise")),
        }
    }

    /// Whether that is what decides its results.
    #[must_use]
    pub fn is_of(&self, configuration: &str) -> bool {
        self.manifest.configuration_sha256 == sha256(configuration)
    }

    /// Whether every file is as it was written.
    ///
    /// # Errors
    /// [`WorkError`] names the first that is not.
    pub fn check(&self) -> Result<(), WorkError> {
        self.names().iter().try_for_each(|name| self.read_bytes(name).map(drop))
    }

    /// Whether other work was configured the same and came to the same.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        self.manifest == other.manifest
    }

    /// Whether it is in a folder already, and need not be copied there.
    ///
    /// # Errors
    /// [`WorkError`] if there is other work.
    pub fn is_in(&self, folder: &Path) -> Result<bool, WorkError> {
        let path = folder.join(MANIFEST);
        let own = self.folder.display();
        match Manifest::read(&path)? {
            None => Ok(false),
            Some(there) if there == self.manifest => Ok(true),
            Some(there) if there.program.is_some() => Err(WorkError::damaged(
                &path,
                format!("the {} there is half done, and that in {own} is not", there.kind),
            )),
            Some(there) => {
                Err(WorkError::damaged(&path, format!("the {} there came to something else than in {own}", there.kind)))
            }
        }
    }

    /// Copies it to a folder, every file checked on the way and the manifest last; where it is already, nothing is done.
    ///
    /// # Errors
    /// [`WorkError`] if a file is not as it was written, or there is other work in that folder.
    pub fn copy_to(&self, folder: &Path) -> Result<(), WorkError> {
        if self.is_in(folder)? {
            return Ok(());
        }
        disk::make_folder(folder)?;
        for name in self.names() {
            let place = folder.join(&name);
            place.parent().map_or(Ok(()), disk::make_folder)?;
            disk::write(&place, self.read_bytes(&name)?)?;
        }
        Ok(self.manifest.write(folder)?)
    }

    /// The error about one of its files that is no JSON of the right form.
    #[must_use]
    pub fn unreadable(&self, name: &str, error: &serde_json::Error) -> WorkError {
        self.damaged(name, format!("line {}, column {}: not as crumple writes it", error.line(), error.column()))
    }

    /// An error about one of its files.
    #[must_use]
    pub fn damaged(&self, name: &str, problem: impl std::fmt::Display) -> WorkError {
        WorkError::damaged(&self.folder.join(name), problem.to_string())
    }
}
