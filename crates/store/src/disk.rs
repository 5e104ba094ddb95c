//! Files that appear whole or not at all, through a loss of power too, and errors that name them.

mod unfinished;

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tempfile::TempPath;
pub(crate) use unfinished::is_unfinished;
pub use unfinished::remove_unfinished;
pub(crate) use unfinished::{numbered_name, parse_number, remove_all_unfinished};

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

/// Files to be written together. They are first written beside their places and then moved there, so that a failure
/// leaves nothing half-written. Staging removes what earlier processes left unfinished in the same folder.
#[derive(Default)]
pub struct StagedFiles {
    staged: Vec<StagedFile>,
}

/// A file beside its place.
struct StagedFile {
    file: fs::File,
    temp_path: TempPath,
    path: PathBuf,
}

impl StagedFiles {
    /// Stages a file.
    ///
    /// # Errors
    /// [`DiskError`] if it cannot be written, or if another file is staged for its place: [`io::ErrorKind::AlreadyExists`].
    pub fn stage(&mut self, path: &Path, contents: impl AsRef<[u8]>) -> Result<(), DiskError> {
        if self.staged.iter().any(|staged| staged.path == path) {
            let twice = "two results would go there: give scenarios names of their own";
            return Err(DiskError::at(path)(io::Error::new(io::ErrorKind::AlreadyExists, twice)));
        }
        let folder = parent_folder(path);
        if !self.staged.iter().any(|staged| parent_folder(&staged.path) == folder) {
            // A folder that cannot be read may still be written.
            let _ = remove_unfinished(folder);
        }
        let stage = || {
            // What cannot be replaced is known before anything is written.
            if path.is_dir() {
                return Err(io::ErrorKind::IsADirectory.into());
            }
            let mut file = unfinished::create_locked(folder)?;
            file.write_all(contents.as_ref())?;
            Ok(file.into_parts())
        };
        let (file, unfinished) = stage().map_err(|error: io::Error| {
            // The kind alone: the error itself would name a temporary file, of which the caller knows nothing.
            DiskError::at(path)(match error.kind() {
                io::ErrorKind::NotFound => io::Error::new(io::ErrorKind::NotFound, "there is no such folder"),
                kind => kind.into(),
            })
        })?;
        self.staged.push(StagedFile { file, temp_path: unfinished, path: path.to_owned() });
        Ok(())
    }

    /// Moves every staged file to its place.
    ///
    /// # Errors
    /// [`DiskError`] names the first file that cannot be moved; those before it are in their places.
    pub fn commit(self) -> Result<(), DiskError> {
        // Else a loss of power could leave new names with nothing behind them. All at once, for each waits for the disk.
        self.staged.par_iter().try_for_each(|staged| staged.file.sync_all().map_err(DiskError::at(&staged.path)))?;
        let mut folders = BTreeSet::new();
        for StagedFile { temp_path: unfinished, path, .. } in self.staged {
            fs::rename(&unfinished, &path).map_err(DiskError::at(&path))?;
            // Nothing is left to be cleared away.
            let _ = unfinished.keep();
            folders.insert(parent_folder(&path).to_owned());
        }
        folders.par_iter().try_for_each(|folder| sync_folder(folder))
    }
}

/// Writes one file, whole or not at all.
///
/// # Errors
/// [`DiskError`] if it cannot be written.
pub fn write(path: &Path, contents: impl AsRef<[u8]>) -> Result<(), DiskError> {
    let mut files = StagedFiles::default();
    files.stage(path, contents)?;
    files.commit()
}

/// The bytes of a file of at most so many; none if there is no such file.
///
/// # Errors
/// [`DiskError`] if there is one that cannot be read or is longer: [`io::ErrorKind::FileTooLarge`].
pub fn read(path: &Path, most: u64) -> Result<Option<Vec<u8>>, DiskError> {
    match none_if_missing(fs::metadata(path)).map_err(DiskError::at(path))? {
        None => return Ok(None),
        // A pipe would be waited for.
        Some(found) if !found.is_file() && !found.is_dir() => {
            let problem = io::Error::new(io::ErrorKind::InvalidData, "is no file");
            return Err(DiskError::at(path)(problem));
        }
        Some(_) => {}
    }
    let Some(file) = none_if_missing(fs::File::open(path)).map_err(DiskError::at(path))? else { return Ok(None) };
    let mut bytes = Vec::new();
    match file.take(most.saturating_add(1)).read_to_end(&mut bytes) {
        Ok(count) if count as u64 > most => Err(DiskError::at(path)(io::ErrorKind::FileTooLarge.into())),
        Ok(_) => Ok(Some(bytes)),
        Err(source) => Err(DiskError::at(path)(source)),
    }
}

/// Removes files, as far as they are there.
///
/// # Errors
/// [`DiskError`] names the first that cannot be removed.
pub fn remove(paths: &[impl AsRef<Path>]) -> Result<(), DiskError> {
    let mut folders = BTreeSet::new();
    for path in paths.iter().map(AsRef::as_ref) {
        if none_if_missing(fs::remove_file(path)).map_err(DiskError::at(path))?.is_some() {
            folders.insert(parent_folder(path));
        }
    }
    folders.iter().try_for_each(|folder| sync_folder(folder))
}

/// Makes a folder and those it lies in, as far as they are missing.
///
/// # Errors
/// [`DiskError`] if it cannot be made.
pub fn make_folder(path: &Path) -> Result<(), DiskError> {
    if path.as_os_str().is_empty() || path.is_dir() {
        return Ok(());
    }
    make_folder(parent_folder(path))?;
    match fs::create_dir(path) {
        // Another process was faster.
        Err(_) if path.is_dir() => {}
        Err(_) if path.symlink_metadata().is_ok() => {
            let problem = if path.is_symlink() {
                "a link that leads to no folder"
            } else {
                "there is something else than a folder"
            };
            return Err(DiskError::at(path)(io::Error::new(io::ErrorKind::AlreadyExists, problem)));
        }
        made => made.map_err(DiskError::at(path))?,
    }
    sync_folder(parent_folder(path))
}

/// Makes the name of a file, and of those beside it, outlast a loss of power.
///
/// # Errors
/// [`DiskError`] if the folder cannot be read or written.
pub fn sync_parent_folder(path: &Path) -> Result<(), DiskError> {
    sync_folder(parent_folder(path))
}

/// The folder that a file lies in.
fn parent_folder(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Makes the names in a folder outlast a loss of power. Where folders cannot be opened as files, nothing can be done.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), DiskError> {
    #[cfg(unix)]
    fs::File::open(folder).and_then(|folder| folder.sync_all()).map_err(DiskError::at(folder))?;
    Ok(())
}

fn none_if_missing<T>(result: io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}
