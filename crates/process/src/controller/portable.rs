//! Copies of the files of a process, with which it is the same controller in another folder.

use std::io::{self, Read as _};
use std::path::{Component, Path};

use crumple_core::regular_file;

use super::{ListedFile, ProcessController, file_digest};

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
        let setup = &self.0.setup;
        let name = setup.file.as_ref()?.path().file_name()?.to_str()?;
        let [first, words @ ..] = setup.command.as_slice() else {
            return None;
        };
        let is_program_elsewhere = setup.program.is_some()
            || Path::new(first).is_absolute()
            || Path::new(first).components().count() == 1;
        let is_small = self.0.files.iter().map(|listed| listed.bytes).sum::<u64>() <= MAX_BYTES;
        let names = self.0.files.iter().map(|listed| listed.path.as_str());
        let is_copied =
            self.0.identity.is_some() && is_small && names.chain([name]).all(is_plain_path);
        let is_portable = is_copied
            && is_program_elsewhere
            && words.iter().all(|word| self.is_portable_word(word));
        is_portable.then_some(name)
    }

    /// Returns true for a word of the command that means the same in another folder with copies of the listed files.
    fn is_portable_word(&self, word: &str) -> bool {
        let path = word.trim_start_matches("./");
        self.0.files.iter().any(|listed| listed.path == path)
            || !self.0.setup.folder.join(word).is_file()
            || Path::new(word).is_absolute()
    }

    /// Reads the files to copy, each with its path in the folder; none without a [portable file](Self::portable_file).
    ///
    /// # Errors
    /// If a file cannot be read, or has changed since the controller was created.
    pub fn portable_files(&self) -> io::Result<Vec<(String, Vec<u8>)>> {
        let Some(name) = self.portable_file() else {
            return Ok(Vec::new());
        };
        let folder = &self.0.setup.folder;
        let mut files = Vec::new();
        for ListedFile { path, sha256, .. } in &self.0.files {
            if file_digest(&folder.join(path))?.sha256 != *sha256 {
                return Err(io::Error::other(format!(
                    "{path} has changed since it was read"
                )));
            }
            files.push((path.clone(), read_file(&folder.join(path))?));
        }
        if !files.iter().any(|(path, _)| path == name) {
            files.push((name.to_owned(), read_file(&folder.join(name))?));
        }
        Ok(files)
    }
}

fn read_file(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    regular_file::open(path)?
        .take(MAX_BYTES)
        .read_to_end(&mut bytes)?;
    Ok(bytes)
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
