//! Results whose file names crumple chooses, in a folder that the user named.
//!
//! crumple writes a file if none exists, or if crumple wrote the existing file and it has not changed since. Any other
//! file stays. Symbolic links are not followed. If one file may not be written, none is. A listing in the folder, in
//! the format of `sha256sum`, records the files that crumple wrote. Files that the user named are not subject to this:
//! see [`output::resolve_output_path`].

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};

use super::{CliError, output};
use crumple_core::digest::{Sha256, sha256};
use crumple_core::{regular_file, text_file};
use crumple_store::disk::{self, DiskError, StagedFiles};

#[derive(Debug)]
pub(super) struct OutputFolder {
    path: PathBuf,
    /// Name of the listing; with `None`, only equal files, and with `force` any plain file, may exist.
    listing: Option<&'static str>,
    force: bool,
    /// SHA-256 of every file that crumple wrote there, by name. During a change there are two.
    recorded: BTreeMap<String, BTreeSet<String>>,
}

/// Policy for files of earlier commands in the same folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EarlierFiles {
    Keep,
    /// The new files replace all of them, except those that have changed since.
    Replace,
}

impl OutputFolder {
    /// Reads the listing of a folder, if there is one.
    pub(super) fn with_listing(path: &Path, listing: &'static str) -> Result<Self, CliError> {
        let folder = Self {
            listing: Some(listing),
            ..Self::without_listing(path, false)
        };
        let before = read_listing(&path.join(listing))?;
        let announced = read_listing(&pending_listing(path, listing))?;
        Ok(folder.with_known_files(before.into_iter().chain(announced)))
    }

    /// Returns a folder without a listing. With `force` any plain file there may be replaced, otherwise none.
    pub(super) fn without_listing(path: &Path, force: bool) -> Self {
        Self {
            path: path.to_owned(),
            listing: None,
            force,
            recorded: BTreeMap::new(),
        }
    }

    pub(super) fn with_known_files(
        mut self,
        files: impl IntoIterator<Item = (String, String)>,
    ) -> Self {
        for (name, digest) in files {
            self.recorded.entry(name).or_default().insert(digest);
        }
        self
    }

    /// Checks, before long work, that files of these names may be written with any contents.
    pub(super) fn check(&self, names: &[&str]) -> Result<(), CliError> {
        let changed = names.iter().find(|name| {
            self.path.join(name).symlink_metadata().is_ok() && self.unchanged_digest(name).is_none()
        });
        match changed {
            Some(name) => Err(CliError::at(&self.path.join(name), CHANGED_FILE_PROBLEM)),
            None => Ok(()),
        }
    }

    /// Writes files and the listing. Creates the folder if it is missing. A file with equal contents stays as it is.
    pub(super) fn write(
        &self,
        contents: &[(String, Vec<u8>)],
        earlier: EarlierFiles,
    ) -> Result<(), CliError> {
        disk::make_folder(&self.path)?;
        disk::remove_unfinished(&self.path)?;
        let mut files = StagedFiles::default();
        for (name, contents) in contents {
            self.stage(&mut files, name, contents)?;
        }
        let Some(listing) = self.listing else {
            return Ok(files.commit()?);
        };
        self.commit_with_listing(files, contents, earlier, listing)
    }

    /// Moves staged files into place, with a listing of them and of the earlier files that stay.
    fn commit_with_listing(
        &self,
        mut files: StagedFiles,
        contents: &[(String, Vec<u8>)],
        earlier: EarlierFiles,
        listing: &str,
    ) -> Result<(), CliError> {
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
            false => files.stage(&self.path.join(listing), after)?,
        }
        files.commit()?;
        // Removed last: until then the pending listing knows the stale files.
        stale.push(announced);
        Ok(disk::remove(&stale)?)
    }

    fn recorded_lines(&self) -> String {
        self.recorded
            .iter()
            .flat_map(|(name, digests)| digests.iter().map(|digest| listing_line(name, digest)))
            .collect()
    }

    /// Stages a file, and creates the folder if it is missing. A file with equal contents stays as it is.
    pub(super) fn stage(
        &self,
        files: &mut StagedFiles,
        name: &str,
        contents: &[u8],
    ) -> Result<(), CliError> {
        let path = self.path.join(name);
        if let Some(link) = self.find_symlink(&path) {
            return Err(CliError::at(link, SYMLINK_PROBLEM));
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

const SYMLINK_PROBLEM: &str = "is a symbolic link, and crumple writes only regular files: remove it, or use another \
                               name";
const CHANGED_FILE_PROBLEM: &str =
    "has changed, or crumple did not write it here: move it, or use another --out";
const EXISTING_FILE_PROBLEM: &str =
    "exists with other contents: use --force to overwrite it, or another name";

/// Stages a file that the user named. With `force` it may replace a file with other contents.
pub(super) fn stage_unless_edited(
    files: &mut StagedFiles,
    path: &Path,
    bytes: &[u8],
    force: bool,
) -> Result<(), CliError> {
    stage(
        files,
        &output::resolve_output_path(path)?,
        bytes,
        |_| force,
        EXISTING_FILE_PROBLEM,
    )
}

/// Stages a file if none exists, or `is_own` accepts the digest of the existing plain file.
pub(super) fn stage(
    files: &mut StagedFiles,
    path: &Path,
    contents: &[u8],
    is_own: impl FnOnce(&str) -> bool,
    otherwise: &str,
) -> Result<(), CliError> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Ok(files.stage(path, contents)?);
        }
        Err(error) => return Err(DiskError::at(path)(error).into()),
        Ok(metadata) if metadata.is_symlink() => return Err(CliError::at(path, SYMLINK_PROBLEM)),
        Ok(metadata) if !metadata.is_file() => {
            let problem = "is not a regular file: remove it, or use another name";
            return Err(CliError::at(path, problem));
        }
        Ok(_) => {}
    }
    match file_digest(path)? {
        digest if digest == sha256(contents) => Ok(()),
        digest if is_own(&digest) => Ok(files.stage(path, contents)?),
        _ => Err(CliError::at(path, otherwise)),
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
fn read_listing(path: &Path) -> Result<Vec<(String, String)>, CliError> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Ok(metadata) if !metadata.is_file() => {
            let problem = "is not a regular file, but crumple needs this name for its list of written files: remove \
                           it, or use another --out";
            return Err(CliError::at(path, problem));
        }
        _ => {}
    }
    let text = text_file::read(path)?;
    text.lines()
        .enumerate()
        .map(|(index, line)| {
            parse_listing_line(line).ok_or_else(|| {
                let problem =
                    "expected a SHA-256 and the name of a file in this folder: use another --out";
                CliError::Input(format!("{}:{}: {problem}", path.display(), index + 1))
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
