//! Results whose file names crumple chooses, in a folder that the user named.
//!
//! crumple writes a file if none exists, or if crumple wrote the existing file and it has not changed since. Any other
//! file stays. Symbolic links are not followed. If one file may not be written, none is. A listing in the folder, in
//! the format of `sha256sum`, records the files that crumple wrote.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};

use crumple_core::digest::{Sha256, sha256};
use crumple_core::text_file::FileError;
use crumple_core::{regular_file, text_file};

use crate::disk::{self, DiskError, StagedFiles};

/// An error of writing files into a folder.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// The listing cannot be read.
    #[error(transparent)]
    Listing(#[from] FileError),
    /// A line of the listing names no file in the folder.
    #[error(
        "{}:{line}: expected a SHA-256 and the name of a file in this folder: use another folder",
        path.display()
    )]
    ListingLine {
        /// Path of the listing.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
    },
    /// crumple may not write a file of this name.
    #[error("{}: {problem}", path.display())]
    Refused {
        /// Path of the file, or of the link that leads to it.
        path: PathBuf,
        /// Problem with it, and advice.
        problem: String,
    },
}

impl OutputError {
    fn refused(path: &Path, problem: &str) -> Self {
        Self::Refused {
            path: path.to_owned(),
            problem: problem.to_owned(),
        }
    }
}

/// A folder for results whose file names crumple chooses.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    /// Name of the listing; with `None`, only equal files, and with `force` any plain file, may exist.
    listing: Option<&'static str>,
    /// Name of the file that describes all others ([`Self::with_manifest`]).
    manifest: Option<&'static str>,
    force: bool,
    /// SHA-256 of every file that crumple wrote there, by name. During a change there are two.
    recorded: BTreeMap<String, BTreeSet<String>>,
}

/// Policy for files of earlier commands in the same folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EarlierFiles {
    /// They stay, and the new listing names them.
    Keep,
    /// The new files replace all of them, except those that have changed since.
    Replace,
}

impl OutputFolder {
    /// Reads the listing of a folder, if there is one.
    ///
    /// # Errors
    /// [`OutputError`] if the listing cannot be read, or names files elsewhere.
    pub fn with_listing(path: &Path, listing: &'static str) -> Result<Self, OutputError> {
        let folder = Self {
            listing: Some(listing),
            ..Self::without_listing(path, false)
        };
        let before = read_listing(&path.join(listing))?;
        let announced = read_listing(&pending_listing(path, listing))?;
        Ok(folder.with_known_files(before.into_iter().chain(announced)))
    }

    /// Returns a folder without a listing. With `force` any plain file there may be replaced, otherwise none.
    #[must_use]
    pub fn without_listing(path: &Path, force: bool) -> Self {
        Self {
            path: path.to_owned(),
            listing: None,
            manifest: None,
            force,
            recorded: BTreeMap::new(),
        }
    }

    /// Sets the name of a file that describes all others. It is removed before they change, and written after them, so
    /// that it never describes files of different results.
    #[must_use]
    pub fn with_manifest(mut self, manifest: &'static str) -> Self {
        self.manifest = Some(manifest);
        self
    }

    /// Adds names and SHA-256 of files that crumple wrote.
    #[must_use]
    pub fn with_known_files(mut self, files: impl IntoIterator<Item = (String, String)>) -> Self {
        for (name, digest) in files {
            self.recorded.entry(name).or_default().insert(digest);
        }
        self
    }

    /// Checks, before long work, that files of these names may be written with any contents.
    ///
    /// # Errors
    /// [`OutputError::Refused`] names the first file that has changed, or that crumple did not write.
    pub fn check(&self, names: &[&str]) -> Result<(), OutputError> {
        let changed = names.iter().find(|name| {
            self.path.join(name).symlink_metadata().is_ok() && self.unchanged_digest(name).is_none()
        });
        let Some(path) = changed.map(|name| self.path.join(name)) else {
            return Ok(());
        };
        let problem = if path.is_symlink() {
            SYMLINK_PROBLEM
        } else {
            CHANGED_FILE_PROBLEM
        };
        Err(OutputError::refused(&path, problem))
    }

    /// Writes files and the listing. Creates the folder if it is missing. A file with equal contents stays as it is.
    ///
    /// # Errors
    /// [`OutputError`] if a file may not or cannot be written. Unless it occurs while the staged files are moved into
    /// place, no file has changed.
    pub fn write(
        &self,
        contents: &[(String, Vec<u8>)],
        earlier: EarlierFiles,
    ) -> Result<(), OutputError> {
        disk::make_folder(&self.path)?;
        disk::remove_unfinished(&self.path)?;
        let mut staged = StagedOutput::default();
        for (name, contents) in contents {
            let files = if self.manifest == Some(name.as_str()) {
                &mut staged.manifest
            } else {
                &mut staged.files
            };
            self.stage(files, name, contents)?;
        }
        let Some(listing) = self.listing else {
            return Ok(self.commit(staged)?);
        };
        self.commit_with_listing(staged, contents, earlier, listing)
    }

