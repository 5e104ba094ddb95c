//! Planned work: its runs, its duration and its command.

use std::time::Duration;

use serde::Serialize;

use super::PlanCommand;
use crate::cli::{CliError, output};
use crumple_evidence::{RateConfig, RatePlan, SampleSizeError, required_runs};
use crumple_store::shard::ShardId;
use crumple_world::control::is_external_allowed;

#[derive(Serialize)]
pub(super) struct PlannedCount {
    pub(super) registration_sha256: String,
    pub(super) runs: u64,
    pub(super) confidence: f64,
    /// Rate that the count shows if `failures` runs fail.
    pub(super) rate_at_most: f64,
    pub(super) failures: u64,
}

pub(super) struct WorkEstimate {
    pub(super) runs: u64,
    /// Runs per second on one core.
    pub(super) runs_per_second: f64,
    pub(super) max_shards: u32,
    /// Size on disk of this many shards.
    pub(super) bytes_of_shards: Box<dyn Fn(u32) -> u64>,
}

const PACE_DURATION: Duration = Duration::from_secs(2);
/// Separates the seeds of the measurement from those of the counted runs.
const PACE_SEED_MASK: u64 = 0x9e37_79b9_7f4a_7c15;

impl PlanCommand {
    pub(super) fn plan_rate(&self, quiet: bool) -> Result<(PlannedCount, Vec<String>, WorkEstimate), CliError> {
        let runs = match (self.runs, self.rate_below) {
            (Some(runs), _) => runs,
            (None, rate) => {
                let named = |error| match error {
                    SampleSizeError::Confidence { .. } => CliError::Input(format!("--{error}")),
                    _ => CliError::Input(format!("--rate-below: {error}")),
                };
                required_runs(rate.unwrap_or_default(), self.confidence, self.failures).map_err(named)?
            }
        };
        let plan = self.rate_plan(self.seed, runs)?;
        if let Some(shards) = self.shards {
            plan.shard_blocks(ShardId::new(shards, shards).map_err(CliError::input)?).map_err(CliError::input)?;
        }
        output::note("measuring the pace", quiet);
        let pace = self
            .rate_plan(self.seed ^ PACE_SEED_MASK, runs.min(100_000))?
            .runs_per_second(PACE_DURATION)
            .map_err(CliError::input)?;
        let wanted = PlannedCount {
            registration_sha256: plan.registration().digest(),
            runs,
            confidence: self.confidence,
            rate_at_most: plan.record().rate_at_most(self.failures),
            failures: self.failures,
        };
        // Runs of resamples are not counted, but take as long.
        let (resamples, runs_each) = plan.resampling().unwrap_or_default();
        let measure = WorkEstimate {
            runs: runs + u64::from(resamples) * u64::from(runs_each),
            runs_per_second: pace,
            max_shards: plan.max_shards(),
            bytes_of_shards: Box::new(move |shards| plan.estimated_bytes(shards)),
        };
        Ok((wanted, self.rate_args(runs), measure))
    }

    fn rate_plan(&self, seed: u64, runs: u64) -> Result<RatePlan, CliError> {
        Ok(RatePlan::new(RateConfig {
            seed,
            estimator: self.estimator,
            confidence: self.confidence,
            ..RateConfig::new(self.controller.clone(), self.space.1.clone(), runs)
        })?)
    }

    fn rate_args(&self, runs: u64) -> Vec<String> {
        let mut words = vec!["verify".to_owned(), "rate".to_owned()];
        if is_external_allowed() {
            words.push("--allow-external".to_owned());
        }
        words.extend([
            format!("--controller={}", self.controller.name),
            format!("--space={}", self.space.0),
            format!("--estimator={}", self.estimator.name()),
            format!("--seed={}", self.seed),
            format!("--runs={runs}"),
            format!("--confidence={}", self.confidence),
        ]);
        words
    }
}
