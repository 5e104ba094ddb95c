//! An estimate as a study: `rare-estimate.json`, `rare-failures.json`, the folder `failures`, and the manifest
//! `work.json`; until it is finished, `progress.json`.
//!
//! The progress holds the pilot, completed repetitions, and estimates in resamples. All of them depend on the seed
//! only, so a resumed estimate has the result of an uninterrupted one.

use std::ops::ControlFlow;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{
    FAILURE_FOLDER, FAILURE_LIST_FILE, RareError, RareEstimate, RarePlan, RareReport, Repetition,
    SplittingLevels,
};
use crate::exposure::RatePerExposure;
use crumple_core::digest::sha256;
use crumple_core::observer::{Observer, ProgressCounter, RunProgress};
use crumple_core::old_names;
use crumple_spaces::file;
use crumple_store::run_folder::{FolderTransaction, RunFolder, RunFolderError};
use crumple_store::study::{Study, StudyStep};

/// Name of the estimate in its folder.
pub const ESTIMATE_FILE: &str = "rare-estimate.json";
pub(super) const PROGRESS_FILE: &str = "progress.json";

/// Stage of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RareStage {
    /// Pilots place the levels; the number of their runs is not known beforehand.
    Pilot,
    /// Repetitions of the splitting.
    Repetitions,
    /// Estimates in spaces that are fitted to resamples of the episodes.
    Resamples,
}

/// Progress of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RareProgress {
    /// Current stage.
    pub stage: RareStage,
    /// Runs of this stage.
    pub runs: u64,
    /// Approximate number of runs of this stage, if known.
    pub total: Option<u64>,
}

/// Results of the steps so far.
#[derive(Debug, Default)]
pub struct RareState {
    saved: SavedProgress,
    exposure: Option<RatePerExposure>,
    is_exposed: bool,
}

/// The file `progress.json`.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SavedProgress {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pilot: Option<SplittingLevels>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    repetitions: Option<Vec<Repetition>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "resampled")]
    resample_estimates: Option<ResampleEstimates>,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ResampleEstimates {
    resamples: u32,
    estimates: Vec<RareEstimate>,
}

impl RareState {
    /// Returns the number of completed repetitions.
    #[must_use]
    pub fn completed_repetitions(&self) -> u64 {
        self.saved.completed_repetitions()
    }

    /// Returns the approximate number of runs of the completed repetitions.
    #[must_use]
    pub fn completed_runs(&self, plan: &RarePlan) -> u64 {
        let all = plan.effort.repetition_count as u64;
        let done = self.completed_repetitions();
        let pilot = self.saved.pilot.as_ref();
        pilot.map_or(0, |pilot| pilot.runs_of(done, all).0)
    }
}

impl Study for RarePlan {
    const KIND: &'static str = "rare-failure estimate";
    const CONFIGURATION_FILE: &'static str = ESTIMATE_FILE;
    const OUTPUTS: &'static [&'static str] = &[ESTIMATE_FILE, FAILURE_LIST_FILE, FAILURE_FOLDER];

    type State = RareState;
    type Progress = RareProgress;
    type Report = RareReport;
    type Error = RareError;

    /// Has the names of version 1: an estimate of 0.3.0 is recognised by the hash of this text.
    fn configuration(&self) -> Result<String, RareError> {
        let mut configuration = json!({
            "controller": self.controller.name,
            "controller_sha256": self.controller.source.identity(),
            "estimator": self.estimator,
            "space_sha256": sha256(file::to_identity_toml(&self.space)?),
            "failure": self.failure_description(),
            "seed": self.seed,
            "effort": self.effort,
        });
        old_names::STUDY.restore_in_value(&mut configuration);
        Ok(configuration.to_string())
    }

    /// The estimate states its configuration.
    fn configuration_file(&self) -> Result<Option<String>, RareError> {
        Ok(None)
    }

    fn unidentified_controller(&self) -> Option<&str> {
        let is_unidentified = self.controller.source.identity().is_none();
        is_unidentified.then_some(&self.controller.name)
    }

    fn load(&self, folder: &RunFolder) -> Result<RareState, RareError> {
        let saved: SavedProgress = folder.read_json(PROGRESS_FILE)?.unwrap_or_default();
        if !saved.is_consistent_with(self) {
            let path = folder.path(PROGRESS_FILE);
            return Err(RunFolderError::damaged(&path, "belongs to another estimate").into());
        }
        Ok(RareState {
            saved,
            ..RareState::default()
        })
    }

    fn step(
        &self,
        state: &mut RareState,
        folder: &RunFolder,
        observer: &dyn Observer<RareProgress>,
    ) -> Result<StudyStep, RareError> {
        let Some(pilot) = &state.saved.pilot else {
            state.saved.pilot = Some(self.run_pilot(observer)?);
            state.saved.write(folder)?;
            return Ok(StudyStep::Continue);
        };
        let all = self.effort.repetition_count as u64;
        let done = state.saved.completed_repetitions();
        if pilot.reaches_failure() && done < all {
            let end = all.min(done.saturating_add(pilot.repetitions_per_write()));
            let report = report_runs(observer, RareStage::Repetitions, pilot.runs_of(done, all));
            let counter = ProgressCounter::new(&report, None);
            let more = pilot.run_repetitions(self, done..end, &counter)?;
            state.saved.repetitions.get_or_insert_default().extend(more);
            state.saved.write(folder)?;
            return Ok(StudyStep::Continue);
        }
        if !state.is_exposed {
            let estimate = self.summary(&state.saved);
            state.exposure = self.exposure(&estimate, &mut state.saved, folder, observer)?;
            state.is_exposed = true;
        }
        Ok(StudyStep::Done)
    }

    /// Writes the failures, and the estimate without rates per hour, which depend on the number of resamples.
    fn finish(
        &self,
        state: RareState,
        _: &RunFolder,
        results: &mut FolderTransaction<'_>,
        _: &dyn Observer<RareProgress>,
    ) -> Result<RareReport, RareError> {
        let report = self.report(self.summary(&state.saved))?;
        let repetitions = state.saved.repetitions.unwrap_or_default();
        for (name, text) in self.failure_files(&repetitions)? {
            results.write(&name, text);
        }
        results
            .write_json(ESTIMATE_FILE, &report)?
            .remove(PROGRESS_FILE);
        Ok(RareReport {
            exposure: state.exposure,
            ..report
        })
    }

    /// Reads the estimate, and estimates rates per hour again.
    fn read(
        &self,
        folder: &RunFolder,
        observer: &dyn Observer<RareProgress>,
    ) -> Result<RareReport, RareError> {
        let mut report: RareReport = folder.read_required_json(ESTIMATE_FILE)?;
        // 0.3.0 has only the description of a failure.
        report.subject.specification = self.specification.to_string();
        let report = report.with_gaps();
        let mut nothing_saved = SavedProgress::default();
        let exposure = self.exposure(&report.estimate, &mut nothing_saved, folder, observer)?;
        Ok(RareReport { exposure, ..report })
    }
}

