//! Work that is kept in a folder, so that it can be gone on with: what lies there is what was written, or an error names it.
//!
//! A folder of work holds `work.json`, a manifest: which work it is, the program and the configuration it was begun with, and of
//! every file how long it is and its SHA-256. Files are written whole, beside their place, and reach the disk before they are
//! moved there; the manifest says beforehand what will be moved, and whoever opens the folder next makes what is left of it. So
//! whatever ends the process leaves a folder that is either as before a change or as after it, never a mixture. One process works in a folder at a time.
//!
//! Work may lie in a folder of other work ([`Work::include`]). Half-done work whose files are damaged begins anew in another folder: the
//! same seed ends with the same results.
//!
//! This is integrity, not secrecy: it finds what was cut, edited, moved or left over, on purpose or by accident, but not the work
//! of somebody who writes files and manifest anew. Who must not be able to do that must not be able to write there.

mod changes;
mod examine;
mod finished;
mod lock;
mod manifest;
mod pending;
mod state;

pub use changes::Changes;
pub use examine::{Examined, examine};
pub use finished::{Finished, Found, find};
pub use lock::{Lock, exclusively};
pub use state::Prefix;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::disk::{self, DiskError};
use crate::program::{self, OTHER_BUILD};
use crumple_core::digest::sha256;
use manifest::{Manifest, entries_of};
use state::FileState;

/// The file that says what the others are.
pub const MANIFEST: &str = "work.json";

/// Returns whether a folder is one of work: whether it holds `work.json`.
#[must_use]
pub fn is_there(folder: &Path) -> bool {
    folder.join(MANIFEST).exists()
}

/// Folder in which earlier versions kept older copies of files while the work lasted.
const PREVIOUS: &str = "previous";

/// The manifest of files that are written all at once, by whoever made them, as those of a report are: `work.json` beside them, and
/// [`examine`] knows what was cut, edited or moved since.
///
/// # Errors
/// [`serde_json::Error`] in principle; it is text and numbers.
pub fn manifest_of<'a>(
    kind: &str,
    configuration: &str,
    files: impl Iterator<Item = (&'a str, &'a [u8])>,
) -> Result<String, serde_json::Error> {
    Manifest::of_all(kind, &sha256(configuration), files).text()
}

/// What kind of work a folder holds, by its manifest; none if it has none that can be read.
#[must_use]
pub fn kind_in(folder: &Path) -> Option<String> {
    Some(Manifest::read(&folder.join(MANIFEST)).ok()??.kind)
}

/// Returns the name and SHA-256 of every file of work of a kind, `work.json` included, as its manifest states them; nothing without a
/// manifest that can be read.
#[must_use]
pub fn digests_in(folder: &Path, kind: &str) -> Vec<(String, String)> {
    let manifest = Manifest::read(&folder.join(MANIFEST)).ok().flatten().filter(|manifest| manifest.kind == kind);
    manifest.map(|manifest| manifest.digests()).unwrap_or_default()
}

/// What tells work of a kind with a configuration from all other, as this program does it ([`Work::identity`]).
pub fn identity(kind: &str, configuration: &str) -> Result<String, DiskError> {
    let program = program::identity()?;
    Ok(Manifest::new(kind, program, &sha256(configuration), &[]).identity(program))
}

/// What is said of a file that is there and should not be.
const UNKNOWN: &str =
    "work.json knows no such file: it is left over from other work, or of version 0.1.0, or work.json was lost";

/// A folder of work in use.
#[derive(Debug)]
pub struct Work {
    folder: PathBuf,
    program: &'static str,
    manifest: Mutex<Manifest>,
    _lock: Lock,
}

