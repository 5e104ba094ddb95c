//! Shards of an estimate: some of its repetitions each, and the pilot, which each of them runs, for all that follows depends on it.
//!
//! A folder holds `shard.json`, all that decides it, and `repetitions.json`; until that is there, `progress.json`.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::driving::RareRecord;
use super::progress::Progress;
use super::{Estimate, Pilot, RareError, RarePlan, RareReport, Repetitions};
use crate::evidence::exposed::{ExposedRate, OtherResamples, Probability, PutTogether, estimate_again, own_resamples};
use crate::shard::{self, MergeError, MissingShards, Parts, SHARD, Shard};
use crate::work::{Finished, WorkError};
use crumple_world::digest::sha256;
use crumple_world::scenario::space::{Space, file};

/// What a folder of one is called in its `work.json`.
pub const SHARD_OF_AN_ESTIMATE: &str = "shard of a rare-failure estimate";

const REPETITIONS: &str = "repetitions.json";
/// The version of these files.
const VERSION: u32 = 3;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShardFile {
    version: u32,
    shard: Shard,
    estimate: RareRecord,
    /// Where failures are stated per hour.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    exposed: Option<Exposed>,
}

/// What decides what an estimate comes to per hour.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Exposed {
    /// Of the episodes that the space was fitted to.
    resamples: u32,
    /// The space, in TOML.
    space_text: String,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Repeated {
    pilot: Pilot,
    repetitions: Repetitions,
    /// Estimates in its share of the resamples.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    resampled: Vec<Estimate>,
}

/// A folder for a shard of an estimate, in use.
pub struct RareShard<'a> {
    plan: &'a RarePlan,
    shard: Shard,
    resamples: u32,
    progress: Progress,
}

impl RarePlan {
    /// The folder, if it is this shard's or nobody's. In a space fitted to episodes, estimates are made in so many `resamples` of these, too.
    ///
    /// # Errors
    /// [`RareError`] if there are fewer repetitions than shards, the controller states no identity, or the folder cannot be used,
    /// holds something else, or is damaged.
    pub fn shard_in_folder(
        &self,
        (shard, resamples): (Shard, u32),
        folder: &Path,
        resume: bool,
    ) -> Result<RareShard<'_>, RareError> {
        let estimate = self.record()?;
        if estimate.controller_sha256.is_none() {
            return Err(RareError::Unknown(self.controller.name.clone()));
        }
        let own = shard.range(self.effort.repetitions as u64, WHAT)?;
        let exposed = match self.space.spec().exposure {
            Some(_) => Some(Exposed { resamples, space_text: file::to_toml(&self.space)? }),
            None => None,
        };
        let resamples = exposed.as_ref().map_or(0, |exposed| exposed.resamples);
        let file = ShardFile { version: VERSION, shard, estimate, exposed };
        let configuration = serde_json::to_string_pretty(&file)? + "\n";
        let work = shard::open_shard(folder, SHARD_OF_AN_ESTIMATE, &configuration, REPETITIONS, resume)?;
        let progress = Progress::in_folder(work, &file.estimate, own.end - own.start)?;
        Ok(RareShard { plan: self, shard, resamples, progress })
    }
}

const WHAT: &str = "repetitions";

impl RareShard<'_> {
    /// Whether it was made before.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.progress.work().is_complete()
    }

    /// Places the levels, or what is left of that, and keeps them. `done` hears of every batch of runs.
    ///
    /// # Errors
    /// [`RareError`] if a run cannot be made or a file not written.
    pub fn pilot(&mut self, done: &(dyn Fn(u64) + Sync)) -> Result<Pilot, RareError> {
        self.progress.pilot(self.plan, done)
    }

    /// Runs its repetitions, with the levels of the pilot, and estimates in its share of the resamples, without what is in the folder already.
    /// `done` hears of every batch of runs.
    ///
    /// # Errors
    /// [`RareError`] if a run cannot be made or a file not written.
    pub fn repeat(&mut self, pilot: &Pilot, done: &(dyn Fn(u64) + Sync)) -> Result<(), RareError> {
        let all = self.plan.effort.repetitions as u64;
        let range = self.shard.range(all, WHAT)?;
        let own = own_resamples(self.resamples, &range, all);
        let (plan, resamples) = (self.plan, self.resamples);
        let repetitions = self.progress.repeat(plan, pilot, range, done)?;
        let resampled = match pilot.reaches_failure() {
            true => {
                let mut again = self.progress.again(resamples);
                plan.resampled(resamples, own, &mut |space, seed| again.next(plan, (space, seed), done))?
            }
            false => Vec::new(),
        };
        let repeated = Repeated { pilot: pilot.clone(), repetitions, resampled };
        self.progress.finish(REPETITIONS, serde_json::to_string_pretty(&repeated)? + "\n")
    }
}

/// Shards of one estimate.
#[derive(Debug)]
pub struct MergedEstimate {
    record: RareRecord,
    exposed: Option<Exposed>,
    pilot: Pilot,
    /// Of repetitions.
    parts: Parts<(Repetitions, Vec<Estimate>)>,
}

