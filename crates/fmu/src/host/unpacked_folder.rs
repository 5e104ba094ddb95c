//! Folders of unpacked FMUs. A process locks its folder; the system releases the lock when the process ends, however it
//! ends. Each start removes unlocked folders of earlier processes.
//!
//! Other users may share the temporary folder, so only real folders of the same user are locked and removed.

use std::io;
use std::path::Path;

use tempfile::{Builder, TempDir};

/// Prefix of the name of each folder. Releases before the lock used other names, which are ignored.
const PREFIX: &str = "crumple-fmu-run-";

/// Maximum number of attempts to create and lock a folder; another process may remove it before it is locked.
#[cfg(unix)]
const MAX_ATTEMPTS: usize = 100;

/// Locked temporary folder that is removed when dropped.
pub(super) struct UnpackedFolder {
    // Dropped before the lock, because other processes remove unlocked folders.
    folder: TempDir,
    #[cfg(unix)]
    _lock: Option<std::fs::File>,
}

impl UnpackedFolder {
    /// Creates an empty folder that no other user can open, and removes the folders of ended processes.
    ///
    /// # Errors
    /// The system's error if the folder cannot be created.
    pub(super) fn new() -> io::Result<Self> {
        Self::new_in(&std::env::temp_dir())
    }

    pub(super) fn path(&self) -> &Path {
        self.folder.path()
    }

    #[cfg(unix)]
    fn new_in(temporary: &Path) -> io::Result<Self> {
        use std::os::unix::fs::PermissionsExt as _;

        unix::remove_abandoned(temporary);
        let mut builder = Builder::new();
        builder
            .prefix(PREFIX)
            .permissions(std::fs::Permissions::from_mode(0o700));
        for _ in 0..MAX_ATTEMPTS {
            let folder = builder.tempdir_in(temporary)?;
            if let Some(lock) = unix::lock(folder.path())? {
                return Ok(Self {
                    folder,
                    _lock: Some(lock),
                });
            }
        }
        Err(io::Error::new(
            io::ErrorKind::ResourceBusy,
            "another process keeps removing new folders",
        ))
    }

    #[cfg(not(unix))]
    fn new_in(temporary: &Path) -> io::Result<Self> {
        Ok(Self {
            folder: Builder::new().prefix(PREFIX).tempdir_in(temporary)?,
        })
    }
}

#[cfg(unix)]
mod unix {
    use std::fs::{self, File, TryLockError};
    use std::io;
    use std::os::unix::fs::MetadataExt as _;
    use std::path::Path;

    use rustix::fs::{Mode, OFlags};

    use super::PREFIX;

    fn open(path: &Path) -> io::Result<File> {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        Ok(rustix::fs::open(path, flags, Mode::empty())?.into())
    }

    /// Locks a new folder; none if another process removes it. Without file locks, no folder is removed.
    ///
    /// # Errors
    /// The system's error if the folder cannot be opened.
    pub(super) fn lock(path: &Path) -> io::Result<Option<File>> {
        let folder = match open(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            opened => opened?,
        };
        if let Err(TryLockError::WouldBlock) = folder.try_lock() {
            return Ok(None);
        }
        let locked = folder.metadata()?;
        let is_there = fs::symlink_metadata(path)
            .is_ok_and(|entry| (entry.dev(), entry.ino()) == (locked.dev(), locked.ino()));
        Ok(is_there.then_some(folder))
    }

    /// Removes each folder of the same user whose process has ended, and ignores errors.
    pub(super) fn remove_abandoned(temporary: &Path) {
        let Ok(entries) = fs::read_dir(temporary) else {
            return;
        };
        for entry in entries.flatten().filter(|entry| {
            entry
                .file_name()
                .as_encoded_bytes()
                .starts_with(PREFIX.as_bytes())
        }) {
            let path = entry.path();
            let Ok(folder) = open(&path) else { continue };
            let own = rustix::process::geteuid().as_raw();
            if folder.metadata().is_ok_and(|entry| entry.uid() == own) && folder.try_lock().is_ok()
            {
                let _ = fs::remove_dir_all(&path);
            }
        }
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use std::fs;
    use std::os::unix::fs::{PermissionsExt as _, symlink};
    use std::path::PathBuf;

    use super::*;

    fn sorted_names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    fn create_abandoned(temporary: &Path, name: &str) -> PathBuf {
        let path = temporary.join(format!("{PREFIX}{name}"));
        fs::create_dir_all(path.join("binaries/linux64")).unwrap();
        fs::write(path.join("binaries/linux64/a.so"), "library").unwrap();
        path
    }

    /// Other users can create any entry in a shared temporary folder.
    #[test]
    fn only_abandoned_folders_are_removed() {
        let temporary = tempfile::tempdir().unwrap();
        let precious = tempfile::tempdir().unwrap();
        fs::write(precious.path().join("precious"), "precious").unwrap();
        symlink(
            precious.path(),
            temporary.path().join(format!("{PREFIX}link")),
        )
        .unwrap();
        symlink(
            temporary.path().join("nothing"),
            temporary.path().join(format!("{PREFIX}dangling")),
        )
        .unwrap();
        fs::write(temporary.path().join(format!("{PREFIX}file")), "file").unwrap();
        fs::create_dir(temporary.path().join("crumple-fmu-Ab12Cd")).unwrap();
        let inside = create_abandoned(temporary.path(), "abandoned");
        symlink(precious.path(), inside.join("resources")).unwrap();
        let before = sorted_names(temporary.path());
        drop(UnpackedFolder::new_in(temporary.path()).unwrap());
        let left: Vec<String> = before
            .into_iter()
            .filter(|name| !name.ends_with("-abandoned"))
            .collect();
        assert_eq!(sorted_names(temporary.path()), left);
        assert_eq!(sorted_names(precious.path()), ["precious"]);
    }

    /// Eight concurrent starts, repeated: each keeps its folder.
    #[test]
    fn concurrent_starts_keep_their_folders() {
        let temporary = tempfile::tempdir().unwrap();
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for _ in 0..50 {
                        let folder = UnpackedFolder::new_in(temporary.path()).unwrap();
                        assert_eq!(
                            fs::metadata(folder.path()).unwrap().permissions().mode() & 0o777,
                            0o700
                        );
                        fs::write(folder.path().join("data.txt"), "data").unwrap();
                        std::thread::yield_now();
                        assert_eq!(
                            fs::read_to_string(folder.path().join("data.txt")).unwrap(),
                            "data"
                        );
                    }
                });
            }
        });
        assert!(sorted_names(temporary.path()).is_empty());
    }
}
