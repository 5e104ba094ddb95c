//! What a pilot leaves to the repetitions, by either method.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::importance::{Importance, Weighed};
use super::splitting::Repetition;
use super::{Effort, Estimate, Problem, RareMethod, Splitting};

/// All that repetitions need to know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pilot {
    /// Levels to climb.
    Splitting(Splitting),
    /// A law to draw from.
    Importance(Importance),
}

/// What came of some repetitions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Repetitions {
    /// Populations that climbed.
    Splitting(Vec<Repetition>),
    /// Populations that were drawn where failures are.
    Importance(Vec<Weighed>),
}

impl Pilot {
    /// Runs the pilot. `done` hears of every batch of runs.
    ///
    /// # Errors
    /// Those of the problem.
    pub fn run<P: Problem>(
        problem: &P,
        method: RareMethod,
        effort: Effort,
        seed: u64,
        done: &(dyn Fn(u64) + Sync),
    ) -> Result<Self, P::Error> {
        let climbed = Splitting::pilot(problem, effort, seed, done)?;
        Ok(match method {
            RareMethod::Splitting => Self::Splitting(climbed),
            RareMethod::Importance => Self::Importance(Importance::pilot(problem, climbed, done)?),
        })
    }

    /// Whether it reached a failure.
    #[must_use]
    pub fn reaches_failure(&self) -> bool {
        match self {
            Self::Splitting(levels) => levels.reaches_failure(),
            Self::Importance(proposal) => proposal.reaches_failure(),
        }
    }

    /// How many runs the repetitions will make at most.
    #[must_use]
    pub fn runs_ahead(&self) -> u64 {
        match self {
            Self::Splitting(levels) => levels.runs_ahead(),
            Self::Importance(proposal) => proposal.runs_ahead(),
        }
    }

    /// Runs all repetitions. The result depends neither on the number of threads nor on `done`.
    ///
    /// # Errors
    /// Those of the problem.
    pub fn estimate<P: Problem>(&self, problem: &P, done: &(dyn Fn(u64) + Sync)) -> Result<Estimate, P::Error> {
        Ok(self.summary([&self.repeat(problem, 0..self.levels().effort().repetitions as u64, done)?]))
    }

    /// Runs some of the repetitions: each is a function of the seed and its number alone. None where no failure was reached.
    ///
    /// # Errors
    /// Those of the problem.
    pub fn repeat<P: Problem>(
        &self,
        problem: &P,
        range: Range<u64>,
        done: &(dyn Fn(u64) + Sync),
    ) -> Result<Repetitions, P::Error> {
        let range = range.start..range.end.min(self.levels().effort().repetitions as u64);
        Ok(match self {
            Self::Splitting(levels) => Repetitions::Splitting(levels.repeat(problem, range, done)?),
            Self::Importance(proposal) => Repetitions::Importance(proposal.repeat(problem, range, done)?),
        })
    }

    /// What all repetitions come to, in their order.
    #[must_use]
    pub fn summary<'a>(&self, repeated: impl IntoIterator<Item = &'a Repetitions>) -> Estimate {
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

    /// Whether it was run by that method, with that effort and by that seed.
    pub(super) fn is_of(&self, method: RareMethod, effort: Effort, seed: u64) -> bool {
        let own = match self {
            Self::Splitting(_) => RareMethod::Splitting,
            Self::Importance(_) => RareMethod::Importance,
        };
        own == method && self.levels().is_of(effort, seed)
    }

    fn levels(&self) -> &Splitting {
        match self {
            Self::Splitting(levels) => levels,
            Self::Importance(proposal) => &proposal.climbed,
        }
    }

    /// Whether these repetitions could have come of it.
    pub(super) fn may_have(&self, repeated: &Repetitions) -> bool {
        match (self, repeated) {
            (Self::Splitting(levels), Repetitions::Splitting(some)) => levels.may_have(some),
            (Self::Importance(proposal), Repetitions::Importance(some)) => proposal.may_have(some),
            _ => false,
        }
    }
}

impl Repetitions {
    /// How many there are.
    pub(super) fn count(&self) -> u64 {
        match self {
            Self::Splitting(some) => some.len() as u64,
            Self::Importance(some) => some.len() as u64,
        }
    }
}
