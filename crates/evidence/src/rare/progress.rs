//! Progress of an unfinished estimate in the file `progress.json`. The file holds the pilot, completed repetitions, and
//! estimates in resamples. All of them depend on the seed only, so a resumed estimate has the result of an
//! uninterrupted one.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::plan::RareRecord;
use super::{RareError, RareEstimate, RarePlan, Repetition, SplittingLevels};
use crumple_core::observer::ProgressCounter;
use crumple_spaces::ScenarioSpace;
use crumple_store::run_folder::{RunFolder, RunFolderError};

pub(super) const PROGRESS_FILE: &str = "progress.json";

/// A run folder of an estimate.
#[derive(Debug)]
pub(super) struct RareProgress {
    pub(super) run_folder: RunFolder,
    state: RareProgressFile,
}

#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RareProgressFile {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pilot: Option<SplittingLevels>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    repetitions: Option<Vec<Repetition>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "resampled")]
    resample_estimates: Option<ResampleEstimates>,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ResampleEstimates {
    resamples: u32,
    estimates: Vec<RareEstimate>,
}

impl RareProgress {
    pub(super) fn load(
        work: RunFolder,
        record: &RareRecord,
        repetitions: u64,
    ) -> Result<Self, RunFolderError> {
        let damaged = |problem: String| RunFolderError::damaged(&work.path(PROGRESS_FILE), problem);
        let Some(bytes) = work.read(PROGRESS_FILE)? else {
            return Ok(Self {
                run_folder: work,
                state: RareProgressFile::default(),
            });
        };
        let found: RareProgressFile =
            serde_json::from_slice(&bytes).map_err(|error| damaged(error.to_string()))?;
        match found.is_consistent_with(record, repetitions) {
            true => Ok(Self {
                run_folder: work,
                state: found,
            }),
            false => Err(damaged("belongs to another estimate".to_owned())),
        }
    }

    /// Returns the saved pilot, or runs the rest of it.
    pub(super) fn run_pilot(
        &mut self,
        plan: &RarePlan,
        counter: &ProgressCounter<'_>,
    ) -> Result<SplittingLevels, RareError> {
        if let Some(pilot) = &self.state.pilot {
            return Ok(pilot.clone());
        }
        let pilot = SplittingLevels::run_pilots(plan, plan.effort, plan.seed, counter)?;
        self.state.pilot = Some(pilot.clone());
        self.state.write(&self.run_folder)?;
        Ok(pilot)
    }

    pub(super) fn completed_repetitions(&self) -> u64 {
        self.state
            .repetitions
            .as_ref()
            .map_or(0, |done| done.len() as u64)
    }

    /// Runs those of the repetitions that are not saved.
    pub(super) fn run_repetitions(
        &mut self,
        plan: &RarePlan,
        pilot: &SplittingLevels,
        own: Range<u64>,
        counter: &ProgressCounter<'_>,
    ) -> Result<Vec<Repetition>, RareError> {
        let mut next = own.start + self.completed_repetitions();
        let mut repetitions = self.state.repetitions.take().unwrap_or_default();
        while pilot.reaches_failure() && next < own.end {
            let end = own
                .end
                .min(next.saturating_add(pilot.repetitions_per_write()));
            repetitions.extend(pilot.run_repetitions(plan, next..end, counter)?);
            next = end;
            self.state.repetitions = Some(repetitions.clone());
            self.state.write(&self.run_folder)?;
        }
        self.state.repetitions = Some(repetitions.clone());
        Ok(repetitions)
    }

    /// Returns the estimator in spaces that are fitted to resamples; it reuses saved estimates.
    pub(super) fn resample_estimator(&mut self, resamples: u32) -> ResampleEstimator<'_> {
        if self
            .state
            .resample_estimates
            .as_ref()
            .is_none_or(|resampled| resampled.resamples != resamples)
        {
            self.state.resample_estimates = Some(ResampleEstimates {
                resamples,
                estimates: Vec::new(),
            });
        }
        ResampleEstimator {
            progress: self,
            next: 0,
        }
    }

    pub(super) fn finish(&self, name: &str, contents: String) -> Result<(), RareError> {
        self.run_folder
            .transaction()
            .write(name, contents)
            .remove(PROGRESS_FILE)
            .commit()?;
        Ok(self.run_folder.finish()?)
    }
}

/// An iteration over resamples that reuses saved estimates.
pub(super) struct ResampleEstimator<'a> {
    progress: &'a mut RareProgress,
    next: usize,
}

impl ResampleEstimator<'_> {
    pub(super) fn next(
        &mut self,
        plan: &RarePlan,
        (space, seed): (&ScenarioSpace, u64),
        counter: &ProgressCounter<'_>,
    ) -> Result<RareEstimate, RareError> {
        let found = &mut self.progress.state;
        let kept = found
            .resample_estimates
            .as_ref()
            .and_then(|resampled| resampled.estimates.get(self.next))
            .cloned();
        self.next += 1;
        if let Some(kept) = kept {
            return Ok(kept);
        }
        let estimate = plan.estimate_in_space(space, seed, counter)?;
        if let Some(resampled) = &mut found.resample_estimates {
            resampled.estimates.push(estimate.clone());
        }
        // The folder of a finished estimate keeps no estimates in resamples.
        if !self.progress.run_folder.is_complete() {
            found.write(&self.progress.run_folder)?;
        }
        Ok(estimate)
    }
}

impl RareProgressFile {
    fn write(&self, work: &RunFolder) -> Result<(), RareError> {
        Ok(work.write(PROGRESS_FILE, serde_json::to_string(self)? + "\n")?)
    }

    fn is_consistent_with(&self, record: &RareRecord, repetitions: u64) -> bool {
        let is_own = |pilot: &SplittingLevels| pilot.is_placed_by(record.effort, record.seed);
        let may_be = |some: &Vec<Repetition>| {
            some.len() as u64 <= repetitions
                && self
                    .pilot
                    .as_ref()
                    .is_some_and(|pilot| pilot.is_consistent_with(some))
        };
        self.pilot.iter().all(is_own) && self.repetitions.iter().all(may_be)
    }
}
