//! A hunt for collisions of one controller, and for broken laws on the way.

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::{Collection, Crumple, TestCase, TestedController, Violation, behaviour};
use crumple_world::sim::UnknownController;

/// All oracles take many times as long as a run: they are asked of what is new, and of every so many inputs.
const EVERY: usize = 16;

/// What the fuzz target `scenario` does with its inputs.
#[derive(Debug)]
pub struct CollisionSearch {
    controller: Option<TestedController>,
    collisions: Option<Collection>,
    seen: Vec<AtomicBool>,
    inputs: AtomicUsize,
}

/// What a hunt ends with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CollisionSearchError {
    /// There is no such controller.
    #[error(transparent)]
    Controller(#[from] UnknownController),
    /// A collision cannot be written.
    #[error("the folder for collisions: {0}")]
    Collisions(#[from] io::Error),
    /// A broken law.
    #[error(transparent)]
    Violation(#[from] Violation),
}

impl CollisionSearch {
    /// A hunt for collisions of a controller (`any`: whichever an input chooses), kept in a folder if one is named.
    ///
    /// # Errors
    /// [`CollisionSearchError`] if there is no such controller, or the folder cannot be made.
    pub fn new(controller: &str, collisions: Option<&Path>) -> Result<Self, CollisionSearchError> {
        Ok(Self {
            controller: if controller == "any" { None } else { Some(TestedController::named(controller)?) },
            collisions: collisions.map(Collection::in_folder).transpose()?,
            seen: (0..behaviour::FEATURES).map(|_| AtomicBool::new(false)).collect(),
            inputs: AtomicUsize::new(0),
        })
    }

    /// The test case that an input stands for in this hunt.
    #[must_use]
    pub fn test_case(&self, bytes: &[u8]) -> TestCase {
        let test_case = TestCase::of_bytes(bytes);
        match &self.controller {
            Some(controller) => test_case.under_test(controller.clone()),
            None => test_case,
        }
    }

    /// Runs an input, keeps its collision and returns the [`behaviour::features`] of the run.
    ///
    /// A fresh hunt has seen nothing, and asks all oracles of its first input.
    ///
    /// # Errors
    /// [`CollisionSearchError`] for a broken law, or a collision that cannot be kept.
    pub fn take(&self, bytes: &[u8]) -> Result<Vec<usize>, CollisionSearchError> {
        let test_case = self.test_case(bytes);
        let result = test_case.examine_run(&Crumple)?;
        let features = behaviour::features(&test_case, &result);
        let is_new = |&feature: &usize| self.seen.get(feature).is_some_and(|seen| !seen.swap(true, Ordering::Relaxed));
        // Every feature is marked, so no short cut.
        let news = features.iter().filter(|feature| is_new(feature)).count();
        if news > 0 || self.inputs.fetch_add(1, Ordering::Relaxed).is_multiple_of(EVERY) {
            test_case.examine(&Crumple)?;
        }
        if let Some(collisions) = &self.collisions {
            collisions.keep(&test_case, &result)?;
        }
        Ok(features)
    }
}
