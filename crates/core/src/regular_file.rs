//! Opening of files that a user names, on the command line or within other files.
//!
//! Reading a pipe, a terminal or a device may wait for ever or never end. These functions therefore open regular files
//! only. Every crate that reads such files uses them; `tests/suite/special_files.rs` checks this.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Pipes that may be read.
static PERMITTED_PIPES: OnceLock<Vec<PathBuf>> = OnceLock::new();

/// Permits [`open`] to read these paths even if they are pipes or terminals, such as `/dev/stdin` as an argument of the
/// program. A second call has no effect.
pub fn permit_pipes(paths: Vec<PathBuf>) {
    let _ = PERMITTED_PIPES.set(paths);
}

/// Files that [`open`] has opened, as whole paths; `None` without [`record_opened`].
static OPENED: Mutex<Option<Vec<PathBuf>>> = Mutex::new(None);

/// Records the files that [`open`] opens from now on, until [`take_opened`].
pub fn record_opened() {
    *OPENED.lock().unwrap_or_else(PoisonError::into_inner) = Some(Vec::new());
}

/// Returns the recorded files as whole paths, and ends the record.
#[must_use]
pub fn take_opened() -> Vec<PathBuf> {
    let recorded = OPENED.lock().unwrap_or_else(PoisonError::into_inner).take();
    recorded.unwrap_or_default()
}

/// Opens a regular file for reading.
///
/// # Errors
/// Those of the system; [`io::ErrorKind::InvalidInput`] for a pipe, a terminal, a device or a socket.
pub fn open(path: &Path) -> io::Result<File> {
    let is_permitted = PERMITTED_PIPES
        .get()
        .is_some_and(|pipes| pipes.iter().any(|pipe| pipe == path));
    if is_permitted
        && path
            .metadata()
            .is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
    {
        return File::open(path);
    }
    let file = open_with(path, OpenOptions::new().read(true))?;
    if let Some(opened) = &mut *OPENED.lock().unwrap_or_else(PoisonError::into_inner) {
        opened.extend(path.canonicalize());
    }
    Ok(file)
}

/// Opens a regular file with the given options, which may create it. Does not wait, whatever has its name.
///
/// # Errors
/// Those of [`open`].
pub fn open_with(path: &Path, options: &OpenOptions) -> io::Result<File> {
    // To open a device may have effects.
    if let Ok(metadata) = path.metadata() {
        ensure_regular(&metadata)?;
    }
    let file = without_waiting(options.clone()).open(path)?;
    // Since the first check, another file may have got the name.
    ensure_regular(&file.metadata()?)?;
    Ok(file)
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
/// Those of [`open`]; [`io::ErrorKind::InvalidData`] for a longer file.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?
        .take(most.saturating_add(1))
        .read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let size = if most < 1 << 20 {
            format!("{} KiB", most >> 10)
        } else {
            format!("{} MiB", most >> 20)
        };
        let problem = format!("holds more than {size}, too much for such a file");
        return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
    }
    Ok(bytes)
}

fn ensure_regular(metadata: &Metadata) -> io::Result<()> {
    if metadata.is_file() {
        Ok(())
    } else if metadata.is_dir() {
        Err(io::Error::new(
            io::ErrorKind::IsADirectory,
            "is not a regular file but a folder",
        ))
    } else {
        Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "is not a regular file",
        ))
    }
}

/// `O_NONBLOCK`, which has no effect on reads and writes of regular files. The standard library has no name for it.
#[cfg(unix)]
const NON_BLOCKING: i32 = if cfg!(any(target_os = "linux", target_os = "android")) {
    if cfg!(any(target_arch = "mips", target_arch = "mips64")) {
        0x80
    } else {
        0x800
    }
} else {
    0x4
};

#[cfg(unix)]
fn without_waiting(mut options: OpenOptions) -> OpenOptions {
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, NON_BLOCKING);
    options
}

#[cfg(not(unix))]
fn without_waiting(options: OpenOptions) -> OpenOptions {
    options
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs;
    use std::process::Command;

    use super::*;

    #[test]
    fn only_regular_files_are_opened_without_waiting() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("file"), "text").unwrap();
        std::os::unix::fs::symlink(at("file"), at("link")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", at("device")).unwrap();
        assert!(
            Command::new("mkfifo")
                .arg(at("pipe"))
                .status()
                .unwrap()
                .success()
        );
        for name in ["file", "link"] {
            assert_eq!(read(&at(name), 4).unwrap(), b"text");
            assert_eq!(
                read(&at(name), 3).unwrap_err().kind(),
                io::ErrorKind::InvalidData
            );
        }
        let writing = OpenOptions::new().write(true).create(true).clone();
        for name in ["device", "pipe"] {
            assert_eq!(
                open(&at(name)).unwrap_err().to_string(),
                "is not a regular file"
            );
            assert_eq!(
                open_with(&at(name), &writing).unwrap_err().kind(),
                io::ErrorKind::InvalidInput
            );
        }
        assert_eq!(
            open(folder.path()).unwrap_err().kind(),
            io::ErrorKind::IsADirectory
        );
        assert_eq!(
            open(&at("missing")).unwrap_err().kind(),
            io::ErrorKind::NotFound
        );
        assert!(open_with(&at("new"), &writing).is_ok());
    }
}
