//! The manifest of a run folder.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::lock::LOCK_FILE;
use super::pending::{self, PendingChange, is_inside_folder};
use super::state::{FileState, MISSING_FILE_MESSAGE, Prefix, read_regular_file, regular_file_len};
use super::{MANIFEST_FILE, PREVIOUS_FOLDER, RunFolderError, UNLISTED_FILE_MESSAGE};
use crate::disk::{self, DiskError, none_if_missing};
use crumple_core::digest::{Sha256, sha256};
use crumple_core::format_version::check_version;

/// Version of the format.
const VERSION: u32 = 1;

/// Maximum size of a manifest that is read; ten thousand files need less than a tenth of it.
pub(super) const MAX_BYTES: u64 = 64 << 20;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Manifest {
    version: u32,
    /// Kind of the run, as a noun for readers.
    pub(super) kind: String,
    /// [`crate::program::identity`]; `None` once the run is complete, so that all builds write the same bytes.
    pub(super) program: Option<String>,
    pub(super) configuration_sha256: String,
    /// Paths that the run will write, in addition to `files`. Before the run writes them, nothing may exist there.
    /// Folders end in a slash.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    outputs: Vec<String>,
    /// True if other files may lie in its folders.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    shares_folders: bool,
    /// State of each file, once the pending changes are applied.
    files: BTreeMap<String, FileState>,
    /// Changes that were announced and may not have been applied. Everything they need is on disk.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pending: Vec<PendingChange>,
    /// SHA-256 of this file with an empty string here.
    sha256: String,
}

impl Manifest {
    pub(super) fn new(
        kind: &str,
        program: &str,
        configuration_sha256: &str,
        outputs: &[&str],
    ) -> Self {
        Self {
            version: VERSION,
            kind: kind.to_owned(),
            program: Some(program.to_owned()),
            configuration_sha256: configuration_sha256.to_owned(),
            outputs: outputs.iter().map(|name| (*name).to_owned()).collect(),
            shares_folders: false,
            files: BTreeMap::new(),
            pending: Vec::new(),
            sha256: String::new(),
        }
    }

