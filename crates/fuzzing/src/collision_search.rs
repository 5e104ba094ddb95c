//! Search for collisions of one controller; it also checks the invariants.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::{fs, io};

use super::{Crumple, ORACLES, RUN_ORACLES, TestCase, TestedController, Violation, behaviour};
use crumple_controllers::UnknownController;
use crumple_sim::engine::{RefusedController, Run, RunError, SimulationResult};
use crumple_sim::scenario::InvalidField;
use crumple_testing::generator::with_compatible_step;

/// Interval, in inputs, at which all oracles are checked even without new features: they take many times as long as a
/// run.
const FULL_CHECK_INTERVAL: usize = 16;
/// Interval, in inputs, at which avoidability, the last oracle, is checked: instrumented convex programs take most of
/// the time.
const AVOIDABILITY_INTERVAL: usize = 256;

/// A search for collisions: the work of the fuzz target `scenario`.
#[derive(Debug)]
pub struct CollisionSearch {
    controller: Option<TestedController>,
    /// Folder with one scenario file per kind of collision.
    collisions: Option<PathBuf>,
    seen_features: Vec<AtomicBool>,
    input_count: AtomicUsize,
}

/// Reason why a search ends.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CollisionSearchError {
    /// The controller does not exist.
    #[error(transparent)]
    Controller(#[from] UnknownController),
    /// The controller contradicted itself, or can no longer be started.
    #[error(transparent)]
    Refused(#[from] RefusedController),
    /// The controller has a decision interval at which no scenario can run.
    #[error(
        "`{controller}` has a decision interval of {interval_s} s, which fits the step of no scenario: {reason}"
    )]
    Interval {
        /// Name of the controller.
        controller: String,
        /// Decision interval, in seconds.
        interval_s: f64,
        /// Reason why a scenario with such a step is refused.
        reason: Box<InvalidField>,
    },
    /// A collision cannot be written.
    #[error("the folder for collisions: {0}")]
    Collisions(#[from] io::Error),
    /// An invariant is violated.
    #[error(transparent)]
    Violation(#[from] Violation),
}

impl CollisionSearch {
    /// Creates a search for collisions of a controller (`any`: each input chooses one), and the folder for them if one
    /// is given.
    ///
    /// # Errors
    /// [`CollisionSearchError`] if the controller does not exist or has an unsuitable interval, or if the folder cannot
    /// be created.
    pub fn new(controller: &str, collisions: Option<&Path>) -> Result<Self, CollisionSearchError> {
        collisions.map_or(Ok(()), fs::create_dir_all)?;
        Ok(Self {
            controller: if controller == "any" {
                None
            } else {
                Some(find_controller(controller)?)
            },
            collisions: collisions.map(Path::to_owned),
            seen_features: (0..behaviour::FEATURE_COUNT)
                .map(|_| AtomicBool::new(false))
                .collect(),
            input_count: AtomicUsize::new(0),
        })
    }

    /// Returns the test case of an input. Its step suits the decision interval of the controller.
    #[must_use]
    pub fn test_case(&self, bytes: &[u8]) -> TestCase {
        let mut test_case = TestCase::from_bytes(bytes);
        if let Some(controller) = &self.controller {
            if let Some(Ok(scenario)) = controller
                .interval_s()
                .map(|interval_s| with_compatible_step(&test_case.scenario, interval_s))
            {
                test_case.scenario = scenario;
            }
            test_case.setup.controller = controller.clone();
        }
        test_case
    }

    /// Runs an input, saves its collision and returns the features of the run; none if the controller refuses the
    /// scenario, for example a shield with an unsuitable vehicle. Checks all oracles with the first input; with a
    /// process or an FMU, only those of a single run, because the others take too many queries.
    ///
    /// # Errors
    /// [`CollisionSearchError`] for a violated invariant, a process that contradicts itself, or a collision that cannot
    /// be saved.
    pub fn run_input(&self, bytes: &[u8]) -> Result<Vec<usize>, CollisionSearchError> {
        let test_case = self.test_case(bytes);
        let options = test_case.setup.options(test_case.scenario.spec().step_s);
        if let Err(RunError::Shield { .. } | RunError::MissingNeighbour { .. }) =
            Run::new(&test_case.scenario, options)
        {
            return Ok(Vec::new());
        }
        let result = test_case.check_each(&RUN_ORACLES, &Crumple)?;
        test_case.setup.controller.ensure_trusted()?;
        let features = behaviour::extract_features(&test_case, &result);
        // Counts without short-circuiting, so that every feature is marked as seen.
        let new_features = features
            .iter()
            .filter_map(|&feature| self.seen_features.get(feature))
            .filter(|is_seen| !is_seen.swap(true, Ordering::Relaxed))
            .count();
        let input = self.input_count.fetch_add(1, Ordering::Relaxed);
        let is_due = new_features > 0 || input.is_multiple_of(FULL_CHECK_INTERVAL);
        if is_due && !test_case.setup.controller.is_process() {
            let count = if input.is_multiple_of(AVOIDABILITY_INTERVAL) {
                ORACLES.len()
            } else {
                ORACLES.len() - 1
            };
            test_case.check_each(&ORACLES[..count], &Crumple)?;
        }
        if let Some(collisions) = &self.collisions {
            write_collision(collisions, &test_case, &result)?;
        }
        Ok(features)
    }
}

/// Writes the scenario if a vehicle under test collided and no collision of this kind is there.
fn write_collision(
    folder: &Path,
    test_case: &TestCase,
    result: &SimulationResult,
) -> io::Result<()> {
    let Some(kind) = behaviour::collision_kind(test_case, result) else {
        return Ok(());
    };
    let path = folder.join(format!("{kind}.toml"));
    if path.exists() {
        return Ok(());
    }
    let about = format!(
        "Found by `cargo fuzz run scenario` under {}.",
        test_case.setup.controller.name()
    );
    let named = test_case
        .scenario
        .edited(|spec| (spec.name, spec.about) = (kind, about));
    let scenario = named.unwrap_or_else(|_| test_case.scenario.clone());
    fs::write(
        &path,
        TestCase {
            scenario,
            setup: test_case.setup.clone(),
        }
        .reproducer(),
    )
}

fn find_controller(name: &str) -> Result<TestedController, CollisionSearchError> {
    let controller = TestedController::from_name(name)?;
    if let Some(interval_s) = controller.interval_s() {
        with_compatible_step(&TestCase::from_bytes(&[]).scenario, interval_s).map_err(
            |reason| CollisionSearchError::Interval {
                controller: name.to_owned(),
                interval_s,
                reason: Box::new(reason),
            },
        )?;
    }
    Ok(controller)
}
