//! Work that is kept in a folder, so that it can be gone on with: what lies there is what was written, or an error names it.
//!
//! A folder of work holds `work.json`, a manifest: which work it is, the program and the configuration it was begun with, and of
//! every file how long it is and its SHA-256. Files are written whole, beside their place, and reach the disk before they are
//! moved there; the manifest says beforehand what will be moved, and whoever opens the folder next makes what is left of it. So
//! whatever ends the process leaves a folder that is either as before a change or as after it, never a mixture. One process works in a folder at a time.
//!
//! Work may lie in a folder of other work ([`RunFolder::include`]). Half-done work whose files are damaged begins anew in another folder: the
//! same seed ends with the same results.
//!
//! This is integrity, not secrecy: it finds what was cut, edited, moved or left over, on purpose or by accident, but not the work
//! of somebody who writes files and manifest anew. Who must not be able to do that must not be able to write there.

mod completed_run;
mod examine;
mod lock;
mod manifest;
mod pending;
mod state;
mod transaction;

pub use completed_run::{CompletedRun, RunState, read_state};
pub use examine::{FolderExamination, examine};
pub use lock::{FolderLock, with_folder_lock};
pub use state::Prefix;
pub use transaction::FolderTransaction;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::disk::{self, DiskError};
use crate::program::{self, OTHER_BUILD_MESSAGE};
use crumple_core::digest::sha256;
use manifest::{Manifest, sorted_entries};
use state::FileState;

/// The file that says what the others are.
pub const MANIFEST_FILE: &str = "work.json";

/// Returns whether a folder is one of work: whether it holds `work.json`.
#[must_use]
pub fn is_run_folder(folder: &Path) -> bool {
    folder.join(MANIFEST_FILE).exists()
}

/// Folder in which earlier versions kept older copies of files while the work lasted.
const PREVIOUS_FOLDER: &str = "previous";

/// The manifest of files that are written all at once, by whoever made them, as those of a report are: `work.json` beside them, and
/// [`examine`] knows what was cut, edited or moved since.
///
/// # Errors
/// [`serde_json::Error`] in principle; it is text and numbers.
pub fn manifest_text<'a>(
    kind: &str,
    configuration: &str,
    files: impl Iterator<Item = (&'a str, &'a [u8])>,
) -> Result<String, serde_json::Error> {
    Manifest::from_files(kind, &sha256(configuration), files).to_json()
}

/// What kind of work a folder holds, by its manifest; none if it has none that can be read.
#[must_use]
pub fn read_kind(folder: &Path) -> Option<String> {
    Some(Manifest::read(&folder.join(MANIFEST_FILE)).ok()??.kind)
}

/// Returns the name and SHA-256 of every file of work of a kind, `work.json` included, as its manifest states them; nothing without a
/// manifest that can be read.
#[must_use]
pub fn read_digests(folder: &Path, kind: &str) -> Vec<(String, String)> {
    let manifest = Manifest::read(&folder.join(MANIFEST_FILE)).ok().flatten().filter(|manifest| manifest.kind == kind);
    manifest.map(|manifest| manifest.digests()).unwrap_or_default()
}

/// What tells work of a kind with a configuration from all other, as this program does it ([`RunFolder::identity`]).
pub fn identity(kind: &str, configuration: &str) -> Result<String, DiskError> {
    let program = program::identity()?;
    Ok(Manifest::new(kind, program, &sha256(configuration), &[]).identity(program))
}

/// What is said of a file that is there and should not be.
const UNLISTED_FILE_MESSAGE: &str =
    "work.json knows no such file: it is left over from other work, or of version 0.1.0, or work.json was lost";

/// A folder of work in use.
#[derive(Debug)]
pub struct RunFolder {
    folder: PathBuf,
    program: &'static str,
    manifest: Mutex<Manifest>,
    _lock: FolderLock,
}

/// Why a folder cannot be worked in.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunFolderError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// Work is there that was not to be gone on with.
    #[error("{} holds a {kind} already: use --resume, or another --out", folder.display())]
    AlreadyExists {
        /// The folder.
        folder: PathBuf,
        /// What kind of work is there.
        kind: String,
    },
    /// Another process is at work there.
    #[error("{}: another process works on the {kind} there", folder.display())]
    InUse {
        /// The folder.
        folder: PathBuf,
        /// What kind of work is asked for.
        kind: String,
    },
    /// There is work of another kind.
    #[error("{}: the work there is a {found}, and no {kind}", path.display())]
    OtherKind {
        /// The manifest.
        path: PathBuf,
        /// What kind of work is there.
        found: String,
        /// What kind of work is asked for.
        kind: String,
    },
    /// It was configured otherwise.
    #[error("{}: the {kind} there was configured otherwise", path.display())]
    OtherConfiguration {
        /// The file that says how, or would.
        path: PathBuf,
        /// What kind of work is there.
        kind: String,
        /// What that file holds; empty if it was not written yet.
        found: String,
    },
    /// The same, where it is known in what: the place and both values.
    #[error("{0}")]
    ConfigurationDiffers(String),
    /// Another build of crumple left it half done.
    #[error("{}: {OTHER_BUILD_MESSAGE}", path.display())]
    OtherBuild {
        /// The manifest.
        path: PathBuf,
    },
    /// A file is not as it was written.
    #[error("{}: {problem}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
}

