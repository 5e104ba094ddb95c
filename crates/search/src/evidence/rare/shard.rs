//! Shards of an estimate: some of its repetitions each, and the pilot, which each of them runs, for all that follows depends on it.
//!
//! A folder holds `shard.json`, all that decides it, and `repetitions.json`. Nothing of a shard is kept halfway.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::driving::RareRecord;
use super::splitting::Repetition;
use super::{RareError, RarePlan, RareReport, Splitting};
use crate::shard::{self, MergeError, Parts, SHARD, Shard};
use crate::work::{Finished, Work, WorkError};

/// What a folder of one is called in its `work.json`.
pub const SHARD_OF_AN_ESTIMATE: &str = "shard of a rare-failure estimate";

const REPETITIONS: &str = "repetitions.json";
/// The version of these files.
const VERSION: u32 = 1;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShardFile {
    version: u32,
    shard: Shard,
    estimate: RareRecord,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Repeated {
    pilot: Splitting,
    repetitions: Vec<Repetition>,
}

/// A folder for a shard of an estimate, in use.
pub struct RareShard<'a> {
    plan: &'a RarePlan,
    shard: Shard,
    work: Work,
}

impl RarePlan {
    /// The folder, if it is this shard's or nobody's.
    ///
    /// # Errors
    /// [`RareError`] if there are fewer repetitions than shards, the controller states no identity, or the folder cannot be used,
    /// holds something else, or is damaged.
    pub fn shard_in_folder(&self, shard: Shard, folder: &Path, resume: bool) -> Result<RareShard<'_>, RareError> {
        let estimate = self.record()?;
        if estimate.controller_sha256.is_none() {
            return Err(RareError::Unknown(self.controller.name.clone()));
        }
        shard.range(self.effort.repetitions as u64, WHAT)?;
        let configuration = serde_json::to_string_pretty(&ShardFile { version: VERSION, shard, estimate })? + "\n";
        let work = shard::open_shard(folder, SHARD_OF_AN_ESTIMATE, &configuration, REPETITIONS, resume)?;
        Ok(RareShard { plan: self, shard, work })
    }
}

const WHAT: &str = "repetitions";

impl RareShard<'_> {
    /// Whether it was made before.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.work.is_complete()
    }

    /// Runs its repetitions, with the levels of the pilot. `done` hears of every batch of runs.
    ///
    /// # Errors
    /// [`RareError`] if a run cannot be made or a file not written.
    pub fn repeat(&self, pilot: &Splitting, done: &(dyn Fn(u64) + Sync)) -> Result<(), RareError> {
        let range = self.shard.range(self.plan.effort.repetitions as u64, WHAT)?;
        let repetitions = pilot.repeat(self.plan, range, done)?;
        let repeated = Repeated { pilot: pilot.clone(), repetitions };
        self.work.write(REPETITIONS, serde_json::to_string_pretty(&repeated)? + "\n")?;
        Ok(self.work.finish()?)
    }
}

/// Shards of one estimate.
#[derive(Debug)]
pub struct MergedEstimate {
    record: RareRecord,
    pilot: Splitting,
    /// Of repetitions.
    parts: Parts<Vec<Repetition>>,
}

impl MergedEstimate {
    /// Begins with a shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn of(folder: &Path, found: &Finished) -> Result<Self, MergeError> {
        let (file, repeated) = read(found)?;
        let mut merged = Self { record: file.estimate, pilot: repeated.pilot, parts: Parts::of(folder) };
        merged.place(folder, file.shard, repeated.repetitions)?;
        Ok(merged)
    }

    /// Takes in another shard. After an error it is as it was.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or does not go with the others.
    pub fn take(&mut self, folder: &Path, found: &Finished) -> Result<(), MergeError> {
        let (file, repeated) = read(found)?;
        if file.estimate != self.record {
            return Err(self.parts.foreign(folder, "what is estimated, how or by which release".to_owned()));
        }
        // The same seed has placed the same levels, wherever that was.
        if repeated.pilot != self.pilot {
            return Err(self.parts.foreign(folder, "the pilot, as of another build,".to_owned()));
        }
        self.place(folder, file.shard, repeated.repetitions)
    }

    fn place(&mut self, folder: &Path, shard: Shard, repetitions: Vec<Repetition>) -> Result<(), MergeError> {
        let all = self.record.effort.repetitions as u64;
        let range =
            shard.range(all, WHAT).map_err(|error| WorkError::damaged(&folder.join(SHARD), error.to_string()))?;
        self.parts.place(folder, shard, range, repetitions)
    }

    /// Of how many shards they are, and which of these are missing; where they are of several numbers, nothing.
    #[must_use]
    pub fn missing_shards(&self) -> (Option<u32>, Vec<u32>) {
        self.parts.missing_shards()
    }

    /// Repetitions that are missing.
    #[must_use]
    pub fn missing(&self) -> u64 {
        self.parts.missing(self.record.effort.repetitions as u64).iter().map(|range| range.end - range.start).sum()
    }

    /// The estimate; none while repetitions are missing.
    #[must_use]
    pub fn report(&self) -> Option<RareReport> {
        let repetitions = || self.parts.contents().flatten().cloned().collect();
        (self.missing() == 0).then(|| self.record.report(self.pilot.summary(repetitions())))
    }

    /// Writes the folder of the whole estimate, that of an estimate by one machine to the byte, and says where the estimate is; none
    /// while repetitions are missing: then nothing is written.
    ///
    /// # Errors
    /// [`RareError`] if the folder cannot be used, or holds something else.
    pub fn write_in(&self, folder: &Path) -> Result<Option<(PathBuf, RareReport)>, RareError> {
        let Some(report) = self.report() else { return Ok(None) };
        let folder = self.record.in_folder(folder, true)?;
        match folder.kept()? {
            Some(kept) if kept != report => {
                let problem = "there is an estimate of the same configuration that came to something else";
                return Err(WorkError::damaged(&folder.path(), problem).into());
            }
            _ => folder.keep(&report)?,
        }
        Ok(Some((folder.path(), report)))
    }
}

fn read(found: &Finished) -> Result<(ShardFile, Repeated), WorkError> {
    let unreadable = |name: &'static str| move |error: serde_json::Error| found.unreadable(name, &error);
    let file: ShardFile = shard::read_shard(found)?;
    let repeated: Repeated = serde_json::from_str(&found.read(REPETITIONS)?).map_err(unreadable(REPETITIONS))?;
    if file.version != VERSION {
        return Err(found.damaged(SHARD, format!("version: {}, and this release reads {VERSION}", file.version)));
    }
    let range = file.shard.range(file.estimate.effort.repetitions as u64, WHAT);
    let range = range.map_err(|error| found.damaged(SHARD, error))?;
    let made = if repeated.pilot.reaches_failure() { range.end - range.start } else { 0 };
    let is_sound = repeated.pilot.is_of(file.estimate.effort, file.estimate.seed)
        && repeated.pilot.may_have(&repeated.repetitions);
    if repeated.repetitions.len() as u64 != made || !is_sound {
        return Err(found.damaged(REPETITIONS, format!("not what shard {} of that estimate comes to", file.shard)));
    }
    Ok((file, repeated))
}
