//! An estimate in a folder: `rare-estimate.json`, and `work.json`, which says what it is. Nothing is kept halfway.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::driving::RareRecord;
use super::{RareError, RarePlan, RareReport};
use crate::work::{Asked, Work, WorkError};

const ESTIMATE: &str = "rare-estimate.json";

/// A folder for one estimate, in use.
#[derive(Debug)]
pub struct RareFolder {
    work: Work,
}

impl RarePlan {
    /// The folder, if it is this estimate's or nobody's. One that is there is read where `resume` says so, and refused otherwise.
    ///
    /// # Errors
    /// [`RareError`] if the folder cannot be used, holds something else, or is damaged.
    pub fn in_folder(&self, folder: &Path, resume: bool) -> Result<RareFolder, RareError> {
        if resume && self.controller.kind.identity().is_none() {
            return Err(RareError::Unknown(self.controller.name.clone()));
        }
        self.record()?.in_folder(folder, resume)
    }
}

impl RareRecord {
    /// The folder of the whole estimate.
    pub(super) fn in_folder(&self, folder: &Path, resume: bool) -> Result<RareFolder, RareError> {
        let configuration = json!({
            "controller": self.controller,
            "controller_sha256": self.controller_sha256,
            "estimator": self.estimator,
            "space_sha256": self.space_sha256,
            "failure": self.failure,
            "seed": self.seed,
            "method": self.method,
            "effort": self.effort,
        });
        let asked = Asked {
            kind: "rare-failure estimate",
            configuration: &configuration.to_string(),
            configuration_file: ESTIMATE,
            resume,
            outputs: &[ESTIMATE],
        };
        Ok(RareFolder { work: Work::open(folder, asked)? })
    }
}

impl RareReport {
    /// What is kept of it.
    pub(super) fn kept(&self) -> Self {
        Self { exposed: None, ..self.clone() }
    }
}

impl RareFolder {
    /// The estimate that is there.
    ///
    /// # Errors
    /// [`RareError::Work`] if it is damaged.
    pub fn kept(&self) -> Result<Option<RareReport>, RareError> {
        let damaged = |error: serde_json::Error| WorkError::damaged(&self.path(), format!("no estimate: {error}"));
        let bytes = self.work.read(ESTIMATE)?;
        Ok(bytes.map(|bytes| serde_json::from_slice(&bytes)).transpose().map_err(damaged)?)
    }

    /// Writes the estimate, without what it comes to per hour: that takes resamples, of which anybody may ask for others.
    ///
    /// # Errors
    /// [`RareError::Work`] if it cannot be written.
    pub fn keep(&self, report: &RareReport) -> Result<(), RareError> {
        self.work.write(ESTIMATE, serde_json::to_string_pretty(&report.kept())? + "\n")?;
        Ok(self.work.finish()?)
    }

    /// Where the estimate goes.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        self.work.path(ESTIMATE)
    }
}
