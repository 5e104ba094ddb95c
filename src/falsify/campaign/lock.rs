//! One process a folder.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

use super::CampaignError;

/// The exclusive use of a campaign's folder. It ends with the value, and with the process however that ends.
pub(super) struct Lock {
    path: PathBuf,
    /// Holds the lock of the operating system.
    _file: File,
}

impl Lock {
    pub(super) fn of(folder: &Path) -> Result<Self, CampaignError> {
        let path = folder.join("campaign.lock");
        let unusable = |source| CampaignError::environment(&path, source);
        let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(unusable)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { path, _file: file }),
            Err(TryLockError::WouldBlock) => {
                let problem = format!("{}: another process works on the campaign there", folder.display());
                Err(CampaignError::Folder(problem))
            }
            Err(TryLockError::Error(source)) => Err(unusable(source)),
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // The lock is what counts; a file that stays behind is in nobody's way.
        let _ = fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_locked_once_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let lock = Lock::of(folder.path()).unwrap();
        let refused = Lock::of(folder.path()).err().unwrap().to_string();
        assert!(refused.contains("another process works"), "{refused}");
        drop(lock);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        Lock::of(folder.path()).unwrap();
    }
}
