//! The controller under test and its runs.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crumple_world::control::{Controller, ControllerFailure, ControllerKind, ControllerSource, Ego};
use crumple_world::measure::{RunVerdict, Specification, SpecificationError};
use crumple_world::observation::{EstimatorKind, Observation};
use crumple_world::scenario::Scenario;
use crumple_world::sim::{AfterContact, RecordingLevel, Run, RunError, RunOptions, SimulationResult, simulate};

use super::drawing;
use super::generator::with_compatible_step;

/// The controller that drives the vehicles under test, and its estimator.
#[derive(Debug, Clone)]
pub struct ControllerUnderTest {
    /// The controller.
    pub kind: ControllerKind,
    /// Estimator of its observations.
    pub estimator: EstimatorKind,
}

impl ControllerUnderTest {
    /// Returns the verdict of a specification.
    ///
    /// # Errors
    /// [`SpecificationError`] if the controller cannot drive in this scenario, or a formula does not fit it.
    pub fn evaluate(&self, spec: &Specification, scenario: &Scenario) -> Result<RunVerdict, SpecificationError> {
        spec.evaluate_scenario(scenario, self.options())
    }

    /// Simulates a scenario with a trace, to the first collision.
    ///
    /// # Errors
    /// [`RunError`] if the controller cannot drive in this scenario.
    pub fn simulate(&self, scenario: &Scenario) -> Result<SimulationResult, RunError> {
        let run = Run::new(scenario, self.options().with_after_contact(AfterContact::Stop))?;
        Ok(simulate(&run, RecordingLevel::Trace))
    }

    /// Draws gaps and speeds of a run as lines of text.
    #[must_use]
    pub fn draw(&self, scenario: &Scenario) -> String {
        drawing::to_text(&self.curves(scenario))
    }

    pub(super) fn curves(&self, scenario: &Scenario) -> Vec<drawing::Curve> {
        let run = catch_unwind(AssertUnwindSafe(|| self.simulate(scenario)));
        let trace = run.ok().and_then(Result::ok).and_then(|result| result.trace);
        trace.map_or_else(Vec::new, |trace| drawing::curves(scenario, &trace))
    }

    /// Returns the scenario with a step that suits the controller's decision interval.
    #[must_use]
    pub fn adapt(&self, scenario: &Scenario) -> Scenario {
        let adapted = self.kind.interval_s().and_then(|at_s| with_compatible_step(scenario, at_s).ok());
        adapted.unwrap_or_else(|| scenario.clone())
    }

    fn options(&self) -> RunOptions {
        RunOptions::new(self.kind.clone()).with_estimator(self.estimator)
    }
}

/// A controller without memory: a function from an observation to an acceleration in m/s².
#[derive(Debug, Clone, Copy)]
pub struct StatelessController<F>(F);

/// Makes a function a controller under test. A controller with memory implements [`ControllerSource`].
pub fn stateless<F>(decide: F) -> Arc<StatelessController<F>>
where
    F: Fn(&Observation) -> f64 + Clone + Send + Sync + 'static,
{
    Arc::new(StatelessController(decide))
}

impl<F: Fn(&Observation) -> f64 + Clone + Send + Sync + 'static> ControllerSource for StatelessController<F> {
    fn identity(&self) -> Option<String> {
        None
    }

    fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(Self(self.0.clone())))
    }
}

impl<F: Fn(&Observation) -> f64 + Send> Controller for StatelessController<F> {
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        Ok(self.0(seen))
    }
}
