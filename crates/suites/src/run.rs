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
use super::spec::{ClauseSpec, LeadManeuver, SuiteSpec, TestSpec};
use super::worst_in_tolerance::{WorstInTolerance, WorstPoint, find_worst};
use crumple_search::confirmation::CONFIRMING_PLANT;
use crumple_search::falsify::counterexample::AvoidabilityAnalysis;

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
    let (mut tested, mut known) = (Vec::new(), PreventabilityCache::new());
    for clause in &spec.clauses {
        for test in &clause.tests {
            let grid = TestGrid::new(
                &spec.name,
                test,
                format!("{}: {}", clause.clause, clause.summary),
            )?;
            for controller in controllers {
                tested.push(grid.run(controller, estimator, &mut known));
                controller.ensure_trusted()?;
            }
        }
    }
    Ok(assemble(spec, estimator, controllers.len(), tested))
}

fn assemble(
    spec: &SuiteSpec,
    estimator: EstimatorKind,
    controllers: usize,
    tested: impl IntoIterator<Item = ControllerResult>,
) -> SuiteResult {
    let mut tested = tested.into_iter();
    let mut test = |test: &TestSpec| TestResult {
        name: test.name.clone(),
        is_as_stated: test.is_as_stated(),
        parameters: test.parameters.clone(),
        impact_at_most: test.impact_at_most.clone(),
        controllers: tested.by_ref().take(controllers).collect(),
    };
    let clause = |clause: &ClauseSpec| ClauseResult {
        clause: clause.clause.clone(),
        summary: clause.summary.clone(),
        tests: clause.tests.iter().map(&mut test).collect(),
    };
    SuiteResult {
        statement: DISCLAIMER,
        suite: spec.name.clone(),
        document: spec.document.clone(),
        edition: spec.edition.clone(),
        parameter_source: spec.parameter_source.clone(),
        not_modelled: spec.not_modelled.clone(),
        omitted_parameters: spec.omitted_parameters.clone(),
        estimator,
        clauses: spec.clauses.iter().map(clause).collect(),
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
        let named = |(point, number): (&Vec<f64>, usize)| {
            let about = format!("{about} ({}.) {DISCLAIMER}", test.describe_point(point));
            test.scenario(&format!("{name}-{number:03}"), &about, point)
        };
        let scenarios = grid.iter().zip(1..).map(named).collect::<Result<_, _>>()?;
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
        known: &mut PreventabilityCache,
    ) -> ControllerResult {
        let driven = ControllerSetup {
            controller: &controller.source,
            estimator,
        };
        let seen = match (self.criterion, &self.test.refusal_reason) {
            (Some(criterion), _) => driven.run_scenarios(criterion, &self.scenarios),
            (None, reason) => vec![RunResult::refused(reason.clone().unwrap_or_default())],
        };
        let of_grid = TestVerdict::worst(seen.iter().map(|seen| &seen.verdict))
            .unwrap_or(&TestVerdict::Passed);
        let gaps = seen.iter().filter_map(|seen| seen.min_gap_m);
        ControllerResult {
            controller: controller.name.clone(),
            verdict: of_grid.clone(),
            points: self.grid.len(),
            passed_points: seen.iter().filter(|seen| seen.verdict.is_passed()).count(),
            min_gap_m: gaps.reduce(f64::min),
            margins: self
                .criterion
                .map(|criterion| find_margins(self.test, criterion, &driven))
                .unwrap_or_default(),
            worst_in_tolerance: self.worst_in_tolerance(&driven, known),
            failed_points: self.failed_points(&self.grid, &self.scenarios, &seen, (&driven, known)),
        }
    }

    fn worst_in_tolerance(
        &self,
        driven: &ControllerSetup<'_>,
        known: &mut PreventabilityCache,
    ) -> Option<WorstInTolerance> {
        let WorstPoint {
            point,
            scenario,
            result,
            points_run,
            failures,
            unanswered,
        } = find_worst(&self.name, &self.about, self.test, self.criterion?, driven)?;
        let (verdict, min_gap_m, words) = (
            result.verdict.clone(),
            result.min_gap_m,
            self.test.describe_point(&point),
        );
        let failed_point = self
            .failed_points(&[point], &[scenario], &[result], (driven, known))
            .pop();
        Some(WorstInTolerance {
            point: words,
            verdict,
            min_gap_m,
            points_run,
            failures,
            unanswered,
            failed_point,
        })
    }

    fn failed_points(
        &self,
        points: &[Vec<f64>],
        scenarios: &[Scenario],
        seen: &[RunResult],
        (driven, known): (&ControllerSetup<'_>, &mut PreventabilityCache),
    ) -> Vec<FailedPoint> {
        let all = points.iter().zip(scenarios).zip(seen);
        let failed: Vec<_> = all.filter(|(_, seen)| seen.verdict.is_failure()).collect();
        // Others may have ended without a collision.
        let collides = |seen: &RunResult| matches!(seen.verdict, TestVerdict::Failed { .. });
        let touching = failed.iter().filter(|(_, seen)| collides(seen));
        let scenarios: Vec<_> = touching.map(|((_, scenario), _)| *scenario).collect();
        let prevented = self
            .criterion
            .map(|criterion| assess_preventability(criterion, &scenarios, known))
            .unwrap_or_default();
        let mut prevented = prevented.into_iter();
        let failing = failed.iter().map(|((_, scenario), _)| *scenario);
        let mut replays = self.replay_with_multi_body(driven, failing).into_iter();
        let nobody = || Preventability {
            references: Vec::new(),
            classification: AvoidabilityAnalysis::default(),
        };
        let with = failed.into_iter().map(|one| {
            let prevented = if collides(one.1) {
                prevented.next()
            } else {
                None
            };
            (one, prevented.unwrap_or_else(nobody))
        });
        let told = with.map(|(((point, scenario), seen), prevented)| FailedPoint {
            point: self.test.describe_point(point),
            verdict: seen.verdict.clone(),
            references: prevented.references,
            avoidability: prevented.classification.avoidability,
            survives_multi_body: replays.next().flatten(),
            escape_survives_multi_body: prevented.classification.escape_survives,
            escape: prevented.classification.escape,
            scenario_name: scenario.spec().name.clone(),
            scenario: scenario.clone(),
        });
        told.collect()
    }
}

impl TestGrid<'_> {
    /// Replays scenarios with the multi-body plant. Returns which fail; `None` if the controller refuses the plant.
    fn replay_with_multi_body<'s>(
        &self,
        driven: &ControllerSetup<'_>,
        scenarios: impl Iterator<Item = &'s Scenario>,
    ) -> Vec<Option<bool>> {
        let with_plant: Result<Vec<_>, _> = scenarios
            .map(|scenario| scenario.with_plant(CONFIRMING_PLANT))
            .collect();
        let (Ok(with_plant), Some(criterion)) = (with_plant, self.criterion) else {
            return Vec::new();
        };
        let seen = driven.run_scenarios(criterion, &with_plant).into_iter();
        seen.map(|seen| match seen.verdict {
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
        let mut seen = simulate_batch(&runs, RecordingLevel::Trace, |_, simulated| {
            judge(criterion, &simulated)
        })
        .into_iter();
        let unseen = || RunResult::refused("was not run".to_owned());
        refused
            .into_iter()
            .map(|refused| refused.or_else(|| seen.next()).unwrap_or_else(unseen))
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
    let is_over = |ahead_mps: f64, own_mps: f64| match lead {
        LeadManeuver::Slower | LeadManeuver::CutIn => own_mps <= ahead_mps,
        LeadManeuver::Stopped | LeadManeuver::Decelerating | LeadManeuver::CutOut => own_mps == 0.0,
        LeadManeuver::Ghost => false,
    };
    let pairs = trace.pairs(lead.under_test_index());
    let pair = pairs.last()?;
    let over = |sample: usize| {
        let speeds = pair
            .front
            .speed_mps
            .get(sample)
            .zip(pair.rear.speed_mps.get(sample));
        speeds.is_some_and(|(&ahead_mps, &own_mps)| is_over(ahead_mps, own_mps))
    };
    pair.gaps_m()
        .find(|(sample, _)| over(*sample))
        .and_then(|(sample, _)| pair.time_s.get(sample).copied())
}
