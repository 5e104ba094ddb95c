//! Files that appear whole or not at all, through a loss of power too, and errors that name them.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use tempfile::NamedTempFile;

/// A file or folder that cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", path.display())]
pub struct DiskError {
    /// The file or folder.
    pub path: PathBuf,
    /// What the system says.
    pub source: io::Error,
}

impl DiskError {
    /// What the system says of a file or folder.
    pub fn at(path: &Path) -> impl Fn(io::Error) -> Self + Copy + '_ {
        |source| Self { path: path.to_owned(), source }
    }
}

/// How names of files begin that are not yet in their places.
const UNFINISHED: &str = ".crumple-unfinished-";

/// Whether a file was being written when the process that did so ended: it may be removed.
#[must_use]
pub fn is_unfinished(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(UNFINISHED))
}

/// Files to be written together. They are first written beside their places and then moved there, so that a failure
/// leaves nothing half-written.
#[derive(Default)]
pub struct Files {
    staged: Vec<(NamedTempFile, PathBuf)>,
}

impl Files {
    /// Stages a file.
    ///
    /// # Errors
    /// [`DiskError`] if it cannot be written, or if another file is staged for its place: [`io::ErrorKind::AlreadyExists`].
    pub fn stage(&mut self, path: &Path, contents: impl AsRef<[u8]>) -> Result<(), DiskError> {
        if self.staged.iter().any(|(_, staged)| staged == path) {
            let twice = "two results would go there: give scenarios names of their own";
            return Err(DiskError::at(path)(io::Error::new(io::ErrorKind::AlreadyExists, twice)));
        }
        let folder = folder_of(path);
        let stage = || {
            // What cannot be replaced is known before anything is written.
            if path.is_dir() {
                return Err(io::ErrorKind::IsADirectory.into());
            }
            let mut builder = tempfile::Builder::new();
            builder.prefix(UNFINISHED);
            // A temporary file is private; the result should be as readable as any other new file.
            #[cfg(unix)]
            builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o644));
            let mut file = builder.tempfile_in(folder)?;
            file.write_all(contents.as_ref())?;
            // Else a loss of power could leave the new name with nothing behind it.
            file.as_file().sync_all()?;
            Ok(file)
        };
        let file = stage().map_err(|error: io::Error| {
            // The kind alone: the error itself would name a temporary file, of which the caller knows nothing.
            DiskError::at(path)(match error.kind() {
                io::ErrorKind::NotFound => io::Error::new(io::ErrorKind::NotFound, "there is no such folder"),
                kind => kind.into(),
            })
        })?;
        self.staged.push((file, path.to_owned()));
        Ok(())
    }

    /// Moves every staged file to its place.
    ///
    /// # Errors
    /// [`DiskError`] names the first file that cannot be moved; those before it are in their places.
    pub fn commit(self) -> Result<(), DiskError> {
        let mut folders = BTreeSet::new();
        for (file, path) in self.staged {
            file.persist(&path).map_err(|error| DiskError::at(&path)(error.error))?;
            folders.insert(folder_of(&path).to_owned());
        }
        folders.iter().try_for_each(|folder| sync_folder(folder))
    }
}

/// Writes one file, whole or not at all.
///
/// # Errors
/// [`DiskError`] if it cannot be written.
pub fn write(path: &Path, contents: impl AsRef<[u8]>) -> Result<(), DiskError> {
    let mut files = Files::default();
    files.stage(path, contents)?;
    files.commit()
}

/// Writes one file of indented JSON, whole or not at all.
///
/// # Errors
/// [`DiskError`] if it cannot be encoded or written.
pub fn write_json(path: &Path, contents: &impl Serialize) -> Result<(), DiskError> {
    let text = serde_json::to_string_pretty(contents).map_err(|error| DiskError::at(path)(error.into()))?;
    write(path, text + "\n")
}

/// The bytes of a file; none if there is no such file.
///
/// # Errors
/// [`DiskError`] if there is one that cannot be read.
pub fn read(path: &Path) -> Result<Option<Vec<u8>>, DiskError> {
    unless_missing(fs::read(path)).map_err(DiskError::at(path))
}

/// Removes a file, if there is one.
///
/// # Errors
/// [`DiskError`] if it cannot be removed.
pub fn remove(path: &Path) -> Result<(), DiskError> {
    match unless_missing(fs::remove_file(path)).map_err(DiskError::at(path))? {
        Some(()) => sync_folder(folder_of(path)),
        None => Ok(()),
    }
}

/// Makes a folder and those it lies in, as far as they are missing.
///
/// # Errors
/// [`DiskError`] if it cannot be made.
pub fn make_folder(path: &Path) -> Result<(), DiskError> {
    if path.is_dir() {
        return Ok(());
    }
    fs::create_dir_all(path).map_err(DiskError::at(path))?;
    sync_folder(folder_of(path))
}

/// The folder that a file lies in.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Makes the names in a folder outlast a loss of power. Where folders cannot be opened as files, nothing can be done.
fn sync_folder(folder: &Path) -> Result<(), DiskError> {
    #[cfg(unix)]
    fs::File::open(folder).and_then(|folder| folder.sync_all()).map_err(DiskError::at(folder))?;
    Ok(())
}

fn unless_missing<T>(result: io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}
