//! Draws of a space, classed: which of their contacts were avoidable.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::RetrainError;
use super::files::{hash_scenario, read_json, write_json};
use super::progress::{RetrainingObserver, RetrainingProgress};
use crumple_core::digest::{Sha256, sha256};
use crumple_search::falsify::counterexample::{Avoidability, AvoidabilityClass};
use crumple_store::run_folder::{RunFolder, RunFolderError};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::Scenario;
use crumple_world::scenario::space::ScenarioSpace;
use crumple_world::sim::{
    Contact, ControllerKind, NamedController, RecordingLevel, Run, RunError, RunOptions, simulate_batch,
};

/// The version of corpus files.
pub const CORPUS_VERSION: u32 = 1;

/// Draws that are classed together, at most.
const BATCH_SIZE: u64 = 500;
/// A space of which less than this share can be avoided is given up, once that many have been looked at.
const MIN_AVOIDABLE_SHARE: f64 = 0.01;

/// The avoidable ones among the first draws of a space by one seed. Nearly all are, so the others are listed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Corpus {
    /// Version of the format: 1.
    pub version: u32,
    /// Name of the space.
    pub space: String,
    /// SHA-256 of the space as JSON.
    pub space_sha256: String,
    /// Seed of the draws.
    pub seed: u64,
    /// Draws that were classed: those from 0 to this, excluded.
    pub draws: u64,
    /// How many of them were avoidable: they are the corpus.
    pub avoidable: u64,
    /// Those that no driver could have avoided, by proof.
    pub unavoidable: Vec<u64>,
    /// Those of which neither is known.
    pub undecided: Vec<u64>,
    /// SHA-256 over the JSON of the corpus's scenarios, in order; empty until it is complete.
    pub scenarios_sha256: String,
}

impl Corpus {
    /// An empty one.
    pub(super) fn empty(space: &ScenarioSpace, seed: u64) -> Result<Self, RetrainError> {
        let spec = serde_json::to_string(space.spec()).map_err(RetrainError::encoding)?;
        Ok(Self {
            version: CORPUS_VERSION,
            space: space.name().to_owned(),
            space_sha256: sha256(spec),
            seed,
            draws: 0,
            avoidable: 0,
            unavoidable: Vec::new(),
            undecided: Vec::new(),
            scenarios_sha256: String::new(),
        })
    }

    /// Indices of the corpus's draws.
    pub fn indices(&self) -> impl Iterator<Item = u64> {
        let is_out =
            |index: &u64| self.unavoidable.binary_search(index).is_ok() || self.undecided.binary_search(index).is_ok();
        (0..self.draws).filter(move |index| !is_out(index))
    }

    /// The corpus's scenarios, in order.
    ///
    /// # Errors
    /// [`RetrainError::Scenario`] if a draw is none; [`Space::draw`] has none.
    pub fn scenarios(&self, space: &ScenarioSpace) -> Result<Vec<Scenario>, RetrainError> {
        Ok(self.indices().map(|index| space.draw(self.seed, index)).collect::<Result<_, _>>()?)
    }

    /// Classes the next draws, as long as fewer than `wanted` are avoidable, and tells `seen` what each witness did in each
    /// of those that are.
    pub(super) fn classify_next(
        &mut self,
        space: &ScenarioSpace,
        wanted: u64,
        witnesses: &[NamedController],
        estimator: EstimatorKind,
        mut seen: impl FnMut(&[Option<Contact>]),
    ) -> Result<(), RetrainError> {
        // No more than are missing: what a block holds beyond the last one wanted would be classed for nothing.
        let range = self.draws..self.draws + (wanted - self.avoidable).min(BATCH_SIZE);
        let classed = classify_draws(space, self.seed, range.clone(), witnesses, estimator)?;
        for (index, (class, contacts)) in range.zip(classed) {
            self.draws += 1;
            match class {
                AvoidabilityClass::Avoidable => {
                    self.avoidable += 1;
                    seen(&contacts);
                }
                AvoidabilityClass::Unavoidable => self.unavoidable.push(index),
                AvoidabilityClass::Undecided | AvoidabilityClass::NotAsked => self.undecided.push(index),
            }
        }
        let share = self.avoidable as f64 / self.draws as f64;
        if self.draws >= BATCH_SIZE && share < MIN_AVOIDABLE_SHARE {
            let (space, draws, avoidable) = (self.space.clone(), self.draws, self.avoidable);
            return Err(RetrainError::TooFewAvoidable { space, draws, avoidable, wanted });
        }
        Ok(())
    }

