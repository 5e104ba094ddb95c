//! What a pilot leaves to the repetitions, by either method.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::importance::{Importance, Weighed};
use super::splitting::Repetition;
use super::{Effort, Estimate, Problem, RareMethod, Splitting};

/// All that repetitions need to know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pilot {
    effort: Effort,
    seed: u64,
    prepared: Prepared,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Prepared {
    Splitting(Splitting),
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
        let effort = effort.at_least();
        let climbed = Splitting::pilot(problem, effort, seed, done)?;
        let prepared = match method {
            RareMethod::Splitting => Prepared::Splitting(climbed),
            RareMethod::Importance => Prepared::Importance(Importance::pilot(problem, climbed, (effort, seed), done)?),
        };
        Ok(Self { effort, seed, prepared })
    }

    /// Whether it reached a failure.
    #[must_use]
    pub fn reaches_failure(&self) -> bool {
        match &self.prepared {
            Prepared::Splitting(levels) => levels.reaches_failure(),
            Prepared::Importance(proposal) => proposal.reaches_failure(),
        }
    }

    /// How many runs the repetitions will make at most.
    #[must_use]
    pub fn runs_ahead(&self) -> u64 {
        match &self.prepared {
            Prepared::Splitting(levels) => levels.runs_ahead(),
            Prepared::Importance(proposal) => proposal.runs_ahead(self.effort),
        }
    }

    /// Runs all repetitions. The result depends neither on the number of threads nor on `done`.
    ///
    /// # Errors
    /// Those of the problem.
    pub fn estimate<P: Problem>(&self, problem: &P, done: &(dyn Fn(u64) + Sync)) -> Result<Estimate, P::Error> {
        Ok(self.summary([&self.repeat(problem, 0..self.effort.repetitions as u64, done)?]))
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
        let range = range.start..range.end.min(self.effort.repetitions as u64);
        Ok(match &self.prepared {
            Prepared::Splitting(levels) => Repetitions::Splitting(levels.repeat(problem, range, done)?),
            Prepared::Importance(proposal) => {
                Repetitions::Importance(proposal.repeat(problem, (self.effort, self.seed), range, done)?)
            }
        })
    }

    /// What all repetitions come to, in their order.
    #[must_use]
    pub fn summary<'a>(&self, repeated: impl IntoIterator<Item = &'a Repetitions>) -> Estimate {
        let repeated = repeated.into_iter();
        match &self.prepared {
            Prepared::Splitting(levels) => {
                let all = repeated.flat_map(|some| match some {
                    Repetitions::Splitting(some) => some.as_slice(),
                    Repetitions::Importance(_) => &[],
                });
                levels.summary(all.cloned().collect())
            }
            Prepared::Importance(proposal) => {
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
        let (levels, own) = match &self.prepared {
            Prepared::Splitting(levels) => (levels, RareMethod::Splitting),
            Prepared::Importance(proposal) => (&proposal.climbed, RareMethod::Importance),
        };
        let effort = effort.at_least();
        own == method && self.effort == effort && self.seed == seed && levels.is_of(effort, seed)
    }

    /// Whether these repetitions could have come of it.
    pub(super) fn may_have(&self, repeated: &Repetitions) -> bool {
        match (&self.prepared, repeated) {
            (Prepared::Splitting(levels), Repetitions::Splitting(some)) => levels.may_have(some),
            (Prepared::Importance(_), Repetitions::Importance(some)) => Importance::may_have(self.effort, some),
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
