//! Crash tests of the crash-tester: any scenario, and laws that must hold in it.
//!
//! One generator reads scenarios and setups from bytes, as departures from the paper's scenario 1: no bytes, and zero
//! bytes, are that scenario under the baseline. Property suites hand it random bytes and fuzzers hand it evolved ones, so
//! both search one space. Oracles take a [`TestCase`] and answer [`Checked`] or a [`Violation`] with a scenario file that
//! shows it again. [`targets`] are whole fuzz targets, which the suite replays without a fuzzer. [`behaviour`] is what a
//! fuzzer is told about a run beyond the code it reached.
//!
//! For the project's own suites and fuzzers, without any promise of stability.

pub mod behaviour;
mod choices;
mod collection;
mod collision_search;
mod driver;
mod formula;
mod lanes;
pub mod oracle;
mod run_folder;
mod scenario;
mod setup;
mod shape;
mod system;
pub mod targets;
mod violation;

use std::fmt;

use arbitrary::{Arbitrary, Unstructured};

pub(crate) use collection::CollisionCorpus;
pub use collision_search::{CollisionSearch, CollisionSearchError};
pub use driver::{CONTROLLERS, controller_from_bytes, make_scripted, profile_from_bytes};
pub use formula::formula_from_bytes;
pub(crate) use lanes::{LANE_BYTES, with_lane_changes};
pub(crate) use oracle::RUN_ORACLE_COUNT;
pub use oracle::{LANE_ORACLES, ORACLES, OracleContext, OracleFn, OracleOutcome};
pub use scenario::{SCENARIO_BYTES, read_scenario, read_scenario_of_shape};
pub use setup::{ControllerByName, RunSetup, SETUP_BYTES, TestedController};
pub use shape::{DriverKind, ScenarioShape};
pub use system::{Crumple, ObservationSample, ScenarioFormat, System};
pub use violation::{Invariant, Violation};

use crumple_world::scenario::Scenario;
use crumple_world::sim::SimulationResult;

/// Bytes that a test case is read from.
pub const TEST_CASE_BYTES: usize = SCENARIO_BYTES + SETUP_BYTES;

/// Bytes that a test case with changes of lanes is read from.
pub const LANE_CASE_BYTES: usize = TEST_CASE_BYTES + LANE_BYTES;

/// A scenario and how it is run. Its debug format is a reproducer: a scenario file that says how to run it.
#[derive(Clone, PartialEq)]
pub struct TestCase {
    /// What happens.
    pub scenario: Scenario,
    /// Who is under test, and how it is simulated.
    pub setup: RunSetup,
}

impl<'b> Arbitrary<'b> for TestCase {
    fn arbitrary(from: &mut Unstructured<'b>) -> arbitrary::Result<Self> {
        Ok(Self { scenario: read_scenario(from), setup: RunSetup::read(from) })
    }

    fn size_hint(_depth: usize) -> (usize, Option<usize>) {
        (0, Some(TEST_CASE_BYTES))
    }
}

impl fmt::Debug for TestCase {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.reproducer())
    }
}

impl TestCase {
    /// The test case that bytes stand for; no bytes are the paper's scenario 1 under the baseline.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Self {
        let mut from = Unstructured::new(bytes);
        Self { scenario: read_scenario(&mut from), setup: RunSetup::read(&mut from) }
    }

    /// The test case that bytes stand for, with changes of lanes after the others; without them it is that of [`TestCase::from_bytes`].
    #[must_use]
    pub fn from_bytes_with_lanes(bytes: &[u8]) -> Self {
        let mut from = Unstructured::new(bytes);
        let (scenario, setup) = (read_scenario(&mut from), RunSetup::read(&mut from));
        Self { scenario: with_lane_changes(scenario, &mut from), setup }
    }

    /// This test case with another controller under test.
    #[must_use]
    pub(crate) fn with_controller(mut self, controller: TestedController) -> Self {
        self.setup.controller = controller;
        self
    }

    /// Asks every oracle and returns the run they were asked about.
    ///
    /// # Errors
    /// The first [`Violation`] found.
    pub fn check_all(&self, system: &dyn System) -> Result<SimulationResult, Violation> {
        self.check_each(&ORACLES, system)
    }

    /// Asks every oracle that holds where vehicles enter or leave the lane.
    ///
    /// # Errors
    /// The first [`Violation`] found.
    pub(crate) fn check_lanes(&self, system: &dyn System) -> Result<SimulationResult, Violation> {
        self.check_each(&LANE_ORACLES, system)
    }

    /// Asks the oracles that look at one run only, which costs little more than the run.
    ///
    /// # Errors
    /// The first [`Violation`] found.
    pub(crate) fn check_run(&self, system: &dyn System) -> Result<SimulationResult, Violation> {
        self.check_each(&ORACLES[..RUN_ORACLE_COUNT], system)
    }

    fn check_each(&self, oracles: &[OracleFn], system: &dyn System) -> Result<SimulationResult, Violation> {
        let question = OracleContext::new(self, system)?;
        for &oracle in oracles {
            question.check(oracle)?;
        }
        Ok(question.result)
    }

    /// Asks one oracle.
    ///
    /// # Errors
    /// The [`Violation`] it found.
    pub fn check(&self, oracle: OracleFn, system: &dyn System) -> Result<OracleOutcome, Violation> {
        OracleContext::new(self, system)?.check(oracle)
    }
}
