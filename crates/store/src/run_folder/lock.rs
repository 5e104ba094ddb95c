//! One process a folder.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use crate::disk::DiskError;

/// The file that is locked.
pub(super) const LOCK_FILE: &str = "work.lock";

/// The exclusive use of a folder. It ends with the value, and with the process however that ends.
///
/// The file stays: a process that removed it might remove one that another process is about to lock.
#[derive(Debug)]
pub struct FolderLock {
    /// Holds the lock of the operating system.
    file: File,
    /// The folder itself, where it can be locked: its lock stays if somebody removes the file.
    folder: Option<File>,
}

impl FolderLock {
    /// None if another process has it.
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
        // Not every system opens folders, and not every file system locks them.
        let Ok(folder) = File::open(folder) else { return Ok(Some(lock)) };
        match folder.try_lock() {
            Ok(()) => lock.folder = Some(folder),
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(_)) => {}
        }
        Ok(Some(lock))
    }
}

impl Drop for FolderLock {
    /// Closing would not be enough: a child that another thread is starting holds the file open until it is another program.
    fn drop(&mut self) {
        // Nothing can be done if it fails, and the end of the process releases it at the latest.
        let _ = self.file.unlock();
        let _ = self.folder.as_ref().map(File::unlock);
    }
}

/// The file, which is one of the folder's own: no link is followed, and no pipe waited for.
fn open_lock_file(folder: &Path) -> Result<(File, PathBuf), DiskError> {
    let path = folder.join(LOCK_FILE);
    let unusable = DiskError::at(&path);
    if fs::symlink_metadata(&path).is_ok_and(|found| !found.is_file()) {
        let problem = "no plain file, as which crumple makes and locks it: remove it";
        return Err(unusable(io::Error::new(io::ErrorKind::InvalidData, problem)));
    }
    let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(unusable)?;
    Ok((file, path))
}

/// Does something short in a folder while no other process does the same: waits until it may.
///
/// # Errors
/// [`DiskError`] if the folder cannot be locked, or what is done has it.
pub fn with_folder_lock<T, E: From<DiskError>>(folder: &Path, work: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
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
        // As a child has it that is about to become another program.
        let held = lock.file.try_clone().unwrap();
        drop(lock);
        assert!(FolderLock::try_acquire(folder.path()).unwrap().is_some());
        drop(held);
        let lock = FolderLock::try_acquire(folder.path()).unwrap().unwrap();
        fs::remove_file(folder.path().join(LOCK_FILE)).unwrap();
        assert!(FolderLock::try_acquire(folder.path()).unwrap().is_none(), "the folder itself is locked");
        drop(lock);
        assert!(FolderLock::try_acquire(folder.path()).unwrap().is_some());
    }
}
