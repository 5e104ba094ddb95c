//! Simulation of every point of every grid of a suite with every controller.

use std::collections::BTreeMap;
use std::sync::Arc;

use crumple_sim::control::{ControllerSource, STANDARD_GRAVITY_MPS2};
use crumple_sim::engine::{
    NamedController, Outcome, RecordingLevel, RefusedController, Run, RunOptions, SimulationResult,
    Trace, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{InvalidField, Scenario};

use super::TestSuite;
use super::margin::find_margins;
use super::prevention::{Preventability, assess_preventability};
use super::result::{
    ClauseResult, ControllerResult, DISCLAIMER, FailedPoint, SuiteResult, TestResult, TestVerdict,
};
use super::spec::{LeadManeuver, SuiteSpec, TestSpec};
use super::worst_in_tolerance::{WorstInTolerance, WorstPoint, find_worst};
use crumple_search::confirmation::CONFIRMING_PLANT;

/// Deceleration from which braking without cause fails a test, in m/s²: 0.25 g.
const MIN_FALSE_BRAKE_MPS2: f64 = 0.25 * STANDARD_GRAVITY_MPS2;

/// Reason why a suite did not run to its end.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteRunError {
    /// A point makes no scenario; impossible for a valid suite.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// A controller contradicted itself, or can no longer be started, so that its results are invalid.
    #[error(transparent)]
    Refused(#[from] RefusedController),
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Criterion {
    pub(super) lead: LeadManeuver,
    /// Largest impact speed that passes, in m/s; `None` if no collision passes.
    pub(super) impact_at_most_mps: Option<f64>,
}

impl Criterion {
    fn passes(self, impact_speed_mps: f64) -> bool {
        self.impact_at_most_mps
            .is_some_and(|most| impact_speed_mps <= most)
    }
}

pub(super) struct ControllerSetup<'c> {
    pub(super) controller: &'c Arc<dyn ControllerSource>,
    pub(super) estimator: EstimatorKind,
}

#[derive(Debug, Clone)]
pub(super) struct RunResult {
    pub(super) verdict: TestVerdict,
    pub(super) min_gap_m: Option<f64>,
    pub(super) max_brake_mps2: f64,
}

impl RunResult {
    fn refused(reason: String) -> Self {
        Self {
            verdict: TestVerdict::Refused { reason },
            min_gap_m: None,
            max_brake_mps2: 0.0,
        }
    }

    fn is_collision(&self) -> bool {
        matches!(self.verdict, TestVerdict::Failed { .. })
    }
}

/// Runs a suite with some controllers. The result depends neither on the number of threads nor on the other
/// controllers.
///
/// # Errors
/// [`SuiteRunError::Refused`] for a controller that is refused during the run. A valid suite causes no other error.
pub fn run(
    suite: &TestSuite,
    controllers: &[NamedController],
    estimator: EstimatorKind,
) -> Result<SuiteResult, SuiteRunError> {
    let spec = suite.spec();
    let mut results = Vec::new();
    let mut cache = PreventabilityCache::new();
    for clause in &spec.clauses {
        for test in &clause.tests {
            let grid = TestGrid::new(
                &spec.name,
                test,
                format!("{}: {}", clause.clause, clause.summary),
            )?;
            for controller in controllers {
                results.push(grid.run(controller, estimator, &mut cache));
                controller.ensure_trusted()?;
            }
        }
    }
    Ok(assemble(spec, estimator, controllers.len(), results))
}

/// Assembles the results of all tests, which are in the order of the suite, then of the controllers.
fn assemble(
    spec: &SuiteSpec,
    estimator: EstimatorKind,
    controllers: usize,
    results: Vec<ControllerResult>,
) -> SuiteResult {
    let mut results = results.into_iter();
    let mut clauses = Vec::new();
    for clause in &spec.clauses {
        let tests = clause.tests.iter().map(|test| TestResult {
            name: test.name.clone(),
            is_as_stated: test.is_as_stated(),
            parameters: test.parameters.clone(),
            impact_at_most: test.impact_at_most.clone(),
            controllers: results.by_ref().take(controllers).collect(),
        });
        clauses.push(ClauseResult {
            clause: clause.clause.clone(),
            summary: clause.summary.clone(),
            tests: tests.collect(),
        });
    }
    SuiteResult {
        statement: DISCLAIMER,
        suite: spec.name.clone(),
        document: spec.document.clone(),
        edition: spec.edition.clone(),
        parameter_source: spec.parameter_source.clone(),
        not_modelled: spec.not_modelled.clone(),
        omitted_parameters: spec.omitted_parameters.clone(),
        estimator,
        clauses,
    }
}

/// Preventability of points by scenario name, shared by all controllers.
pub(super) type PreventabilityCache = BTreeMap<String, Preventability>;

struct TestGrid<'t> {
    name: String,
    about: String,
    test: &'t TestSpec,
    criterion: Option<Criterion>,
    grid: Vec<Vec<f64>>,
    scenarios: Vec<Scenario>,
}

