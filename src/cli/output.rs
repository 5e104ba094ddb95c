//! Writing results: files appear whole or not at all, and a closed pipe is no error.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use super::Failure;

/// Files to be written together. They are first written beside their places and then moved there, so that a failure
/// leaves nothing half-written.
#[derive(Default)]
pub(super) struct Files {
    staged: Vec<(NamedTempFile, PathBuf)>,
}

impl Files {
    /// Stages a file.
    pub(super) fn stage(&mut self, path: &Path, contents: &[u8]) -> Result<(), Failure> {
        if self.staged.iter().any(|(_, staged)| staged == path) {
            let path = path.display();
            return Err(Failure::Input(format!(
                "{path}: two results would go there: give scenarios names of their own"
            )));
        }
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let stage = || {
            // What cannot be replaced, or is not there, is known before anything is written.
            if path.is_dir() {
                return Err(io::ErrorKind::IsADirectory.into());
            }
            std::fs::metadata(folder)?;
            let mut builder = tempfile::Builder::new();
            // A temporary file is private; the result should be as readable as any other new file.
            #[cfg(unix)]
            builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o644));
            let mut file = builder.tempfile_in(folder)?;
            file.write_all(contents)?;
            Ok(file)
        };
        let file = stage().map_err(|error: io::Error| {
            // The kind alone: the error itself would name a temporary file nobody asked for.
            let source = match error.kind() {
                io::ErrorKind::NotFound => io::Error::new(io::ErrorKind::NotFound, "there is no such folder"),
                kind => kind.into(),
            };
            Failure::environment(path, source)
        })?;
        self.staged.push((file, path.to_owned()));
        Ok(())
    }

    /// Moves every staged file to its place.
    pub(super) fn commit(self) -> Result<(), Failure> {
        for (file, path) in self.staged {
            file.persist(&path).map_err(|error| Failure::environment(&path, error.error))?;
        }
        Ok(())
    }
}

/// Prints to standard output.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(Failure::NobodyListens),
        Err(source) => Err(Failure::environment(Path::new("standard output"), source)),
    }
}

/// Says something on standard error, unless told to be quiet.
pub(super) fn note(text: &str, quiet: bool) {
    if !quiet {
        // A closed standard error leaves nowhere to complain.
        let _ = writeln!(io::stderr(), "{text}");
    }
}
