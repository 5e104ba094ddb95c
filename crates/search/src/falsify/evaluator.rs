//! Evaluation of scenarios by a specification, alone or with a partner simulation.

use super::failure_criterion::FailureCriterion;
use crumple_measure::{RunVerdict, Specification, SpecificationError};
use crumple_sim::engine::{
    FailedController, NamedController, RecordingLevel, Run, RunOptions, simulate, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;

#[derive(Debug, Clone, Copy)]
pub(super) struct Evaluator<'a> {
    pub(super) specification: &'a Specification,
    pub(super) controller: &'a NamedController,
    pub(super) estimator: EstimatorKind,
    pub(super) failure_criterion: Option<&'a FailureCriterion>,
}

impl Evaluator<'_> {
    /// Returns the options of a simulation up to a collision, with the step divided by `parts`.
    pub(super) fn run_options(&self, scenario: &Scenario, parts: u32) -> RunOptions {
        run_options(self.controller, self.estimator, scenario, parts)
    }

    /// Returns the verdict with the scenario's step divided by `parts`.
    pub(super) fn evaluate(
        &self,
        scenario: &Scenario,
        parts: u32,
    ) -> Result<RunVerdict, SpecificationError> {
        self.evaluate_all(&[(scenario, parts)])
            .pop()
            .unwrap_or(Err(SpecificationError::NoTrace))
    }

    /// Returns the verdicts of many scenarios, which are simulated together.
    pub(super) fn evaluate_all(
        &self,
        simulations: &[(&Scenario, u32)],
    ) -> Vec<Result<RunVerdict, SpecificationError>> {
        let own = self.evaluate_with(self.controller, simulations);
        let Some(criterion) = self.failure_criterion else {
            return own;
        };
        let partner = self.evaluate_with(criterion.partner_controller(), simulations);
        own.into_iter()
            .zip(partner)
            .map(|(own, partner)| Ok(FailureCriterion::combine_verdicts(own?, partner?)))
            .collect()
    }

    /// Returns the reason why the controller of the partner simulation gives no answer; `None` if it answers.
    pub(super) fn partner_failure_reason(&self, scenario: &Scenario) -> Option<String> {
        let options = run_options(
            self.failure_criterion?.partner_controller(),
            self.estimator,
            scenario,
            1,
        );
        let run = Run::new(
            scenario,
            options.with_after_collision(self.specification.after_collision()),
        )
        .ok()?;
        simulate(&run, RecordingLevel::Summary)
            .outcome
            .failed_controller()
            .map(FailedController::reason)
    }

    fn evaluate_with(
        &self,
        controller: &NamedController,
        simulations: &[(&Scenario, u32)],
    ) -> Vec<Result<RunVerdict, SpecificationError>> {
        let prepared = simulations.iter().map(|(scenario, parts)| {
            let options = run_options(controller, self.estimator, scenario, *parts);
            Run::new(
                scenario,
                options.with_after_collision(self.specification.after_collision()),
            )
        });
        let mut runs = Vec::new();
        let mut refused = Vec::new();
        for (index, run) in prepared.enumerate() {
            match run {
                Ok(run) => runs.push(run),
                Err(error) => refused.push((index, error)),
            }
        }
        let mut verdicts: Vec<Result<RunVerdict, SpecificationError>> = simulate_batch(
            &runs,
            self.specification.recording_level(),
            |index, result| match runs.get(index) {
                Some(run) => self.specification.evaluate(run, &result),
                None => Err(SpecificationError::NoTrace),
            },
        );
        // Insert in ascending order, so that each index exists.
        refused
            .into_iter()
            .for_each(|(index, error)| verdicts.insert(index, Err(error.into())));
        verdicts
    }
}

fn run_options(
    controller: &NamedController,
    estimator: EstimatorKind,
    scenario: &Scenario,
    parts: u32,
) -> RunOptions {
    let options = RunOptions::new(controller.source.clone()).with_estimator(estimator);
    if parts == 1 {
        options
    } else {
        options.with_dt_s(scenario.spec().step_s / f64::from(parts))
    }
}
