//! What has come of an estimate so far: `progress.json`, in its folder until it is finished, and in that of a shard.
//!
//! The pilot is kept when it is done, that of importance sampling after every population and round of fitting; repetitions as they end; and
//! estimates in resamples, one by one. All of these are functions of the seed, so that whoever goes on ends as if nothing had happened.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::plan::RareRecord;
use super::importance::MixtureFitting;
use super::{Estimate, Pilot, RareError, RarePlan, Repetitions};
use crumple_core::observer::Counter;
use crumple_store::work::{Work, WorkError};
use crumple_world::scenario::space::Space;

pub(super) const PROGRESS_FILE: &str = "progress.json";

/// A folder in which an estimate, or a shard of one, is made.
#[derive(Debug)]
pub(super) struct RareProgress {
    run_folder: Work,
    state: Found,
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
    estimates: Vec<Estimate>,
}

impl RareProgress {
    /// What is in the folder of so many repetitions of an estimate.
    pub(super) fn load(work: Work, record: &RareRecord, repetitions: u64) -> Result<Self, WorkError> {
        let damaged = |problem: String| WorkError::damaged(&work.path(PROGRESS), problem);
        let Some(bytes) = work.read(PROGRESS)? else { return Ok(Self { work, found: Found::default() }) };
        let found: Found = serde_json::from_slice(&bytes).map_err(|error| damaged(error.to_string()))?;
        match found.may_be(record, repetitions) {
            true => Ok(Self { work, found }),
            false => Err(damaged("not of this estimate".to_owned())),
        }
    }

    /// The folder.
    pub(super) fn run_folder(&self) -> &Work {
        &self.work
    }

    /// The pilot that is there, or what is left of it.
    pub(super) fn run_pilot(&mut self, plan: &RarePlan, counter: &Counter<'_>) -> Result<Pilot, RareError> {
        let dimension = plan.space.dimension();
        let may_be = |fitting: &MixtureFitting| fitting.may_be(plan.effort, plan.seed, dimension);
        if !self.found.pilot.iter().all(|pilot| pilot.is_in(dimension)) || !self.found.fitting.iter().all(may_be) {
            return Err(WorkError::damaged(&self.work.path(PROGRESS), "not of this space").into());
        }
        if let Some(pilot) = &self.found.pilot {
            return Ok(pilot.clone());
        }
        let work = &self.work;
        let mut keep = |fitting: &MixtureFitting| -> Result<(), RareError> {
            Found { fitting: Some(fitting.clone()), ..Found::default() }.keep(work)
        };
        let asked = (plan.method, plan.effort, plan.seed);
        let pilot = Pilot::go_on(plan, asked, self.found.fitting.take(), &mut keep, counter)?;
        self.found.pilot = Some(pilot.clone());
        self.found.keep(&self.work)?;
        Ok(pilot)
    }

    /// How many of its repetitions were made already.
    pub(super) fn completed_repetitions(&self) -> u64 {
        self.found.repetitions.as_ref().map_or(0, Repetitions::count)
    }

    /// Some of the repetitions, of which those that are there are not made again.
    pub(super) fn run_repetitions(
        &mut self,
        plan: &RarePlan,
        pilot: &Pilot,
        own: Range<u64>,
        counter: &Counter<'_>,
    ) -> Result<Repetitions, RareError> {
        let mut next = own.start + self.completed_repetitions();
        // Where the pilot reached no failure, there are none to make.
        let mut repetitions = match self.found.repetitions.take() {
            Some(kept) => kept,
            None => pilot.repeat(plan, own.start..own.start, counter)?,
        };
        while pilot.reaches_failure() && next < own.end {
            let end = own.end.min(next.saturating_add(pilot.repetitions_per_write()));
            repetitions.append(pilot.repeat(plan, next..end, counter)?);
            next = end;
            self.found.repetitions = Some(repetitions.clone());
            self.found.keep(&self.work)?;
        }
        self.found.repetitions = Some(repetitions.clone());
        Ok(repetitions)
    }

    /// Estimates in other spaces, those fitted to so many resamples of which it makes some in order: what is there is not made again.
    pub(super) fn resample_estimator(&mut self, resamples: u32) -> Again<'_> {
        if self.found.resampled.as_ref().is_none_or(|resampled| resampled.resamples != resamples) {
            self.found.resampled = Some(ResampleEstimates { resamples, estimates: Vec::new() });
        }
        Again { progress: self, next: 0 }
    }

    /// Writes what it comes to. What it was made of is needed no longer.
    pub(super) fn finish(&self, name: &str, contents: String) -> Result<(), RareError> {
        self.work.changes().write(name, contents).remove(PROGRESS).commit()?;
        Ok(self.work.finish()?)
    }
}

/// Estimates in resamples, while they are gone through.
pub(super) struct ResampleEstimator<'a> {
    progress: &'a mut RareProgress,
    next: usize,
}

impl Again<'_> {
    /// The next one.
    pub(super) fn next(
        &mut self,
        plan: &RarePlan,
        (space, seed): (&Space, u64),
        counter: &Counter<'_>,
    ) -> Result<Estimate, RareError> {
        let found = &mut self.progress.found;
        let kept = found.resampled.as_ref().and_then(|resampled| resampled.estimates.get(self.next)).cloned();
        self.next += 1;
        if let Some(kept) = kept {
            return Ok(kept);
        }
        let estimate = plan.again(space, seed, counter)?;
        if let Some(resampled) = &mut found.resampled {
            resampled.estimates.push(estimate.clone());
        }
        // Of an estimate that was finished nothing but itself is kept.
        if !self.progress.work.is_complete() {
            found.keep(&self.progress.work)?;
        }
        Ok(estimate)
    }
}

impl Found {
    fn write(&self, work: &Work) -> Result<(), RareError> {
        Ok(work.write(PROGRESS, serde_json::to_string(self)? + "\n")?)
    }

    /// Whether an estimate of which so many repetitions are made could have come to it.
    fn is_consistent_with(&self, record: &RareRecord, repetitions: u64) -> bool {
        let is_own = |pilot: &Pilot| pilot.is_of(record.method, record.effort, record.seed);
        let may_be = |some: &Repetitions| {
            some.count() <= repetitions && self.pilot.as_ref().is_some_and(|pilot| pilot.is_consistent_with(some))
        };
        self.pilot.iter().all(is_own) && self.repetitions.iter().all(may_be)
    }
}
