//! Property tests and fuzz targets of crumple: invariants that must hold in every simulation.
//!
//! A test case is a scenario of [`crumple_testing::generator`] and a setup, both from bytes. No bytes, or zero bytes,
//! give the paper's scenario 1 with the baseline controller. Oracles check a [`TestCase`] and return an
//! [`OracleOutcome`] or a [`Violation`] with a scenario file that reproduces it. [`targets`] are complete fuzz targets,
//! which the test suite replays without a fuzzer. [`behaviour`] provides feedback for fuzzers beyond code coverage.
//!
//! For crumple's own tests and fuzzers; the API is not stable.

pub mod behaviour;
mod collision_search;
mod formula;
pub mod oracle;
mod run_folder;
mod setup;
mod system;
pub mod targets;
mod violation;

use std::fmt;

use arbitrary::Unstructured;

pub use collision_search::{CollisionSearch, CollisionSearchError};
pub use formula::formula_from_bytes;
pub(crate) use oracle::RUN_ORACLES;
pub use oracle::{LANE_ORACLES, ORACLES, OracleContext, OracleFn, OracleOutcome};
pub use setup::{ControllerByName, RunSetup, SETUP_BYTES, TestedController};
pub use system::{Crumple, ObservationSample, ScenarioFormat, System};
pub use violation::{Invariant, Violation};

use crumple_sim::engine::SimulationResult;
use crumple_sim::scenario::Scenario;
use crumple_testing::generator::{LANE_BYTES, SCENARIO_BYTES, read_scenario, with_lane_changes};

/// Bytes of a test case.
pub const TEST_CASE_BYTES: usize = SCENARIO_BYTES + SETUP_BYTES;

/// Bytes of a test case with lane changes.
pub const LANE_CASE_BYTES: usize = TEST_CASE_BYTES + LANE_BYTES;

/// A scenario and its setup. The debug format is a reproducer: a scenario file with the command that runs it.
#[derive(Clone, PartialEq)]
pub struct TestCase {
    /// Scenario to simulate.
    pub scenario: Scenario,
    /// Controller under test and simulation settings.
    pub setup: RunSetup,
}

impl fmt::Debug for TestCase {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.reproducer())
    }
}

impl TestCase {
    /// Reads a test case from bytes; no bytes give the paper's scenario 1 with the baseline.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Self {
        let mut from = Unstructured::new(bytes);
        Self {
            scenario: read_scenario(&mut from),
            setup: RunSetup::read(&mut from),
        }
    }

    /// Reads a test case with lane changes; their bytes follow those of [`TestCase::from_bytes`].
    #[must_use]
    pub fn from_bytes_with_lanes(bytes: &[u8]) -> Self {
        let mut from = Unstructured::new(bytes);
        let scenario = read_scenario(&mut from);
        let setup = RunSetup::read(&mut from);
        Self {
            scenario: with_lane_changes(scenario, &mut from),
            setup,
        }
    }

    /// Checks all oracles and returns the simulated run.
    ///
    /// # Errors
    /// The first [`Violation`] found.
    pub fn check_all(&self, system: &dyn System) -> Result<SimulationResult, Violation> {
        self.check_each(&ORACLES, system)
    }

    /// Checks some oracles and returns the simulated run.
    ///
    /// # Errors
    /// The first [`Violation`] found.
    pub(crate) fn check_each(
        &self,
        oracles: &[OracleFn],
        system: &dyn System,
    ) -> Result<SimulationResult, Violation> {
        let question = OracleContext::new(self, system)?;
        for &oracle in oracles {
            question.check(oracle)?;
        }
        Ok(question.result)
    }

    /// Checks one oracle.
    ///
    /// # Errors
    /// The [`Violation`] that the oracle found.
    pub fn check(&self, oracle: OracleFn, system: &dyn System) -> Result<OracleOutcome, Violation> {
        OracleContext::new(self, system)?.check(oracle)
    }
}
