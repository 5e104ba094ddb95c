//! Work that is kept in a folder, so that it can be gone on with: what lies there is what was written, or an error names it.
//!
//! A folder of work holds `work.json`, a manifest: which work it is, the program and the configuration it was begun with, and of
//! every file how long it is and its SHA-256. Files are written whole, beside their place, and reach the disk before they are
//! moved there; the manifest says beforehand what will be written, so that whatever ends the process leaves a folder that is
//! either as before a change or as after it. One process works in a folder at a time.
//!
//! What only doing the work again could make again, such as the checkpoint of a training, is kept twice while the work lasts: as it
//! is, and in the folder `previous` as it was before ([`Work::advance`]). `work.json` has its second copy there, too. If one of
//! them is damaged, [`restore`] goes back to the other. Work may lie in a folder of other work ([`Work::include`]).
//!
//! This is integrity, not secrecy: it finds what was cut, edited, moved or left over, on purpose or by accident, but not the work
//! of somebody who writes files and manifest anew. Who must not be able to do that must not be able to write there.

mod examine;
mod generation;
mod lock;
mod manifest;

pub use examine::{Examined, examine};
pub use generation::{Restored, restore};
pub use lock::exclusively;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::disk::{self, DiskError};
use crate::program::{self, OTHER_BUILD};
use crumple_world::digest::{Sha256, sha256};
use lock::Lock;
use manifest::{FileState, Manifest};