impl RunFolderError {
    /// A file that is not there and should be.
    #[must_use]
    pub fn missing(path: &Path) -> Self {
        Self::damaged(path, "the file is missing")
    }

    /// Returns the error about a file whose content is not what its writer wrote.
    pub fn damaged(path: &Path, problem: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_owned(), problem: problem.into() }
    }
}

/// What is asked of a folder.
#[derive(Debug, Clone, Copy)]
pub struct RunFolderOptions<'a> {
    /// What kind of work, as a noun for readers.
    pub kind: &'a str,
    /// Everything that decides its results.
    pub configuration: &'a str,
    /// The file that says so to readers.
    pub configuration_file: &'a str,
    /// Whether work that is there is gone on with.
    pub resume: bool,
    /// The names of its results, folders with a slash at the end: nothing else may be in these places when it begins or goes on.
    pub outputs: &'a [&'a str],
}

impl RunFolder {
    /// Begins work in a folder, which is made if it is not there; or goes on with what is there, once every file has been found
    /// to be as it was written.
    ///
    /// # Errors
    /// [`RunFolderError`] if the folder cannot be used, is in use, holds other work, or anything in it is damaged.
    pub fn open(folder: &Path, asked: RunFolderOptions<'_>) -> Result<Self, RunFolderError> {
        disk::make_folder(folder)?;
        let kind = || asked.kind.to_owned();
        let lock = FolderLock::try_acquire(folder)?
            .ok_or_else(|| RunFolderError::InUse { folder: folder.to_owned(), kind: kind() })?;
        let (path, configuration_sha256) = (folder.join(MANIFEST_FILE), sha256(asked.configuration));
        let program = program::identity()?;
        let manifest = match Manifest::read(&path)? {
            // It is written with the first change: what cannot be begun leaves nothing behind.
            None => Manifest::new(asked.kind, program, &configuration_sha256, asked.outputs),
            Some(found) if found.kind != asked.kind => {
                return Err(RunFolderError::OtherKind { path, found: found.kind, kind: kind() });
            }
            Some(_) if !asked.resume => {
                return Err(RunFolderError::AlreadyExists { folder: folder.to_owned(), kind: kind() });
            }
            Some(found) if found.configuration_sha256 != configuration_sha256 => {
                let name = asked.configuration_file;
                if found.check_file(folder, name).is_err() {
                    let problem =
                        format!("the `{name}` beside it is not the one that it knows: one of them is of other work");
                    return Err(RunFolderError::damaged(&path, problem));
                }
                let found = found.read_contents(folder, name)?.unwrap_or_default();
                return Err(RunFolderError::OtherConfiguration {
                    path: folder.join(name),
                    kind: kind(),
                    found: String::from_utf8_lossy(&found).into_owned(),
                });
            }
            // What is complete may be read by any build.
            Some(found) if found.program.as_deref().is_some_and(|found| found != program) => {
                return Err(RunFolderError::OtherBuild { path });
            }
            Some(found) => found,
        };
        let work = Self { folder: folder.to_owned(), program, manifest: Mutex::new(manifest), _lock: lock };
        work.recover()?;
        Ok(work)
    }

