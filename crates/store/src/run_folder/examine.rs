//! Read-only examination of a run folder.

use std::path::Path;

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
        let damaged_file = self.files.iter().find_map(|(name, state)| {
            let problem = state.as_ref().err()?;
            Some(RunFolderError::damaged(&folder.join(name), problem))
        });
        damaged_file.or_else(|| {
            let path = folder.join(self.unlisted_files.first()?);
            Some(RunFolderError::damaged(&path, UNLISTED_FILE_MESSAGE))
        })
    }

    /// Adds the files of an included folder under its name.
    fn add_included(&mut self, folder: &str, included: Self) {
        let files = included.files.into_iter();
        self.files
            .extend(files.map(|(name, state)| (format!("{folder}/{name}"), state)));
        let unlisted_files = included.unlisted_files.into_iter();
        self.unlisted_files
            .extend(unlisted_files.map(|name| format!("{folder}/{name}")));
    }
}

/// Examines every file of a run folder and of its included folders. Changes nothing, and continues after damage.
///
/// # Errors
/// [`RunFolderError`] if there is no manifest, if it is damaged, or if the folder is in use.
pub fn examine(folder: &Path) -> Result<FolderExamination, RunFolderError> {
    let path = folder.join(MANIFEST_FILE);
    let manifest = Manifest::read(&path)?.ok_or_else(|| RunFolderError::missing(&path))?;
    check_unused(folder, &manifest)?;
    let mut files = Vec::new();
    for name in manifest.file_names() {
        let state = match manifest.check_file(folder, &name) {
            Ok(()) => Ok(()),
            Err(RunFolderError::Damaged { problem, .. }) => Err(problem),
            Err(error) => return Err(error),
        };
        files.push((name, state));
    }
    let unlisted_files = manifest.unlisted_files(folder)?.into_iter().map(|path| {
        let name = path.strip_prefix(folder).unwrap_or(&path);
        name.to_string_lossy().into_owned()
    });
    let mut examination = FolderExamination {
        is_complete: manifest.program.is_none(),
        is_of_this_build: match &manifest.program {
            Some(program) => program == program::identity()?,
            None => true,
        },
        files,
        unlisted_files: unlisted_files.collect(),
        identity: manifest
            .program
            .as_deref()
            .map(|program| manifest.identity(program)),
        unrelated_files: manifest.unrelated_files(folder)?,
        kind: manifest.kind.clone(),
    };
    for name in manifest.included_folders() {
        match examine(&folder.join(&name)) {
            Err(RunFolderError::Damaged { .. }) => {} // Its manifest is one of the files above.
            included => examination.add_included(&name, included?.into_included()),
        }
    }
    Ok(examination)
}

/// Checks that no run is in progress in a folder.
fn check_unused(folder: &Path, manifest: &Manifest) -> Result<(), RunFolderError> {
    match FolderLock::try_acquire(folder) {
        Ok(None) => {
            return Err(RunFolderError::InUse {
                folder: folder.to_owned(),
                kind: manifest.kind.clone(),
            });
        }
        // No process can run in a folder that is not writable.
        Err(error) if error.is_read_only() => {}
        lock => drop(lock?),
    }
    Ok(())
}
