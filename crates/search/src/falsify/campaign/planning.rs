//! Estimates of the speed and size of a campaign and its shards.

use std::time::{Duration, Instant};

use super::resolved_config::ResolvedConfig;
use super::{Campaign, CampaignError, EvaluationLog};
use crate::falsify::Method;
use crumple_store::jobs::run_on_one_core;

/// Approximate bytes of a shard's failures: three of each of six kinds, each with two scenarios, and a front of thirty.
const FAILURE_BYTES: u64 = 90_000;

impl Campaign {
    /// Measures the evaluations per second on one core, with uniform points for about `during`, without examinations.
    ///
    /// # Errors
    /// [`CampaignError`] if a scenario cannot be simulated.
    pub fn evaluations_per_second(&self, during: Duration) -> Result<f64, CampaignError> {
        let terms = ResolvedConfig::from_campaign(self, EvaluationLog::Summary)?;
        self.check(&terms.nominal)?;
        run_on_one_core(|| {
            let mut search = Method::Uniform.start(&terms.cube, self.seed);
            let (begun, mut evaluations) = (Instant::now(), 0_u64);
            while evaluations == 0 || begun.elapsed() < during {
                evaluations += self.evaluate(&terms.space, &search.ask())?.len() as u64;
            }
            Ok(evaluations as f64 / begun.elapsed().as_secs_f64().max(1e-9))
        })
    }

    /// Returns the approximate bytes that all shards write.
    #[must_use]
    pub fn estimated_bytes(&self, shards: u32) -> u64 {
        let dimension = self.space.dimension() as u64;
        // A hexadecimal digit holds four cells.
        let cells = 10 * dimension + 100 * (dimension * dimension.saturating_sub(1) / 2);
        u64::from(shards) * (FAILURE_BYTES + self.methods().len() as u64 * cells / 4)
    }

    /// Returns the maximum number of shards of the campaign.
    #[must_use]
    pub fn max_shards(&self) -> u32 {
        u32::try_from(self.budget).unwrap_or(u32::MAX).min(crumple_store::shard::MAX_SHARDS)
    }
}
