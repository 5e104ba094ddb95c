//! Estimation of rare failure rates by multilevel splitting.
//!
//! Counting a failure of probability 10⁻⁷ would take 10⁹ runs. Splitting (Kahn and Harris, 1951; Au and Beck,
//! Estimation of small failure probabilities by subset simulation, 2001) uses a margin g that is negative for a
//! failure, and levels t₁ > t₂ > … > t_m, the last of which is the failure:
//!
//! ```text
//! P(g < 0) = P(g ≤ t₁) · P(g ≤ t₂ | g ≤ t₁) · … · P(g < 0 | g ≤ t_{m-1}),
//! ```
//!
//! Each factor is large enough to be counted. Runs that pass a level are copied to restore the population, and each is
//! moved by a Markov chain that leaves the distribution below the level invariant.
//!
//! # Properties of the estimate
//!
//! A pilot places the levels and tunes the chains; its runs are discarded. The estimate is the mean over *repetitions*,
//! independent populations with the same levels and chains; an extinct one counts as zero. The product of the shares is
//! unbiased, however slowly the chains mix (Del Moral, Feynman-Kac formulae, 2004, theorem 7.4.2; Cérou and others,
//! Sequential Monte Carlo for rare event estimation, 2012). The spread of the independent repetitions measures its
//! precision without assumptions on the chains.
//!
//! The runs are chosen adaptively, so they cannot count for a certificate; [`RatePlan`](super::RatePlan) does not
//! accept them. If the likeliest cause of failures is hard to reach, few repetitions find it: estimate and spread are
//! then far too low, more often than the interval states.
//!
//! # Failures
//!
//! Each repetition keeps a random sample of its failures. Together they are a weighted sample of the failure
//! distribution, about [`MAX_KEPT_FAILURES`] scenarios: see [`WeightedFailures`].
//!
//! # Noise
//!
//! Noise of accelerations, measurements and initial estimates is normal, and moves by the same autoregressive steps: it
//! is a weighted sum of the noise of several seeds, and each accepted move adds a seed. Failures that noise causes are
//! therefore reached step by step. Lost measurements and random controllers depend on the first seed, which only a
//! quarter of the moves replace.

mod failures;
mod plan;
mod splitting;
mod study;
#[cfg(test)]
mod study_tests;
#[cfg(test)]
mod tests;
mod text;

use serde::{Deserialize, Serialize};

pub use failures::{
    FAILURE_FOLDER, FAILURE_LIST_FILE, MAX_KEPT_FAILURES, WeightedFailure, WeightedFailures,
};
pub use plan::{RareError, RarePlan, RareReport};
pub use splitting::{MAX_LEVELS, PILOT_FACTORS, Repetition, SplittingLevels};
pub use study::{ESTIMATE_FILE, RareProgress, RareStage, RareState};

/// Effort of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SplittingConfig {
    /// Size of a population, at least 50.
    pub samples: usize,
    /// Number of independent populations, at least 5.
    #[serde(alias = "populations")]
    pub repetition_count: usize,
}

impl SplittingConfig {
    fn clamped(self) -> Self {
        Self {
            samples: self.samples.max(50),
            repetition_count: self.repetition_count.max(5),
        }
    }
}

impl Default for SplittingConfig {
    fn default() -> Self {
        Self {
            samples: 500,
            repetition_count: 20,
        }
    }
}

/// A level and its results.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "WrittenLevel")]
pub struct Level {
    /// Threshold: runs with at most this robustness pass, in metres for collisions. The last level is the failure, at
    /// 0.
    #[serde(alias = "robustness")]
    pub margin: f64,
    /// Threshold as a gap, if collisions are the failure; `None` otherwise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smallest_gap_m: Option<f64>,
    /// Probability of reaching the level: mean over the repetitions.
    pub probability: f64,
    /// Share of runs at the previous level that passed: mean over the repetitions that reached the previous level.
    pub share: f64,
    /// Step of the chains below this level, from 0 (no move) to 1 (independent sample); `None` at the last one.
    pub step: Option<f64>,
    /// Share of accepted moves.
    pub acceptance: Option<f64>,
}

/// Serialised level; in old files all margins are called gaps.
#[derive(Deserialize)]
struct WrittenLevel {
    #[serde(alias = "robustness")]
    margin: Option<f64>,
    smallest_gap_m: Option<f64>,
    probability: f64,
    share: f64,
    step: Option<f64>,
    acceptance: Option<f64>,
}

impl TryFrom<WrittenLevel> for Level {
    type Error = &'static str;

    fn try_from(written: WrittenLevel) -> Result<Self, &'static str> {
        let WrittenLevel {
            margin,
            smallest_gap_m,
            probability,
            share,
            step,
            acceptance,
        } = written;
        let margin = margin.or(smallest_gap_m).ok_or("a level has no `margin`")?;
        Ok(Self {
            margin,
            smallest_gap_m,
            probability,
            share,
            step,
            acceptance,
        })
    }
}

/// Estimate of a rare failure rate.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RareEstimate {
    /// Probability of a failure, at most 1; `None` if the pilot reached none.
    pub probability: Option<f64>,
    /// Relative standard deviation of the mean of the repetitions; `None` if that is zero.
    pub coefficient_of_variation: Option<f64>,
    /// Confidence interval at 95 %, if the estimate is above 0: Student's t on a logarithmic scale. Clopper-Pearson
    /// with a single level, which is a count.
    pub interval_95: Option<[f64; 2]>,
    /// Results of the repetitions. The estimate is their mean.
    pub repetitions: Vec<f64>,
    /// Number of runs, including the pilot.
    pub evaluations: u64,
    /// Number of independent initial samples of the populations, including the pilot.
    #[serde(default)]
    pub independent_runs: u64,
    /// Number of these that failed.
    #[serde(default)]
    pub independent_failures: u64,
    /// Levels; those of the pilot if it reached no failure.
    pub levels: Vec<Level>,
}
