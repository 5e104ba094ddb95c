//! Atomic files: a reader finds the whole file or none, even after a loss of power. Errors name the file.

mod unfinished;

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use crumple_core::regular_file;
use rayon::prelude::*;
use tempfile::{NamedTempFile, TempPath};
pub(crate) use unfinished::is_unfinished;
pub use unfinished::remove_unfinished;
pub(crate) use unfinished::{numbered_name, parse_number, remove_all_unfinished};

/// An error of reading or writing a file or folder.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", path.display())]
pub struct DiskError {
    /// Path of the file or folder.
    pub path: PathBuf,
    /// Error of the operating system.
    pub source: io::Error,
}

impl DiskError {
    /// Returns true if the folder or file may be read, but not written.
    #[must_use]
    pub fn is_read_only(&self) -> bool {
        matches!(
            self.source.kind(),
            io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied
        )
    }

    /// Returns a function that adds a path to an error of the operating system.
    pub fn at(path: &Path) -> impl Fn(io::Error) -> Self + Copy + '_ {
        |source| Self {
            path: path.to_owned(),
            source,
        }
    }
}

/// Files that are written together. Each is written under a temporary name in its folder and then renamed, so that a
/// failure leaves no partial file. Staging removes the unfinished files of ended processes from that folder. One file
/// stays open for each folder.
#[derive(Default)]
pub struct StagedFiles {
    /// Temporary file of each path. Declared before the locks, so that it is dropped before them.
    staged: BTreeMap<PathBuf, TempPath>,
    /// The staged paths, each in one spelling.
    files: BTreeSet<PathBuf>,
    /// Lock of each folder, which protects the temporary files there.
    locks: BTreeMap<PathBuf, NamedTempFile>,
}

impl StagedFiles {
    /// Stages a file.
    ///
    /// # Errors
    /// [`DiskError`] if it cannot be written, or its path is staged already: [`io::ErrorKind::AlreadyExists`].
    pub fn stage(&mut self, path: &Path, contents: impl AsRef<[u8]>) -> Result<(), DiskError> {
        let file = whole_path(path);
        if !self.files.insert(file) {
            return Err(DiskError::at(path)(io::Error::new(
                io::ErrorKind::AlreadyExists,
                "two results would have this path",
            )));
        }
        let temp_path = self
            .write_temporary(path, contents.as_ref())
            .map_err(|error| {
                // Only kind and code: the error itself would name a temporary file that the caller does not know.
                DiskError::at(path)(match (error.kind(), system_code(&error)) {
                    (io::ErrorKind::NotFound, _) => {
                        io::Error::new(io::ErrorKind::NotFound, "there is no such folder")
                    }
                    (_, Some(code)) => io::Error::from_raw_os_error(code),
                    (kind, None) => kind.into(),
                })
            })?;
        self.staged.insert(path.to_owned(), temp_path);
        Ok(())
    }

    fn write_temporary(&mut self, path: &Path, contents: &[u8]) -> io::Result<TempPath> {
        // Fail before anything is written.
        if path.is_dir() {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        let folder = parent_folder(path);
        let lock = match self.locks.entry(folder.to_owned()) {
            Entry::Occupied(lock) => lock.into_mut(),
            Entry::Vacant(entry) => {
                // A folder that cannot be listed may still be writable.
                let _ = remove_unfinished(folder);
                entry.insert(unfinished::create_lock(folder)?)
            }
        };
        let (mut file, temp_path) = unfinished::create_protected(lock.path(), self.staged.len())?;
        file.write_all(contents)?;
        Ok(temp_path)
    }

    /// Returns true if no file is staged.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.staged.is_empty()
    }

    /// Moves every staged file to its path, in the order of the paths.
    ///
    /// # Errors
    /// [`DiskError`] names the first file that cannot be moved; earlier files are in place.
    pub fn commit(self) -> Result<(), DiskError> {
        // Sync before the renames; otherwise a loss of power could leave files with the new names and no contents. In
        // parallel, because each call waits for the disk.
        self.staged.par_iter().try_for_each(|(path, temp_path)| {
            let file = fs::File::options().write(true).open(temp_path);
            file.and_then(|file| file.sync_all())
                .map_err(DiskError::at(path))
        })?;
        for (path, temp_path) in self.staged {
            fs::rename(&temp_path, &path).map_err(DiskError::at(&path))?;
            // The rename left no temporary file to delete.
            let _ = temp_path.keep();
        }
        // Deletes the locks, before the folders are synced.
        let folders: Vec<_> = self.locks.into_keys().collect();
        folders
            .par_iter()
            .try_for_each(|folder| sync_folder(folder))
    }
}

