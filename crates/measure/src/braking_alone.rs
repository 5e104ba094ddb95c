//! Unnecessary braking that only the vehicles behind cause.

use super::run_report::{RunReport, brakes_unnecessarily};
use crumple_sim::engine::{RecordingLevel, Run, RunError, simulate};
use crumple_sim::scenario::{InvalidField, Scenario};

/// An error of a run without the vehicles behind.
#[derive(Debug, thiserror::Error)]
#[error("{scenario}: without the vehicles behind: {problem}")]
pub struct BrakingAloneError {
    /// Name of the scenario.
    pub scenario: String,
    /// Reason.
    pub problem: BrakingAloneProblem,
}

/// Reason why a run without the vehicles behind is impossible.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BrakingAloneProblem {
    /// The scenario needs these vehicles.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// The controller needs these vehicles.
    #[error(transparent)]
    Run(#[from] RunError),
}

impl RunReport<'_> {
    /// States if only the vehicles behind those under test cause the unnecessary braking: without them, the same run
    /// has neither a collision nor unnecessary braking. To know it, simulates a run with unnecessary braking again.
    /// `run` is that of the report. In scenarios with lane changes the braking always counts, because a vehicle behind
    /// may become the leader.
    ///
    /// # Errors
    /// [`BrakingAloneError`] if the scenario or the controller needs the vehicles behind.
    pub fn with_cause_of_braking(self, run: &Run) -> Result<Self, BrakingAloneError> {
        let scenario = run.scenario();
        let may_be_caused = self.brakes_unnecessarily() && scenario.keeps_lanes();
        if !may_be_caused || scenario.ends_under_test() {
            return Ok(self);
        }
        let alone = without_vehicles_behind(run)?;
        let simulated = simulate(&alone, RecordingLevel::Trace);
        let is_fine =
            simulated.outcome.is_safe() && !brakes_unnecessarily(alone.scenario(), &simulated);
        Ok(Self {
            brakes_only_with_vehicle_behind: is_fine,
            ..self
        })
    }
}

/// Returns the run up to the last vehicle under test, with at least two vehicles.
fn without_vehicles_behind(run: &Run) -> Result<Run, BrakingAloneError> {
    let scenario = run.scenario();
    let shortened = shorten(scenario).map_err(BrakingAloneProblem::from);
    shortened
        .and_then(|shortened| Ok(Run::new(&shortened, run.options().clone())?))
        .map_err(|problem| BrakingAloneError {
            scenario: scenario.spec().name.clone(),
            problem,
        })
}

fn shorten(scenario: &Scenario) -> Result<Scenario, InvalidField> {
    let vehicles = scenario.vehicles().len();
    let last = (0..vehicles).rfind(|&index| scenario.is_under_test(index));
    let kept = last.map_or(vehicles, |last| (last + 1).max(2));
    scenario.edited(|spec| spec.vehicles.truncate(kept))
}
