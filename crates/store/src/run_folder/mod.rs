//! A resumable run folder with an integrity manifest. Opening it checks that every file is as it was written, and names
//! a damaged one.
//!
//! The manifest `work.json` records the kind of the run, its program, its configuration, and the size and SHA-256 of
//! every file. Files are written under temporary names and synced to disk. The manifest then announces their renames.
//! If the process ends before it has made all of them, the next process that opens the folder makes the rest. Every
//! change is therefore atomic, however the process ends. One process uses a folder at a time.
//!
//! A run folder may include others ([`RunFolder::include`]). A damaged incomplete run must be started again in another
//! folder.
//!
//! The manifest protects integrity, not authenticity. It detects files that were truncated, edited, moved or left over.
//! It does not detect an author who rewrites both files and manifest.

mod completed_run;
mod examine;
mod lock;
mod manifest;
mod pending;
mod report;
mod state;
mod transaction;

pub use completed_run::{CompletedRun, RunState, read_state};
pub use examine::{FolderExamination, examine};
pub use lock::{FolderLock, with_folder_lock};
pub use report::{DamagedFile, FolderReport};
pub use state::Prefix;
pub use transaction::FolderTransaction;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::disk::{self, DiskError};
use crate::program::{self, OTHER_BUILD_MESSAGE};
use crumple_core::digest::sha256;
use crumple_core::text_file;
use manifest::{Manifest, sorted_entries};
use state::FileState;

/// Name of the manifest.
pub const MANIFEST_FILE: &str = "work.json";

/// Returns true if a folder contains `work.json`.
#[must_use]
pub fn is_run_folder(folder: &Path) -> bool {
    folder.join(MANIFEST_FILE).exists()
}

/// Folder in which earlier versions kept backups of files until the run was complete.
const PREVIOUS_FOLDER: &str = "previous";

/// Returns the text of a manifest `work.json` for files that the caller writes without a [`RunFolder`], such as a
/// report, so that [`examine`] can check them.
///
/// # Errors
/// [`serde_json::Error`] never occurs in practice, because the content is text and numbers.
pub fn manifest_text<'a>(
    kind: &str,
    configuration: &str,
    files: impl Iterator<Item = (&'a str, &'a [u8])>,
) -> Result<String, serde_json::Error> {
    Manifest::from_files(kind, &sha256(configuration), files).to_json()
}

/// Returns the kind of run in a folder; `None` without a manifest that can be read.
#[must_use]
pub fn read_kind(folder: &Path) -> Option<String> {
    Some(Manifest::read(&folder.join(MANIFEST_FILE)).ok()??.kind)
}

/// Returns the name and SHA-256 of every file of a run of this kind, and of `work.json`; empty without a manifest.
#[must_use]
pub fn read_digests(folder: &Path, kind: &str) -> Vec<(String, String)> {
    let manifest = Manifest::read(&folder.join(MANIFEST_FILE))
        .ok()
        .flatten()
        .filter(|manifest| manifest.kind == kind);
    manifest
        .map(|manifest| manifest.digests())
        .unwrap_or_default()
}

/// Returns a hash that is unique to the kind, the configuration and this program ([`RunFolder::identity`]).
pub fn identity(kind: &str, configuration: &str) -> Result<String, DiskError> {
    let program = program::identity()?;
    Ok(Manifest::new(kind, program, &sha256(configuration), &[]).identity(program))
}

/// Message about a file that the manifest does not list.
const UNLISTED_FILE_MESSAGE: &str = "work.json does not list this file: it belongs to another run \
    or to version 0.1.0, or work.json was lost";

/// An open run folder.
#[derive(Debug)]
pub struct RunFolder {
    folder: PathBuf,
    program: &'static str,
    manifest: Mutex<Manifest>,
    /// `None` for a complete run in a folder that cannot be written.
    _lock: Option<FolderLock>,
}