    /// Creates the manifest of a complete run with these files; other files may lie in their folders.
    pub(super) fn from_files<'a>(
        kind: &str,
        configuration_sha256: &str,
        files: impl Iterator<Item = (&'a str, &'a [u8])>,
    ) -> Self {
        let files = files
            .map(|(name, contents)| (name.to_owned(), FileState::from_contents(contents)))
            .collect();
        Self {
            program: None,
            shares_folders: true,
            files,
            ..Self::new(kind, "", configuration_sha256, &[])
        }
    }

    /// Returns a hash that is unique to the kind, the configuration and the program.
    pub(super) fn identity(&self, program: &str) -> String {
        Sha256::default()
            .with(&self.kind)
            .with(&self.configuration_sha256)
            .with(program)
            .hexadecimal()
    }

    /// Reads the manifest in a file; returns `None` if there is no such file.
    pub(super) fn read(path: &Path) -> Result<Option<Self>, RunFolderError> {
        let Some(bytes) = read_regular_file(path, MAX_BYTES)? else {
            return Ok(None);
        };
        let manifest: Self = serde_json::from_slice(&bytes).map_err(|error| {
            RunFolderError::damaged(
                path,
                format!(
                    "line {}, column {}: not as crumple writes it",
                    error.line(),
                    error.column()
                ),
            )
        })?;
        check_version(manifest.version, VERSION).map_err(|unsupported| {
            RunFolderError::damaged(path, format!("version: {unsupported}"))
        })?;
        match manifest.to_json() {
            Ok(text) if text.as_bytes() == bytes && manifest.is_inside_folder() => {
                Ok(Some(manifest))
            }
            _ => Err(RunFolderError::damaged(
                path,
                "sha256: the file has changed since it was written",
            )),
        }
    }

    /// Returns true if all its names are inside its folder.
    fn is_inside_folder(&self) -> bool {
        self.files
            .keys()
            .chain(&self.outputs)
            .all(|name| is_inside_folder(name))
            && self.pending.iter().all(PendingChange::is_inside_folder)
    }

    pub(super) fn write(&self, folder: &Path) -> Result<(), DiskError> {
        let path = folder.join(MANIFEST_FILE);
        let text = self
            .to_json()
            .map_err(|error| DiskError::at(&path)(error.into()))?;
        disk::write(&path, text)
    }

    /// Returns the text of the file, with its digest.
    pub(super) fn to_json(&self) -> Result<String, serde_json::Error> {
        let without_digest = self.to_json_with(String::new())?;
        self.to_json_with(sha256(without_digest))
    }

    fn to_json_with(&self, sha256: String) -> Result<String, serde_json::Error> {
        let text = serde_json::to_string_pretty(&Self {
            sha256,
            ..self.clone()
        })?;
        Ok(text + "\n")
    }

    /// Reads a regular file, or its pending replacement, of at most the recorded size; `None` if it does not exist.
    pub(super) fn read_contents(
        &self,
        folder: &Path,
        name: &str,
    ) -> Result<Option<Vec<u8>>, RunFolderError> {
        let path = folder.join(name);
        let Some(state) = self.files.get(name) else {
            let is_unlisted = !self.has_entry(name) && path.symlink_metadata().is_ok();
            return if is_unlisted {
                Err(RunFolderError::damaged(&path, UNLISTED_FILE_MESSAGE))
            } else {
                Ok(None)
            };
        };
        let contents = read_regular_file(&path, state.max_bytes());
        let Some(unfinished) = self.unfinished_for(name) else {
            return contents;
        };
        if matches_state(&contents, state) {
            return contents;
        }
        let replacement = read_regular_file(&folder.join(unfinished), state.max_bytes());
        match matches_state(&replacement, state) {
            true => replacement,
            false => contents,
        }
    }

    /// Returns the name of the file that will replace a file.
    fn unfinished_for(&self, file: &str) -> Option<&str> {
        self.pending.iter().find_map(|pending| match pending {
            PendingChange::Place { unfinished, name } if name == file => Some(unfinished.as_str()),
            _ => None,
        })
    }

    /// Returns the name and SHA-256 of every file except append-only ones, and of the manifest.
    pub(super) fn digests(&self) -> Vec<(String, String)> {
        let own = self
            .to_json()
            .map(|text| (MANIFEST_FILE.to_owned(), sha256(text)));
        let files = self.files.iter().filter_map(|(name, state)| match state {
            FileState::Whole { sha256, .. } => Some((name.clone(), sha256.clone())),
            FileState::Growing(_) => None,
        });
        files.chain(own).collect()
    }

    pub(super) fn file_names(&self) -> Vec<String> {
        self.files.keys().cloned().collect()
    }

    /// Returns true if a file is listed, or its removal is pending.
    pub(super) fn has_entry(&self, name: &str) -> bool {
        self.files.contains_key(name) || self.pending.iter().any(|pending| pending.name() == name)
    }

    /// Returns the unlisted entries in the subfolders of the run, and files at the paths of outputs that are not yet
    /// written. Other entries of the root folder are [unrelated](Self::unrelated_files).
    pub(super) fn unlisted_files(&self, root: &Path) -> Result<Vec<PathBuf>, DiskError> {
        if self.shares_folders {
            return Ok(Vec::new());
        }
        let (folders, files): (Vec<&str>, Vec<&str>) = self
            .outputs
            .iter()
            .map(String::as_str)
            .partition(|name| name.ends_with('/'));
        let is_unlisted =
            |name: &&str| !self.has_entry(name) && root.join(name).symlink_metadata().is_ok();
        let mut unlisted: Vec<PathBuf> = files
            .into_iter()
            .filter(is_unlisted)
            .map(|name| root.join(name))
            .collect();
        let folders = folders.into_iter().map(|name| name.trim_end_matches('/'));
        for folder in self
            .folders()
            .into_iter()
            .chain(folders)
            .collect::<BTreeSet<_>>()
        {
            let path = root.join(folder);
            if path.is_symlink() {
                unlisted.push(path);
            } else if !self.includes_folder(folder) {
                unlisted.extend(
                    sorted_entries(&path)?
                        .into_iter()
                        .filter(|path| !self.is_expected(root, path)),
                );
            }
        }
        Ok(unlisted)
    }

    /// Returns true if a path in a folder of the run belongs to it. Any subfolder may belong to an incomplete run.
    fn is_expected(&self, root: &Path, path: &Path) -> bool {
        let Ok(name) = path
            .strip_prefix(root)
            .map(|name| name.to_string_lossy().into_owned())
        else {
            return false;
        };
        if path.is_dir() && !path.is_symlink() {
            let mut below = self
                .files
                .keys()
                .filter_map(|file| file.strip_prefix(name.as_str()));
            return self.program.is_some() || below.any(|rest| rest.starts_with('/'));
        }
        self.has_entry(&name)
            || path == root.join(PREVIOUS_FOLDER).join(MANIFEST_FILE)
            || disk::is_unfinished(path)
    }

    /// Returns the entries of the root folder that do not belong to the run.
    pub(super) fn unrelated_files(&self, root: &Path) -> Result<Vec<String>, DiskError> {
        let outputs = self.outputs.iter().map(String::as_str);
        let mut expected: BTreeSet<&str> = self
            .folders()
            .into_iter()
            .chain(outputs)
            .filter_map(|name| name.split('/').next())
            .collect();
        expected.extend([MANIFEST_FILE, LOCK_FILE, PREVIOUS_FOLDER]);
        let entries = fs::read_dir(root).map_err(DiskError::at(root))?.flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let mut unrelated: Vec<String> = names
            .filter(|name| !self.has_entry(name) && !expected.contains(name.as_str()))
            .filter(|name| !disk::is_unfinished(Path::new(name)))
            .collect();
        unrelated.sort_unstable();
        Ok(unrelated)
    }

    pub(super) fn whole_file_state(&self, name: &str) -> Option<&FileState> {
        self.files
            .get(name)
            .filter(|state| matches!(state, FileState::Whole { .. }))
    }

    pub(super) fn set_state(&mut self, name: &str, state: FileState) {
        self.files.insert(name.to_owned(), state);
    }

    pub(super) fn included_folders(&self) -> Vec<String> {
        let names = self.files.keys();
        let folders = names.filter_map(|name| name.strip_suffix(MANIFEST_FILE)?.strip_suffix('/'));
        folders.map(str::to_owned).collect()
    }

    pub(super) fn includes_folder(&self, folder: &str) -> bool {
        self.has_entry(&format!("{folder}/{MANIFEST_FILE}"))
    }

    /// Returns the recorded prefix of an append-only file.
    pub(super) fn prefix(&self, name: &str) -> Option<&Prefix> {
        match self.files.get(name)? {
            FileState::Growing(prefix) => Some(prefix),
            FileState::Whole { .. } => None,
        }
    }

    pub(super) fn folders(&self) -> BTreeSet<&str> {
        self.files
            .keys()
            .filter_map(|name| name.rsplit_once('/'))
            .map(|(folder, _)| folder)
            .collect()
    }

    /// Announces that the file `unfinished` will replace the file `name`, which then has the given state.
    pub(super) fn add_pending_move(&mut self, name: &str, unfinished: String, state: FileState) {
        self.pending.retain(|pending| pending.name() != name);
        self.pending.push(PendingChange::Place {
            unfinished,
            name: name.to_owned(),
        });
        self.set_state(name, state);
    }

    /// Announces the removal of a file, if it exists.
    pub(super) fn add_pending_removal(&mut self, name: &str) {
        let was = self.files.remove(name);
        self.pending.extend(was.map(|was| PendingChange::Remove {
            name: name.to_owned(),
            old_state: was,
        }));
    }

    /// Applies the pending changes of this process.
    pub(super) fn apply_pending(&mut self, folder: &Path) -> Result<(), DiskError> {
        pending::apply(folder, &self.pending.iter().collect::<Vec<_>>())?;
        self.pending.clear();
        Ok(())
    }

    /// Applies the pending changes that another process announced, after a check of everything that they need. Returns
    /// true if there were any.
    pub(super) fn recover_pending(&mut self, folder: &Path) -> Result<bool, RunFolderError> {
        if self.pending.is_empty() {
            return Ok(false);
        }
        let mut open = Vec::new();
        for pending in &self.pending {
            if self.is_unapplied(folder, pending)? {
                open.push(pending);
            } else if let Some(parent) = folder
                .join(pending.name())
                .parent()
                .filter(|parent| parent.is_dir())
            {
                // The change was applied, and may not have reached the disk.
                disk::sync_folder(parent)?;
            }
        }
        pending::apply(folder, &open)?;
        self.pending.clear();
        Ok(true)
    }

    /// Returns true if a change is still to be applied.
    fn is_unapplied(&self, folder: &Path, pending: &PendingChange) -> Result<bool, RunFolderError> {
        let path = folder.join(pending.name());
        match pending {
            PendingChange::Place { unfinished, name } => match self.files.get(name) {
                Some(state)
                    if !state.matches_file(&path)
                        && state.matches_file(&folder.join(unfinished)) =>
                {
                    Ok(true)
                }
                _ => self.check_file(folder, name).map(|()| false),
            },
            PendingChange::Remove { old_state: was, .. } => match path.symlink_metadata() {
                Err(_) => Ok(false),
                Ok(_) if matches!(was, FileState::Growing(_)) || was.matches_file(&path) => {
                    Ok(true)
                }
                Ok(_) => Err(RunFolderError::damaged(
                    &path,
                    "has changed since it was written",
                )),
            },
        }
    }

    pub(super) fn unfinished_names(&self) -> impl Iterator<Item = String> + use<> {
        let used = self.pending.iter().filter_map(|pending| match pending {
            PendingChange::Place { unfinished, .. } => disk::parse_number(unfinished),
            PendingChange::Remove { .. } => None,
        });
        let first = used.max().map_or(0, |last| last.saturating_add(1));
        (first..).map(disk::numbered_name)
    }

    /// Checks the contents of a file against its recorded state.
    pub(super) fn check(&self, name: &str, contents: Option<&[u8]>) -> Result<(), String> {
        match (self.files.get(name), contents) {
            (None, None) | (Some(FileState::Growing(_)), _) => Ok(()),
            (Some(state), Some(contents)) if state.matches_contents(contents) => Ok(()),
            (Some(_), Some(_)) => Err("has changed since it was written".to_owned()),
            (Some(_), None) => Err(MISSING_FILE_MESSAGE.to_owned()),
            (None, Some(_)) => Err(UNLISTED_FILE_MESSAGE.to_owned()),
        }
    }

    /// Checks that a file in the folder is as it was written.
    pub(super) fn check_file(&self, folder: &Path, name: &str) -> Result<(), RunFolderError> {
        let path = folder.join(name);
        let checked = match self.prefix(name) {
            Some(prefix) => {
                regular_file_len(&path)?;
                prefix.check_file(&path)?
            }
            None => self.check(name, self.read_contents(folder, name)?.as_deref()),
        };
        checked.map_err(|problem| RunFolderError::damaged(&path, problem))
    }
}

fn matches_state(contents: &Result<Option<Vec<u8>>, RunFolderError>, state: &FileState) -> bool {
    match contents {
        Ok(Some(bytes)) => state.matches_contents(bytes),
        _ => false,
    }
}

pub(super) fn sorted_entries(folder: &Path) -> Result<Vec<PathBuf>, DiskError> {
    let entries = none_if_missing(fs::read_dir(folder))
        .map_err(DiskError::at(folder))?
        .into_iter()
        .flatten();
    let paths = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<io::Result<Vec<_>>>();
    let mut paths = paths.map_err(DiskError::at(folder))?;
    paths.sort_unstable();
    Ok(paths)
}
