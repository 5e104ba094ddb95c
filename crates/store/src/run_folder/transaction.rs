//! Changes to a folder of work: announced together, then made together.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;

use rayon::prelude::*;

use super::state::{FileState, Prefix};
use super::{RunFolder, RunFolderError};
use crate::disk::{self, DiskError};

/// Changes that are not yet made.
#[must_use = "nothing is changed before `commit`"]
pub struct FolderTransaction<'a> {
    run_folder: &'a RunFolder,
    changes: Vec<(String, FileChange)>,
}

enum FileChange {
    Write(Vec<u8>),
    Remove,
    /// It may be there from now on ([`Work::grew`]).
    AppendOnly,
}

impl<'a> FolderTransaction<'a> {
    pub(super) fn new(work: &'a RunFolder) -> Self {
        Self { run_folder: work, changes: Vec::new() }
    }

    /// A file, whole or not at all. What is there with the same contents is left alone.
    pub fn write(&mut self, name: &str, contents: impl Into<Vec<u8>>) -> &mut Self {
        self.changes.push((name.to_owned(), FileChange::Write(contents.into())));
        self
    }

    /// A file goes, if it is there.
    pub fn remove(&mut self, name: &str) -> &mut Self {
        self.changes.push((name.to_owned(), FileChange::Remove));
        self
    }

    /// A file may be there from now on that grows, and whose records have checks of their own: the manifest knows of it what
    /// [`Work::grew`] says.
    pub fn append_only(&mut self, name: &str) -> &mut Self {
        self.changes.push((name.to_owned(), FileChange::AppendOnly));
        self
    }

    /// Brings all that the changes need to the disk, announces them together, and makes them. Whatever ends the process before the
    /// announcement leaves the folder as it was; after it, whoever opens the folder next makes what is left of them.
    ///
    /// # Errors
    /// [`WorkError`] if a file is in the way of which nothing is known, or one cannot be written.
    pub fn commit(&mut self) -> Result<(), RunFolderError> {
        let work = self.run_folder;
        let mut manifest = work.lock_manifest();
        // What an earlier attempt announced and could not make.
        manifest.recover_pending(&work.folder)?;
        self.changes.iter().try_for_each(|(name, _)| work.check_unoccupied(&manifest, name))?;
        let changes = std::mem::take(&mut self.changes);
        let (mut next, mut staged) = (manifest.clone(), Vec::new());
        let mut unfinished = manifest.unfinished_names();
        for (name, change) in changes {
            let (state, contents) = match change {
                FileChange::Write(contents) => (FileState::from_contents(&contents), contents),
                FileChange::Remove => {
                    next.add_pending_removal(&name);
                    continue;
                }
                // What is known of it already stays known.
                FileChange::AppendOnly => {
                    if !next.is_append_only(&name) {
                        next.set_state(&name, FileState::AppendOnly(Prefix::empty()));
                    }
                    continue;
                }
            };
            if next.whole_file_state(&name) != Some(&state)
                && let Some(unfinished) = unfinished.next()
            {
                let place = work.path(&unfinished);
                staged.push(stage(place, &contents).map_err(|source| DiskError::at(&work.path(&name))(source))?);
                next.add_pending_move(&name, unfinished, state);
            }
        }
        if next == *manifest {
            return Ok(());
        }
        // All at once, for each waits for the disk. The names before the announcement that speaks of them.
        staged.into_par_iter().try_for_each(|(file, path)| file.sync_all().map_err(DiskError::at(&path)))?;
        disk::sync_folder(&work.folder)?;
        next.program = Some(work.program.to_owned());
        next.write(&work.folder)?;
        *manifest = next;
        Ok(manifest.apply_pending(&work.folder)?)
    }
}

/// Writes the contents of a file beside its place. The file has not yet reached the disk.
fn stage(place: PathBuf, contents: &[u8]) -> io::Result<(File, PathBuf)> {
    match fs::remove_file(&place) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut file = File::create_new(&place)?;
    file.write_all(contents)?;
    Ok((file, place))
}