/// An error of opening or changing a run folder.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunFolderError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// The folder contains a run, and `resume` is false.
    #[error("{} already holds a {kind}: use --resume or another --out", folder.display())]
    AlreadyExists {
        /// Path of the folder.
        folder: PathBuf,
        /// Kind of the existing run.
        kind: String,
    },
    /// Another process uses the folder.
    #[error("{}: another process is working on the {kind} there", folder.display())]
    InUse {
        /// Path of the folder.
        folder: PathBuf,
        /// Requested kind.
        kind: String,
    },
    /// The folder contains a run of another kind.
    #[error("{}: the folder holds a {found}, not a {kind}", path.display())]
    OtherKind {
        /// Path of the manifest.
        path: PathBuf,
        /// Kind of the existing run.
        found: String,
        /// Requested kind.
        kind: String,
    },
    /// The run has another configuration.
    #[error("{}: the {kind} there has a different configuration: {difference}", path.display())]
    OtherConfiguration {
        /// Path of the configuration file.
        path: PathBuf,
        /// Kind of the existing run.
        kind: String,
        /// First line that differs, there and as requested.
        difference: String,
    },
    /// Another build of crumple left the run incomplete.
    #[error("{}: {OTHER_BUILD_MESSAGE}", path.display())]
    OtherBuild {
        /// Path of the manifest.
        path: PathBuf,
    },
    /// The folder has no finished run.
    #[error("{}: {problem}", folder.display())]
    NotFinished {
        /// Path of the folder.
        folder: PathBuf,
        /// State of the folder, as a clause.
        problem: String,
    },
    /// A controller has no identity, so earlier results cannot be attributed to it.
    #[error(
        "the controller `{controller}` states no identity, so its {kind} cannot be resumed; start again without \
         --resume, with another --out"
    )]
    NoIdentity {
        /// Name of the controller.
        controller: String,
        /// Kind of the run.
        kind: String,
    },
    /// A file cannot be encoded.
    #[error("{file}: cannot be encoded: {problem}")]
    Encoding {
        /// Name of the file.
        file: &'static str,
        /// Problem of the encoder.
        problem: String,
    },
    /// A file is not as it was written.
    #[error("{}: {problem}", path.display())]
    Damaged {
        /// Path of the file.
        path: PathBuf,
        /// Problem with the file.
        problem: String,
    },
}

impl RunFolderError {
    /// Returns the error about a missing file.
    #[must_use]
    pub fn missing(path: &Path) -> Self {
        Self::damaged(path, "the file is missing")
    }

    /// Returns the error about a file that cannot be encoded.
    pub fn encoding(file: &'static str, problem: impl std::fmt::Display) -> Self {
        Self::Encoding {
            file,
            problem: problem.to_string(),
        }
    }

    /// Names the first line in which the texts of `compared` differ, if this is the error about another configuration.
    /// `compared` receives the configuration file of the existing run.
    #[must_use]
    pub(crate) fn with_difference(
        self,
        compared: impl FnOnce(&str) -> Option<[String; 2]>,
    ) -> Self {
        let Self::OtherConfiguration {
            path,
            kind,
            difference,
        } = self
        else {
            return self;
        };
        let texts = text_file::read(&path).ok().and_then(|text| compared(&text));
        Self::OtherConfiguration {
            path,
            kind,
            difference: texts.map_or(difference, |[there, now]| describe_difference(&there, &now)),
        }
    }

    /// Returns the error about a file whose content is not what its writer wrote.
    pub fn damaged(path: &Path, problem: impl Into<String>) -> Self {
        Self::Damaged {
            path: path.to_owned(),
            problem: problem.into(),
        }
    }
}

/// Returns indented JSON for a file.
///
/// # Errors
/// [`RunFolderError::Encoding`] in principle, if the encoder fails.
pub fn encode_json(file: &'static str, value: &impl Serialize) -> Result<String, RunFolderError> {
    match serde_json::to_string_pretty(value) {
        Ok(text) => Ok(text + "\n"),
        Err(error) => Err(RunFolderError::encoding(file, error)),
    }
}

/// Options of [`RunFolder::open`].
#[derive(Debug, Clone, Copy)]
pub struct RunFolderOptions<'a> {
    /// Kind of the run, as a noun for readers.
    pub kind: &'a str,
    /// Everything that decides the results.
    pub configuration: &'a str,
    /// Name of the file with the configuration.
    pub configuration_file: &'a str,
    /// True to resume an existing run.
    pub resume: bool,
    /// Names of the results, folders with a slash at the end. No files may be at these paths when a new run starts.
    pub outputs: &'a [&'a str],
}

