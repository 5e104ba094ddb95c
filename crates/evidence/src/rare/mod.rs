//! How rare a failure is that plain sampling does not see: multilevel splitting.
//!
//! A failure of probability 10⁻⁷ would take a thousand million runs to be counted. Splitting climbs to it instead (Kahn and
//! Harris, 1951; Au and Beck, Estimation of small failure probabilities by subset simulation, 2001). With a margin g that is
//! negative where the run fails, and levels t₁ > t₂ > … > t_m with the failure itself as the last one,
//!
//! ```text
//! P(g < 0) = P(g ≤ t₁) · P(g ≤ t₂ | g ≤ t₁) · … · P(g < 0 | g ≤ t_{m-1}),
//! ```
//!
//! and each factor is large enough to be counted. Runs that pass a level are multiplied to as many as there were, and each
//! is moved on by a Markov chain that leaves the distribution below the level as it is.
//!
//! # What the figure is
//!
//! A pilot places the levels and sets the steps of the chains; where it reaches no failure, a larger one does. It is then thrown away: the estimate is the mean over
//! *repetitions*, independent populations that climb the same levels with the same steps. With levels and chains fixed in
//! advance the product of the shares is unbiased, however slowly the chains mix (Del Moral, Feynman-Kac formulae, 2004,
//! theorem 7.4.2; Cérou and others, Sequential Monte Carlo for rare event estimation, 2012), and since repetitions are
//! independent their spread says how far the mean can be trusted without any assumption on the chains. A
//! repetition that dies out counts as zero.
//!
//! Importance sampling ([`RareMethod::Importance`]) takes where the pilot arrives and draws there, each draw with its exact weight:
//! the same mean, of far fewer runs where failures lie in a few places. Its repetitions are populations of draws by one law, which is fixed in
//! advance as well.
//!
//! It is an estimate. Importance enters the choice of what is run, so none of these runs may be counted for a
//! certificate, and none is: [`RatePlan`](super::RatePlan) has no way to take them in. If failures have several causes, of which
//! the likeliest is hard to climb to, few repetitions see it: then the estimate is far too low, and the spread with it, more
//! often than the interval says. Sampling noise of the sensors is redrawn from time to time, not climbed: a failure that
//! noise alone decides is found no sooner than by counting.

mod folder;
mod importance;
mod mixture;
mod pilot;
mod plan;
mod progress;
#[cfg(test)]
mod progress_tests;
mod shard;
#[cfg(test)]
mod shard_tests;
mod splitting;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use folder::RareFolder;
pub use importance::ImportanceProposal;
pub use pilot::{Pilot, Repetitions};
pub use plan::{RareError, RarePlan, RareReport};
pub use shard::{ESTIMATE_SHARD_KIND, MergedEstimate, RareShard};
pub use splitting::{MAX_LEVELS, PILOT_FACTORS, SplittingLevels};

/// How much work goes into an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SplittingConfig {
    /// Runs of a population, at least 50.
    pub samples: usize,
    /// Independent populations, at least 5.
    #[serde(rename = "populations")]
    pub repetitions: usize,
}

/// How failures are climbed to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RareMethod {
    /// Populations that climb level by level, and the product of the shares that pass.
    #[default]
    Splitting,
    /// Draws from a law fitted to where such populations arrive, each with its exact weight.
    Importance,
}

impl SplittingConfig {
    /// With what there must be at least.
    fn clamped(self) -> Self {
        Self { samples: self.samples.max(50), repetitions: self.repetitions.max(5) }
    }
}

impl Default for SplittingConfig {
    fn default() -> Self {
        Self { samples: 500, repetitions: 20 }
    }
}

/// A level and what came of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "WrittenLevel")]
pub struct Level {
    /// Runs pass whose margin is at most this: their robustness, in metres for contacts; the last level is the failure itself, at 0.
    #[serde(rename = "robustness")]
    pub margin: f64,
    /// Of contacts the same, which is the smallest gap there; none in what does not know what fails.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smallest_gap_m: Option<f64>,
    /// Probability to get here: mean over the repetitions.
    pub probability: f64,
    /// Share of the runs that passed, of those that were at the level before: mean over the repetitions that were.
    pub share: f64,
    /// Step of the chains below this level, from 0 (no move) to 1 (a new draw); none below the last one.
    pub step: Option<f64>,
    /// Share of moves that were accepted there.
    pub acceptance: Option<f64>,
}

/// A level as it is written, or was: margins of all rules were called gaps.
#[derive(Deserialize)]
struct WrittenLevel {
    robustness: Option<f64>,
    smallest_gap_m: Option<f64>,
    probability: f64,
    share: f64,
    step: Option<f64>,
    acceptance: Option<f64>,
}

impl TryFrom<WrittenLevel> for Level {
    type Error = &'static str;

    fn try_from(written: WrittenLevel) -> Result<Self, &'static str> {
        let WrittenLevel { robustness, smallest_gap_m, probability, share, step, acceptance } = written;
        let margin = robustness.or(smallest_gap_m).ok_or("a level has no `robustness`")?;
        Ok(Self { margin, smallest_gap_m, probability, share, step, acceptance })
    }
}

/// What splitting found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RareEstimate {
    /// The probability of a failure, at most 1; none if the pilot did not reach it.
    pub probability: Option<f64>,
    /// Standard deviation of the mean of the repetitions, relative to it; none if it is zero.
    pub coefficient_of_variation: Option<f64>,
    /// An interval at 95 % for the probability, if there is an estimate above 0: Student's, on a logarithmic scale; Clopper's and
    /// Pearson's where there is one level, so that runs are only counted, and of the independent draws where the spread leaves
    /// nothing below 1.
    pub interval_95: Option<[f64; 2]>,
    /// What each repetition says. The mean of these is the estimate; of weighted draws it may be above 1, where the estimate ends.
    pub repetitions: Vec<f64>,
    /// Runs made, those of the pilot included.
    pub evaluations: u64,
    /// Draws that populations began with, the pilot's included: independent of each other.
    #[serde(default)]
    pub independent_runs: u64,
    /// How many of these failed.
    #[serde(default)]
    pub independent_failures: u64,
    /// The levels; where the failure was not reached, and of importance sampling, those that were, as the pilot saw them.
    pub levels: Vec<Level>,
    /// Of importance sampling: the largest weight of a run, of the sum of all; if it is large, the spread says little.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub largest_weight: Option<f64>,
}
