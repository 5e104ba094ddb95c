//! Shares of replays with a result.

use serde::{Deserialize, Serialize};

use crumple_core::interval::RateInterval;

const CONFIDENCE: f64 = 0.95;

/// Number of replays with a result, and the exact 95 % interval of its share.
///
/// The interval holds for replays of independent random scenarios. Counterexamples of a search are selected, so for
/// them it says nothing about all failures of the space.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ReplayShare {
    /// Number of replays with the result.
    pub count: u64,
    /// Number of replays.
    pub replays: u64,
    /// Exact 95 % interval of the share.
    #[serde(flatten)]
    pub interval: RateInterval,
}

impl ReplayShare {
    /// Counts the results; `None` if there is none.
    #[must_use]
    pub fn from_results(results: impl IntoIterator<Item = bool>) -> Option<Self> {
        let mut count = 0;
        let mut replays = 0;
        for result in results {
            count += u64::from(result);
            replays += 1;
        }
        let interval = RateInterval::clopper_pearson(count, replays, CONFIDENCE);
        (replays > 0).then_some(Self {
            count,
            replays,
            interval,
        })
    }

    /// Describes the share, with the words after the numbers.
    #[must_use]
    pub fn describe(&self, what: &str) -> String {
        let share = 100.0 * self.count as f64 / self.replays as f64;
        let interval = self.interval.to_percent_text(1);
        let Self { count, replays, .. } = self;
        format!("{count} of {replays} {what} ({share:.1} %; exact 95 % interval: {interval} %)")
    }
}
