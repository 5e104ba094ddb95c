//! Lock of a folder for one process.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use crate::disk::DiskError;
use crumple_core::regular_file;

pub(super) const LOCK_FILE: &str = "work.lock";

/// The exclusive use of a folder. The operating system releases it when the process ends.
///
/// The file stays: a process that removed it might remove one that another process is about to lock.
#[derive(Debug)]
pub struct FolderLock {
    /// Holds the lock of the operating system.
    file: File,
    /// The locked folder itself, if the file system can lock folders. It protects the run even if the lock file is
    /// deleted.
    folder: Option<File>,
}

impl FolderLock {
    /// Acquires the lock; returns `None` if another process has it.
    ///
    /// # Errors
    /// [`DiskError`] if there is no such folder, or it cannot be written.
    pub fn try_acquire(folder: &Path) -> Result<Option<Self>, DiskError> {
        let (file, path) = open_lock_file(folder)?;
        let mut lock = match file.try_lock() {
            Ok(()) => Self { file, folder: None },
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(source)) => return Err(DiskError::at(&path)(source)),
        };
        // Some systems cannot open folders, and some file systems cannot lock them.
        let Ok(folder) = File::open(folder) else {
            return Ok(Some(lock));
        };
        match folder.try_lock() {
            Ok(()) => lock.folder = Some(folder),
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(_)) => {}
        }
        Ok(Some(lock))
    }
}

impl Drop for FolderLock {
    /// Unlocks explicitly. Closing the file is not enough: a child process inherits the open file, and with it the
    /// lock, until it executes its program.
    fn drop(&mut self) {
        // A failure has no remedy; the end of the process releases the lock at the latest.
        let _ = self.file.unlock();
        let _ = self.folder.as_ref().map(File::unlock);
    }
}

/// Opens the lock file, which must be a regular file: follows no link, and waits for no pipe.
fn open_lock_file(folder: &Path) -> Result<(File, PathBuf), DiskError> {
    let path = folder.join(LOCK_FILE);
    let unusable = DiskError::at(&path);
    if fs::symlink_metadata(&path).is_ok_and(|metadata| !metadata.is_file()) {
        let problem = "is not a plain file, so crumple cannot lock it: remove it";
        return Err(unusable(io::Error::new(
            io::ErrorKind::InvalidData,
            problem,
        )));
    }
    let file = regular_file::open_with(
        &path,
        File::options().create(true).truncate(false).write(true),
    );
    let file = file.map_err(unusable)?;
    Ok((file, path))
}

/// Waits for the lock of a folder, and runs a short `work` under it.
///
/// # Errors
/// [`DiskError`] if the folder cannot be locked, or the error of `work`.
pub fn with_folder_lock<T, E: From<DiskError>>(
    folder: &Path,
    work: impl FnOnce() -> Result<T, E>,
) -> Result<T, E> {
    let (file, path) = open_lock_file(folder)?;
    file.lock().map_err(DiskError::at(&path))?;
    let _lock = FolderLock { file, folder: None };
    work()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_locked_once_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let lock = FolderLock::try_acquire(folder.path()).unwrap().unwrap();
        assert!(FolderLock::try_acquire(folder.path()).unwrap().is_none());
        // A duplicate, as a child process holds it before it executes its program.
        let duplicate = lock.file.try_clone().unwrap();
        drop(lock);
        assert!(FolderLock::try_acquire(folder.path()).unwrap().is_some());
        drop(duplicate);
        let lock = FolderLock::try_acquire(folder.path()).unwrap().unwrap();
        fs::remove_file(folder.path().join(LOCK_FILE)).unwrap();
        assert!(
            FolderLock::try_acquire(folder.path()).unwrap().is_none(),
            "the folder itself is locked"
        );
        drop(lock);
        assert!(FolderLock::try_acquire(folder.path()).unwrap().is_some());
    }
}