    /// Moves staged files into place, with a listing of them and of the earlier files that stay.
    fn commit_with_listing(
        &self,
        mut staged: StagedOutput,
        contents: &[(String, Vec<u8>)],
        earlier: EarlierFiles,
        listing: &str,
    ) -> Result<(), OutputError> {
        let mut next: BTreeMap<&str, String> = contents
            .iter()
            .map(|(name, contents)| (name.as_str(), sha256(contents)))
            .collect();
        let mut stale = Vec::new();
        for (name, digest) in self
            .recorded
            .keys()
            .filter_map(|name| Some((name.as_str(), self.unchanged_digest(name)?)))
        {
            match (next.contains_key(name), earlier) {
                (true, _) => {}
                (false, EarlierFiles::Keep) => drop(next.insert(name, digest)),
                (false, EarlierFiles::Replace) => stale.push(self.path.join(name)),
            }
        }
        let after: String = next
            .iter()
            .map(|(name, digest)| listing_line(name, digest))
            .collect();
        let announced = pending_listing(&self.path, listing);
        disk::write(&announced, self.recorded_lines() + &after)?;
        match after.is_empty() {
            true => stale.push(self.path.join(listing)),
            false => staged.files.stage(&self.path.join(listing), after)?,
        }
        self.commit(staged)?;
        // Removed last: until then the pending listing knows the stale files.
        stale.push(announced);
        Ok(disk::remove(&stale)?)
    }

    /// Moves staged files into place.
    fn commit(&self, staged: StagedOutput) -> Result<(), DiskError> {
        if let Some(manifest) = self.manifest.filter(|_| !staged.manifest.is_empty()) {
            disk::remove(&[self.path.join(manifest)])?;
        }
        staged.files.commit()?;
        staged.manifest.commit()
    }

    fn recorded_lines(&self) -> String {
        self.recorded
            .iter()
            .flat_map(|(name, digests)| digests.iter().map(|digest| listing_line(name, digest)))
            .collect()
    }

    /// Stages a file, and creates the folder if it is missing. A file with equal contents stays as it is.
    ///
    /// # Errors
    /// [`OutputError`] if the file may not or cannot be written.
    pub fn stage(
        &self,
        files: &mut StagedFiles,
        name: &str,
        contents: &[u8],
    ) -> Result<(), OutputError> {
        let path = self.path.join(name);
        if let Some(link) = self.find_symlink(&path) {
            return Err(OutputError::refused(link, SYMLINK_PROBLEM));
        }
        path.parent().map_or(Ok(()), disk::make_folder)?;
        let advice = if self.listing.is_some() {
            CHANGED_FILE_PROBLEM
        } else {
            EXISTING_FILE_PROBLEM
        };
        stage(
            files,
            &path,
            contents,
            |digest| {
                self.force
                    || self
                        .recorded
                        .get(name)
                        .is_some_and(|digests| digests.contains(digest))
            },
            advice,
        )
    }

    /// Returns the digest of a file that crumple wrote and that has not changed since.
    fn unchanged_digest(&self, name: &str) -> Option<String> {
        let path = self.path.join(name);
        let is_plain = self.find_symlink(&path).is_none()
            && fs::symlink_metadata(&path).is_ok_and(|metadata| metadata.is_file());
        let digest = is_plain.then(|| file_digest(&path).ok()).flatten()?;
        self.recorded.get(name)?.contains(&digest).then_some(digest)
    }

    /// Returns the first folder between this one and a file in it that is a symbolic link.
    fn find_symlink<'a>(&self, path: &'a Path) -> Option<&'a Path> {
        let between = path
            .ancestors()
            .skip(1)
            .take_while(|folder| *folder != self.path);
        between.into_iter().find(|folder| folder.is_symlink())
    }
}

/// Staged files of an [`OutputFolder`].
#[derive(Default)]
struct StagedOutput {
    files: StagedFiles,
    /// The file that describes the others, moved into place last.
    manifest: StagedFiles,
}

const SYMLINK_PROBLEM: &str = "is a symbolic link, and crumple writes only regular files: remove it, or use another \
                               name";
const CHANGED_FILE_PROBLEM: &str =
    "has changed, or crumple did not write it here: move it, or use another folder";
/// Problem of a file that may be replaced only with `--force`.
pub const EXISTING_FILE_PROBLEM: &str =
    "exists with other contents: use --force to overwrite it, or another name";

