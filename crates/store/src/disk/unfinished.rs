//! Temporary files `.crumple-unfinished-*`, written and not yet renamed.
//!
//! [`StagedFiles`](super::StagedFiles) uses random names and locks each file until it is renamed, so that any process
//! can recognise a file of an ended writer. [`RunFolder`](crate::run_folder::RunFolder) numbers its files, which only
//! the process that holds the lock of the folder removes.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::Path;

use tempfile::NamedTempFile;

use super::{DiskError, none_if_missing, remove};

const PREFIX: &str = ".crumple-unfinished-";

pub(crate) fn is_unfinished(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(PREFIX))
}

/// Returns the name of the numbered file of a run folder.
pub(crate) fn numbered_name(number: u64) -> String {
    format!("{PREFIX}{number}")
}

pub(crate) fn parse_number(name: &str) -> Option<u64> {
    name.strip_prefix(PREFIX)?.parse().ok()
}

/// Creates a file with a random name that stays locked while it is open.
pub(super) fn create_locked(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    // The letters keep random names distinct from numbers.
    let prefix = format!("{PREFIX}file-");
    builder.prefix(&prefix);
    // Temporary files are private by default; the result should have the usual permissions.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o644));
    loop {
        let file = builder.tempfile_in(folder)?;
        let is_locked = !matches!(file.as_file().try_lock(), Err(TryLockError::WouldBlock));
        // Before the lock, another process may have removed the file as abandoned. On a file system without locks no
        // process does so.
        if is_locked && file.path().exists() {
            return Ok(file);
        }
    }
}

/// Removes the unfinished files of ended writers from a folder, except the numbered files of a run folder.
///
/// # Errors
/// [`DiskError`] if the folder cannot be read or written.
pub fn remove_unfinished(folder: &Path) -> Result<(), DiskError> {
    remove_abandoned(folder, false)
}

/// Removes numbered files, too. The caller holds the lock of the folder, and no change is pending.
///
/// # Errors
/// [`DiskError`] if the folder cannot be read or written.
pub(crate) fn remove_all_unfinished(folder: &Path) -> Result<(), DiskError> {
    remove_abandoned(folder, true)
}

fn remove_abandoned(folder: &Path, and_numbered: bool) -> Result<(), DiskError> {
    for entry in none_if_missing(fs::read_dir(folder)).map_err(DiskError::at(folder))?.into_iter().flatten() {
        let path = entry.map_err(DiskError::at(folder))?.path();
        if !is_unfinished(&path) {
            continue;
        }
        // Held until the file is removed, so that its writer cannot lock it in between.
        let lock = lock_if_abandoned(&path);
        if lock.is_some() || and_numbered && is_numbered(&path) {
            remove(&[path])?;
        }
    }
    Ok(())
}

fn is_numbered(path: &Path) -> bool {
    path.file_name().is_some_and(|name| parse_number(&name.to_string_lossy()).is_some())
}

/// Locks a file whose writer has ended; `None` if the writer still holds the lock, or a run folder owns the file.
fn lock_if_abandoned(path: &Path) -> Option<File> {
    let is_plain = fs::symlink_metadata(path).is_ok_and(|found| found.is_file());
    if !is_plain || is_numbered(path) {
        return None;
    }
    // Some file systems lock only files that are open for writing.
    let file = File::options().read(true).write(true).open(path).ok()?;
    file.try_lock().is_ok().then_some(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::disk::StagedFiles;

    /// A file of a killed writer carries no lock.
    #[test]
    fn the_next_writer_removes_abandoned_files() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let mut writing = StagedFiles::default();
        writing.stage(&at("other.json"), "alive").unwrap();
        for name in ["file-a1B2c3", "a1B2c3", "7"] {
            fs::write(at(&format!("{PREFIX}{name}")), "dead").unwrap();
        }
        super::super::write(&at("result.json"), "whole").unwrap();
        let mut contents: Vec<String> = fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| fs::read_to_string(entry.unwrap().path()).unwrap())
            .collect();
        contents.sort();
        assert_eq!(contents, ["alive", "dead", "whole"], "that of a folder of work stays");
        writing.commit().unwrap();
        assert_eq!(fs::read_to_string(at("other.json")).unwrap(), "alive");
        remove_all_unfinished(folder.path()).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
