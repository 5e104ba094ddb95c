//! Cases that a policy is retrained on.

use serde::{Deserialize, Serialize};

use super::RetrainError;
use super::SearchedSpaces;
use super::corpus::CORPUS_VERSION;
use super::files::scenarios_sha256;
use crate::rl::ScenarioSource;
use crumple_core::digest::sha256;
use crumple_sim::scenario::{Scenario, ScenarioSpec};

/// Avoidable scenarios in which the policy of some round collided: the file `retrained-on.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cases {
    /// Version of the format: 1.
    pub version: u32,
    /// Name of the space, or names of the spaces.
    pub space: String,
    /// SHA-256 of the spaces as JSON.
    pub space_sha256: String,
    /// SHA-256 over the JSON of all cases, counterexamples first.
    pub scenarios_sha256: String,
    /// Random scenarios of the space, by round.
    pub draws: Vec<CollidingDraws>,
    /// Shrunk counterexamples of the searches.
    pub counterexamples: Vec<ScenarioSpec>,
}

/// Random scenarios of one seed.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CollidingDraws {
    /// Round that found them.
    pub round: u64,
    /// Seed of the scenarios.
    pub seed: u64,
    /// Indices for [`ScenarioSpace::draw`](crumple_spaces::ScenarioSpace::draw) of the space with the
    /// number index modulo the number of spaces.
    pub indices: Vec<u64>,
}

impl Cases {
    pub(super) fn empty(space: &SearchedSpaces) -> Result<Self, RetrainError> {
        Ok(Self {
            version: CORPUS_VERSION,
            space: space.name(),
            space_sha256: space.sha256()?,
            scenarios_sha256: sha256([]),
            draws: Vec::new(),
            counterexamples: Vec::new(),
        })
    }

    /// Returns all cases, counterexamples first.
    ///
    /// # Errors
    /// [`RetrainError::Scenario`] if one of them is invalid.
    pub fn scenarios(&self, space: &SearchedSpaces) -> Result<Vec<Scenario>, RetrainError> {
        let counterexamples = self
            .counterexamples
            .iter()
            .map(|spec| Scenario::new(spec.clone()));
        let drawn = self.draws.iter().flat_map(|draws| {
            let indices = draws.indices.iter();
            indices.map(|&index| space.draw(draws.seed, index))
        });
        Ok(counterexamples.chain(drawn).collect::<Result<_, _>>()?)
    }

    pub(super) fn with_round(
        mut self,
        space: &SearchedSpaces,
        draws: CollidingDraws,
        counterexamples: Vec<ScenarioSpec>,
    ) -> Result<Self, RetrainError> {
        self.draws.push(draws);
        // An attack finds a case again that the last round did not fix.
        let new = counterexamples
            .into_iter()
            .filter(|counterexample| !self.counterexamples.contains(counterexample));
        let new: Vec<_> = new.collect();
        self.counterexamples.extend(new);
        self.scenarios_sha256 = scenarios_sha256(&self.scenarios(space)?)?;
        Ok(self)
    }
}
