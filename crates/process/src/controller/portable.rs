//! Copies of the files of a process, with which it is the same controller in another folder.

use std::io::{self, Read as _};
use std::path::{Component, Path};

use crumple_core::regular_file;

use super::{ListedFile, ProcessController, file_sha256};
use crate::setup::ProcessSetup;

/// Maximum size of all listed files, in bytes.
const MAX_BYTES: u64 = 64 << 20;

impl ProcessController {
    /// Returns the name of the controller file or FMU that is this controller in any folder with copies of its files.
    ///
    /// `None` if copies would not be: without an identity, if the program or another file of the command is in the
    /// folder and not listed, and if the listed files exceed 64 MiB. A program in the folder cannot be listed either,
    /// because a copy is not executable.
    #[must_use]
    pub fn portable_file(&self) -> Option<&str> {
        let ProcessSetup {
            command,
            program,
            folder,
            file,
            ..
        } = &self.0.setup;
        let name = file.as_ref()?.path().file_name()?.to_str()?;
        let is_listed = |path: &str| {
            self.0
                .files
                .iter()
                .any(|listed| listed.path == path.trim_start_matches("./"))
        };
        let is_portable = |word: &String| {
            is_listed(word) || !folder.join(word).is_file() || Path::new(word).is_absolute()
        };
        let (first, words) = command.split_first()?;
        let is_program_elsewhere = program.is_some()
            || Path::new(first).is_absolute()
            || Path::new(first).components().count() == 1;
        let is_small = self.0.files.iter().map(|listed| listed.bytes).sum::<u64>() <= MAX_BYTES;
        let names = self.0.files.iter().map(|listed| listed.path.as_str());
        let is_copied =
            self.0.identity.is_some() && is_small && names.chain([name]).all(is_plain_path);
        (is_copied && is_program_elsewhere && words.iter().all(is_portable)).then_some(name)
    }

    /// Reads the files to copy, each with its path in the folder; none without a [portable file](Self::portable_file).
    ///
    /// # Errors
    /// If a file cannot be read, or has changed since the controller was created.
    pub fn portable_files(&self) -> io::Result<Vec<(String, Vec<u8>)>> {
        let Some(name) = self.portable_file() else {
            return Ok(Vec::new());
        };
        let read = |path: &str| -> io::Result<Vec<u8>> {
            let mut bytes = Vec::new();
            regular_file::open(&self.0.setup.folder.join(path))?
                .take(MAX_BYTES)
                .read_to_end(&mut bytes)?;
            Ok(bytes)
        };
        let mut files = Vec::new();
        for ListedFile { path, sha256, .. } in &self.0.files {
            if file_sha256(&self.0.setup.folder.join(path))?.0 != *sha256 {
                return Err(io::Error::other(format!(
                    "{path} has changed since it was read"
                )));
            }
            files.push((path.clone(), read(path)?));
        }
        if !files.iter().any(|(path, _)| path == name) {
            files.push((name.to_owned(), read(name)?));
        }
        Ok(files)
    }
}

/// Returns true for a path below the folder that any system accepts in a listing of files.
fn is_plain_path(path: &str) -> bool {
    let is_below = Path::new(path)
        .components()
        .all(|part| matches!(part, Component::Normal(_)));
    is_below
        && !path.is_empty()
        && !path
            .chars()
            .any(|letter| letter.is_control() || letter == '\\')
}
