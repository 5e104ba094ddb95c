//! Lookup of the recorded verdicts of a scenario file.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::{ExpectedFile, ExpectedVerdict, ReplayError};
use crumple_controllers::{ControllerSpec, Controllers, UnknownController};
use crumple_core::text_file::FileError;
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::file::{EXPECTED_FILE_NAME, LEGACY_EXPECTED_FILE_NAME};

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
        let Ok(path) = fs::canonicalize(scenario) else {
            return Ok(None);
        };
        let folders: Vec<&Path> = path.ancestors().skip(1).take(2).collect();
        for folder in &folders {
            self.read_folder(folder)?;
        }
        let records = &self.folders;
        Ok(folders.into_iter().find_map(|folder| {
            let recorded = records.get(folder)?.expected.iter();
            let verdicts: Vec<_> = recorded
                .filter(|verdict| folder.join(&verdict.scenario) == path)
                .collect();
            (!verdicts.is_empty()).then(|| RecordedVerdicts {
                folder: folder.to_owned(),
                verdicts,
            })
        }))
    }

    fn read_folder(&mut self, folder: &Path) -> Result<(), FileError> {
        if !self.folders.contains_key(folder) {
            let has_record = [EXPECTED_FILE_NAME, LEGACY_EXPECTED_FILE_NAME]
                .iter()
                .any(|name| folder.join(name).is_file());
            let record = if has_record {
                ExpectedFile::load_from_folder(folder)?
            } else {
                ExpectedFile::default()
            };
            self.folders.insert(folder.to_owned(), record);
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
            let identity = controller_identity(verdict);
            if !first
                .iter()
                .any(|earlier| controller_identity(earlier) == identity)
            {
                first.push(verdict);
            }
        }
        first
    }

    /// Finds the controller of a verdict, and starts its program once as a trial.
    ///
    /// A campaign records the path of a file as the user gave it, and not the folder to which it is relative. This
    /// function searches the folder of the record and the current one. If the record has a hash, which proves that a
    /// file is the right one, it also searches the folders above the record. Commands run in the current folder, or
    /// else in that of the record.
    ///
    /// # Errors
    /// [`ReplayError`] if there is no such file, it is not the recorded controller, or its program does not start.
    pub fn find_controller(
        &self,
        verdict: &ExpectedVerdict,
        controllers: Controllers,
    ) -> Result<NamedController, ReplayError> {
        let parsed = ControllerSpec::parse(&verdict.controller).ok();
        let folders = match parsed.as_ref().and_then(ControllerSpec::file) {
            None => vec![PathBuf::new(), self.folder.clone()],
            Some(file) => self.folders_with_file(verdict, file)?,
        };
        let mut attempts = folders.iter().map(|folder| {
            let controller = verdict.find_controller(folder, controllers)?;
            controller.try_start().map_err(UnknownController::from)?;
            Ok(controller)
        });
        // The first error is that of the likeliest folder.
        match attempts.next() {
            Some(Err(first)) => attempts.find_map(Result::ok).ok_or(first),
            Some(controller) => controller,
            None => Err(ReplayError::MissingController { folders }),
        }
    }

    /// Returns the folders that have the controller's file, the likeliest first.
    fn folders_with_file(
        &self,
        verdict: &ExpectedVerdict,
        file: &str,
    ) -> Result<Vec<PathBuf>, ReplayError> {
        let has_hash = verdict.policy_sha256.is_some() || verdict.controller_sha256.is_some();
        let above = self
            .folder
            .ancestors()
            .skip(1)
            .filter(|_| has_hash)
            .map(Path::to_owned);
        let searched: Vec<PathBuf> = [self.folder.clone(), PathBuf::new()]
            .into_iter()
            .chain(above)
            .collect();
        let with_file: Vec<_> = searched
            .iter()
            .filter(|folder| folder.join(file).exists())
            .cloned()
            .collect();
        if with_file.is_empty() {
            return Err(ReplayError::MissingController { folders: searched });
        }
        Ok(with_file)
    }
}

/// Returns what distinguishes the controllers of a record.
fn controller_identity(
    verdict: &ExpectedVerdict,
) -> (&str, Option<&str>, Option<&str>, EstimatorKind) {
    (
        &verdict.controller,
        verdict.policy_sha256.as_deref(),
        verdict.controller_sha256.as_deref(),
        verdict.estimator,
    )
}
