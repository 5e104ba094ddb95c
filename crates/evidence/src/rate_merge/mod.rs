//! Merge of the shards of a count, in any order; duplicates and gaps are allowed. A shard is a range of blocks, each
//! with a hash of its runs. The merged blocks, sums, bound and certificate are those of an undivided count, without
//! rounding. Memory grows with the number of blocks, at most ten thousand, not of runs.

use std::ops::{Deref, DerefMut, Range};
use std::path::{Path, PathBuf};

use crumple_verify::Certificate;
use serde::Serialize;

use super::exposure::{
    FailureProbability, MergedResamples, RatePerExposure, ResampleCountMismatch, count_on_resamples,
};
use super::rate_folder::RateFolderError;
use super::rate_shard::ShardedCount;
use super::record::{CountRecord, CountTally, range_len};
use crumple_store::run_folder::CompletedRun;
use crumple_store::shard::{MergeError, MergedShards, MissingShards, SHARD_FILE};
use crumple_world::scenario::space::{ScenarioSpace, file};

/// Shards of one count, for merging.
#[derive(Debug)]
pub struct MergedCount(MergedShards<ShardedCount>);

impl Deref for MergedCount {
    type Target = MergedShards<ShardedCount>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl DerefMut for MergedCount {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

/// Result of some or all shards.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartialCount {
    /// Digest of the registration.
    pub registration_sha256: String,
    /// Number of registered runs.
    pub registered_runs: u64,
    /// Number of runs in the shards.
    pub runs: u64,
    /// Runs in which the controller failed; with two controllers, both.
    pub failures: u64,
    /// Runs in which only the first of two controllers failed.
    pub only_first_failed: u64,
    /// Runs in which only the second failed.
    pub only_second_failed: u64,
    /// Number of shards.
    pub shards: u64,
    /// Number of duplicates of these shards.
    pub duplicates: u64,
    /// Missing runs, as ranges: the first, and the one after the last.
    pub missing_runs: Vec<[u64; 2]>,
    /// Missing shards, if all shards are of the same division.
    pub missing_shards: Vec<u32>,
    /// Number of shards of the division; `None` with several divisions.
    #[serde(rename = "of_shards")]
    pub shard_count: Option<u32>,
    /// Bound for one controller at the registered confidence level, with all missing runs taken as failures.
    pub rate_at_most: Option<f64>,
}

impl MergedCount {
    /// Starts with the first shard.
    ///
    /// # Errors
    /// [`MergeError`] if the shard cannot be read.
    pub fn new(folder: &Path, found: &CompletedRun) -> Result<Self, MergeError> {
        MergedShards::new(folder, found).map(Self)
    }

    /// Returns the registration with the space.
    #[must_use]
    pub fn record(&self) -> &CountRecord {
        &self.work().count
    }

    /// True if every run was counted.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.missing_ranges().is_empty()
    }

    /// Returns the result of the shards.
    #[must_use]
    pub fn partial_count(&self) -> PartialCount {
        let sum = |of: fn(&CountTally) -> u64| self.parts().contents().map(of).sum::<u64>();
        let missing: Vec<Range<u64>> =
            self.missing_ranges().into_iter().map(|blocks| self.record().run_range(blocks)).collect();
        let MissingShards { shard_count: of_shards, missing_shards } = self.parts().missing_shards();
        let open: u64 = missing.iter().map(range_len).sum();
        let failures = sum(|tally| tally.failures);
        let worst = failures.saturating_add(open);
        PartialCount {
            registration_sha256: self.record().registration.digest(),
            registered_runs: self.record().registration.runs,
            runs: sum(|tally| tally.runs),
            failures,
            only_first_failed: sum(|tally| tally.only_first_failed),
            only_second_failed: sum(|tally| tally.only_second_failed),
            shards: self.parts().shard_count(),
            duplicates: self.parts().duplicates(),
            missing_runs: missing.iter().map(|runs| [runs.start, runs.end]).collect(),
            missing_shards,
            shard_count: of_shards,
            rate_at_most: match (self.record().is_comparison(), missing.is_empty()) {
                (true, _) => None,
                (false, true) => Some(self.record().rate_at_most(failures)),
                (false, false) => Some(self.record().uncertified_rate_at_most(worst)),
            },
        }
    }

    /// Returns the tally of all runs; `None` while some are missing.
    #[must_use]
    pub fn tally(&self) -> Option<CountTally> {
        if !self.is_complete() {
            return None;
        }
        let mut tally = self.record().empty_tally();
        for (index, block) in (0..).zip(self.parts().contents().flat_map(|part| &part.blocks)) {
            tally.add_block(range_len(&self.record().run_range(index..index + 1)), block.clone());
        }
        Some(tally)
    }

    /// Returns failures per hour and per 1000 km if the space states its exposure, identical to an undivided count;
    /// `None` while runs are missing.
    ///
    /// # Errors
    /// [`MergeError`] if the resamples are not those of the space.
    pub fn rate_per_exposure(&self) -> Result<Option<RatePerExposure>, MergeError> {
        let (Some(tally), Some(resampling)) = (self.tally(), self.work().resampling) else { return Ok(None) };
        let unusable = |problem: String| self.parts().damaged_error(SHARD_FILE, problem);
        let space = file::from_toml(&self.record().space_text, Path::new("space_text"));
        let space = space.map_err(|error| unusable(error.to_string()))?;
        let seed = self.record().registration.configuration.get("seed").and_then(|seed| seed.parse().ok());
        let seed = seed.ok_or_else(|| unusable("configuration.seed: must be a number".to_owned()))?;
        let mut kept =
            MergedResamples::new(self.parts().contents().flat_map(|part| &part.resample_failures).copied().collect());
        let resamples =
            count_on_resamples(&space, seed, resampling.0, resampling.1, &mut |_: &ScenarioSpace, _, _| kept.next());
        let resamples = resamples.and_then(|resamples| kept.finish().map(|()| resamples));
        let resamples = resamples
            .map_err(|ResampleCountMismatch| unusable("the number of resamples does not match the space".to_owned()))?;
        let known = FailureProbability::Counted { failures: tally.failures, unknown: 0, runs: tally.runs };
        Ok(RatePerExposure::new(&space, known, resamples.as_ref()))
    }

    /// Writes the folder of the whole count, byte for byte as an undivided count would, and returns the path of its
    /// certificate. `None` while runs are missing: then nothing is written.
    ///
    /// # Errors
    /// [`RateFolderError`] if the folder cannot be used or has other content, or if the certificate is rejected.
    pub fn write_in(&self, folder: &Path) -> Result<Option<(PathBuf, Certificate)>, RateFolderError> {
        self.tally().map(|tally| self.record().write_in(folder, &tally)).transpose()
    }
}

#[cfg(test)]
mod tests;