/// Why a folder cannot be worked in.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WorkError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// Work is there that was not to be gone on with.
    #[error("{} holds a {kind} already: use --resume, or another --out", folder.display())]
    Taken {
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
    Differing(String),
    /// Another build of crumple left it half done.
    #[error("{}: {OTHER_BUILD}", path.display())]
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

impl WorkError {
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
pub struct Asked<'a> {
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

impl Work {
    /// Begins work in a folder, which is made if it is not there; or goes on with what is there, once every file has been found
    /// to be as it was written.
    ///
    /// # Errors
    /// [`WorkError`] if the folder cannot be used, is in use, holds other work, or anything in it is damaged.
    pub fn open(folder: &Path, asked: Asked<'_>) -> Result<Self, WorkError> {
        disk::make_folder(folder)?;
        let kind = || asked.kind.to_owned();
        let lock = Lock::of(folder)?.ok_or_else(|| WorkError::InUse { folder: folder.to_owned(), kind: kind() })?;
        let (path, configuration_sha256) = (folder.join(MANIFEST), sha256(asked.configuration));
        let program = program::identity()?;
        let manifest = match Manifest::read(&path)? {
            // It is written with the first change: what cannot be begun leaves nothing behind.
            None => Manifest::new(asked.kind, program, &configuration_sha256, asked.outputs),
            Some(found) if found.kind != asked.kind => {
                return Err(WorkError::OtherKind { path, found: found.kind, kind: kind() });
            }
            Some(_) if !asked.resume => return Err(WorkError::Taken { folder: folder.to_owned(), kind: kind() }),
            Some(found) if found.configuration_sha256 != configuration_sha256 => {
                let name = asked.configuration_file;
                if found.look(folder, name).is_err() {
                    let problem =
                        format!("the `{name}` beside it is not the one that it knows: one of them is of other work");
                    return Err(WorkError::damaged(&path, problem));
                }
                let found = found.contents(folder, name)?.unwrap_or_default();
                return Err(WorkError::OtherConfiguration {
                    path: folder.join(name),
                    kind: kind(),
                    found: String::from_utf8_lossy(&found).into_owned(),
                });
            }
            // What is complete may be read by any build.
            Some(found) if found.program.as_deref().is_some_and(|found| found != program) => {
                return Err(WorkError::OtherBuild { path });
            }
            Some(found) => found,
        };
        let work = Self { folder: folder.to_owned(), program, manifest: Mutex::new(manifest), _lock: lock };
        work.settle()?;
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
        self.locked().program.is_none()
    }

    /// What tells this work from all other: its kind, its program and its configuration. For records that have checks of their
    /// own.
    #[must_use]
    pub fn identity(&self) -> String {
        self.locked().identity(self.program)
    }

    /// The bytes of a file; none if there is no such file.
    ///
    /// # Errors
    /// [`WorkError::Damaged`] if they are not what was written.
    pub fn read(&self, name: &str) -> Result<Option<Vec<u8>>, WorkError> {
        let manifest = self.locked();
        let bytes = manifest.contents(&self.folder, name)?;
        let damaged = |problem| WorkError::damaged(&self.path(name), problem);
        manifest.check(name, bytes.as_deref()).map_err(damaged)?;
        Ok(bytes)
    }

    /// The bytes of a file that the work has written.
    ///
    /// # Errors
    /// [`WorkError::Damaged`] if they are not what was written, or it is not there.
    pub fn read_present(&self, name: &str) -> Result<Vec<u8>, WorkError> {
        self.read(name)?.ok_or_else(|| WorkError::missing(&self.path(name)))
    }

    /// Changes that are announced and made together.
    pub fn changes(&self) -> Changes<'_> {
        Changes::of(self)
    }

    /// Writes a file ([`Changes::write`]).
    ///
    /// # Errors
    /// [`WorkError`] if something unknown is in its place, or it cannot be written.
    pub fn write(&self, name: &str, contents: impl Into<Vec<u8>>) -> Result<(), WorkError> {
        self.changes().write(name, contents).commit()
    }

    /// Takes the work that was finished in a folder of this one, such as `rounds/01/search`, to be part of it: from now on its
    /// files are checked with those of this one.
    ///
    /// # Errors
    /// [`WorkError`] if there is no work, or its manifest cannot be read or that of this one not be written.
    pub fn include(&self, folder: &str) -> Result<(), WorkError> {
        let name = format!("{folder}/{MANIFEST}");
        let path = self.path(&name);
        let bytes = state::regular(&path, manifest::MOST_BYTES)?.ok_or_else(|| WorkError::missing(&path))?;
        let mut manifest = self.locked();
        manifest.include(&name, FileState::of(&bytes));
        Ok(manifest.write(&self.folder)?)
    }

    /// Says how a file that grows ([`Changes::grow`]) begins from now on: what has reached the disk. Shorter than that, or begun
    /// otherwise, it is damaged.
    ///
    /// # Errors
    /// [`WorkError::Disk`] if the manifest cannot be written.
    pub fn grew(&self, name: &str, prefix: Prefix) -> Result<(), WorkError> {
        let mut manifest = self.locked();
        manifest.include(name, FileState::Growing(prefix));
        Ok(manifest.write(&self.folder)?)
    }

    /// Says that nothing will be changed any more.
    ///
    /// # Errors
    /// [`WorkError::Disk`] if the manifest cannot be written.
    pub fn finish(&self) -> Result<(), WorkError> {
        let mut manifest = self.locked();
        manifest.program = None;
        Ok(manifest.write(&self.folder)?)
    }

    /// Where nothing is known of, nothing may lie: neither the file itself nor, in a folder that is new to the work, another.
    fn is_free(&self, manifest: &Manifest, name: &str) -> Result<(), WorkError> {
        let path = self.path(name);
        if manifest.knows(name) {
            return Ok(());
        }
        if path.symlink_metadata().is_ok() {
            return Err(WorkError::damaged(&path, UNKNOWN));
        }
        let folder = name.rsplit_once('/').map(|(folder, _)| folder);
        match folder.filter(|folder| !manifest.folders().contains(folder)) {
            None => Ok(()),
            Some(folder) => match entries_of(&self.path(folder))?.iter().find(|path| !path.is_dir()) {
                Some(left_over) => Err(WorkError::damaged(left_over, UNKNOWN)),
                None => Ok(()),
            },
        }
    }

    /// Makes what is left of the last change, and finds out whether everything is as it was written.
    fn settle(&self) -> Result<(), WorkError> {
        let mut manifest = self.locked();
        manifest.complete(&self.folder)?;
        for folder in [""].into_iter().chain(manifest.folders()) {
            if !manifest.includes(folder) {
                disk::remove_all_unfinished(&self.path(folder))?;
            }
        }
        if let Some(stranger) = manifest.strangers(&self.folder)?.first() {
            return Err(WorkError::damaged(stranger, UNKNOWN));
        }
        manifest.names().iter().try_for_each(|name| manifest.look(&self.folder, name))?;
        for folder in manifest.included() {
            let folder = self.path(&folder);
            examine(&folder)?.within().first_damage(&folder).map_or(Ok(()), Err)?;
        }
        Ok(())
    }

    fn locked(&self) -> std::sync::MutexGuard<'_, Manifest> {
        // Nothing is left half done under this lock, so that a panic elsewhere does not spoil it.
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests;
