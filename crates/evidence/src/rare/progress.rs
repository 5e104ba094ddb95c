//! What has come of an estimate so far: `progress.json`, in its folder until it is finished, and in that of a shard.
//!
//! The pilot is kept when it is done, that of importance sampling after every population and round of fitting; repetitions as they end; and
//! estimates in resamples, one by one. All of these are functions of the seed, so that whoever goes on ends as if nothing had happened.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::importance::MixtureFitting;
use super::plan::RareRecord;
use super::{Pilot, RareError, RareEstimate, RarePlan, Repetitions};
use crumple_core::observer::ProgressCounter;
use crumple_store::run_folder::{RunFolder, RunFolderError};
use crumple_world::scenario::space::ScenarioSpace;

pub(super) const PROGRESS_FILE: &str = "progress.json";

/// A folder in which an estimate, or a shard of one, is made.
#[derive(Debug)]
pub(super) struct RareProgress {
    run_folder: RunFolder,
    state: RareProgressFile,
}

#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RareProgressFile {
    /// Of importance sampling, until the pilot is done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fitting: Option<MixtureFitting>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pilot: Option<Pilot>,
    /// The first of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    repetitions: Option<Repetitions>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "resampled")]
    resample_estimates: Option<ResampleEstimates>,
}

/// What came of the first of its own resamples.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ResampleEstimates {
    /// Of so many.
    resamples: u32,
    estimates: Vec<RareEstimate>,
}

impl RareProgress {
    /// What is in the folder of so many repetitions of an estimate.
    pub(super) fn load(work: RunFolder, record: &RareRecord, repetitions: u64) -> Result<Self, RunFolderError> {
        let damaged = |problem: String| RunFolderError::damaged(&work.path(PROGRESS_FILE), problem);
        let Some(bytes) = work.read(PROGRESS_FILE)? else {
            return Ok(Self { run_folder: work, state: RareProgressFile::default() });
        };
        let found: RareProgressFile = serde_json::from_slice(&bytes).map_err(|error| damaged(error.to_string()))?;
        match found.is_consistent_with(record, repetitions) {
            true => Ok(Self { run_folder: work, state: found }),
            false => Err(damaged("not of this estimate".to_owned())),
        }
    }

    /// The folder.
    pub(super) fn run_folder(&self) -> &RunFolder {
        &self.run_folder
    }

    /// The pilot that is there, or what is left of it.
    pub(super) fn run_pilot(&mut self, plan: &RarePlan, counter: &ProgressCounter<'_>) -> Result<Pilot, RareError> {
        let dimension = plan.space.dimension();
        let may_be = |fitting: &MixtureFitting| fitting.is_consistent_with(plan.effort, plan.seed, dimension);
        if !self.state.pilot.iter().all(|pilot| pilot.has_dimension(dimension))
            || !self.state.fitting.iter().all(may_be)
        {
            return Err(RunFolderError::damaged(&self.run_folder.path(PROGRESS_FILE), "not of this space").into());
        }
        if let Some(pilot) = &self.state.pilot {
            return Ok(pilot.clone());
        }
        let work = &self.run_folder;
        let mut keep = |fitting: &MixtureFitting| -> Result<(), RareError> {
            RareProgressFile { fitting: Some(fitting.clone()), ..RareProgressFile::default() }.write(work)
        };
        let asked = (plan.method, plan.effort, plan.seed);
        let pilot = Pilot::resume(plan, asked, self.state.fitting.take(), &mut keep, counter)?;
        self.state.pilot = Some(pilot.clone());
        self.state.write(&self.run_folder)?;
        Ok(pilot)
    }

    /// How many of its repetitions were made already.
    pub(super) fn completed_repetitions(&self) -> u64 {
        self.state.repetitions.as_ref().map_or(0, Repetitions::count)
    }

    /// Some of the repetitions, of which those that are there are not made again.
    pub(super) fn run_repetitions(
        &mut self,
        plan: &RarePlan,
        pilot: &Pilot,
        own: Range<u64>,
        counter: &ProgressCounter<'_>,
    ) -> Result<Repetitions, RareError> {
        let mut next = own.start + self.completed_repetitions();
        // Where the pilot reached no failure, there are none to make.
        let mut repetitions = match self.state.repetitions.take() {
            Some(kept) => kept,
            None => pilot.run_repetitions(plan, own.start..own.start, counter)?,
        };
        while pilot.reaches_failure() && next < own.end {
            let end = own.end.min(next.saturating_add(pilot.repetitions_per_write()));
            repetitions.append(pilot.run_repetitions(plan, next..end, counter)?);
            next = end;
            self.state.repetitions = Some(repetitions.clone());
            self.state.write(&self.run_folder)?;
        }
        self.state.repetitions = Some(repetitions.clone());
        Ok(repetitions)
    }

    /// Estimates in other spaces, those fitted to so many resamples of which it makes some in order: what is there is not made again.
    pub(super) fn resample_estimator(&mut self, resamples: u32) -> ResampleEstimator<'_> {
        if self.state.resample_estimates.as_ref().is_none_or(|resampled| resampled.resamples != resamples) {
            self.state.resample_estimates = Some(ResampleEstimates { resamples, estimates: Vec::new() });
        }
        ResampleEstimator { progress: self, next: 0 }
    }

    /// Writes what it comes to. What it was made of is needed no longer.
    pub(super) fn finish(&self, name: &str, contents: String) -> Result<(), RareError> {
        self.run_folder.transaction().write(name, contents).remove(PROGRESS_FILE).commit()?;
        Ok(self.run_folder.finish()?)
    }
}

/// Estimates in resamples, while they are gone through.
pub(super) struct ResampleEstimator<'a> {
    progress: &'a mut RareProgress,
    next: usize,
}

impl ResampleEstimator<'_> {
    /// The next one.
    pub(super) fn next(
        &mut self,
        plan: &RarePlan,
        (space, seed): (&ScenarioSpace, u64),
        counter: &ProgressCounter<'_>,
    ) -> Result<RareEstimate, RareError> {
        let found = &mut self.progress.state;
        let kept = found.resample_estimates.as_ref().and_then(|resampled| resampled.estimates.get(self.next)).cloned();
        self.next += 1;
        if let Some(kept) = kept {
            return Ok(kept);
        }
        let estimate = plan.estimate_in_space(space, seed, counter)?;
        if let Some(resampled) = &mut found.resample_estimates {
            resampled.estimates.push(estimate.clone());
        }
        // Of an estimate that was finished nothing but itself is kept.
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

    /// Whether an estimate of which so many repetitions are made could have come to it.
    fn is_consistent_with(&self, record: &RareRecord, repetitions: u64) -> bool {
        let is_own = |pilot: &Pilot| pilot.is_run_by(record.method, record.effort, record.seed);
        let may_be = |some: &Repetitions| {
            some.count() <= repetitions && self.pilot.as_ref().is_some_and(|pilot| pilot.is_consistent_with(some))
        };
        self.pilot.iter().all(is_own) && self.repetitions.iter().all(may_be)
    }
}
