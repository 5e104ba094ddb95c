//! What a folder of work holds.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{MANIFEST, UNKNOWN, WorkError, generation};
use crate::disk::{self, DiskError, Files};
use crumple_world::digest::{Sha256, sha256};

/// The version of the file.
const VERSION: u32 = 1;

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Manifest {
    version: u32,
    /// What kind of work it is, as a noun for readers.
    pub(super) kind: String,
    /// [`crate::program::identity`] of the program at work; none once the work is complete, so that results are the same
    /// bytes whatever build made them.
    pub(super) program: Option<String>,
    /// SHA-256 of everything that decides the results.
    pub(super) configuration_sha256: String,
    /// Each file as it may be found: as it is; while a change is on its way, as before it and as after it.
    files: BTreeMap<String, Vec<FileState>>,
    /// SHA-256 of this file with an empty string here.
    sha256: String,
}

/// How a file may be found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum FileState {
    /// It is not there.
    Absent,
    /// It begins with this; what follows has come since, and its records have checks of their own.
    Growing(Prefix),
    /// It has these contents.
    Whole { bytes: u64, sha256: String },
}

/// The first bytes of a file that grows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prefix {
    /// How many there are.
    pub bytes: u64,
    /// Their SHA-256.
    pub sha256: String,
}

impl Prefix {
    /// That of a file of which nothing has to be there.
    pub(super) fn nothing() -> Self {
        Self { bytes: 0, sha256: sha256("") }
    }

    /// Whether a file begins so. Read piece by piece, for it may be larger than memory.
    fn begins(&self, path: &Path) -> Result<Result<(), String>, DiskError> {
        let unreadable = DiskError::at(path);
        let mut file = match fs::File::open(path) {
            Ok(file) => file.take(self.bytes),
            Err(error) if error.kind() == ErrorKind::NotFound && self.bytes == 0 => return Ok(Ok(())),
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Err(MISSING.to_owned())),
            Err(error) => return Err(unreadable(error)),
        };
        let (mut digest, mut part, mut left) = (Sha256::default(), vec![0; 1 << 16], self.bytes);
        loop {
            match file.read(&mut part).map_err(unreadable)? {
                0 => break,
                count => {
                    digest.update(part.get(..count).unwrap_or_default());
                    left = left.saturating_sub(count as u64);
                }
            }
        }
        Ok(match (left, digest.hexadecimal() == self.sha256) {
            (0, true) => Ok(()),
            (0, false) => Err(format!("its first {} bytes are not as they were written", self.bytes)),
            _ => Err(format!("shorter than the {} bytes that were written", self.bytes)),
        })
    }
}

const MISSING: &str = "the file is missing";

impl FileState {
    pub(super) fn of(contents: &[u8]) -> Self {
        Self::Whole { bytes: contents.len() as u64, sha256: sha256(contents) }
    }

    /// Bytes of a file in this state, at most.
    fn bytes(&self) -> u64 {
        match self {
            Self::Absent => 0,
            Self::Growing(_) => u64::MAX,
            Self::Whole { bytes, .. } => *bytes,
        }
    }

    /// Whether a file of these bytes, or none, is in this state.
    fn is(&self, found: Option<&[u8]>) -> bool {
        match (self, found) {
            // `Prefix::begins` has looked.
            (Self::Growing(_), _) => true,
            (Self::Absent, found) => found.is_none(),
            (Self::Whole { bytes, .. }, Some(found)) if *bytes != found.len() as u64 => false,
            (Self::Whole { sha256: expected, .. }, Some(found)) => sha256(found) == *expected,
            (Self::Whole { .. }, None) => false,
        }
    }
}

/// The longest manifest that is read: that of ten thousand files is not a tenth of it.
pub(super) const MOST_BYTES: u64 = 64 << 20;

