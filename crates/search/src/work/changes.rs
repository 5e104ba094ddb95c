//! Changes to a folder of work: announced together, then made together.

use super::manifest::{FileState, Prefix};
use super::{Work, WorkError, generation};
use crate::disk::{self, Files};

/// Changes that are not yet made.
#[must_use = "nothing is changed before `commit`"]
pub struct Changes<'a> {
    work: &'a Work,
    changes: Vec<(String, Change)>,
}

enum Change {
    Write(Vec<u8>),
    /// It becomes a second name of what another file is before the changes.
    Keep {
        of: String,
        state: FileState,
    },
    Remove,
    /// It may be there from now on ([`Work::grew`]).
    Grow,
}

impl Change {
    fn state(&self) -> FileState {
        match self {
            Self::Write(contents) => FileState::of(contents),
            Self::Keep { state, .. } => state.clone(),
            Self::Remove => FileState::Absent,
            Self::Grow => FileState::Growing(Prefix::nothing()),
        }
    }
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

    /// A file that nothing but the work itself could make again: what it replaces is kept until the work is finished, and if that is
    /// nothing or the same, it is kept twice.
    pub fn advance(&mut self, name: &str, contents: impl Into<Vec<u8>>) -> &mut Self {
        let (before, contents) = (generation::before(name), contents.into());
        let state = self.work.locked().state(name);
        let kept = match state.filter(|state| *state != FileState::of(&contents)) {
            Some(state) => Change::Keep { of: name.to_owned(), state },
            None => Change::Write(contents.clone()),
        };
        self.changes.push((before, kept));
        self.write(name, contents)
    }

    /// A file goes, if it is there.
    pub fn remove(&mut self, name: &str) -> &mut Self {
        let before = generation::before(name);
        let is_kept = self.work.locked().knows(&before);
        self.changes.extend(is_kept.then_some((before, Change::Remove)));
        self.changes.push((name.to_owned(), Change::Remove));
        self
    }

    /// A file may be there from now on that grows, and whose records have checks of their own: the manifest knows of it what
    /// [`Work::grew`] says.
    pub fn grow(&mut self, name: &str) -> &mut Self {
        self.changes.push((name.to_owned(), Change::Grow));
        self
    }

    /// Announces the changes, makes those that are any, and knows from then on that they were made.
    ///
    /// # Errors
    /// [`WorkError`] if a file is in the way of which nothing is known, or one cannot be written.
    pub fn commit(&mut self) -> Result<(), WorkError> {
        let work = self.work;
        let mut manifest = work.locked();
        self.changes.iter().try_for_each(|(name, _)| work.is_free(&manifest, name))?;
        let mut changes = std::mem::take(&mut self.changes);
        changes.retain(|(name, change)| manifest.announce(name, change.state()));
        if changes.is_empty() {
            return Ok(());
        }
        manifest.program = Some(work.program.to_owned());
        manifest.write(&work.folder)?;
        let (mut files, mut gone) = (Files::default(), Vec::new());
        for (name, change) in &changes {
            let path = work.path(name);
            match change {
                Change::Write(contents) => {
                    path.parent().map_or(Ok(()), disk::make_folder)?;
                    files.stage(&path, contents)?;
                }
                Change::Keep { of, .. } => {
                    path.parent().map_or(Ok(()), disk::make_folder)?;
                    files.stage_second(&work.path(of), &path)?;
                }
                Change::Remove => gone.push(path),
                Change::Grow => {}
            }
        }
        files.commit()?;
        disk::remove(&gone)?;
        changes.iter().for_each(|(name, _)| manifest.made(name));
        // What is done again if it is lost may be as before the change until the next one; what is kept twice may not, for others fit it.
        match changes.iter().any(|(name, _)| generation::is_of_it(name)) {
            true => Ok(manifest.write(&work.folder)?),
            false => Ok(()),
        }
    }
}
