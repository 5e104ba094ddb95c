//! Pilot and repetitions of either method.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::importance::{ImportanceProposal, MixtureFitting, WeightedRepetition};
use super::splitting::{LimitState, Repetition};
use super::{RareEstimate, RareMethod, SplittingConfig, SplittingLevels};
use crumple_core::observer::ProgressCounter;

/// Minimum number of runs between checkpoints: writing one costs milliseconds.
const MIN_RUNS_PER_WRITE: u64 = 500;

/// Result of a pilot that determines the repetitions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pilot {
    /// Levels of splitting.
    Splitting(SplittingLevels),
    /// Proposal of importance sampling.
    Importance(ImportanceProposal),
}

/// Results of some repetitions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Repetitions {
    /// Repetitions by splitting.
    Splitting(Vec<Repetition>),
    /// Repetitions by importance sampling.
    Importance(Vec<WeightedRepetition>),
}

impl Pilot {
    /// Runs the pilot.
    ///
    /// # Errors
    /// Errors of the problem.
    pub(super) fn run<P: LimitState>(
        problem: &P,
        method: RareMethod,
        effort: SplittingConfig,
        seed: u64,
        counter: &ProgressCounter<'_>,
    ) -> Result<Self, P::Error> {
        Self::resume(problem, (method, effort, seed), None, &mut |_| Ok(()), counter)
    }

    /// Runs or resumes the pilot. Calls `keep` with each state of a fit worth saving.
    pub(super) fn resume<P: LimitState>(
        problem: &P,
        (method, effort, seed): (RareMethod, SplittingConfig, u64),
        begun: Option<MixtureFitting>,
        keep: &mut dyn FnMut(&MixtureFitting) -> Result<(), P::Error>,
        counter: &ProgressCounter<'_>,
    ) -> Result<Self, P::Error> {
        let begun = match (method, begun) {
            (RareMethod::Splitting, _) => {
                return Ok(Self::Splitting(SplittingLevels::run_pilots(problem, effort, seed, counter)?));
            }
            (RareMethod::Importance, Some(begun)) => begun,
            (RareMethod::Importance, None) => {
                let begun = MixtureFitting::new(SplittingLevels::run_pilots(problem, effort, seed, counter)?);
                keep(&begun)?;
                begun
            }
        };
        Ok(Self::Importance(ImportanceProposal::fit(problem, begun, keep, counter)?))
    }

    /// True if the pilot reached a failure.
    #[must_use]
    pub fn reaches_failure(&self) -> bool {
        match self {
            Self::Splitting(levels) => levels.reaches_failure(),
            Self::Importance(proposal) => proposal.reaches_failure(),
        }
    }

    /// Returns the maximum number of runs of the repetitions.
    #[must_use]
    pub fn planned_runs(&self) -> u64 {
        match self {
            Self::Splitting(levels) => levels.planned_runs(),
            Self::Importance(proposal) => proposal.planned_runs(),
        }
    }

    /// Runs all repetitions. The result does not depend on the number of threads.
    ///
    /// # Errors
    /// Errors of the problem.
    pub(super) fn estimate<P: LimitState>(
        &self,
        problem: &P,
        counter: &ProgressCounter<'_>,
    ) -> Result<RareEstimate, P::Error> {
        Ok(self.summary([&self.run_repetitions(problem, 0..self.levels().effort.repetitions as u64, counter)?]))
    }

    /// Runs some of the repetitions; each depends only on the seed and its number. Runs none if no failure was reached.
    ///
    /// # Errors
    /// Errors of the problem.
    pub(super) fn run_repetitions<P: LimitState>(
        &self,
        problem: &P,
        range: Range<u64>,
        counter: &ProgressCounter<'_>,
    ) -> Result<Repetitions, P::Error> {
        let range = range.start..range.end.min(self.levels().effort.repetitions as u64);
        Ok(match self {
            Self::Splitting(levels) => Repetitions::Splitting(levels.run_repetitions(problem, range, counter)?),
            Self::Importance(proposal) => Repetitions::Importance(proposal.run_repetitions(problem, range, counter)?),
        })
    }

    /// Returns the estimate from all repetitions, in order.
    #[must_use]
    pub fn summary<'a>(&self, repeated: impl IntoIterator<Item = &'a Repetitions>) -> RareEstimate {
        let repeated = repeated.into_iter();
        match self {
            Self::Splitting(levels) => {
                let all = repeated.flat_map(|some| match some {
                    Repetitions::Splitting(some) => some.as_slice(),
                    Repetitions::Importance(_) => &[],
                });
                levels.summary(all.cloned().collect())
            }
            Self::Importance(proposal) => {
                let all = repeated.flat_map(|some| match some {
                    Repetitions::Importance(some) => some.as_slice(),
                    Repetitions::Splitting(_) => &[],
                });
                proposal.summary(&all.copied().collect::<Vec<_>>())
            }
        }
    }

    pub(super) fn is_run_by(&self, method: RareMethod, effort: SplittingConfig, seed: u64) -> bool {
        let own = match self {
            Self::Splitting(_) => RareMethod::Splitting,
            Self::Importance(_) => RareMethod::Importance,
        };
        own == method && self.levels().is_placed_by(effort, seed)
    }

    pub(super) fn has_dimension(&self, dimension: usize) -> bool {
        match self {
            Self::Splitting(_) => true,
            Self::Importance(proposal) => proposal.has_dimension(dimension),
        }
    }

    /// Returns the number of repetitions between checkpoints: at least one per thread, and more if they are short.
    pub(super) fn repetitions_per_write(&self) -> u64 {
        let all = self.levels().effort.repetitions as u64;
        let each = (self.planned_runs() / all.max(1)).max(1);
        MIN_RUNS_PER_WRITE.div_ceil(each).max(rayon::current_num_threads() as u64)
    }

    fn levels(&self) -> &SplittingLevels {
        match self {
            Self::Splitting(levels) => levels,
            Self::Importance(proposal) => &proposal.splitting,
        }
    }

    pub(super) fn is_consistent_with(&self, repeated: &Repetitions) -> bool {
        match (self, repeated) {
            (Self::Splitting(levels), Repetitions::Splitting(some)) => levels.is_consistent_with(some),
            (Self::Importance(proposal), Repetitions::Importance(some)) => proposal.is_consistent_with(some),
            _ => false,
        }
    }
}

impl Repetitions {
    pub(super) fn count(&self) -> u64 {
        match self {
            Self::Splitting(some) => some.len() as u64,
            Self::Importance(some) => some.len() as u64,
        }
    }

    pub(super) fn append(&mut self, more: Self) {
        match (self, more) {
            (Self::Splitting(some), Self::Splitting(more)) => some.extend(more),
            (Self::Importance(some), Self::Importance(more)) => some.extend(more),
            _ => {}
        }
    }
}
