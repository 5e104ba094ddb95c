//! Shards of an estimate: some of its repetitions each, and the pilot, which each of them runs, for all that follows depends on it.
//!
//! A folder holds `shard.json`, all that decides it, and `repetitions.json`; until that is there, `progress.json`.

use std::ops::{Deref, DerefMut, Range};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::plan::RareRecord;
use super::progress::Progress;
use super::{Estimate, Pilot, RareError, RarePlan, RareReport, Repetitions};
use crate::exposure::{ExposedRate, ResampleCountMismatch, FailureProbability, MergedResamples, estimate_again, own_resamples};
use crumple_core::digest::sha256;
use crumple_core::observer::{Counter, Observer, Progress as RunProgress};
use crumple_store::shard::{MergeError, Mergeable, Merged, SHARD, Shard, Sharded, open_shard};
use crumple_store::work::{Finished, WorkError};
use crumple_world::scenario::space::{Space, file};

/// What a folder of one is called in its `work.json`.
pub const ESTIMATE_SHARD_KIND: &str = "shard of a rare-failure estimate";

/// Everything that decides an estimate that is divided.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardedEstimate {
    estimate: RareRecord,
    /// Present if failures are stated per hour.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "exposed")]
    exposure: Option<ExposureConfig>,
}

impl Sharded for ShardedEstimate {
    const KIND: &'static str = ESTIMATE_SHARD_KIND;
    const VERSION: u32 = 3;
    const RESULTS: &'static str = "repetitions.json";
    const PARTS: &'static str = "repetitions";
    const IS_PRETTY: bool = true;

    fn parts(&self) -> u64 {
        self.estimate.effort.repetitions as u64
    }

    fn difference(&self, other: &Self) -> Option<String> {
        let fields = [
            ("what is estimated, how or by which release", other.estimate != self.estimate),
            ("the number of resamples", other.exposed != self.exposed),
        ];
        fields.iter().find(|(_, differs)| *differs).map(|(name, _)| (*name).to_owned())
    }
}

impl Mergeable for ShardedEstimate {
    type File = RareShardResults;
    type Results = RareShardResults;

    fn check(&self, repeated: RareShardResults, shard: Shard, own: &Range<u64>) -> Result<RareShardResults, String> {
        let made = if repeated.pilot.reaches_failure() { own.end - own.start } else { 0 };
        let resamples = self.exposed.as_ref().map_or(0, |exposed| exposed.resamples);
        let resampled = own_resamples(resamples, own, self.parts());
        let is_of_space = |exposed: &ExposureConfig| sha256(&exposed.space_text) == self.estimate.space_sha256;
        let is_sound = repeated.pilot.is_of(self.estimate.method, self.estimate.effort, self.estimate.seed)
            && repeated.pilot.is_consistent_with(&repeated.repetitions)
            && repeated.repetitions.count() == made
            && self.exposed.iter().all(is_of_space)
            // There are fewer where no space could be fitted to some.
            && repeated.resampled.len() as u64 <= resampled.end - resampled.start;
        if is_sound { Ok(repeated) } else { Err(format!("not what shard {shard} of that estimate comes to")) }
    }

    /// Returns the pilot if it differs: one seed places the same levels on every machine.
    fn contradiction(one: &RareShardResults, other: &RareShardResults) -> Option<String> {
        (one.pilot != other.pilot).then(|| "the pilot, as of another build,".to_owned())
    }
}

/// What decides what an estimate comes to per hour.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ExposureConfig {
    /// Of the episodes that the space was fitted to.
    resamples: u32,
    /// The space, in TOML.
    space_text: String,
}

/// Results of a shard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RareShardResults {
    pilot: Pilot,
    repetitions: Repetitions,
    /// Estimates in its share of the resamples.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[serde(rename = "resampled")]
    resample_estimates: Vec<Estimate>,
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
    pub fn open_shard_folder(
        &self,
        shard: Shard,
        resamples: u32,
        folder: &Path,
        resume: bool,
    ) -> Result<RareShard<'_>, RareError> {
        let estimate = self.record()?;
        if estimate.controller_sha256.is_none() {
            return Err(RareError::Unknown(self.controller.name.clone()));
        }
        let own = shard.range(self.effort.repetitions as u64, ShardedEstimate::PARTS)?;
        let exposed = match self.space.spec().exposure {
            Some(_) => Some(ExposureConfig { resamples, space_text: file::to_toml(&self.space)? }),
            None => None,
        };
        let resamples = exposed.as_ref().map_or(0, |exposed| exposed.resamples);
        let sharded = ShardedEstimate { estimate, exposed };
        let work = open_shard(&sharded, shard, folder, resume)?;
        let progress = Progress::in_folder(work, &sharded.estimate, own.end - own.start)?;
        Ok(RareShard { plan: self, shard, resamples, progress })
    }
}