impl MergedEstimate {
    /// Begins with a shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn of(folder: &Path, found: &Finished) -> Result<Self, MergeError> {
        let (ShardFile { shard, estimate: record, exposed, .. }, repeated) = read(found)?;
        let Repeated { pilot, repetitions, resampled } = repeated;
        let mut merged = Self { record, exposed, pilot, parts: Parts::of(folder) };
        merged.place(folder, shard, (repetitions, resampled))?;
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
        if file.exposed != self.exposed {
            return Err(self.parts.foreign(folder, "the number of resamples".to_owned()));
        }
        // The same seed has placed the same levels, wherever that was.
        if repeated.pilot != self.pilot {
            return Err(self.parts.foreign(folder, "the pilot, as of another build,".to_owned()));
        }
        self.place(folder, file.shard, (repeated.repetitions, repeated.resampled))
    }

    fn place(&mut self, folder: &Path, shard: Shard, came_to: (Repetitions, Vec<Estimate>)) -> Result<(), MergeError> {
        let all = self.record.effort.repetitions as u64;
        let range =
            shard.range(all, WHAT).map_err(|error| WorkError::damaged(&folder.join(SHARD), error.to_string()))?;
        self.parts.place(folder, shard, range, came_to)
    }

    /// Which shards are missing.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        self.parts.missing_shards()
    }

    /// Repetitions that are missing.
    #[must_use]
    pub fn missing(&self) -> u64 {
        self.parts.missing(self.record.effort.repetitions as u64).iter().map(|range| range.end - range.start).sum()
    }

    /// The estimate, with what it comes to per hour where the space says in how much driving it was seen; none while repetitions are
    /// missing.
    ///
    /// # Errors
    /// [`MergeError`] if the estimates in resamples are not those of the space.
    pub fn report(&self) -> Result<Option<RareReport>, MergeError> {
        if self.missing() > 0 {
            return Ok(None);
        }
        let repetitions = self.parts.contents().map(|(repetitions, _)| repetitions);
        let report = self.record.report(self.pilot.summary(repetitions));
        Ok(Some(RareReport { exposed: self.exposed(&report.estimate)?, ..report }))
    }

    fn exposed(&self, estimate: &Estimate) -> Result<Option<ExposedRate>, MergeError> {
        let Some(Exposed { resamples, space_text }) = &self.exposed else { return Ok(None) };
        let unusable = |problem: String| self.parts.unusable(SHARD, problem);
        let space = file::from_toml(space_text, Path::new("space_text"));
        let space = space.map_err(|error| unusable(error.to_string()))?;
        let mut kept = PutTogether::of(self.parts.contents().flat_map(|(_, resampled)| resampled).cloned().collect());
        let resamples = estimate_again(&space, self.record.seed, *resamples, &mut |_: &Space, _| kept.next());
        let resamples = resamples.and_then(|resamples| kept.end().map(|()| resamples));
        let resamples =
            resamples.map_err(|OtherResamples| unusable("not as many resamples as that space has".to_owned()))?;
        Ok(ExposedRate::of(&space, Probability::Estimated(estimate), resamples.as_ref()))
    }

    /// Writes the folder of the whole estimate, that of an estimate by one machine to the byte, and says where the estimate is; none
    /// while repetitions are missing: then nothing is written.
    ///
    /// # Errors
    /// [`RareError`] if the shards do not go with their space, or the folder cannot be used, or holds something else.
    pub fn write_in(&self, folder: &Path) -> Result<Option<(PathBuf, RareReport)>, RareError> {
        let Some(report) = self.report()? else { return Ok(None) };
        let folder = self.record.in_folder(folder, true)?;
        match folder.kept()? {
            Some(kept) if kept != report.kept() => {
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
    let file: ShardFile = shard::read_shard(found, VERSION)?;
    let repeated: Repeated = serde_json::from_str(&found.read(REPETITIONS)?).map_err(unreadable(REPETITIONS))?;
    let range = file.shard.range(file.estimate.effort.repetitions as u64, WHAT);
    let range = range.map_err(|error| found.damaged(SHARD, error))?;
    let made = if repeated.pilot.reaches_failure() { range.end - range.start } else { 0 };
    let resamples = file.exposed.as_ref().map_or(0, |exposed| exposed.resamples);
    let own = own_resamples(resamples, &range, file.estimate.effort.repetitions as u64);
    let is_of_space = |exposed: &Exposed| sha256(&exposed.space_text) == file.estimate.space_sha256;
    let is_sound = repeated.pilot.is_of(file.estimate.method, file.estimate.effort, file.estimate.seed)
        && repeated.pilot.may_have(&repeated.repetitions)
        && file.exposed.iter().all(is_of_space)
        // There are fewer where no space could be fitted to some.
        && repeated.resampled.len() as u64 <= own.end - own.start;
    if repeated.repetitions.count() != made || !is_sound {
        return Err(found.damaged(REPETITIONS, format!("not what shard {} of that estimate comes to", file.shard)));
    }
    Ok((file, repeated))
}
