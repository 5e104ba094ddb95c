//! An estimate in a run folder: `rare-estimate.json` and the manifest `work.json`; until it is finished,
//! `progress.json`.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::plan::RareRecord;
use super::progress::RareProgress;
use super::{RareError, RarePlan, RareReport, SplittingLevels};
use crumple_core::observer::{Observer, ProgressCounter, RunProgress};
use crumple_store::run_folder::{RunFolder, RunFolderError, RunFolderOptions};

const ESTIMATE_FILE: &str = "rare-estimate.json";

/// An open folder of an estimate.
#[derive(Debug)]
pub struct RareFolder {
    progress: RareProgress,
}

impl RarePlan {
    /// Opens the folder if it is empty or belongs to this estimate. Content is continued with `resume`, and refused
    /// otherwise.
    ///
    /// # Errors
    /// [`RareError`] if the folder cannot be used, has other content, or is damaged.
    pub fn open_folder(&self, folder: &Path, resume: bool) -> Result<RareFolder, RareError> {
        if resume && self.controller.source.identity().is_none() {
            return Err(RareError::NoIdentity(self.controller.name.clone()));
        }
        self.record()?.open_folder(folder, resume)
    }
}

impl RareRecord {
    pub(super) fn open_folder(&self, folder: &Path, resume: bool) -> Result<RareFolder, RareError> {
        let configuration = json!({
            "controller": self.controller,
            "controller_sha256": self.controller_sha256,
            "estimator": self.estimator,
            "space_sha256": self.space_sha256,
            "failure": self.failure,
            "seed": self.seed,
            "effort": self.effort,
        });
        let asked = RunFolderOptions {
            kind: "rare-failure estimate",
            configuration: &configuration.to_string(),
            configuration_file: ESTIMATE_FILE,
            resume,
            outputs: &[ESTIMATE_FILE],
        };
        let work = RunFolder::open(folder, asked)?;
        Ok(RareFolder {
            progress: RareProgress::load(work, self, self.effort.repetitions as u64)?,
        })
    }
}

impl RareReport {
    pub(super) fn without_exposure(&self) -> Self {
        Self {
            exposure: None,
            ..self.clone()
        }
    }

    fn to_json(&self) -> Result<String, serde_json::Error> {
        Ok(serde_json::to_string_pretty(&self.without_exposure())? + "\n")
    }
}

impl RareFolder {
    /// Reads the saved estimate.
    ///
    /// # Errors
    /// [`RareError::RunFolder`] if it is damaged.
    pub fn read_report(&self) -> Result<Option<RareReport>, RareError> {
        let damaged = |error: serde_json::Error| {
            RunFolderError::damaged(&self.path(), format!("no estimate: {error}"))
        };
        let bytes = self.progress.run_folder.read(ESTIMATE_FILE)?;
        let kept: Option<RareReport> = bytes
            .map(|bytes| serde_json::from_slice(&bytes))
            .transpose()
            .map_err(damaged)?;
        Ok(kept.map(RareReport::with_gaps))
    }

    /// Writes the estimate without rates per hour, which depend on the number of resamples.
    ///
    /// # Errors
    /// [`RareError::RunFolder`] if it cannot be written.
    pub fn write_report(&self, report: &RareReport) -> Result<(), RareError> {
        self.progress.finish(ESTIMATE_FILE, report.to_json()?)
    }

    /// True if the folder has a complete estimate.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.progress.run_folder.is_complete()
    }

    /// Runs or resumes the pilot, and saves the levels. Reports every batch of runs.
    ///
    /// # Errors
    /// [`RareError`] if a run fails, a file cannot be written, or `observer` stops the pilot.
    pub fn run_pilot(
        &mut self,
        plan: &RarePlan,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<SplittingLevels, RareError> {
        self.progress
            .run_pilot(plan, &ProgressCounter::new(observer, None))
    }

    /// Runs the remaining repetitions, and saves each of them and the estimate. If the space is fitted to episodes,
    /// also estimates, with less effort, the rate in spaces that are fitted to `resamples` resamples of them.
    ///
    /// # Errors
    /// [`RareError`] if a run fails, a file cannot be written, or `observer` stops the estimate.
    pub fn estimate(
        &mut self,
        plan: &RarePlan,
        pilot: &SplittingLevels,
        resamples: u32,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<RareReport, RareError> {
        let (all, counter) = (
            0..plan.effort.repetitions as u64,
            ProgressCounter::new(observer, None),
        );
        let repeated = self.progress.run_repetitions(plan, pilot, all, &counter)?;
        let report = plan.record()?.report(pilot.summary(repeated));
        let report = self.add_exposure(plan, report, resamples, &counter)?;
        self.write_report(&report)?;
        Ok(report)
    }

    /// Adds rates per hour, if the space states its exposure.
    ///
    /// # Errors
    /// [`RareError`] if a run fails, a file cannot be written, or `observer` stops the estimates in resamples.
    pub fn with_exposure(
        &mut self,
        plan: &RarePlan,
        report: RareReport,
        resamples: u32,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<RareReport, RareError> {
        self.add_exposure(
            plan,
            report,
            resamples,
            &ProgressCounter::new(observer, None),
        )
    }

    fn add_exposure(
        &mut self,
        plan: &RarePlan,
        report: RareReport,
        resamples: u32,
        counter: &ProgressCounter<'_>,
    ) -> Result<RareReport, RareError> {
        let mut again = self.progress.resample_estimator(resamples);
        let exposed = plan.rate_per_exposure(&report.estimate, resamples, &mut |space, seed| {
            again.next(plan, (space, seed), counter)
        })?;
        Ok(RareReport {
            exposure: exposed,
            ..report
        })
    }

    /// Returns the number of completed repetitions.
    #[must_use]
    pub fn completed_repetitions(&self) -> u64 {
        self.progress.completed_repetitions()
    }

    /// Returns the path of the estimate.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        self.progress.run_folder.path(ESTIMATE_FILE)
    }
}