    /// Where a file of that name is.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Whether the work was finished.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.lock_manifest().program.is_none()
    }

    /// What tells this work from all other: its kind, its program and its configuration. For records that have checks of their
    /// own.
    #[must_use]
    pub fn identity(&self) -> String {
        self.lock_manifest().identity(self.program)
    }

    /// The bytes of a file; none if there is no such file.
    ///
    /// # Errors
    /// [`RunFolderError::Damaged`] if they are not what was written.
    pub fn read(&self, name: &str) -> Result<Option<Vec<u8>>, RunFolderError> {
        let manifest = self.lock_manifest();
        let bytes = manifest.read_contents(&self.folder, name)?;
        let damaged = |problem| RunFolderError::damaged(&self.path(name), problem);
        manifest.check(name, bytes.as_deref()).map_err(damaged)?;
        Ok(bytes)
    }

    /// The bytes of a file that the work has written.
    ///
    /// # Errors
    /// [`RunFolderError::Damaged`] if they are not what was written, or it is not there.
    pub fn read_required(&self, name: &str) -> Result<Vec<u8>, RunFolderError> {
        self.read(name)?.ok_or_else(|| RunFolderError::missing(&self.path(name)))
    }

    /// Changes that are announced and made together.
    pub fn transaction(&self) -> FolderTransaction<'_> {
        FolderTransaction::new(self)
    }

    /// Writes a file ([`Changes::write`]).
    ///
    /// # Errors
    /// [`RunFolderError`] if something unknown is in its place, or it cannot be written.
    pub fn write(&self, name: &str, contents: impl Into<Vec<u8>>) -> Result<(), RunFolderError> {
        self.transaction().write(name, contents).commit()
    }

    /// Takes the work that was finished in a folder of this one, such as `rounds/01/search`, to be part of it: from now on its
    /// files are checked with those of this one.
    ///
    /// # Errors
    /// [`RunFolderError`] if there is no work, or its manifest cannot be read or that of this one not be written.
    pub fn include(&self, folder: &str) -> Result<(), RunFolderError> {
        let name = format!("{folder}/{MANIFEST_FILE}");
        let path = self.path(&name);
        let bytes =
            state::read_regular_file(&path, manifest::MAX_BYTES)?.ok_or_else(|| RunFolderError::missing(&path))?;
        let mut manifest = self.lock_manifest();
        manifest.set_state(&name, FileState::from_contents(&bytes));
        Ok(manifest.write(&self.folder)?)
    }

    /// Says how a file that grows ([`Changes::grow`]) begins from now on: what has reached the disk. Shorter than that, or begun
    /// otherwise, it is damaged.
    ///
    /// # Errors
    /// [`RunFolderError::Disk`] if the manifest cannot be written.
    pub fn record_prefix(&self, name: &str, prefix: Prefix) -> Result<(), RunFolderError> {
        let mut manifest = self.lock_manifest();
        manifest.set_state(name, FileState::AppendOnly(prefix));
        Ok(manifest.write(&self.folder)?)
    }

    /// Says that nothing will be changed any more.
    ///
    /// # Errors
    /// [`RunFolderError::Disk`] if the manifest cannot be written.
    pub fn finish(&self) -> Result<(), RunFolderError> {
        let mut manifest = self.lock_manifest();
        manifest.program = None;
        Ok(manifest.write(&self.folder)?)
    }

    /// Where nothing is known of, nothing may lie: neither the file itself nor, in a folder that is new to the work, another.
    fn check_unoccupied(&self, manifest: &Manifest, name: &str) -> Result<(), RunFolderError> {
        let path = self.path(name);
        if manifest.has_entry(name) {
            return Ok(());
        }
        if path.symlink_metadata().is_ok() {
            return Err(RunFolderError::damaged(&path, UNLISTED_FILE_MESSAGE));
        }
        let folder = name.rsplit_once('/').map(|(folder, _)| folder);
        match folder.filter(|folder| !manifest.folders().contains(folder)) {
            None => Ok(()),
            Some(folder) => match sorted_entries(&self.path(folder))?.iter().find(|path| !path.is_dir()) {
                Some(left_over) => Err(RunFolderError::damaged(left_over, UNLISTED_FILE_MESSAGE)),
                None => Ok(()),
            },
        }
    }

    /// Makes what is left of the last change, and finds out whether everything is as it was written.
    fn recover(&self) -> Result<(), RunFolderError> {
        let mut manifest = self.lock_manifest();
        manifest.recover_pending(&self.folder)?;
        for folder in [""].into_iter().chain(manifest.folders()) {
            if !manifest.includes_folder(folder) {
                disk::remove_all_unfinished(&self.path(folder))?;
            }
        }
        if let Some(stranger) = manifest.unlisted_files(&self.folder)?.first() {
            return Err(RunFolderError::damaged(stranger, UNLISTED_FILE_MESSAGE));
        }
        manifest.file_names().iter().try_for_each(|name| manifest.check_file(&self.folder, name))?;
        for folder in manifest.included_folders() {
            let folder = self.path(&folder);
            examine(&folder)?.into_included().first_damage(&folder).map_or(Ok(()), Err)?;
        }
        Ok(())
    }

    fn lock_manifest(&self) -> std::sync::MutexGuard<'_, Manifest> {
        // Nothing is left half done under this lock, so that a panic elsewhere does not spoil it.
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests;
