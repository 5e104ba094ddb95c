//! Lookup of the recorded verdicts of a scenario file.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::{fs, iter};

use super::{ExpectedFile, ExpectedVerdict};
use crumple_world::scenario::file::{EXPECTED_FILE_NAME, FileError, LEGACY_EXPECTED_FILE_NAME};

/// A reader of recorded verdicts, which reads the record of each folder once.
#[derive(Debug, Default)]
pub struct VerdictRecordReader {
    folders: HashMap<PathBuf, ExpectedFile>,
}

/// The verdicts recorded for one scenario file.
#[derive(Debug)]
pub struct RecordedVerdicts<'a> {
    /// Folder of the record and of the controllers that it names.
    pub folder: PathBuf,
    /// Verdicts, at least one.
    pub verdicts: Vec<&'a ExpectedVerdict>,
}

impl VerdictRecordReader {
    /// Returns the verdicts on a scenario file that are recorded in its folder or in the parent folder, if any.
    ///
    /// # Errors
    /// [`FileError`] for a record that cannot be read or parsed.
    pub fn find(&mut self, scenario: &Path) -> Result<Option<RecordedVerdicts<'_>>, FileError> {
        let Ok(path) = fs::canonicalize(scenario) else { return Ok(None) };
        let folders: Vec<&Path> = path.ancestors().skip(1).take(2).collect();
        for folder in &folders {
            self.read_folder(folder)?;
        }
        let records = &self.folders;
        Ok(folders.into_iter().find_map(|folder| {
            let recorded = records.get(folder)?.expected.iter();
            let verdicts: Vec<_> = recorded.filter(|one| folder.join(&one.scenario) == path).collect();
            (!verdicts.is_empty()).then(|| RecordedVerdicts { folder: folder.to_owned(), verdicts })
        }))
    }

    fn read_folder(&mut self, folder: &Path) -> Result<(), FileError> {
        if !self.folders.contains_key(folder) {
            let has_record =
                [EXPECTED_FILE_NAME, LEGACY_EXPECTED_FILE_NAME].iter().any(|name| folder.join(name).is_file());
            let read = if has_record { ExpectedFile::load_from_folder(folder)? } else { ExpectedFile::default() };
            self.folders.insert(folder.to_owned(), read);
        }
        Ok(())
    }
}

impl<'a> RecordedVerdicts<'a> {
    /// Returns one verdict for each controller in the record, distinguished by name, hashes and estimator.
    #[must_use]
    pub fn by_controller(&self) -> Vec<&'a ExpectedVerdict> {
        let mut first: Vec<&ExpectedVerdict> = Vec::new();
        for verdict in &self.verdicts {
            let is_known = |known: &&ExpectedVerdict| {
                (&known.controller, &known.policy_sha256, &known.controller_sha256, known.estimator)
                    == (&verdict.controller, &verdict.policy_sha256, &verdict.controller_sha256, verdict.estimator)
            };
            if !first.iter().any(is_known) {
                first.push(verdict);
            }
        }
        first
    }

    /// Returns the folders that may contain the controller of a verdict: the record's, and, with a hash, the current
    /// one.
    pub fn controller_folders(&self, verdict: &ExpectedVerdict) -> impl Iterator<Item = PathBuf> {
        let current = verdict.policy_sha256.as_ref().or(verdict.controller_sha256.as_ref()).map(|_| PathBuf::new());
        iter::once(self.folder.clone()).chain(current)
    }
}