impl RareShard<'_> {
    /// Whether it was made before.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.progress.work().is_complete()
    }

    /// Places the levels, or what is left of that, and keeps them. Reports every batch of runs.
    ///
    /// # Errors
    /// [`RareError`] if a run cannot be made or a file not written, or `observer` stops the pilot.
    pub fn run_pilot(&mut self, observer: &dyn Observer<RunProgress>) -> Result<Pilot, RareError> {
        self.progress.pilot(self.plan, &Counter::new(observer, None))
    }

    /// Runs its repetitions, with the levels of the pilot, and estimates in its share of the resamples, without what is in the folder already.
    ///
    /// # Errors
    /// [`RareError`] if a run cannot be made or a file not written, or `observer` stops the shard.
    pub fn run_repetitions(&mut self, pilot: &Pilot, observer: &dyn Observer<RunProgress>) -> Result<(), RareError> {
        let counter = Counter::new(observer, None);
        let all = self.plan.effort.repetitions as u64;
        let range = self.shard.range(all, ShardedEstimate::PARTS)?;
        let own = own_resamples(self.resamples, &range, all);
        let (plan, resamples) = (self.plan, self.resamples);
        let repetitions = self.progress.repeat(plan, pilot, range, &counter)?;
        let resampled = match pilot.reaches_failure() {
            true => {
                let mut again = self.progress.again(resamples);
                plan.resampled(resamples, own, &mut |space, seed| again.next(plan, (space, seed), &counter))?
            }
            false => Vec::new(),
        };
        let repeated = RareShardResults { pilot: pilot.clone(), repetitions, resampled };
        self.progress.finish(ShardedEstimate::RESULTS, serde_json::to_string_pretty(&repeated)? + "\n")
    }
}

/// Shards of one estimate.
#[derive(Debug)]
pub struct MergedEstimate(Merged<ShardedEstimate>);

impl Deref for MergedEstimate {
    type Target = Merged<ShardedEstimate>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl DerefMut for MergedEstimate {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

impl MergedEstimate {
    /// Begins with a shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn new(folder: &Path, found: &Finished) -> Result<Self, MergeError> {
        Merged::of(folder, found).map(Self)
    }

    /// The estimate, with what it comes to per hour where the space says in how much driving it was seen; none while repetitions are
    /// missing.
    ///
    /// # Errors
    /// [`MergeError`] if the estimates in resamples are not those of the space.
    pub fn report(&self) -> Result<Option<RareReport>, MergeError> {
        let Some(first) = self.results().next().filter(|_| self.missing_part_count() == 0) else { return Ok(None) };
        let repetitions = self.results().map(|repeated| &repeated.repetitions);
        let report = self.work().estimate.report(first.pilot.summary(repetitions));
        Ok(Some(RareReport { exposed: self.exposed(&report.estimate)?, ..report }))
    }

    fn rate_per_exposure(&self, estimate: &Estimate) -> Result<Option<ExposedRate>, MergeError> {
        let Some(ExposureConfig { resamples, space_text }) = &self.work().exposed else { return Ok(None) };
        let unusable = |problem: String| self.parts().unusable(SHARD, problem);
        let space = file::from_toml(space_text, Path::new("space_text"));
        let space = space.map_err(|error| unusable(error.to_string()))?;
        let mut kept = MergedResamples::of(self.results().flat_map(|repeated| &repeated.resampled).cloned().collect());
        let resamples = estimate_again(&space, self.work().estimate.seed, *resamples, &mut |_: &Space, _| kept.next());
        let resamples = resamples.and_then(|resamples| kept.end().map(|()| resamples));
        let resamples =
            resamples.map_err(|ResampleCountMismatch| unusable("not as many resamples as that space has".to_owned()))?;
        Ok(ExposedRate::of(&space, FailureProbability::Estimated(estimate), resamples.as_ref()))
    }

    /// Writes the folder of the whole estimate, that of an estimate by one machine to the byte, and says where the estimate is; none
    /// while repetitions are missing: then nothing is written.
    ///
    /// # Errors
    /// [`RareError`] if the shards do not go with their space, or the folder cannot be used, or holds something else.
    pub fn write_in(&self, folder: &Path) -> Result<Option<(PathBuf, RareReport)>, RareError> {
        let Some(report) = self.report()? else { return Ok(None) };
        let folder = self.work().estimate.in_folder(folder, true)?;
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
