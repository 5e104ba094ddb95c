//! Changes of a run folder that are announced together, then applied together.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;

use rayon::prelude::*;
use serde::Serialize;

use super::manifest::Manifest;
use super::state::{FileState, Prefix};
use super::{RunFolder, RunFolderError, encode_json};
use crate::disk::{self, DiskError, none_if_missing};

/// A set of changes that are not yet applied.
#[must_use = "nothing is changed before `commit`"]
pub struct FolderTransaction<'a> {
    run_folder: &'a RunFolder,
    changes: Vec<(String, FileChange)>,
}

enum FileChange {
    Write(Vec<u8>),
    Remove,
    /// Allows an append-only file ([`RunFolder::record_prefix`]).
    AppendOnly,
}

impl<'a> FolderTransaction<'a> {
    pub(super) fn new(work: &'a RunFolder) -> Self {
        Self {
            run_folder: work,
            changes: Vec::new(),
        }
    }

    /// Writes a file atomically. Leaves a file with the same contents alone.
    pub fn write(&mut self, name: &str, contents: impl Into<Vec<u8>>) -> &mut Self {
        self.changes
            .push((name.to_owned(), FileChange::Write(contents.into())));
        self
    }

    /// Writes a file as indented JSON ([`Self::write`]).
    ///
    /// # Errors
    /// [`RunFolderError::Encoding`] in principle, if the encoder fails.
    pub fn write_json(
        &mut self,
        name: &'static str,
        value: &impl Serialize,
    ) -> Result<&mut Self, RunFolderError> {
        let text = encode_json(name, value)?;
        Ok(self.write(name, text))
    }

    /// Removes a file, if it exists.
    pub fn remove(&mut self, name: &str) -> &mut Self {
        self.changes.push((name.to_owned(), FileChange::Remove));
        self
    }

    /// Allows an append-only file with its own checksums; [`RunFolder::record_prefix`] records its prefix.
    pub fn append_only(&mut self, name: &str) -> &mut Self {
        self.changes.push((name.to_owned(), FileChange::AppendOnly));
        self
    }

    /// Writes all contents to disk, announces the changes together, and applies them. If the process ends before the
    /// announcement, the folder is unchanged. After it, the next process that opens the folder completes the changes.
    ///
    /// # Errors
    /// [`RunFolderError`] if an unlisted file is at a path, or a file cannot be written.
    pub fn commit(&mut self) -> Result<(), RunFolderError> {
        let mut manifest = self.run_folder.lock_manifest();
        self.stage_and_apply(&mut manifest, StateAfterChange::InProgress)
    }

    /// Commits the changes, and marks the run as complete in the same announcement.
    ///
    /// # Errors
    /// [`RunFolderError`] as for [`Self::commit`].
    pub fn finish(&mut self) -> Result<(), RunFolderError> {
        let mut manifest = self.run_folder.lock_manifest();
        self.stage_and_apply(&mut manifest, StateAfterChange::Complete)?;
        // A complete manifest has no pending changes, so that all interruptions end with the same bytes.
        Ok(manifest.write(&self.run_folder.folder)?)
    }

    fn stage_and_apply(
        &mut self,
        manifest: &mut Manifest,
        state: StateAfterChange,
    ) -> Result<(), RunFolderError> {
        let folder = &self.run_folder.folder;
        // Apply the changes that an earlier attempt announced.
        manifest.recover_pending(folder)?;
        self.changes
            .iter()
            .try_for_each(|(name, _)| self.run_folder.check_unoccupied(manifest, name))?;
        let (mut next, staged) = self.stage(manifest)?;
        if next == *manifest && state == StateAfterChange::InProgress {
            return Ok(());
        }
        // In parallel, because each call waits for the disk. Names are synced before the manifest that lists them.
        staged
            .into_par_iter()
            .try_for_each(|(file, path)| file.sync_all().map_err(DiskError::at(&path)))?;
        disk::sync_folder(folder)?;
        next.program = match state {
            StateAfterChange::InProgress => Some(self.run_folder.program.to_owned()),
            StateAfterChange::Complete => None,
        };
        next.write(folder)?;
        *manifest = next;
        Ok(manifest.apply_pending(folder)?)
    }

    /// Writes new contents under temporary names. Returns the manifest that announces all changes.
    fn stage(&mut self, manifest: &Manifest) -> Result<(Manifest, Vec<StagedFile>), DiskError> {
        let mut next = manifest.clone();
        let mut staged = Vec::new();
        let mut unfinished = manifest.unfinished_names();
        for (name, change) in std::mem::take(&mut self.changes) {
            match change {
                FileChange::Remove => next.add_pending_removal(&name),
                // Keep a prefix that is already recorded.
                FileChange::AppendOnly if next.prefix(&name).is_some() => {}
                FileChange::AppendOnly => {
                    next.set_state(&name, FileState::Growing(Prefix::empty()));
                }
                FileChange::Write(contents) => {
                    let state = FileState::from_contents(&contents);
                    if next.whole_file_state(&name) != Some(&state)
                        && let Some(unfinished) = unfinished.next()
                    {
                        let file = stage_file(self.run_folder.path(&unfinished), &contents);
                        let path = self.run_folder.path(&name);
                        staged.push(file.map_err(DiskError::at(&path))?);
                        next.add_pending_move(&name, unfinished, state);
                    }
                }
            }
        }
        Ok((next, staged))
    }
}

/// A written file that is not yet synced, and its path.
type StagedFile = (File, PathBuf);

/// State of the run after a change.
#[derive(Clone, Copy, PartialEq)]
enum StateAfterChange {
    InProgress,
    Complete,
}

/// Writes the contents of a file under a temporary name, without a sync.
fn stage_file(path: PathBuf, contents: &[u8]) -> io::Result<StagedFile> {
    none_if_missing(fs::remove_file(&path))?;
    let mut file = File::create_new(&path)?;
    file.write_all(contents)?;
    Ok((file, path))
}
