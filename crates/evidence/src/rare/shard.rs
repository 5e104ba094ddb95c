//! Shards of an estimate: each runs the pilot, which determines the levels, and some of the repetitions. The folder of
//! a shard holds `shard.json`, the configuration, and `repetitions.json`; until that exists, `progress.json`.

use std::ops::{Deref, DerefMut, Range};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::plan::RareRecord;
use super::progress::RareProgress;
use super::{Pilot, RareError, RareEstimate, RarePlan, RareReport, Repetitions};
use crate::exposure::{
    FailureProbability, MergedResamples, RatePerExposure, ResampleCountMismatch, estimate_on_resamples, resample_range,
};
use crumple_core::digest::sha256;
use crumple_core::observer::{Observer, ProgressCounter, RunProgress};
use crumple_store::run_folder::{CompletedRun, RunFolderError};
use crumple_store::shard::{MergeError, Mergeable, MergedShards, SHARD_FILE, ShardId, Sharded, open_shard};
use crumple_world::scenario::space::{ScenarioSpace, file};

/// Kind of the run folder in its `work.json`.
pub const ESTIMATE_SHARD_KIND: &str = "shard of a rare-failure estimate";

/// Configuration of an estimate that is divided into shards.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardedEstimate {
    estimate: RareRecord,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "exposed")]
    exposure: Option<ExposureConfig>,
}

impl Sharded for ShardedEstimate {
    const KIND: &'static str = ESTIMATE_SHARD_KIND;
    const VERSION: u32 = 3;
    const RESULTS_FILE: &'static str = "repetitions.json";
    const PARTS_NAME: &'static str = "repetitions";
    const IS_PRETTY: bool = true;

    fn part_count(&self) -> u64 {
        self.estimate.effort.repetitions as u64
    }

    fn differing_field(&self, other: &Self) -> Option<String> {
        let fields = [
            ("the configuration or the release", other.estimate != self.estimate),
            ("the number of resamples", other.exposure != self.exposure),
        ];
        fields.iter().find(|(_, differs)| *differs).map(|(name, _)| (*name).to_owned())
    }
}

impl Mergeable for ShardedEstimate {
    type File = RareShardResults;
    type Results = RareShardResults;

    fn check(&self, repeated: RareShardResults, shard: ShardId, own: &Range<u64>) -> Result<RareShardResults, String> {
        let made = if repeated.pilot.reaches_failure() { own.end - own.start } else { 0 };
        let resamples = self.exposure.as_ref().map_or(0, |exposed| exposed.resamples);
        let resampled = resample_range(resamples, own, self.part_count());
        let is_of_space = |exposed: &ExposureConfig| sha256(&exposed.space_text) == self.estimate.space_sha256;
        let is_sound = repeated.pilot.is_run_by(self.estimate.method, self.estimate.effort, self.estimate.seed)
            && repeated.pilot.is_consistent_with(&repeated.repetitions)
            && repeated.repetitions.count() == made
            && self.exposure.iter().all(is_of_space)
            && repeated.resample_estimates.len() as u64 <= resampled.end - resampled.start;
        if is_sound { Ok(repeated) } else { Err(format!("inconsistent with shard {shard} of that estimate")) }
    }

    /// Compares the pilots: the same seed gives the same levels on every machine.
    fn contradiction(one: &RareShardResults, other: &RareShardResults) -> Option<String> {
        (one.pilot != other.pilot).then(|| "the pilot, as of another build,".to_owned())
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ExposureConfig {
    resamples: u32,
    space_text: String,
}

/// Results of a shard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RareShardResults {
    pilot: Pilot,
    repetitions: Repetitions,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[serde(rename = "resampled")]
    resample_estimates: Vec<RareEstimate>,
}

/// An open folder of a shard.
pub struct RareShard<'a> {
    plan: &'a RarePlan,
    shard: ShardId,
    resamples: u32,
    progress: RareProgress,
}

impl RarePlan {
    /// Opens the folder if it is empty or belongs to this shard. With a space that is fitted to episodes, the shard
    /// also estimates in its share of `resamples`.
    ///
    /// # Errors
    /// [`RareError`] if there are fewer repetitions than shards, the controller has no identity, or the folder cannot
    /// be used, has other content, or is damaged.
    pub fn open_shard_folder(
        &self,
        shard: ShardId,
        resamples: u32,
        folder: &Path,
        resume: bool,
    ) -> Result<RareShard<'_>, RareError> {
        let estimate = self.record()?;
        if estimate.controller_sha256.is_none() {
            return Err(RareError::NoIdentity(self.controller.name.clone()));
        }
        let own = shard.range(self.effort.repetitions as u64, ShardedEstimate::PARTS_NAME)?;
        let exposed = match self.space.spec().exposure {
            Some(_) => Some(ExposureConfig { resamples, space_text: file::to_toml(&self.space)? }),
            None => None,
        };
        let resamples = exposed.as_ref().map_or(0, |exposed| exposed.resamples);
        let sharded = ShardedEstimate { estimate, exposure: exposed };
        let work = open_shard(&sharded, shard, folder, resume)?;
        let progress = RareProgress::load(work, &sharded.estimate, own.end - own.start)?;
        Ok(RareShard { plan: self, shard, resamples, progress })
    }
}