impl RunFolderOptions<'_> {
    /// Locks a folder. A complete run can be read without a lock, where the folder cannot be written.
    fn lock(&self, folder: &Path) -> Result<Option<FolderLock>, RunFolderError> {
        let error = match FolderLock::try_acquire(folder) {
            Ok(Some(lock)) => return Ok(Some(lock)),
            Ok(None) => RunFolderError::InUse {
                folder: folder.to_owned(),
                kind: self.kind.to_owned(),
            },
            Err(error) if self.resume && error.is_read_only() => {
                let manifest = Manifest::read(&folder.join(MANIFEST_FILE))?;
                if manifest.is_some_and(|manifest| manifest.program.is_none()) {
                    return Ok(None);
                }
                error.into()
            }
            Err(error) => error.into(),
        };
        Err(error)
    }

    /// Checks that an existing run may be resumed or read.
    fn check_existing(
        &self,
        existing: &Manifest,
        folder: &Path,
        program: &str,
    ) -> Result<(), RunFolderError> {
        let path = folder.join(MANIFEST_FILE);
        let kind = self.kind.to_owned();
        if existing.kind != self.kind {
            return Err(RunFolderError::OtherKind {
                path,
                found: existing.kind.clone(),
                kind,
            });
        }
        if !self.resume {
            return Err(RunFolderError::AlreadyExists {
                folder: folder.to_owned(),
                kind,
            });
        }
        // Any build may read a complete run.
        if existing
            .program
            .as_deref()
            .is_some_and(|existing| existing != program)
        {
            return Err(RunFolderError::OtherBuild { path });
        }
        if existing.configuration_sha256 == sha256(self.configuration) {
            return Ok(());
        }
        let name = self.configuration_file;
        let contents = existing.read_contents(folder, name).ok();
        let checked = contents.filter(|bytes| existing.check(name, bytes.as_deref()).is_ok());
        let Some(bytes) = checked else {
            let problem =
                "in the same folder does not match it: one of them belongs to another run";
            return Err(RunFolderError::damaged(
                &path,
                format!("the `{name}` {problem}"),
            ));
        };
        Err(RunFolderError::OtherConfiguration {
            path: folder.join(name),
            kind,
            difference: describe_difference(
                &String::from_utf8_lossy(&bytes.unwrap_or_default()),
                self.configuration,
            ),
        })
    }
}

/// Describes the first line in which two texts differ.
fn describe_difference(existing: &str, requested: &str) -> String {
    let equal = existing.lines().zip(requested.lines());
    let equal = equal.take_while(|(there, now)| there == now).count();
    let [there, now] = [existing, requested].map(|text| match text.lines().nth(equal) {
        Some(line) => format!("`{}`", line.trim()),
        None => "missing".to_owned(),
    });
    format!("line {} is {there} there, and {now} now", equal + 1)
}

impl RunFolder {
    /// Creates a run folder, or resumes the run that it contains after a check of every file.
    ///
    /// # Errors
    /// [`RunFolderError`] if the folder cannot be used, is in use, contains another run, or anything in it is damaged.
    pub fn open(folder: &Path, options: RunFolderOptions<'_>) -> Result<Self, RunFolderError> {
        disk::make_folder(folder)?;
        let lock = options.lock(folder)?;
        let program = program::identity()?;
        let manifest = match Manifest::read(&folder.join(MANIFEST_FILE))? {
            // The first change writes the manifest, so that a run that cannot start leaves no file.
            None => Manifest::new(
                options.kind,
                program,
                &sha256(options.configuration),
                options.outputs,
            ),
            Some(existing) => {
                options.check_existing(&existing, folder, program)?;
                existing
            }
        };
        let work = Self {
            folder: folder.to_owned(),
            program,
            manifest: Mutex::new(manifest),
            _lock: lock,
        };
        work.recover()?;
        Ok(work)
    }

