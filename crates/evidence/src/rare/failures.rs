//! A sample of the failure distribution: scenarios that failed in the repetitions of a splitting, with weights.
//!
//! The last level of a repetition is the failure. Its survivors are a sample of the failure distribution, and share the
//! probability that the repetition estimates. The weights of all repetitions add up to the estimate. An average over
//! the failures, with these weights, is therefore one over the failure distribution.

use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::splitting::{LimitState, Particle, RandomInputs};
use super::{RareError, RarePlan, Repetition};
use crumple_core::non_finite;
use crumple_sim::random::{NoiseShare, Stream};
use crumple_sim::scenario::file;

/// Number of failures that an estimate keeps, rounded up to a multiple of its repetitions.
pub const MAX_KEPT_FAILURES: usize = 200;

/// Folder of the scenario files in the folder of an estimate.
pub const FAILURE_FOLDER: &str = "failures/";

/// Name of the list of failures in the folder of an estimate.
pub const FAILURE_LIST_FILE: &str = "rare-failures.json";

/// Random inputs of a run that failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FailedRun {
    normal: Vec<f64>,
    noise: Vec<WrittenNoiseShare>,
    #[serde(with = "non_finite")]
    margin: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenNoiseShare {
    seed: u64,
    weight: f64,
}

/// Failures of an estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeightedFailures {
    /// Version of the format: 1.
    pub version: u32,
    /// Sum of the weights: the estimated probability of a failure.
    pub probability: f64,
    /// Failures in the order of the repetitions.
    pub failures: Vec<WeightedFailure>,
}

/// A failure of an estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeightedFailure {
    /// Name of the scenario file in [`FAILURE_FOLDER`].
    pub file: String,
    /// Probability that this failure stands for.
    pub weight: f64,
    /// Margin of the run, negative; minus infinity if the controller gave no answer.
    #[serde(with = "non_finite")]
    pub margin: f64,
    /// True if the scenario file fails as well. It has the noise of one seed only: the first of `noise`.
    pub replays: bool,
    /// Seeds whose noise the run had, each with the factor of its noise in the sum. The squares of the factors add up
    /// to 1.
    noise: Vec<WrittenNoiseShare>,
}

impl FailedRun {
    fn new((inputs, margin): &Particle) -> Self {
        let noise = inputs.noise.iter().map(|share| WrittenNoiseShare {
            seed: share.seed,
            weight: share.weight,
        });
        Self {
            normal: inputs.normal.clone(),
            noise: noise.collect(),
            margin: *margin,
        }
    }

    /// True if a run in a space with so many parameters can be this one.
    pub(super) fn is_possible(&self, dimension: usize) -> bool {
        self.normal.len() == dimension && !self.noise.is_empty() && self.margin < 0.0
    }

    #[cfg(test)]
    pub(super) fn margin(&self) -> f64 {
        self.margin
    }

    /// Returns the inputs of the scenario file, which has the noise of the first seed alone.
    fn file_inputs(&self) -> RandomInputs {
        let first = self.noise.iter().take(1);
        RandomInputs {
            normal: self.normal.clone(),
            noise: first
                .map(|share| NoiseShare {
                    seed: share.seed,
                    weight: 1.0,
                })
                .collect(),
        }
    }
}

/// Chooses at most `most` failures at random, each with the same probability.
pub(super) fn choose(failures: &[Particle], most: usize, random: &mut Stream) -> Vec<FailedRun> {
    let mut order: Vec<usize> = (0..failures.len()).collect();
    for index in 0..most.min(order.len()) {
        let other = random.random_range(index..order.len());
        order.swap(index, other);
    }
    let chosen = order
        .iter()
        .take(most)
        .filter_map(|&index| failures.get(index));
    chosen.map(FailedRun::new).collect()
}

/// Returns the failures of all repetitions with their weights. Equal runs are joined.
pub(super) fn weigh(repetitions: &[Repetition]) -> Vec<(&FailedRun, f64)> {
    let mut weighted: Vec<(&FailedRun, f64)> = Vec::new();
    for repetition in repetitions {
        let share = repetition.probability() / repetitions.len() as f64;
        let failed = repetition.failed_runs();
        let weight = share / failed.len().max(1) as f64;
        let first = weighted.len();
        for run in failed {
            // Copies of a run are in its own repetition.
            let own = weighted.get_mut(first..).unwrap_or_default();
            match own.iter_mut().find(|(known, _)| *known == run) {
                Some((_, sum)) => *sum += weight,
                None => weighted.push((run, weight)),
            }
        }
    }
    weighted
}

impl RarePlan {
    /// Returns the files of the failures: one for each scenario, and their list. Simulates each scenario again.
    pub(super) fn failure_files(
        &self,
        repetitions: &[Repetition],
    ) -> Result<Vec<(String, String)>, RareError> {
        let weighted = weigh(repetitions);
        if weighted.is_empty() {
            return Ok(Vec::new());
        }
        let inputs: Vec<RandomInputs> = weighted.iter().map(|(run, _)| run.file_inputs()).collect();
        let margins = self.margins(&inputs)?;
        let mut files = Vec::with_capacity(weighted.len() + 1);
        let mut failures = Vec::with_capacity(weighted.len());
        for (number, (((run, weight), inputs), margin)) in
            (1..).zip(weighted.into_iter().zip(&inputs).zip(margins))
        {
            let name = format!("{number:03}.toml");
            let text = file::to_toml(&self.scenario(inputs)?)?;
            files.push((format!("{FAILURE_FOLDER}{name}"), text));
            failures.push(WeightedFailure {
                file: name,
                weight,
                margin: run.margin,
                replays: margin < 0.0,
                noise: run.noise.clone(),
            });
        }
        let list = WeightedFailures {
            version: 1,
            probability: failures.iter().map(|failure| failure.weight).sum(),
            failures,
        };
        let text = crumple_store::run_folder::encode_json(FAILURE_LIST_FILE, &list)?;
        files.push((FAILURE_LIST_FILE.to_owned(), text));
        Ok(files)
    }
}
