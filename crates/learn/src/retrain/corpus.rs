//! Random scenarios of a space, classified by avoidability.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

use super::RetrainError;
use super::SearchedSpaces;
use super::files::scenarios_sha256;
use super::progress::{RetrainingObserver, RetrainingProgress};
use crate::rl::ScenarioSource;
use crumple_search::falsify::counterexample::{Avoidability, AvoidabilityClass};
use crumple_sim::control::ControllerSource;
use crumple_sim::engine::{
    Collision, NamedController, RecordingLevel, Run, RunError, RunOptions, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use crumple_store::run_folder::{RunFolder, RunFolderError};

/// Version of corpus files.
pub(super) const CORPUS_VERSION: u32 = 1;

const BATCH_SIZE: u64 = 500;
/// Minimum share of avoidable scenarios after [`BATCH_SIZE`] scenarios; below it the space is abandoned.
const MIN_AVOIDABLE_SHARE: f64 = 0.01;

/// Avoidable scenarios among the first random scenarios of a space and seed. Stores the few exceptions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Corpus {
    /// Version of the format: 1.
    pub version: u32,
    /// Name of the space, or names of the spaces.
    pub space: String,
    /// SHA-256 of the spaces as JSON.
    pub space_sha256: String,
    /// Seed of the random scenarios.
    pub seed: u64,
    /// Number of classified scenarios, which have the indices from 0 up.
    pub draws: u64,
    /// Number of avoidable scenarios, which form the corpus.
    pub avoidable: u64,
    /// Scenarios that are proved unavoidable.
    pub unavoidable: Vec<u64>,
    /// Undecided scenarios.
    pub undecided: Vec<u64>,
    /// SHA-256 over the JSON of the corpus's scenarios, in order; empty until the corpus is complete.
    pub scenarios_sha256: String,
}

impl Corpus {
    pub(super) fn empty(space: &SearchedSpaces, seed: u64) -> Result<Self, RetrainError> {
        Ok(Self {
            version: CORPUS_VERSION,
            space: space.name(),
            space_sha256: space.sha256()?,
            seed,
            draws: 0,
            avoidable: 0,
            unavoidable: Vec::new(),
            undecided: Vec::new(),
            scenarios_sha256: String::new(),
        })
    }

    /// Yields the indices of the corpus's scenarios.
    pub fn indices(&self) -> impl Iterator<Item = u64> {
        (0..self.draws).filter(|index| {
            self.unavoidable.binary_search(index).is_err()
                && self.undecided.binary_search(index).is_err()
        })
    }

    /// Returns the corpus's scenarios, in order.
    ///
    /// # Errors
    /// [`RetrainError::Scenario`] if a scenario is invalid, which no space contains.
    pub fn scenarios(&self, space: &SearchedSpaces) -> Result<Vec<Scenario>, RetrainError> {
        Ok(self
            .indices()
            .map(|index| space.draw(self.seed, index))
            .collect::<Result<_, _>>()?)
    }

    /// Classifies random scenarios until `wanted` are avoidable; passes the witness results of each to `observe`.
    pub(super) fn classify_next(
        &mut self,
        space: &SearchedSpaces,
        wanted: u64,
        witnesses: &[NamedController],
        estimator: EstimatorKind,
        mut observe: impl FnMut(&[Option<Collision>]),
    ) -> Result<(), RetrainError> {
        // Scenarios beyond the last one wanted would be classified in vain.
        let range = self.draws..self.draws + (wanted - self.avoidable).min(BATCH_SIZE);
        let scenarios = range
            .clone()
            .map(|index| space.draw(self.seed, index))
            .collect::<Result<Vec<_>, _>>()?;
        let classed = classify_scenarios(&scenarios, witnesses, estimator)?;
        for (index, (class, collisions)) in range.zip(classed) {
            self.draws += 1;
            match class {
                AvoidabilityClass::Avoidable => {
                    self.avoidable += 1;
                    observe(&collisions);
                }
                AvoidabilityClass::Unavoidable => self.unavoidable.push(index),
                AvoidabilityClass::Undecided | AvoidabilityClass::NotAsked => {
                    self.undecided.push(index)
                }
            }
        }
        let share = self.avoidable as f64 / self.draws as f64;
        if self.draws >= BATCH_SIZE && share < MIN_AVOIDABLE_SHARE {
            return Err(RetrainError::TooFewAvoidable {
                space: self.space.clone(),
                draws: self.draws,
                avoidable: self.avoidable,
                wanted,
            });
        }
        Ok(())
    }