    /// Returns the path of a file.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Returns true if the run is complete.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.lock_manifest().program.is_none()
    }

    /// Returns a hash of the kind, the program and the configuration. Journals and other append-only files contain it,
    /// so that a file of another run is recognised.
    #[must_use]
    pub fn identity(&self) -> String {
        self.lock_manifest().identity(self.program)
    }

    /// Reads a file; returns `None` if there is no such file.
    ///
    /// # Errors
    /// [`RunFolderError::Damaged`] if the file is not as it was written.
    pub fn read(&self, name: &str) -> Result<Option<Vec<u8>>, RunFolderError> {
        let manifest = self.lock_manifest();
        let bytes = manifest.read_contents(&self.folder, name)?;
        match manifest.check(name, bytes.as_deref()) {
            Ok(()) => Ok(bytes),
            Err(problem) => Err(RunFolderError::damaged(&self.path(name), problem)),
        }
    }

    /// Reads a file that the run has written.
    ///
    /// # Errors
    /// [`RunFolderError::Damaged`] if the file is missing, or is not as it was written.
    pub fn read_required(&self, name: &str) -> Result<Vec<u8>, RunFolderError> {
        self.read(name)?
            .ok_or_else(|| RunFolderError::missing(&self.path(name)))
    }

    /// Reads a file as JSON; returns `None` if there is no such file.
    ///
    /// # Errors
    /// [`RunFolderError::Damaged`] if the file is not as it was written, or a run of this kind writes no such JSON.
    pub fn read_json<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, RunFolderError> {
        self.read(name)?
            .map(|bytes| self.parse_json(name, &bytes))
            .transpose()
    }

    /// Reads a file that the run has written, as JSON.
    ///
    /// # Errors
    /// [`RunFolderError::Damaged`] if the file is missing, is not as it was written, or has another form.
    pub fn read_required_json<T: DeserializeOwned>(&self, name: &str) -> Result<T, RunFolderError> {
        self.parse_json(name, &self.read_required(name)?)
    }

    /// Parses JSON from a file.
    ///
    /// # Errors
    /// [`RunFolderError::Damaged`] names the file if a run of this kind writes no such JSON.
    pub fn parse_json<T: DeserializeOwned>(
        &self,
        name: &str,
        json: &[u8],
    ) -> Result<T, RunFolderError> {
        serde_json::from_slice(json).map_err(|error| {
            let kind = &self.lock_manifest().kind;
            let problem = format!("differs from what a {kind} writes: {error}");
            RunFolderError::damaged(&self.path(name), problem)
        })
    }

    /// Writes a file as indented JSON.
    ///
    /// # Errors
    /// [`RunFolderError`] if an unlisted file is at its path, or it cannot be written.
    pub fn write_json(
        &self,
        name: &'static str,
        value: &impl Serialize,
    ) -> Result<(), RunFolderError> {
        self.write(name, encode_json(name, value)?)
    }

    /// Creates a transaction: changes that are announced and applied together.
    pub fn transaction(&self) -> FolderTransaction<'_> {
        FolderTransaction::new(self)
    }

    /// Writes a file ([`FolderTransaction::write`]).
    ///
    /// # Errors
    /// [`RunFolderError`] if an unlisted file is at its path, or it cannot be written.
    pub fn write(&self, name: &str, contents: impl Into<Vec<u8>>) -> Result<(), RunFolderError> {
        self.transaction().write(name, contents).commit()
    }

    /// Includes the completed run in a subfolder, such as `rounds/01/search`: its files are checked from now on.
    ///
    /// # Errors
    /// [`RunFolderError`] if there is no such run, its manifest cannot be read, or the manifest of this folder cannot
    /// be written.
    pub fn include(&self, folder: &str) -> Result<(), RunFolderError> {
        let name = format!("{folder}/{MANIFEST_FILE}");
        let path = self.path(&name);
        let bytes = state::read_regular_file(&path, manifest::MAX_BYTES)?
            .ok_or_else(|| RunFolderError::missing(&path))?;
        let mut manifest = self.lock_manifest();
        manifest.set_state(&name, FileState::from_contents(&bytes));
        Ok(manifest.write(&self.folder)?)
    }

    /// Records the synced prefix of an append-only file ([`FolderTransaction::append_only`]). From now on the file must
    /// begin with these bytes.
    ///
    /// # Errors
    /// [`RunFolderError::Disk`] if the manifest cannot be written.
    pub fn record_prefix(&self, name: &str, prefix: Prefix) -> Result<(), RunFolderError> {
        let mut manifest = self.lock_manifest();
        manifest.set_state(name, FileState::Growing(prefix));
        Ok(manifest.write(&self.folder)?)
    }

    /// Refuses to overwrite a file that the manifest does not list, or to write into a folder that contains such files.
    fn check_unoccupied(&self, manifest: &Manifest, name: &str) -> Result<(), RunFolderError> {
        let path = self.path(name);
        if manifest.has_entry(name) {
            return Ok(());
        }
        if path.symlink_metadata().is_ok() {
            return Err(RunFolderError::damaged(&path, UNLISTED_FILE_MESSAGE));
        }
        let folder = name.rsplit_once('/').map(|(folder, _)| folder);
        let Some(folder) = folder.filter(|folder| !manifest.folders().contains(folder)) else {
            return Ok(());
        };
        match sorted_entries(&self.path(folder))?
            .iter()
            .find(|path| !path.is_dir())
        {
            Some(left_over) => Err(RunFolderError::damaged(left_over, UNLISTED_FILE_MESSAGE)),
            None => Ok(()),
        }
    }

    /// Recovers from a crash: completes the last announced change, then verifies every file.
    fn recover(&self) -> Result<(), RunFolderError> {
        let mut manifest = self.lock_manifest();
        if manifest.recover_pending(&self.folder)? && manifest.program.is_none() {
            manifest.write(&self.folder)?;
        }
        for folder in [""].into_iter().chain(manifest.folders()) {
            if !manifest.includes_folder(folder) {
                disk::remove_all_unfinished(&self.path(folder))?;
            }
        }
        if let Some(unlisted_file) = manifest.unlisted_files(&self.folder)?.first() {
            return Err(RunFolderError::damaged(
                unlisted_file,
                UNLISTED_FILE_MESSAGE,
            ));
        }
        manifest
            .file_names()
            .iter()
            .try_for_each(|name| manifest.check_file(&self.folder, name))?;
        for folder in manifest.included_folders() {
            let folder = self.path(&folder);
            examine(&folder)?
                .into_included()
                .first_damage(&folder)
                .map_or(Ok(()), Err)?;
        }
        Ok(())
    }

    fn lock_manifest(&self) -> std::sync::MutexGuard<'_, Manifest> {
        // A panic under this lock cannot leave a partial change, so poisoning is ignored.
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests;