impl RarePlan {
    fn run_pilot(
        &self,
        observer: &dyn Observer<RareProgress>,
    ) -> Result<SplittingLevels, RareError> {
        let report = report_runs(observer, RareStage::Pilot, (0, None));
        let counter = ProgressCounter::new(&report, None);
        SplittingLevels::run_pilots(self, self.effort, self.seed, &counter)
    }

    fn summary(&self, saved: &SavedProgress) -> RareEstimate {
        let repetitions = saved.repetitions.clone().unwrap_or_default();
        saved
            .pilot
            .as_ref()
            .map(|pilot| pilot.summary(repetitions))
            .unwrap_or_default()
    }

    /// Returns the rates per hour, if the space states its exposure. Uses saved estimates in resamples.
    fn exposure(
        &self,
        estimate: &RareEstimate,
        saved: &mut SavedProgress,
        folder: &RunFolder,
        observer: &dyn Observer<RareProgress>,
    ) -> Result<Option<RatePerExposure>, RareError> {
        let report = report_runs(observer, RareStage::Resamples, (0, None));
        let counter = ProgressCounter::new(&report, None);
        saved.begin_resamples(self.resamples);
        let mut index = 0;
        self.rate_per_exposure(estimate, self.resamples, &mut |space, seed| {
            let saved_estimate = saved.resample(index).cloned();
            index += 1;
            if let Some(estimate) = saved_estimate {
                return Ok(estimate);
            }
            let estimate = self.estimate_in_space(space, seed, &counter)?;
            saved.add_resample(estimate.clone());
            // The folder of a finished estimate keeps no estimates in resamples.
            if !folder.is_complete() {
                saved.write(folder)?;
            }
            Ok(estimate)
        })
    }
}

impl SavedProgress {
    fn write(&self, folder: &RunFolder) -> Result<(), RareError> {
        let text = serde_json::to_string(self)
            .map_err(|error| RunFolderError::encoding(PROGRESS_FILE, error))?;
        Ok(folder.write(PROGRESS_FILE, text + "\n")?)
    }

    fn completed_repetitions(&self) -> u64 {
        self.repetitions
            .as_ref()
            .map_or(0, |done| done.len() as u64)
    }

    /// Drops saved estimates of another number of resamples.
    fn begin_resamples(&mut self, resamples: u32) {
        if self
            .resample_estimates
            .as_ref()
            .is_none_or(|saved| saved.resamples != resamples)
        {
            self.resample_estimates = Some(ResampleEstimates {
                resamples,
                estimates: Vec::new(),
            });
        }
    }

    fn resample(&self, index: usize) -> Option<&RareEstimate> {
        self.resample_estimates.as_ref()?.estimates.get(index)
    }

    fn add_resample(&mut self, estimate: RareEstimate) {
        if let Some(saved) = &mut self.resample_estimates {
            saved.estimates.push(estimate);
        }
    }

    fn is_consistent_with(&self, plan: &RarePlan) -> bool {
        let pilot = self.pilot.as_ref();
        let is_pilot_of_plan = pilot.is_none_or(|pilot| pilot.is_placed_by(plan.effort, plan.seed));
        is_pilot_of_plan
            && self.repetitions.as_ref().is_none_or(|repetitions| {
                repetitions.len() as u64 <= plan.effort.repetition_count as u64
                    && pilot.is_some_and(|pilot| {
                        pilot.is_consistent_with(repetitions, plan.space.dimension())
                    })
            })
    }
}

impl SplittingLevels {
    /// Returns the approximate number of runs of completed repetitions, and of all.
    fn runs_of(&self, done: u64, all: u64) -> (u64, Option<u64>) {
        let planned = self.planned_runs();
        (planned / all.max(1) * done, Some(planned))
    }
}

/// Returns an observer of runs that adds the stage, and the runs before this step.
fn report_runs(
    observer: &dyn Observer<RareProgress>,
    stage: RareStage,
    (before, total): (u64, Option<u64>),
) -> impl Observer<RunProgress> {
    move |progress: &RunProgress| -> ControlFlow<()> {
        observer.observe(&RareProgress {
            stage,
            runs: before + progress.done,
            total,
        })
    }
}
