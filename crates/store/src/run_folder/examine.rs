//! Read-only examination of a run folder.

use std::path::{Path, PathBuf};

use super::lock::FolderLock;
use super::manifest::Manifest;
use super::{MANIFEST_FILE, RunFolderError, UNLISTED_FILE_MESSAGE};
use crate::program;

/// Result of the examination of a run folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FolderExamination {
    /// Kind of the run.
    pub kind: String,
    /// True if the run is complete.
    pub is_complete: bool,
    /// True if this build may resume or read the run.
    pub is_of_this_build: bool,
    /// Name of each file, and the problem with it, if any.
    pub files: Vec<(String, Result<(), String>)>,
    /// Paths where only files of the run may be, but that the manifest does not list.
    pub unlisted_files: Vec<String>,
    /// [`super::RunFolder::identity`] of an incomplete run.
    pub identity: Option<String>,
    /// Files and folders beside the run.
    pub unrelated_files: Vec<String>,
}

impl FolderExamination {
    /// Returns true if every file is as it was written, and no unlisted file exists.
    #[must_use]
    pub fn is_intact(&self) -> bool {
        self.unlisted_files.is_empty() && self.files.iter().all(|(_, state)| state.is_ok())
    }

    /// Converts the examination of an included folder, which may contain no unrelated files.
    pub(super) fn into_included(mut self) -> Self {
        self.unlisted_files.append(&mut self.unrelated_files);
        self
    }

    pub(super) fn first_damage(&self, folder: &Path) -> Option<RunFolderError> {
        let problem = |(name, found): &(String, Result<(), String>)| {
            let problem = found.as_ref().err()?;
            Some(RunFolderError::damaged(&folder.join(name), problem))
        };
        let unlisted_file = || {
            Some(RunFolderError::damaged(
                &folder.join(self.unlisted_files.first()?),
                UNLISTED_FILE_MESSAGE,
            ))
        };
        self.files.iter().find_map(problem).or_else(unlisted_file)
    }
}

/// Examines every file of a run folder and of its included folders. Changes nothing, and continues after damage.
///
/// # Errors
/// [`RunFolderError`] if there is no manifest, if it is damaged, or if the folder is in use.
pub fn examine(folder: &Path) -> Result<FolderExamination, RunFolderError> {
    let path = folder.join(MANIFEST_FILE);
    let manifest = Manifest::read(&path)?.ok_or_else(|| RunFolderError::missing(&path))?;
    match FolderLock::try_acquire(folder) {
        Ok(None) => {
            return Err(RunFolderError::InUse {
                folder: folder.to_owned(),
                kind: manifest.kind,
            });
        }
        // No process can run in a folder that is not writable.
        Err(error) if error.is_read_only() => {}
        lock => drop(lock?),
    }
    let state = |name: String| -> Result<_, RunFolderError> {
        match manifest.check_file(folder, &name) {
            Ok(()) => Ok((name, Ok(()))),
            Err(RunFolderError::Damaged { problem, .. }) => Ok((name, Err(problem))),
            Err(other) => Err(other),
        }
    };
    let names = manifest.file_names();
    let mut files = names
        .into_iter()
        .map(state)
        .collect::<Result<Vec<_>, _>>()?;
    let name = |path: PathBuf| {
        path.strip_prefix(folder)
            .unwrap_or(&path)
            .to_string_lossy()
            .into_owned()
    };
    let mut unlisted: Vec<String> = manifest
        .unlisted_files(folder)?
        .into_iter()
        .map(name)
        .collect();
    for included in manifest.included_folders() {
        let found = match examine(&folder.join(&included)) {
            Err(RunFolderError::Damaged { .. }) => continue, // Its manifest is one of the files above.
            found => found?.into_included(),
        };
        files.extend(
            found
                .files
                .into_iter()
                .map(|(name, state)| (format!("{included}/{name}"), state)),
        );
        unlisted.extend(
            found
                .unlisted_files
                .into_iter()
                .map(|name| format!("{included}/{name}")),
        );
    }
    Ok(FolderExamination {
        is_complete: manifest.program.is_none(),
        is_of_this_build: match &manifest.program {
            Some(program) => program == program::identity()?,
            None => true,
        },
        files,
        unlisted_files: unlisted,
        identity: manifest
            .program
            .as_deref()
            .map(|program| manifest.identity(program)),
        unrelated_files: manifest.unrelated_files(folder)?,
        kind: manifest.kind,
    })
}