impl<'t> TestGrid<'t> {
    fn new(suite: &str, test: &'t TestSpec, about: String) -> Result<Self, InvalidField> {
        let grid = if test.lead.is_some() {
            test.grid()
        } else {
            Vec::new()
        };
        let name = format!("{suite}-{}", test.name);
        let mut scenarios = Vec::new();
        for (point, number) in grid.iter().zip(1..) {
            let about = format!("{about} ({}.) {DISCLAIMER}", test.describe_point(point));
            scenarios.push(test.scenario(&format!("{name}-{number:03}"), &about, point)?);
        }
        Ok(Self {
            name,
            about: format!("{about} {DISCLAIMER}"),
            test,
            criterion: test.criterion(),
            grid,
            scenarios,
        })
    }

    fn run(
        &self,
        controller: &NamedController,
        estimator: EstimatorKind,
        cache: &mut PreventabilityCache,
    ) -> ControllerResult {
        let setup = ControllerSetup {
            controller: &controller.source,
            estimator,
        };
        let results = match (self.criterion, &self.test.refusal_reason) {
            (Some(criterion), _) => setup.run_scenarios(criterion, &self.scenarios),
            (None, reason) => vec![RunResult::refused(reason.clone().unwrap_or_default())],
        };
        let verdict = TestVerdict::worst(results.iter().map(|result| &result.verdict))
            .unwrap_or(&TestVerdict::Passed);
        let passed = results.iter().filter(|result| result.verdict.is_passed());
        let gaps_m = results.iter().filter_map(|result| result.min_gap_m);
        ControllerResult {
            controller: controller.name.clone(),
            verdict: verdict.clone(),
            points: self.grid.len(),
            passed_points: passed.count(),
            min_gap_m: gaps_m.reduce(f64::min),
            margins: self
                .criterion
                .map(|criterion| find_margins(self.test, criterion, &setup))
                .unwrap_or_default(),
            worst_in_tolerance: self.worst_in_tolerance(&setup, cache),
            failed_points: self.failed_points(&self.grid, &self.scenarios, &results, &setup, cache),
        }
    }

    fn worst_in_tolerance(
        &self,
        setup: &ControllerSetup<'_>,
        cache: &mut PreventabilityCache,
    ) -> Option<WorstInTolerance> {
        let WorstPoint {
            point,
            scenario,
            result,
            points_run,
            failures,
            unanswered,
        } = find_worst(&self.name, &self.about, self.test, self.criterion?, setup)?;
        let description = self.test.describe_point(&point);
        let results = std::slice::from_ref(&result);
        let failed_point = self
            .failed_points(&[point], &[scenario], results, setup, cache)
            .pop();
        Some(WorstInTolerance {
            point: description,
            verdict: result.verdict,
            min_gap_m: result.min_gap_m,
            points_run,
            failures,
            unanswered,
            failed_point,
        })
    }

    /// Describes the points that failed: which collisions are preventable, and which failures occur with another plant.
    fn failed_points(
        &self,
        points: &[Vec<f64>],
        scenarios: &[Scenario],
        results: &[RunResult],
        setup: &ControllerSetup<'_>,
        cache: &mut PreventabilityCache,
    ) -> Vec<FailedPoint> {
        let failed: Vec<_> = points
            .iter()
            .zip(scenarios)
            .zip(results)
            .filter(|(_, result)| result.verdict.is_failure())
            .collect();
        // Other failures may have ended without a collision.
        let collisions: Vec<&Scenario> = failed
            .iter()
            .filter(|(_, result)| result.is_collision())
            .map(|((_, scenario), _)| *scenario)
            .collect();
        let mut preventabilities = self
            .criterion
            .map(|criterion| assess_preventability(criterion, &collisions, cache))
            .unwrap_or_default()
            .into_iter();
        let failed_scenarios = failed.iter().map(|((_, scenario), _)| *scenario);
        let mut replays = self
            .replay_with_multi_body(setup, failed_scenarios)
            .into_iter();
        let mut failed_points = Vec::new();
        for ((point, scenario), result) in failed {
            let preventability = result
                .is_collision()
                .then(|| preventabilities.next())
                .flatten();
            let Preventability {
                references,
                classification,
            } = preventability.unwrap_or_default();
            failed_points.push(FailedPoint {
                point: self.test.describe_point(point),
                verdict: result.verdict.clone(),
                references,
                avoidability: classification.avoidability,
                survives_multi_body: replays.next().flatten(),
                escape_survives_multi_body: classification.escape_survives,
                escape: classification.escape,
                scenario_name: scenario.spec().name.clone(),
                scenario: scenario.clone(),
            });
        }
        failed_points
    }
}

