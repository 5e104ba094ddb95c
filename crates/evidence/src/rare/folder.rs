//! A finished estimate in a run folder: `rare-estimate.json` and the manifest `work.json`.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::{RareError, RarePlan, RareReport};
use crumple_store::run_folder::{RunFolder, RunFolderError, RunFolderOptions};

const ESTIMATE_FILE: &str = "rare-estimate.json";

/// An open folder of an estimate.
#[derive(Debug)]
pub struct RareFolder {
    run_folder: RunFolder,
}

impl RarePlan {
    /// Opens the folder if it is empty or belongs to this estimate. A finished estimate is read with `resume`, and
    /// refused otherwise.
    ///
    /// # Errors
    /// [`RareError`] if the folder cannot be used, has other content, or is damaged.
    pub fn open_folder(&self, folder: &Path, resume: bool) -> Result<RareFolder, RareError> {
        if resume && self.controller.kind.identity().is_none() {
            return Err(RareError::NoIdentity(self.controller.name.clone()));
        }
        let record = self.record()?;
        let configuration = json!({
            "controller": record.controller,
            "controller_sha256": record.controller_sha256,
            "estimator": record.estimator,
            "space_sha256": record.space_sha256,
            "failure": record.failure,
            "seed": record.seed,
            "effort": record.effort,
        });
        let asked = RunFolderOptions {
            kind: "rare-failure estimate",
            configuration: &configuration.to_string(),
            configuration_file: ESTIMATE_FILE,
            resume,
            outputs: &[ESTIMATE_FILE],
        };
        Ok(RareFolder { run_folder: RunFolder::open(folder, asked)? })
    }
}

impl RareFolder {
    /// Reads the saved estimate.
    ///
    /// # Errors
    /// [`RareError::RunFolder`] if it is damaged.
    pub fn read_report(&self) -> Result<Option<RareReport>, RareError> {
        let damaged = |error: serde_json::Error| RunFolderError::damaged(&self.path(), format!("no estimate: {error}"));
        let bytes = self.run_folder.read(ESTIMATE_FILE)?;
        let kept: Option<RareReport> =
            bytes.map(|bytes| serde_json::from_slice(&bytes)).transpose().map_err(damaged)?;
        Ok(kept.map(RareReport::with_gaps))
    }

    /// Writes the estimate without rates per hour, which depend on the number of resamples. Leaves a complete folder
    /// unchanged.
    ///
    /// # Errors
    /// [`RareError::RunFolder`] if it cannot be written.
    pub fn write_report(&self, report: &RareReport) -> Result<(), RareError> {
        if self.run_folder.is_complete() {
            return Ok(());
        }
        let report = RareReport { exposure: None, ..report.clone() };
        self.run_folder.write(ESTIMATE_FILE, serde_json::to_string_pretty(&report)? + "\n")?;
        Ok(self.run_folder.finish()?)
    }

    /// Returns the path of the estimate.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        self.run_folder.path(ESTIMATE_FILE)
    }
}