/// How long a file is; none if there is none. A link, a folder or a pipe in its place is not what was written.
fn plain(path: &Path) -> Result<Option<u64>, WorkError> {
    match fs::symlink_metadata(path) {
        Ok(found) if !found.is_file() => {
            Err(WorkError::damaged(path, "no file of its own: work is kept in plain files"))
        }
        Ok(found) => Ok(Some(found.len())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(source) => Err(DiskError::at(path)(source).into()),
    }
}

/// The bytes of a plain file of at most so many; none if there is none. What is longer is not read.
pub(super) fn regular(path: &Path, most: u64) -> Result<Option<Vec<u8>>, WorkError> {
    match plain(path)? {
        Some(bytes) if bytes > most => Err(WorkError::damaged(path, "not as it was written: longer than it was")),
        Some(_) => Ok(disk::read(path, most)?),
        None => Ok(None),
    }
}

impl Manifest {
    pub(super) fn new(kind: &str, program: &str, configuration_sha256: &str) -> Self {
        Self {
            version: VERSION,
            kind: kind.to_owned(),
            program: Some(program.to_owned()),
            configuration_sha256: configuration_sha256.to_owned(),
            files: BTreeMap::new(),
            sha256: String::new(),
        }
    }

    /// The manifest in a file; none if there is no such file.
    pub(super) fn read(path: &Path) -> Result<Option<Self>, WorkError> {
        let Some(bytes) = regular(path, MOST_BYTES)? else { return Ok(None) };
        let damaged = |problem: String| WorkError::damaged(path, problem);
        let found: Self = serde_json::from_slice(&bytes).map_err(|error| damaged(error.to_string()))?;
        if found.version != VERSION {
            return Err(damaged(format!("version: {}, and this release reads {VERSION}", found.version)));
        }
        match found.text() {
            Ok(text) if text.as_bytes() == bytes => Ok(Some(found)),
            _ => Err(damaged("sha256: not as it was written".to_owned())),
        }
    }

    /// Writes it and its second copy; either may be the older one if the process ends in between, and is right all the same, for
    /// nothing that it says is done before.
    pub(super) fn write(&self, folder: &Path) -> Result<(), DiskError> {
        let path = folder.join(MANIFEST);
        let text = self.text().map_err(|error| DiskError::at(&path)(error.into()))?;
        let mut files = Files::default();
        files.stage(&path, &text)?;
        if self.program.is_some() {
            let second = generation::manifest_in(folder);
            second.parent().map_or(Ok(()), disk::make_folder)?;
            files.stage(&second, &text)?;
        }
        files.commit()
    }

    /// The file, with its digest in it.
    fn text(&self) -> Result<String, serde_json::Error> {
        let with = |sha256| serde_json::to_string_pretty(&Self { sha256, ..self.clone() }).map(|text| text + "\n");
        with(sha256(with(String::new())?))
    }

    /// The bytes of a file, unless it cannot be what was written; none if there is no such file.
    pub(super) fn contents(&self, folder: &Path, name: &str) -> Result<Option<Vec<u8>>, WorkError> {
        let path = folder.join(name);
        let longest = |states: &Vec<FileState>| states.iter().map(FileState::bytes).max();
        match self.files.get(name).and_then(longest) {
            Some(longest) => regular(&path, longest),
            None if path.symlink_metadata().is_ok() => Err(WorkError::damaged(&path, UNKNOWN)),
            None => Ok(None),
        }
    }

    pub(super) fn names(&self) -> Vec<String> {
        self.files.keys().cloned().collect()
    }

    pub(super) fn knows(&self, name: &str) -> bool {
        self.files.contains_key(name)
    }

    /// Files in the folders of the work of which it knows nothing, and folders that are none of its own. In the first folder anything
    /// may lie beside the work.
    pub(super) fn strangers(&self, root: &Path) -> Result<Vec<PathBuf>, DiskError> {
        let mut strangers = Vec::new();
        for folder in self.folders().into_iter().filter(|folder| !self.includes(folder)) {
            let place = root.join(folder);
            if place.is_symlink() {
                strangers.push(place);
                continue;
            }
            let is_known = |path: &PathBuf| {
                let name = path.strip_prefix(root).map(|name| name.to_string_lossy().into_owned());
                name.is_ok_and(|name| self.knows(&name)) || *path == generation::manifest_in(root)
            };
            strangers
                .extend(files_in(&place)?.into_iter().filter(|path| !is_known(path) && !disk::is_unfinished(path)));
        }
        Ok(strangers)
    }

    /// What a file was last said to be, if it is there as a whole.
    pub(super) fn state(&self, name: &str) -> Option<FileState> {
        self.files.get(name)?.last().filter(|state| matches!(state, FileState::Whole { .. })).cloned()
    }

    /// Takes a file that something else has written to be as it is.
    pub(super) fn include(&mut self, name: &str, state: FileState) {
        self.files.insert(name.to_owned(), vec![state]);
    }

    /// Knows no more of what was kept.
    pub(super) fn forget_before(&mut self) {
        self.files.retain(|name, _| !generation::is_of_it(name));
    }

    /// The folders in which there is work of its own.
    pub(super) fn included(&self) -> Vec<String> {
        let folder = |name: &String| Some(name.strip_suffix(MANIFEST)?.strip_suffix('/')?.to_owned());
        self.files.keys().filter_map(folder).collect()
    }

    pub(super) fn includes(&self, folder: &str) -> bool {
        self.knows(&format!("{folder}/{MANIFEST}"))
    }

    /// How a file begins that grows.
    fn prefix(&self, name: &str) -> Option<&Prefix> {
        self.files.get(name)?.iter().find_map(|state| match state {
            FileState::Growing(prefix) => Some(prefix),
            _ => None,
        })
    }

    /// Whether more may follow what is known of a file.
    pub(super) fn grows(&self, name: &str) -> bool {
        self.prefix(name).is_some()
    }

    /// Knows more of a file that grows.
    pub(super) fn grew(&mut self, name: &str, prefix: Prefix) {
        self.files.insert(name.to_owned(), vec![FileState::Growing(prefix)]);
    }

    /// The folders that files are in, beside that of the manifest itself.
    pub(super) fn folders(&self) -> BTreeSet<&str> {
        self.files.keys().filter_map(|name| name.rsplit_once('/')).map(|(folder, _)| folder).collect()
    }

    /// Says what a file will be; false if that is what it is.
    pub(super) fn announce(&mut self, name: &str, to: FileState) -> bool {
        let states = self.files.entry(name.to_owned()).or_insert_with(|| vec![FileState::Absent]);
        if states.as_slice() == std::slice::from_ref(&to) {
            self.forget_absent(name);
            return false;
        }
        states.push(to);
        true
    }

    /// Says that a file is what it was last said to be.
    pub(super) fn made(&mut self, name: &str) {
        if let Some(states) = self.files.get_mut(name)
            && let Some(last) = states.pop()
        {
            *states = vec![last];
            self.forget_absent(name);
        }
    }

    /// Whether a file may be found like this.
    pub(super) fn check(&self, name: &str, found: Option<&[u8]>) -> Result<(), String> {
        let absent = [FileState::Absent];
        let states = self.files.get(name).map_or(&absent[..], Vec::as_slice);
        match states.iter().any(|state| state.is(found)) {
            true => Ok(()),
            false => Err(match found {
                None => MISSING.to_owned(),
                Some(_) if states == absent => UNKNOWN.to_owned(),
                Some(_) => "not as it was written".to_owned(),
            }),
        }
    }

    /// Whether a file in the folder is as it was written.
    pub(super) fn look(&self, folder: &Path, name: &str) -> Result<(), WorkError> {
        let path = folder.join(name);
        let damaged = |problem| WorkError::damaged(&path, problem);
        match self.prefix(name) {
            Some(prefix) => {
                plain(&path)?;
                prefix.begins(&path)?.map_err(damaged)
            }
            None => self.check(name, self.contents(folder, name)?.as_deref()).map_err(damaged),
        }
    }

    /// The same, and remembers how it was found.
    pub(super) fn settle(&mut self, name: &str, found: Option<&[u8]>) -> Result<(), String> {
        self.check(name, found)?;
        if let Some(states) = self.files.get_mut(name) {
            states.retain(|state| state.is(found));
            states.truncate(1);
        }
        self.forget_absent(name);
        Ok(())
    }

    fn forget_absent(&mut self, name: &str) {
        if self.files.get(name).is_some_and(|states| states.as_slice() == [FileState::Absent]) {
            self.files.remove(name);
        }
    }
}

/// The files in a folder, in order; none if there is no such folder.
pub(super) fn files_in(folder: &Path) -> Result<Vec<PathBuf>, DiskError> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(DiskError::at(folder)(source)),
    };
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(DiskError::at(folder))?.path();
        if !path.is_dir() {
            files.push(path);
        }
    }
    files.sort_unstable();
    Ok(files)
}
