//! One process a folder.

use std::fs::{File, TryLockError};
use std::path::Path;

use super::CampaignError;
use crate::disk::DiskError;

/// The exclusive use of a campaign's folder. It ends with the value, and with the process however that ends.
///
/// The file stays: a process that removed it might remove one that another process is about to lock.
pub(super) struct Lock {
    /// Holds the lock of the operating system.
    _file: File,
}

impl Lock {
    pub(super) fn of(folder: &Path) -> Result<Self, CampaignError> {
        let path = folder.join("campaign.lock");
        let unusable = DiskError::at(&path);
        let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(unusable)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: file }),
            Err(TryLockError::WouldBlock) => {
                let problem = format!("{}: another process works on the campaign there", folder.display());
                Err(CampaignError::Folder(problem))
            }
            Err(TryLockError::Error(source)) => Err(unusable(source).into()),
        }
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
        Lock::of(folder.path()).unwrap();
    }
}
