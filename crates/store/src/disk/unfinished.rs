//! Temporary files `.crumple-unfinished-*`, written and not yet renamed.
//!
//! [`StagedFiles`](super::StagedFiles) locks a file with a random name in each folder, until all other files there,
//! which have this name and a number, are renamed. So any process recognises files of an ended writer.
//! [`RunFolder`](crate::run_folder::RunFolder) numbers its files, which only the process that holds the lock of the
//! folder removes.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use tempfile::{NamedTempFile, TempPath};

use super::{DiskError, none_if_missing, remove};

const PREFIX: &str = ".crumple-unfinished-";
const PROTECTED_PREFIX: &str = ".crumple-unfinished-file-";

pub(crate) fn is_unfinished(path: &Path) -> bool {
    path.file_name()
        .is_some_and(|name| name.to_string_lossy().starts_with(PREFIX))
}

/// Returns the name of the numbered file of a run folder.
pub(crate) fn numbered_name(number: u64) -> String {
    format!("{PREFIX}{number}")
}

pub(crate) fn parse_number(name: &str) -> Option<u64> {
    name.strip_prefix(PREFIX)?.parse().ok()
}

/// Creates a file with a random name that stays locked while it is open.
pub(super) fn create_lock(folder: &Path) -> io::Result<NamedTempFile> {
    loop {
        // The letters keep random names distinct from numbers.
        let file = tempfile::Builder::new()
            .prefix(PROTECTED_PREFIX)
            .tempfile_in(folder)?;
        let is_locked = !matches!(file.as_file().try_lock(), Err(TryLockError::WouldBlock));
        // Before the lock, another process may have removed the file as abandoned. On a file system without locks no
        // process does so.
        if is_locked && file.path().exists() {
            return Ok(file);
        }
    }
}

/// Creates a numbered file that a lock protects.
pub(super) fn create_protected(lock: &Path, number: usize) -> io::Result<(File, TempPath)> {
    let mut name = lock.as_os_str().to_owned();
    name.push(format!("-{number}"));
    let file = File::create_new(&name)?;
    Ok((file, TempPath::try_from_path(name)?))
}

/// Returns the file whose lock protects an unfinished file: itself if there is no other.
fn lock_of(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let lock = name
        .rsplit_once('-')
        .map(|(lock, _)| lock)
        .filter(|lock| lock.starts_with(PROTECTED_PREFIX));
    lock.map(|lock| path.with_file_name(lock))
        .filter(|lock| lock.exists())
        .unwrap_or_else(|| path.to_owned())
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
    for entry in none_if_missing(fs::read_dir(folder))
        .map_err(DiskError::at(folder))?
        .into_iter()
        .flatten()
    {
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
    path.file_name()
        .is_some_and(|name| parse_number(&name.to_string_lossy()).is_some())
}

/// Takes the lock of a file whose writer has ended; `None` if the writer still holds it, or a run folder owns the file.
fn lock_if_abandoned(path: &Path) -> Option<File> {
    let is_plain = fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file());
    if !is_plain || is_numbered(path) {
        return None;
    }
    // Some file systems lock only files that are open for writing.
    let file = File::options()
        .read(true)
        .write(true)
        .open(lock_of(path))
        .ok()?;
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
        writing.stage(&at("second.json"), "alive").unwrap();
        for name in [
            "file-a1B2c3",
            "file-a1B2c3-0",
            "file-d4E5f6-1",
            "file-123456",
            "a1B2c3",
            "7",
        ] {
            fs::write(at(&format!("{PREFIX}{name}")), "dead").unwrap();
        }
        super::super::write(&at("result.json"), "whole").unwrap();
        let mut contents: Vec<String> = fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| fs::read_to_string(entry.unwrap().path()).unwrap())
            .collect();
        contents.sort();
        assert_eq!(
            contents,
            ["", "alive", "alive", "dead", "whole"],
            "the lock, and the file of a run folder, stay"
        );
        writing.commit().unwrap();
        assert_eq!(fs::read_to_string(at("other.json")).unwrap(), "alive");
        remove_all_unfinished(folder.path()).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    /// A process may open only about 1000 files.
    #[cfg(target_os = "linux")]
    #[test]
    fn staged_files_are_closed() {
        let folder = tempfile::tempdir().unwrap();
        let mut files = StagedFiles::default();
        (0..20).for_each(|number| {
            files
                .stage(&folder.path().join(number.to_string()), "")
                .unwrap()
        });
        let open = fs::read_dir("/proc/self/fd")
            .unwrap()
            .flatten()
            .filter_map(|entry| fs::read_link(entry.path()).ok());
        assert_eq!(
            open.filter(|path| path.starts_with(folder.path())).count(),
            1,
            "the lock"
        );
    }
}