/// The file that says what the others are.
pub const MANIFEST: &str = "work.json";

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
    #[error("{}: configuration_sha256: the {kind} there was configured otherwise", path.display())]
    OtherConfiguration {
        /// The manifest.
        path: PathBuf,
        /// What kind of work is there.
        kind: String,
    },
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

    pub(crate) fn damaged(path: &Path, problem: impl Into<String>) -> Self {
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
    /// Whether work that is there is gone on with.
    pub resume: bool,
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
        let manifest = match Manifest::read(&path).map_err(|error| generation::hinted(folder, error))? {
            None if generation::manifest_in(folder).exists() => {
                return Err(generation::hinted(folder, WorkError::missing(&path)));
            }
            // It is written with the first change: what cannot be begun leaves nothing behind.
            None => Manifest::new(asked.kind, program, &configuration_sha256),
            Some(found) if found.kind != asked.kind => {
                return Err(WorkError::OtherKind { path, found: found.kind, kind: kind() });
            }
            Some(_) if !asked.resume => return Err(WorkError::Taken { folder: folder.to_owned(), kind: kind() }),
            Some(found) if found.configuration_sha256 != configuration_sha256 => {
                return Err(WorkError::OtherConfiguration { path, kind: kind() });
            }
            // What is complete may be read by any build.
            Some(found) if found.program.as_deref().is_some_and(|found| found != program) => {
                return Err(WorkError::OtherBuild { path });
            }
            Some(found) => found,
        };
        let work = Self { folder: folder.to_owned(), program, manifest: Mutex::new(manifest), _lock: lock };
        work.settle().map_err(|error| generation::hinted(folder, error))?;
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
        let manifest = self.locked();
        let digest = Sha256::default().with(&manifest.kind).with(&manifest.configuration_sha256).with(self.program);
        digest.hexadecimal()
    }

    /// The bytes of a file; none if there is no such file.
    ///
    /// # Errors
    /// [`WorkError::Damaged`] if they are not what was written.
    pub fn read(&self, name: &str) -> Result<Option<Vec<u8>>, WorkError> {
        let path = self.path(name);
        let bytes = disk::read(&path)?;
        self.locked().check(name, bytes.as_deref()).map_err(|problem| WorkError::damaged(&path, problem))?;
        Ok(bytes)
    }

    /// The bytes of a file that the work has written.
    ///
    /// # Errors
    /// [`WorkError::Damaged`] if they are not what was written, or it is not there.
    pub fn read_present(&self, name: &str) -> Result<Vec<u8>, WorkError> {
        self.read(name)?.ok_or_else(|| WorkError::missing(&self.path(name)))
    }

    /// Writes a file, whole or not at all. What is there with the same contents is left alone.
    ///
    /// # Errors
    /// [`WorkError::Disk`] if it cannot be written.
    pub fn write(&self, name: &str, contents: impl AsRef<[u8]>) -> Result<(), WorkError> {
        self.write_all(&[(name, contents)])
    }

    /// Writes files, one after the other, each whole or not at all. What is there with the same contents is left alone.
    ///
    /// # Errors
    /// [`WorkError::Disk`] if one cannot be written; those before it are.
    pub fn write_all(&self, files: &[(impl AsRef<str>, impl AsRef<[u8]>)]) -> Result<(), WorkError> {
        let states = files.iter().map(|(name, contents)| (name.as_ref(), FileState::of(contents.as_ref())));
        self.change(states.collect(), |index, path| {
            let Some((_, contents)) = files.get(index) else { return Ok(()) };
            path.parent().map_or(Ok(()), disk::make_folder)?;
            disk::write(path, contents)
        })
    }

    /// Writes files that nothing but the work itself could make again, one after the other, and keeps those they replace in
    /// `previous` until the work is finished. Of the first of its kind, the same is kept.
    ///
    /// # Errors
    /// [`WorkError::Disk`] if one cannot be written; those before it are.
    pub fn advance(&self, files: &[(impl AsRef<str>, impl AsRef<[u8]>)]) -> Result<(), WorkError> {
        let replaced: Vec<(&str, String, FileState)> = {
            let manifest = self.locked();
            let with_state = files.iter().filter_map(|(name, contents)| {
                let state = manifest.state(name.as_ref())?;
                Some((name.as_ref(), contents.as_ref(), state))
            });
            let replaced = with_state.filter(|(_, contents, state)| *state != FileState::of(contents));
            replaced.map(|(name, _, state)| (name, generation::before(name), state)).collect()
        };
        let states = replaced.iter().map(|(_, before, state)| (before.as_str(), state.clone()));
        self.change(states.collect(), |index, path| {
            let Some((name, ..)) = replaced.get(index) else { return Ok(()) };
            path.parent().map_or(Ok(()), disk::make_folder)?;
            disk::keep_as(&self.path(name), path)
        })?;
        self.write_all(files)?;
        let is_single = |name: &str| !replaced.iter().any(|(replaced, ..)| *replaced == name);
        let single = files.iter().filter(|(name, _)| is_single(name.as_ref()));
        let doubles: Vec<_> = single.map(|(name, contents)| (generation::before(name.as_ref()), contents)).collect();
        self.write_all(&doubles)
    }

    /// Removes files, as far as they are there.
    ///
    /// # Errors
    /// [`WorkError::Disk`] if one cannot be removed.
    pub fn remove(&self, names: &[impl AsRef<str>]) -> Result<(), WorkError> {
        let mut earlier: Vec<_> = names.iter().map(|name| generation::before(name.as_ref())).collect();
        earlier.retain(|name| self.locked().knows(name));
        let names = names.iter().map(AsRef::as_ref).chain(earlier.iter().map(String::as_str));
        self.change(names.map(|name| (name, FileState::Absent)).collect(), |_, path| disk::remove(path))
    }

    /// Takes the work that was finished in a folder of this one, such as `rounds/01/search`, to be part of it: from now on its
    /// files are checked with those of this one.
    ///
    /// # Errors
    /// [`WorkError`] if there is no work, or its manifest cannot be read or that of this one not be written.
    pub fn include(&self, folder: &str) -> Result<(), WorkError> {
        let name = format!("{folder}/{MANIFEST}");
        let path = self.path(&name);
        let bytes = disk::read(&path)?.ok_or_else(|| WorkError::missing(&path))?;
        let mut manifest = self.locked();
        manifest.include(&name, FileState::of(&bytes));
        Ok(manifest.write(&self.folder)?)
    }

    /// A file whose records have checks of their own: the manifest says that it may be there, and no more.
    ///
    /// # Errors
    /// [`WorkError::Disk`] if the manifest cannot be written.
    pub fn let_grow(&self, name: &str) -> Result<PathBuf, WorkError> {
        let path = self.path(name);
        self.change(vec![(name, FileState::Growing)], |_, _| Ok(()))?;
        Ok(path)
    }

    /// Says that nothing will be changed any more.
    ///
    /// # Errors
    /// [`WorkError::Disk`] if the manifest cannot be written.
    pub fn finish(&self) -> Result<(), WorkError> {
        let earlier: Vec<_> = self.locked().names().into_iter().filter(|name| generation::is_of_it(name)).collect();
        self.remove(&earlier)?;
        let mut manifest = self.locked();
        manifest.program = None;
        manifest.write(&self.folder)?;
        Ok(generation::forget(&self.folder)?)
    }

    /// Announces changes, makes those that are any, and knows from then on that they were made.
    fn change(
        &self,
        files: Vec<(&str, FileState)>,
        make: impl Fn(usize, &Path) -> Result<(), DiskError>,
    ) -> Result<(), WorkError> {
        let mut manifest = self.locked();
        files.iter().try_for_each(|(name, _)| self.is_free(&manifest, name))?;
        let announced =
            files.into_iter().enumerate().map(|(index, (name, to))| (index, name, manifest.announce(name, to)));
        let changes: Vec<_> = announced.filter(|(.., is_change)| *is_change).collect();
        if !changes.is_empty() {
            manifest.program = Some(self.program.to_owned());
            manifest.write(&self.folder)?;
        }
        for (index, name, _) in changes {
            make(index, &self.path(name))?;
            manifest.made(name);
        }
        Ok(())
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
            Some(folder) => match files_in(&self.path(folder))?.iter().find(|path| !self.is_second_manifest(path)) {
                Some(left_over) => Err(WorkError::damaged(left_over, UNKNOWN)),
                None => Ok(()),
            },
        }
    }

    /// Finds out how far the last change came, and that everything else is as it was written.
    fn settle(&self) -> Result<(), WorkError> {
        let mut manifest = self.locked();
        for folder in std::iter::once("").chain(manifest.folders()).filter(|folder| !manifest.includes(folder)) {
            let files = files_in(&self.path(folder))?;
            let name =
                |path: &Path| path.strip_prefix(&self.folder).is_ok_and(|name| manifest.knows(&name.to_string_lossy()));
            for path in files {
                if disk::is_unfinished(&path) {
                    disk::remove(&path)?;
                } else if !folder.is_empty() && !name(&path) && !self.is_second_manifest(&path) {
                    return Err(WorkError::damaged(&path, UNKNOWN));
                }
            }
        }
        // What checks its own records may be larger than memory, and is read by who does so.
        for name in manifest.names().into_iter().filter(|name| !manifest.grows(name)).collect::<Vec<_>>() {
            let path = self.path(&name);
            let bytes = disk::read(&path)?;
            manifest.settle(&name, bytes.as_deref()).map_err(|problem| WorkError::damaged(&path, problem))?;
        }
        for folder in manifest.included() {
            let folder = self.path(&folder);
            examine(&folder)?.first_damage(&folder).map_or(Ok(()), Err)?;
        }
        Ok(())
    }

    fn is_second_manifest(&self, path: &Path) -> bool {
        path == generation::manifest_in(&self.folder)
    }

    fn locked(&self) -> std::sync::MutexGuard<'_, Manifest> {
        // Nothing is left half done under this lock, so that a panic elsewhere does not spoil it.
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The files in a folder, in order; none if there is no such folder.
fn files_in(folder: &Path) -> Result<Vec<PathBuf>, DiskError> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(DiskError::at(folder)(source)),
    };
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(DiskError::at(folder))?.path();
        if !path.is_dir() {
            files.push(path);
        }
    }
    files.sort_unstable();
    Ok(files)
}

#[cfg(test)]
mod tests;
