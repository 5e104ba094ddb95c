//! Oracles: checks of invariants on a test case.

mod avoidability;
mod engines;
mod estimates;
mod files;
mod impacts;
mod lanes;
mod metrics;
mod monitor;
mod motion;
mod shield;
mod step_size;

use super::{Invariant, System, TestCase, Violation};
use crumple_sim::engine::{RecordingLevel, Run, SimulationResult, Trace};

pub use avoidability::avoidability_bound_holds;
pub use engines::{engines_agree, result_bits};
pub use estimates::estimates_within_bounds;
pub use files::files_round_trip;
pub use impacts::impacts_are_inelastic;
pub use lanes::{
    entering_at_start_changes_nothing, lane_times_are_consistent,
    leaving_last_vehicle_changes_nothing_ahead,
};
pub use metrics::metrics_agree;
pub use monitor::monitor_agrees;
pub use motion::motion_is_physical;
pub use shield::shield_prevents_front_collisions;
pub use step_size::{check_same_impacts, step_size_changes_nothing};

/// Tolerance of a zero gap, in metres: positions are of the order of 10 km.
pub(crate) const ROUNDING_M: f64 = 1e-9;

/// Outcome of an oracle without a violation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OracleOutcome {
    /// The invariant holds.
    Holds,
    /// The test case decides nothing: the result depends on rounding.
    Undecided,
    /// The invariant does not apply to the test case.
    NotApplicable,
}

/// An oracle: a function that checks an invariant on a test case.
pub type OracleFn = fn(&OracleContext<'_>) -> OracleResult;

pub(crate) type OracleResult = Result<OracleOutcome, Finding>;

/// All oracles, the cheapest first.
pub const ORACLES: [OracleFn; 10] = [
    motion_is_physical,
    metrics_agree,
    impacts_are_inelastic,
    files_round_trip,
    monitor_agrees,
    estimates_within_bounds,
    shield_prevents_front_collisions,
    engines_agree,
    step_size_changes_nothing,
    avoidability_bound_holds,
];

/// Oracles that apply to scenarios with lane changes. The other [`ORACLES`] check shields and avoidability, which do
/// not support lane changes.
pub const LANE_ORACLES: [OracleFn; 11] = [
    motion_is_physical,
    lane_times_are_consistent,
    metrics_agree,
    impacts_are_inelastic,
    files_round_trip,
    monitor_agrees,
    estimates_within_bounds,
    entering_at_start_changes_nothing,
    leaving_last_vehicle_changes_nothing_ahead,
    engines_agree,
    step_size_changes_nothing,
];

/// Oracles that examine a single run, at little more than the cost of the run.
pub(crate) const RUN_ORACLES: [OracleFn; 3] =
    [motion_is_physical, metrics_agree, impacts_are_inelastic];

/// A test case, the system under test and its run.
pub struct OracleContext<'t> {
    /// Test case to check.
    pub test_case: &'t TestCase,
    /// System under test.
    pub system: &'t dyn System,
    /// Run that the test case makes.
    pub run: Run,
    /// Result of the run, with its trace.
    pub result: SimulationResult,
}

impl<'t> OracleContext<'t> {
    /// Runs a test case.
    ///
    /// # Errors
    /// [`Violation`] of [`Invariant::Runnable`] if it cannot be run.
    pub fn new(test_case: &'t TestCase, system: &'t dyn System) -> Result<Self, Violation> {
        let options = test_case.setup.options(test_case.scenario.spec().step_s);
        let run = Run::new(&test_case.scenario, options).map_err(|error| Violation {
            invariant: Invariant::Runnable,
            finding: error.to_string(),
            reproducer: test_case.reproducer(),
        })?;
        let result = system.simulate(&run, RecordingLevel::Trace);
        Ok(Self {
            test_case,
            system,
            run,
            result,
        })
    }

    /// Checks an oracle.
    ///
    /// # Errors
    /// The [`Violation`] that the oracle found.
    pub fn check(&self, oracle: OracleFn) -> Result<OracleOutcome, Violation> {
        oracle(self).map_err(|(invariant, finding)| Violation {
            invariant,
            finding,
            reproducer: self.test_case.reproducer(),
        })
    }

    fn trace(&self) -> Result<&Trace, Finding> {
        self.result
            .trace
            .as_ref()
            .ok_or_else(|| (Invariant::MetricsAgree, "no trace was recorded".to_owned()))
    }
}

/// True if a gap is so small, or an impact so soft, that rounding may decide the verdict.
#[must_use]
pub fn is_grazing(result: &SimulationResult) -> bool {
    let is_soft = result
        .impacts
        .iter()
        .any(|impact| impact.collision.impact_speed_mps < 1e-6);
    is_soft
        || result
            .vehicles
            .iter()
            .filter_map(|vehicle| vehicle.min_gap_m)
            .any(|gap_m| gap_m > 0.0 && gap_m < ROUNDING_M)
}

/// A violated invariant, and a description of the violation.
type Finding = (Invariant, String);

fn ensure(
    holds: bool,
    invariant: Invariant,
    finding: impl FnOnce() -> String,
) -> Result<(), Finding> {
    if holds {
        Ok(())
    } else {
        Err((invariant, finding()))
    }
}
