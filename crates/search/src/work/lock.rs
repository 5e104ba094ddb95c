//! One process a folder.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use crate::disk::DiskError;

/// The file that is locked.
const LOCK: &str = "work.lock";

/// The exclusive use of a folder. It ends with the value, and with the process however that ends.
///
/// The file stays: a process that removed it might remove one that another process is about to lock.
#[derive(Debug)]
pub struct Lock {
    /// Holds the lock of the operating system.
    file: File,
}

impl Lock {
    /// None if another process has it.
    ///
    /// # Errors
    /// [`DiskError`] if there is no such folder, or it cannot be written.
    pub fn of(folder: &Path) -> Result<Option<Self>, DiskError> {
        let (file, path) = opened(folder)?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self { file })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(source)) => Err(DiskError::at(&path)(source)),
        }
    }
}

impl Drop for Lock {
    /// Closing would not be enough: a child that another thread is starting holds the file open until it is another program.
    fn drop(&mut self) {
        // Nothing can be done if it fails, and the end of the process releases it at the latest.
        let _ = self.file.unlock();
    }
}

fn opened(folder: &Path) -> Result<(File, PathBuf), DiskError> {
    let path = folder.join(LOCK);
    let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(DiskError::at(&path))?;
    Ok((file, path))
}

/// Does something short in a folder while no other process does the same: waits until it may.
///
/// # Errors
/// [`DiskError`] if the folder cannot be locked, or what is done has it.
pub fn exclusively<T, E: From<DiskError>>(folder: &Path, work: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
    let (file, path) = opened(folder)?;
    file.lock().map_err(DiskError::at(&path))?;
    let _lock = Lock { file };
    work()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_locked_once_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let lock = Lock::of(folder.path()).unwrap().unwrap();
        assert!(Lock::of(folder.path()).unwrap().is_none());
        // As a child has it that is about to become another program.
        let held = lock.file.try_clone().unwrap();
        drop(lock);
        assert!(Lock::of(folder.path()).unwrap().is_some());
        drop(held);
    }
}