/// Stages a file if none exists, or `is_own` accepts the digest of the existing plain file.
///
/// # Errors
/// [`OutputError`] if the file cannot be written, or another file is there: its problem is `otherwise`.
pub fn stage(
    files: &mut StagedFiles,
    path: &Path,
    contents: &[u8],
    is_own: impl FnOnce(&str) -> bool,
    otherwise: &str,
) -> Result<(), OutputError> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Ok(files.stage(path, contents)?);
        }
        Err(error) => return Err(DiskError::at(path)(error).into()),
        Ok(metadata) if metadata.is_symlink() => {
            return Err(OutputError::refused(path, SYMLINK_PROBLEM));
        }
        Ok(metadata) if !metadata.is_file() => {
            let problem = "is not a regular file: remove it, or use another name";
            return Err(OutputError::refused(path, problem));
        }
        Ok(_) => {}
    }
    match file_digest(path)? {
        digest if digest == sha256(contents) => Ok(()),
        digest if is_own(&digest) => Ok(files.stage(path, contents)?),
        _ => Err(OutputError::refused(path, otherwise)),
    }
}

/// Returns the path of the pending listing, which exists while files are moved into place. After a crash the next
/// process finds the old and the new digests in it.
fn pending_listing(folder: &Path, listing: &str) -> PathBuf {
    folder.join(format!(".{listing}.next"))
}

fn listing_line(name: &str, digest: &str) -> String {
    format!("{digest}  {name}\n")
}

/// Reads a listing: names and SHA-256 of files next to it. Empty if there is no such file.
fn read_listing(path: &Path) -> Result<Vec<(String, String)>, OutputError> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Ok(metadata) if !metadata.is_file() => {
            let problem = "is not a regular file, but crumple needs this name for its list of written files: remove \
                           it, or use another folder";
            return Err(OutputError::refused(path, problem));
        }
        _ => {}
    }
    let text = text_file::read(path)?;
    text.lines()
        .enumerate()
        .map(|(index, line)| {
            parse_listing_line(line).ok_or_else(|| OutputError::ListingLine {
                path: path.to_owned(),
                line: index + 1,
            })
        })
        .collect()
}

/// Returns the name and the SHA-256 of a line; `None` for a name outside the folder.
fn parse_listing_line(line: &str) -> Option<(String, String)> {
    let (digest, name) = line.split_once("  ")?;
    let is_within = Path::new(name)
        .components()
        .all(|part| matches!(part, Component::Normal(_)));
    (digest.len() == 64 && is_within).then(|| (name.to_owned(), digest.to_owned()))
}

fn file_digest(path: &Path) -> Result<String, DiskError> {
    let mut digest = Sha256::default();
    let mut copied = regular_file::open(path).map_err(DiskError::at(path))?;
    io::copy(&mut copied, &mut digest).map_err(DiskError::at(path))?;
    Ok(digest.hexadecimal())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(contents: &str) -> Vec<(String, Vec<u8>)> {
        ["a.html", "b/c.csv", "work.json"]
            .map(|name| (name.to_owned(), format!("{name} {contents}").into_bytes()))
            .into()
    }

    fn open(path: &Path) -> OutputFolder {
        OutputFolder::with_listing(path, "list.sha256")
            .unwrap()
            .with_manifest("work.json")
    }

    /// No manifest describes a mixture of old and new files, and the same call completes it.
    #[test]
    fn a_change_that_stops_leaves_no_manifest() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        open(folder.path())
            .write(&files("old"), EarlierFiles::Replace)
            .unwrap();
        let new = files("new");
        let interrupted = open(folder.path());
        let mut staged = StagedOutput::default();
        for (name, contents) in &new {
            let files = match name.as_str() {
                "work.json" => &mut staged.manifest,
                _ => &mut staged.files,
            };
            interrupted.stage(files, name, contents).unwrap();
        }
        let announced: String = new
            .iter()
            .map(|(name, contents)| listing_line(name, &sha256(contents)))
            .collect();
        disk::write(&pending_listing(folder.path(), "list.sha256"), announced).unwrap();
        // A folder in the place of a file makes its rename fail, after that of `a.html`.
        fs::remove_file(at("b/c.csv")).unwrap();
        fs::create_dir(at("b/c.csv")).unwrap();
        assert!(interrupted.commit(staged).is_err());
        assert_eq!(fs::read(at("a.html")).unwrap(), new[0].1);
        assert!(!at("work.json").exists());
        fs::remove_dir(at("b/c.csv")).unwrap();
        open(folder.path())
            .write(&new, EarlierFiles::Replace)
            .unwrap();
        for (name, contents) in &new {
            assert_eq!(&fs::read(at(name)).unwrap(), contents, "{name}");
        }
        assert!(!pending_listing(folder.path(), "list.sha256").exists());
    }
}