    pub(super) fn seal(&mut self, space: &SearchedSpaces) -> Result<(), RetrainError> {
        self.scenarios_sha256 = scenarios_sha256(&self.scenarios(space)?)?;
        Ok(())
    }

    /// Reads the corpus from a file, or builds it if the file is missing or incomplete.
    pub(super) fn load_or_build(
        (work, name): (&RunFolder, &'static str),
        space: &SearchedSpaces,
        (seed, wanted): (u64, u64),
        witnesses: &[NamedController],
        estimator: EstimatorKind,
        watch: &RetrainingObserver<'_>,
    ) -> Result<Self, RetrainError> {
        let mut corpus = Self::empty(space, seed)?;
        if let Some(stored) = work.read_json::<Self>(name)? {
            if (stored.seed, &stored.space_sha256) != (seed, &corpus.space_sha256) {
                let problem = "the scenarios belong to another space or seed";
                return Err(RunFolderError::damaged(&work.path(name), problem).into());
            }
            corpus = stored;
        }
        while corpus.scenarios_sha256.is_empty() {
            watch.notify(&RetrainingProgress::Gathering {
                file: name,
                done: corpus.avoidable,
                wanted,
            })?;
            if corpus.avoidable < wanted {
                corpus.classify_next(space, wanted, witnesses, estimator, |_| {})?;
            } else {
                corpus.seal(space)?;
            }
            work.write_json(name, &corpus)?;
        }
        Ok(corpus)
    }
}

/// Class of a scenario, and its first collision with each witness.
type ClassifiedScenario = (AvoidabilityClass, Vec<Option<Collision>>);

/// Classifies scenarios: avoidable if a witness passed, otherwise by convex programming.
pub(super) fn classify_scenarios(
    scenarios: &[Scenario],
    witnesses: &[NamedController],
    estimator: EstimatorKind,
) -> Result<Vec<ClassifiedScenario>, RetrainError> {
    let mut collisions = vec![Vec::with_capacity(witnesses.len()); scenarios.len()];
    for witness in witnesses {
        let of_witness = first_collisions(scenarios, &witness.source, estimator)?;
        for (collisions, collision) in collisions.iter_mut().zip(of_witness) {
            collisions.push(collision);
        }
    }
    Ok(scenarios
        .par_iter()
        .zip(collisions)
        .map(|(scenario, collisions)| {
            let survived = collisions.iter().any(Option::is_none);
            let class = if survived {
                AvoidabilityClass::Avoidable
            } else {
                Avoidability::classify_collision(scenario).class()
            };
            (class, collisions)
        })
        .collect())
}

pub(super) fn first_collisions(
    scenarios: &[Scenario],
    controller: &Arc<dyn ControllerSource>,
    estimator: EstimatorKind,
) -> Result<Vec<Option<Collision>>, RunError> {
    let options = RunOptions::new(controller.clone()).with_estimator(estimator);
    let runs = scenarios
        .iter()
        .map(|scenario| Run::new(scenario, options.clone()))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(simulate_batch(
        &runs,
        RecordingLevel::Summary,
        |_, result| result.outcome.collision().copied(),
    ))
}

/// Returns the indices of the scenarios that end in a collision.
pub(super) fn colliding_indices(
    scenarios: &[Scenario],
    controller: &Arc<dyn ControllerSource>,
    estimator: EstimatorKind,
) -> Result<Vec<usize>, RunError> {
    let collisions = first_collisions(scenarios, controller, estimator)?;
    Ok((0..scenarios.len())
        .zip(collisions)
        .filter(|(_, collision)| collision.is_some())
        .map(|(index, _)| index)
        .collect())
}
