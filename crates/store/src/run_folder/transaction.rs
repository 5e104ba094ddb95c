//! Changes of a run folder that are announced together, then applied together.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;

use rayon::prelude::*;

use super::state::{FileState, Prefix};
use super::{RunFolder, RunFolderError};
use crate::disk::{self, DiskError, none_if_missing};
use crumple_core::digest::sha256;

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
        let work = self.run_folder;
        let mut manifest = work.lock_manifest();
        // Apply the changes that an earlier attempt announced.
        manifest.recover_pending(&work.folder)?;
        self.changes
            .iter()
            .try_for_each(|(name, _)| work.check_unoccupied(&manifest, name))?;
        let changes = std::mem::take(&mut self.changes);
        let (mut next, mut staged) = (manifest.clone(), Vec::new());
        let mut unfinished = manifest.unfinished_names();
        for (name, change) in changes {
            match change {
                FileChange::Remove => next.add_pending_removal(&name),
                // Keep a prefix that is already recorded.
                FileChange::AppendOnly if next.prefix(&name).is_some() => {}
                FileChange::AppendOnly => next.set_state(
                    &name,
                    FileState::AppendOnly(Prefix {
                        bytes: 0,
                        sha256: sha256(""),
                    }),
                ),
                FileChange::Write(contents) => {
                    let state = FileState::from_contents(&contents);
                    if next.whole_file_state(&name) != Some(&state)
                        && let Some(unfinished) = unfinished.next()
                    {
                        let file = stage(work.path(&unfinished), &contents);
                        staged.push(file.map_err(DiskError::at(&work.path(&name)))?);
                        next.add_pending_move(&name, unfinished, state);
                    }
                }
            }
        }
        if next == *manifest {
            return Ok(());
        }
        // In parallel, because each call waits for the disk. Names are synced before the manifest that lists them.
        staged
            .into_par_iter()
            .try_for_each(|(file, path)| file.sync_all().map_err(DiskError::at(&path)))?;
        disk::sync_folder(&work.folder)?;
        next.program = Some(work.program.to_owned());
        next.write(&work.folder)?;
        *manifest = next;
        Ok(manifest.apply_pending(&work.folder)?)
    }
}

/// Writes the contents of a file under a temporary name, without a sync.
fn stage(place: PathBuf, contents: &[u8]) -> io::Result<(File, PathBuf)> {
    none_if_missing(fs::remove_file(&place))?;
    let mut file = File::create_new(&place)?;
    file.write_all(contents)?;
    Ok((file, place))
}
