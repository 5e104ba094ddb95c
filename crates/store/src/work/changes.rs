//! Changes to a folder of work: announced together, then made together.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;

use rayon::prelude::*;

use super::state::{FileState, Prefix};
use super::{Work, WorkError};
use crate::disk::{self, DiskError};

/// Changes that are not yet made.
#[must_use = "nothing is changed before `commit`"]
pub struct Changes<'a> {
    work: &'a Work,
    changes: Vec<(String, Change)>,
}

enum Change {
    Write(Vec<u8>),
    Remove,
    /// It may be there from now on ([`Work::grew`]).
    Grow,
}

impl<'a> Changes<'a> {
    pub(super) fn of(work: &'a Work) -> Self {
        Self { work, changes: Vec::new() }
    }

    /// A file, whole or not at all. What is there with the same contents is left alone.
    pub fn write(&mut self, name: &str, contents: impl Into<Vec<u8>>) -> &mut Self {
        self.changes.push((name.to_owned(), Change::Write(contents.into())));
        self
    }

    /// A file goes, if it is there.
    pub fn remove(&mut self, name: &str) -> &mut Self {
        self.changes.push((name.to_owned(), Change::Remove));
        self
    }

    /// A file may be there from now on that grows, and whose records have checks of their own: the manifest knows of it what
    /// [`Work::grew`] says.
    pub fn grow(&mut self, name: &str) -> &mut Self {
        self.changes.push((name.to_owned(), Change::Grow));
        self
    }

    /// Brings all that the changes need to the disk, announces them together, and makes them. Whatever ends the process before the
    /// announcement leaves the folder as it was; after it, whoever opens the folder next makes what is left of them.
    ///
    /// # Errors
    /// [`WorkError`] if a file is in the way of which nothing is known, or one cannot be written.
    pub fn commit(&mut self) -> Result<(), WorkError> {
        let work = self.work;
        let mut manifest = work.locked();
        // What an earlier attempt announced and could not make.
        manifest.complete(&work.folder)?;
        self.changes.iter().try_for_each(|(name, _)| work.is_free(&manifest, name))?;
        let changes = std::mem::take(&mut self.changes);
        let (mut next, mut staged) = (manifest.clone(), Vec::new());
        let mut unfinished = manifest.unfinished_names();
        for (name, change) in changes {
            let (state, contents) = match change {
                Change::Write(contents) => (FileState::of(&contents), contents),
                Change::Remove => {
                    next.remove(&name);
                    continue;
                }
                // What is known of it already stays known.
                Change::Grow => {
                    if !next.grows(&name) {
                        next.include(&name, FileState::Growing(Prefix::nothing()));
                    }
                    continue;
                }
            };
            if next.state(&name) != Some(&state)
                && let Some(unfinished) = unfinished.next()
            {
                let place = work.path(&unfinished);
                staged.push(stage(place, &contents).map_err(|source| DiskError::at(&work.path(&name))(source))?);
                next.place(&name, unfinished, state);
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
        Ok(manifest.make(&work.folder)?)
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