/// Writes one file atomically.
///
/// # Errors
/// [`DiskError`] if it cannot be written.
pub fn write(path: &Path, contents: impl AsRef<[u8]>) -> Result<(), DiskError> {
    let mut files = StagedFiles::default();
    files.stage(path, contents)?;
    files.commit()
}

/// Reads a file of at most `most` bytes; returns `None` if it does not exist.
///
/// # Errors
/// [`DiskError`] if it cannot be read or is longer: [`io::ErrorKind::FileTooLarge`].
pub fn read(path: &Path, most: u64) -> Result<Option<Vec<u8>>, DiskError> {
    let Some(file) = none_if_missing(regular_file::open(path)).map_err(DiskError::at(path))? else {
        return Ok(None);
    };
    let mut bytes = Vec::new();
    match file.take(most.saturating_add(1)).read_to_end(&mut bytes) {
        Ok(count) if count as u64 > most => {
            Err(DiskError::at(path)(io::ErrorKind::FileTooLarge.into()))
        }
        Ok(_) => Ok(Some(bytes)),
        Err(source) => Err(DiskError::at(path)(source)),
    }
}

/// Removes those of the files that exist.
///
/// # Errors
/// [`DiskError`] names the first that cannot be removed.
pub fn remove(paths: &[impl AsRef<Path>]) -> Result<(), DiskError> {
    let mut folders = BTreeSet::new();
    for path in paths.iter().map(AsRef::as_ref) {
        if none_if_missing(fs::remove_file(path))
            .map_err(DiskError::at(path))?
            .is_some()
        {
            folders.insert(parent_folder(path));
        }
    }
    folders.iter().try_for_each(|folder| sync_folder(folder))
}

/// Creates a folder and its missing parents.
///
/// # Errors
/// [`DiskError`] if it cannot be created.
pub fn make_folder(path: &Path) -> Result<(), DiskError> {
    if path.as_os_str().is_empty() || path.is_dir() {
        return Ok(());
    }
    make_folder(parent_folder(path))?;
    match fs::create_dir(path) {
        // Another process was faster.
        Err(_) if path.is_dir() => {}
        Err(_) if path.symlink_metadata().is_ok() => {
            let problem = match path.is_symlink() {
                true => "is a link that does not lead to a folder",
                false => "exists and is not a folder",
            };
            return Err(DiskError::at(path)(io::Error::new(
                io::ErrorKind::AlreadyExists,
                problem,
            )));
        }
        result => result.map_err(DiskError::at(path))?,
    }
    sync_folder(parent_folder(path))
}

/// Syncs the folder of a file, so that the file's name survives a loss of power.
///
/// # Errors
/// [`DiskError`] if the folder cannot be read or written.
pub fn sync_parent_folder(path: &Path) -> Result<(), DiskError> {
    sync_folder(parent_folder(path))
}

/// Returns a path with the whole path of its folder, so that two spellings of one path are equal.
fn whole_path(path: &Path) -> PathBuf {
    match (fs::canonicalize(parent_folder(path)), path.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => path.to_owned(),
    }
}

/// Returns the code of the operating system in an error, or in the error that caused it.
fn system_code(error: &io::Error) -> Option<i32> {
    let cause = || error.get_ref()?.source()?.downcast_ref::<io::Error>();
    error.raw_os_error().or_else(|| cause()?.raw_os_error())
}

fn parent_folder(path: &Path) -> &Path {
    path.parent()
        .filter(|parent| !parent.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// Syncs the names in a folder to disk. Has no effect on systems that cannot open folders as files.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), DiskError> {
    #[cfg(unix)]
    fs::File::open(folder)
        .and_then(|folder| folder.sync_all())
        .map_err(DiskError::at(folder))?;
    #[cfg(not(unix))]
    let _ = folder;
    Ok(())
}

/// Returns `None` for an error about a missing file or folder.
pub(crate) fn none_if_missing<T>(result: io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}
