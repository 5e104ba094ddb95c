//! The controller under test and its runs.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crumple_measure::{RunVerdict, Specification, SpecificationError};
use crumple_sim::control::ControllerSource;
use crumple_sim::engine::{
    AfterCollision, RecordingLevel, Run, RunError, RunOptions, SimulationResult, simulate,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;

use super::drawing;
use super::generator::with_compatible_step;

/// The controller that drives the vehicles under test, and its estimator.
#[derive(Debug, Clone)]
pub struct ControllerUnderTest {
    /// The controller.
    pub source: Arc<dyn ControllerSource>,
    /// Estimator of its observations.
    pub estimator: EstimatorKind,
}

impl ControllerUnderTest {
    /// Returns the verdict of a specification.
    ///
    /// # Errors
    /// [`SpecificationError`] if the controller cannot drive in this scenario, or a formula does not fit it.
    pub fn evaluate(
        &self,
        spec: &Specification,
        scenario: &Scenario,
    ) -> Result<RunVerdict, SpecificationError> {
        spec.evaluate_scenario(scenario, self.options())
    }

    /// Simulates a scenario with a trace, to the first collision.
    ///
    /// # Errors
    /// [`RunError`] if the controller cannot drive in this scenario.
    pub fn simulate(&self, scenario: &Scenario) -> Result<SimulationResult, RunError> {
        let run = Run::new(
            scenario,
            self.options().with_after_collision(AfterCollision::Stop),
        )?;
        Ok(simulate(&run, RecordingLevel::Trace))
    }

    /// Draws gaps and speeds of a run as lines of text.
    #[must_use]
    pub fn draw(&self, scenario: &Scenario) -> String {
        drawing::to_text(&self.curves(scenario))
    }

    pub(super) fn curves(&self, scenario: &Scenario) -> Vec<drawing::Curve> {
        let run = catch_unwind(AssertUnwindSafe(|| self.simulate(scenario)));
        let trace = run
            .ok()
            .and_then(Result::ok)
            .and_then(|result| result.trace);
        trace.map_or_else(Vec::new, |trace| drawing::curves(scenario, &trace))
    }

    /// Returns the scenario with a step that suits the controller's decision interval.
    #[must_use]
    pub fn adapt(&self, scenario: &Scenario) -> Scenario {
        let adapted = self
            .source
            .interval_s()
            .and_then(|at_s| with_compatible_step(scenario, at_s).ok());
        adapted.unwrap_or_else(|| scenario.clone())
    }

    fn options(&self) -> RunOptions {
        RunOptions::new(self.source.clone()).with_estimator(self.estimator)
    }
}