impl TestGrid<'_> {
    /// Replays scenarios with the multi-body plant. Returns which fail; `None` if the controller refuses the plant.
    fn replay_with_multi_body<'s>(
        &self,
        setup: &ControllerSetup<'_>,
        scenarios: impl Iterator<Item = &'s Scenario>,
    ) -> Vec<Option<bool>> {
        let with_plant: Result<Vec<_>, _> = scenarios
            .map(|scenario| scenario.with_plant(CONFIRMING_PLANT))
            .collect();
        let Some((with_plant, criterion)) = with_plant.ok().zip(self.criterion) else {
            return Vec::new();
        };
        setup
            .run_scenarios(criterion, &with_plant)
            .into_iter()
            .map(|result| match result.verdict {
                TestVerdict::Refused { .. } => None,
                verdict => Some(verdict.is_failure()),
            })
            .collect()
    }
}

impl ControllerSetup<'_> {
    pub(super) fn run_scenarios(
        &self,
        criterion: Criterion,
        scenarios: &[Scenario],
    ) -> Vec<RunResult> {
        if criterion.lead == LeadManeuver::Ghost && self.estimator == EstimatorKind::Truth {
            let reason =
                "the estimator `truth` ignores the sensors, so that no ghost object is observed";
            return vec![RunResult::refused(reason.to_owned()); scenarios.len()];
        }
        let options = RunOptions::new(self.controller.clone()).with_estimator(self.estimator);
        let prepared: Vec<_> = scenarios
            .iter()
            .map(|scenario| Run::new(scenario, options.clone()))
            .collect();
        let mut refused = Vec::new();
        let mut runs = Vec::new();
        for run in prepared {
            refused.push(
                run.as_ref()
                    .err()
                    .map(|error| RunResult::refused(error.to_string())),
            );
            runs.extend(run.ok());
        }
        let mut results = simulate_batch(&runs, RecordingLevel::Trace, |_, simulated| {
            judge(criterion, &simulated)
        })
        .into_iter();
        refused
            .into_iter()
            .map(|refused| {
                refused
                    .or_else(|| results.next())
                    .unwrap_or_else(|| RunResult::refused("was not run".to_owned()))
            })
            .collect()
    }
}

fn judge(criterion: Criterion, simulated: &SimulationResult) -> RunResult {
    let lead = criterion.lead;
    let trace = simulated.trace.as_ref();
    let end_s = trace.and_then(|trace| test_end_s(lead, trace));
    let own = simulated.vehicles.get(lead.under_test_index());
    let max_brake_mps2 = own.map_or(0.0, |own| own.max_brake_mps2);
    let verdict = match &simulated.outcome {
        Outcome::Collision(contact)
            if end_s.is_none_or(|end_s| contact.time_s <= end_s)
                && !criterion.passes(contact.impact_speed_mps) =>
        {
            TestVerdict::Failed {
                time_s: contact.time_s,
                impact_speed_mps: contact.impact_speed_mps,
            }
        }
        Outcome::ControllerFailed(failed) => TestVerdict::ControllerFailed {
            time_s: failed.time_s,
            reason: failed.failure.to_string(),
        },
        _ if lead == LeadManeuver::Ghost && max_brake_mps2 >= MIN_FALSE_BRAKE_MPS2 => {
            TestVerdict::Braked { max_brake_mps2 }
        }
        Outcome::NoCollision | Outcome::Collision(_) => TestVerdict::Passed,
    };
    RunResult {
        verdict,
        min_gap_m: own.and_then(|own| own.min_gap_m),
        max_brake_mps2,
    }
}

/// Returns the time at which the test ends; later collisions do not count.
fn test_end_s(lead: LeadManeuver, trace: &Trace) -> Option<f64> {
    let pairs = trace.pairs(lead.under_test_index());
    let pair = pairs.last()?;
    pair.gaps_m()
        .find(|&(sample, _)| {
            let speeds_mps = pair
                .front
                .speed_mps
                .get(sample)
                .zip(pair.rear.speed_mps.get(sample));
            speeds_mps.is_some_and(|(&ahead_mps, &own_mps)| is_test_over(lead, ahead_mps, own_mps))
        })
        .and_then(|(sample, _)| pair.time_s.get(sample).copied())
}

fn is_test_over(lead: LeadManeuver, ahead_mps: f64, own_mps: f64) -> bool {
    match lead {
        LeadManeuver::Slower | LeadManeuver::CutIn => own_mps <= ahead_mps,
        LeadManeuver::Stopped | LeadManeuver::Decelerating | LeadManeuver::CutOut => own_mps == 0.0,
        LeadManeuver::Ghost => false,
    }
}
