//! Looking at work without changing it.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::lock::FolderLock;
use super::manifest::Manifest;
use super::{MANIFEST_FILE, RunFolderError, UNLISTED_FILE_MESSAGE};
use crate::program;

/// What is found in a folder of work that is only looked at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FolderExamination {
    /// What kind of work it is.
    pub kind: String,
    /// Whether it was finished.
    pub is_complete: bool,
    /// Whether this build may go on with it, or read it.
    pub is_of_this_build: bool,
    /// Each file, and what is wrong with it.
    pub files: Vec<(String, Result<(), String>)>,
    /// What lies where nothing but the work may be.
    pub unlisted_files: Vec<String>,
    /// [`super::Work::identity`] of what is half done.
    pub identity: Option<String>,
    /// What lies in the folder beside the work.
    pub unrelated_files: Vec<String>,
}

impl FolderExamination {
    /// Whether everything is as it was written, and nothing is in its way.
    #[must_use]
    pub fn is_intact(&self) -> bool {
        self.unlisted_files.is_empty() && self.files.iter().all(|(_, state)| state.is_ok())
    }

    /// Of work within other work: nobody else has anything to do in there.
    pub(super) fn into_included(mut self) -> Self {
        self.unlisted_files.append(&mut self.unrelated_files);
        self
    }

    /// The first file that is not as it was written, as an error.
    pub(super) fn first_damage(&self, folder: &Path) -> Option<RunFolderError> {
        let problem = |(name, found): &(String, Result<(), String>)| {
            let problem = found.as_ref().err()?;
            Some(RunFolderError::damaged(&folder.join(name), problem))
        };
        let stranger =
            || Some(RunFolderError::damaged(&folder.join(self.unlisted_files.first()?), UNLISTED_FILE_MESSAGE));
        self.files.iter().find_map(problem).or_else(stranger)
    }
}

/// Looks at everything in a folder of work and in those it includes, changes nothing, and goes on where something is damaged.
///
/// # Errors
/// [`WorkError`] if there is no manifest, or one that is damaged itself, or if the folder is in use.
pub fn examine(folder: &Path) -> Result<FolderExamination, RunFolderError> {
    let path = folder.join(MANIFEST_FILE);
    let manifest = Manifest::read(&path)?.ok_or_else(|| RunFolderError::missing(&path))?;
    // What cannot be written cannot be at work.
    let is_free = match FolderLock::try_acquire(folder) {
        Err(error) if matches!(error.source.kind(), ErrorKind::ReadOnlyFilesystem | ErrorKind::PermissionDenied) => {
            true
        }
        lock => lock?.is_some(),
    };
    if !is_free {
        return Err(RunFolderError::InUse { folder: folder.to_owned(), kind: manifest.kind });
    }
    let state = |name: String| -> Result<_, RunFolderError> {
        match manifest.check_file(folder, &name) {
            Ok(()) => Ok((name, Ok(()))),
            Err(RunFolderError::Damaged { problem, .. }) => Ok((name, Err(problem))),
            Err(other) => Err(other),
        }
    };
    let names = manifest.file_names();
    let mut files = names.into_iter().map(state).collect::<Result<Vec<_>, _>>()?;
    let name = |path: PathBuf| path.strip_prefix(folder).unwrap_or(&path).to_string_lossy().into_owned();
    let mut strangers: Vec<String> = manifest.unlisted_files(folder)?.into_iter().map(name).collect();
    for included in manifest.included_folders() {
        let found = match examine(&folder.join(&included)) {
            Err(RunFolderError::Damaged { .. }) => continue, // Its manifest is one of the files above.
            found => found?.into_included(),
        };
        files.extend(found.files.into_iter().map(|(name, state)| (format!("{included}/{name}"), state)));
        strangers.extend(found.unlisted_files.into_iter().map(|name| format!("{included}/{name}")));
    }
    let is_of_this_build = match &manifest.program {
        Some(program) => program == program::identity()?,
        None => true,
    };
    let identity = manifest.program.as_deref().map(|program| manifest.identity(program));
    let (kind, complete) = (manifest.kind.clone(), manifest.program.is_none());
    let beside = manifest.unrelated_files(folder)?;
    Ok(FolderExamination {
        kind,
        is_complete: complete,
        is_of_this_build,
        files,
        unlisted_files: strangers,
        identity,
        unrelated_files: beside,
    })
}