    /// States the hash of what has been gathered.
    pub(super) fn seal(&mut self, space: &ScenarioSpace) -> Result<(), RetrainError> {
        let mut digest = Sha256::default();
        for index in self.indices() {
            hash_scenario(&mut digest, &space.draw(self.seed, index)?)?;
        }
        self.scenarios_sha256 = digest.hexadecimal();
        Ok(())
    }

    /// The corpus in a file, gathered first if it is not there or not complete.
    pub(super) fn load_or_build(
        (work, name): (&RunFolder, &'static str),
        space: &ScenarioSpace,
        (seed, wanted): (u64, u64),
        witnesses: &[NamedController],
        estimator: EstimatorKind,
        watch: &RetrainingObserver<'_>,
    ) -> Result<Self, RetrainError> {
        let mut corpus = Self::empty(space, seed)?;
        if let Some(found) = read_json::<Self>(work, name)? {
            if (found.seed, &found.space_sha256) != (seed, &corpus.space_sha256) {
                let problem = "draws of another space or seed".to_owned();
                return Err(RunFolderError::Damaged { path: work.path(name), problem }.into());
            }
            corpus = found;
        }
        while corpus.scenarios_sha256.is_empty() {
            watch.notify(&RetrainingProgress::Gathering { file: name, done: corpus.avoidable, wanted })?;
            if corpus.avoidable < wanted {
                corpus.classify_next(space, wanted, witnesses, estimator, |_| {})?;
            } else {
                corpus.seal(space)?;
            }
            write_json(work, name, &corpus)?;
        }
        Ok(corpus)
    }
}

/// Class of each draw, and what became of it with each witness.
type ClassifiedDraw = (AvoidabilityClass, Vec<Option<Contact>>);

fn classify_draws(
    space: &ScenarioSpace,
    seed: u64,
    range: Range<u64>,
    witnesses: &[NamedController],
    estimator: EstimatorKind,
) -> Result<Vec<ClassifiedDraw>, RetrainError> {
    let scenarios = range.map(|index| space.draw(seed, index)).collect::<Result<Vec<_>, _>>()?;
    let mut contacts = vec![Vec::with_capacity(witnesses.len()); scenarios.len()];
    for witness in witnesses {
        let found = first_contacts(&scenarios, &witness.kind, estimator)?;
        contacts.iter_mut().zip(found).for_each(|(of, contact)| of.push(contact));
    }
    let survived: Vec<bool> = contacts.iter().map(|of| of.iter().any(Option::is_none)).collect();
    let classes = classify_scenarios(&scenarios, &survived);
    Ok(classes.into_iter().zip(contacts).collect())
}

/// Classes of scenarios: what a witness has survived is avoidable; of the others convex programming says it.
pub(super) fn classify_scenarios(scenarios: &[Scenario], survived: &[bool]) -> Vec<AvoidabilityClass> {
    let class = |(scenario, &survived): (&Scenario, &bool)| {
        if survived { AvoidabilityClass::Avoidable } else { Avoidability::classify_contact(scenario).class() }
    };
    scenarios.par_iter().zip(survived).map(class).collect()
}

/// The first contact of each run, if there is one.
pub(super) fn first_contacts(
    scenarios: &[Scenario],
    controller: &ControllerKind,
    estimator: EstimatorKind,
) -> Result<Vec<Option<Contact>>, RunError> {
    let options = RunOptions::new(controller.clone()).with_estimator(estimator);
    let runs = scenarios.iter().map(|scenario| Run::new(scenario, options.clone())).collect::<Result<Vec<_>, _>>()?;
    Ok(simulate_batch(&runs, RecordingLevel::Summary, |_, result| result.outcome.contact().copied()))
}