impl RareShard<'_> {
    /// True if the shard is complete.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.progress.run_folder.is_complete()
    }

    /// Runs or resumes the pilot, and saves the levels. Reports every batch of runs.
    ///
    /// # Errors
    /// [`RareError`] if a run fails, a file cannot be written, or `observer` stops the pilot.
    pub fn run_pilot(&mut self, observer: &dyn Observer<RunProgress>) -> Result<Pilot, RareError> {
        self.progress.run_pilot(self.plan, &ProgressCounter::new(observer, None))
    }

    /// Runs the remaining repetitions and estimates in resamples.
    ///
    /// # Errors
    /// [`RareError`] if a run fails, a file cannot be written, or `observer` stops the shard.
    pub fn run_repetitions(&mut self, pilot: &Pilot, observer: &dyn Observer<RunProgress>) -> Result<(), RareError> {
        let counter = ProgressCounter::new(observer, None);
        let all = self.plan.effort.repetitions as u64;
        let range = self.shard.range(all, ShardedEstimate::PARTS_NAME)?;
        let own = resample_range(self.resamples, &range, all);
        let (plan, resamples) = (self.plan, self.resamples);
        let repetitions = self.progress.run_repetitions(plan, pilot, range, &counter)?;
        let resampled = match pilot.reaches_failure() {
            true => {
                let mut again = self.progress.resample_estimator(resamples);
                plan.estimate_resamples(resamples, own, &mut |space, seed| again.next(plan, (space, seed), &counter))?
            }
            false => Vec::new(),
        };
        let repeated = RareShardResults { pilot: pilot.clone(), repetitions, resample_estimates: resampled };
        self.progress.finish(ShardedEstimate::RESULTS_FILE, serde_json::to_string_pretty(&repeated)? + "\n")
    }
}

/// Shards of one estimate, for merging.
#[derive(Debug)]
pub struct MergedEstimate(MergedShards<ShardedEstimate>);

impl Deref for MergedEstimate {
    type Target = MergedShards<ShardedEstimate>;

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
    /// Starts with the first shard.
    ///
    /// # Errors
    /// [`MergeError`] if the shard cannot be read.
    pub fn new(folder: &Path, found: &CompletedRun) -> Result<Self, MergeError> {
        MergedShards::new(folder, found).map(Self)
    }

    /// Returns the estimate, with rates per hour if the space states its exposure; `None` while repetitions are
    /// missing.
    ///
    /// # Errors
    /// [`MergeError`] if the estimates in resamples are not those of the space.
    pub fn report(&self) -> Result<Option<RareReport>, MergeError> {
        let Some(first) = self.results().next().filter(|_| self.missing_part_count() == 0) else { return Ok(None) };
        let repetitions = self.results().map(|repeated| &repeated.repetitions);
        let report = self.work().estimate.report(first.pilot.summary(repetitions));
        Ok(Some(RareReport { exposure: self.rate_per_exposure(&report.estimate)?, ..report }))
    }

    fn rate_per_exposure(&self, estimate: &RareEstimate) -> Result<Option<RatePerExposure>, MergeError> {
        let Some(ExposureConfig { resamples, space_text }) = &self.work().exposure else { return Ok(None) };
        let unusable = |problem: String| self.parts().damaged_error(SHARD_FILE, problem);
        let space = file::from_toml(space_text, Path::new("space_text"));
        let space = space.map_err(|error| unusable(error.to_string()))?;
        let mut kept =
            MergedResamples::new(self.results().flat_map(|repeated| &repeated.resample_estimates).cloned().collect());
        let resamples =
            estimate_on_resamples(&space, self.work().estimate.seed, *resamples, &mut |_: &ScenarioSpace, _| {
                kept.next()
            });
        let resamples = resamples.and_then(|resamples| kept.finish().map(|()| resamples));
        let resamples = resamples
            .map_err(|ResampleCountMismatch| unusable("the number of resamples does not match the space".to_owned()))?;
        Ok(RatePerExposure::new(&space, FailureProbability::Estimated(estimate), resamples.as_ref()))
    }

    /// Writes the folder of the whole estimate, byte for byte as an undivided estimate would, and returns the path of
    /// the estimate. `None` while repetitions are missing: then nothing is written.
    ///
    /// # Errors
    /// [`RareError`] if the shards do not match their space, or the folder cannot be used or has other content.
    pub fn write_in(&self, folder: &Path) -> Result<Option<(PathBuf, RareReport)>, RareError> {
        let Some(report) = self.report()? else { return Ok(None) };
        let folder = self.work().estimate.open_folder(folder, true)?;
        match folder.read_report()? {
            Some(kept) if kept != report.without_exposure() => {
                let problem = "the folder holds an estimate of the same configuration with other results";
                return Err(RunFolderError::damaged(&folder.path(), problem).into());
            }
            _ => folder.write_report(&report)?,
        }
        Ok(Some((folder.path(), report)))
    }
}
