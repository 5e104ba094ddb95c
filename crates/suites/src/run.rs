//! Simulation of every point of every grid of a suite with every controller.

use std::collections::BTreeMap;
use std::sync::Arc;

use crumple_sim::control::{ControllerSource, TestDriverSettings, TestDriverSource};
use crumple_sim::engine::{
    Collision, NamedController, Outcome, RecordingLevel, RefusedController, Run, RunError,
    RunOptions, SimulationResult, Trace, Track, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::InvalidField;

use super::TestSuite;
use super::margin::find_margins;
use super::prevention::{Preventability, assess_preventability};
use super::result::{
    ClauseResult, ControllerResult, DISCLAIMER, FailedPoint, SuiteResult, TestResult, TestVerdict,
    WarningOrigin,
};
use super::scenario::{FalseBrakingLimit, PointRun};
use super::spec::{LeadManeuver, SuiteSpec, TestSpec};
use super::worst_in_tolerance::{WorstInTolerance, WorstPoint, find_worst};
use crumple_search::confirmation::CONFIRMING_PLANT;

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

/// Number of runs of each point with a controller that acts at random, unless the suite states it: they show a failure
/// that happens in 26 % of the runs with a probability of 95 %.
const RANDOM_CONTROLLER_SEEDS: u32 = 10;

#[derive(Debug, Clone, Copy)]
pub(super) struct Criterion {
    pub(super) lead: LeadManeuver,
    /// Largest impact speed that passes, in m/s; `None` if no collision passes.
    pub(super) impact_at_most_mps: Option<f64>,
}

impl Criterion {
    /// True for a collision before the end of the test that is faster than the test allows.
    fn fails(self, collision: &Collision, end_s: Option<f64>) -> bool {
        let is_allowed = self
            .impact_at_most_mps
            .is_some_and(|most| collision.impact_speed_mps <= most);
        !is_allowed && end_s.is_none_or(|end_s| collision.time_s <= end_s)
    }
}

pub(super) struct ControllerSetup<'c> {
    pub(super) controller: &'c Arc<dyn ControllerSource>,
    pub(super) estimator: EstimatorKind,
    /// Number of runs of each point, at least 1.
    pub(super) seeds: u32,
}

/// Result of a point: the worst of its runs.
#[derive(Debug, Clone)]
pub(super) struct RunResult {
    pub(super) verdict: TestVerdict,
    pub(super) min_gap_m: Option<f64>,
    /// Hardest braking, in m/s²; without a vehicle in the way, only that beyond manual braking and during the test.
    pub(super) max_brake_mps2: f64,
    /// Seed of the worst run, counted from that of the scenario.
    pub(super) seed: u32,
    /// Number of runs that failed.
    failed_seeds: u32,
}

impl RunResult {
    fn new(verdict: TestVerdict, min_gap_m: Option<f64>, max_brake_mps2: f64) -> Self {
        Self {
            failed_seeds: u32::from(verdict.is_failure()),
            verdict,
            min_gap_m,
            max_brake_mps2,
            seed: 0,
        }
    }

    fn refused(reason: String) -> Self {
        Self::new(TestVerdict::Refused { reason }, None, 0.0)
    }

    /// Returns the worst of the runs with successive seeds, the first of equals; `None` without runs.
    fn worst(runs: &[Self]) -> Option<Self> {
        let numbered = runs.iter().zip(0..);
        let (worst, seed) = numbered.reduce(|worst, next| {
            if next.0.verdict.is_worse_than(&worst.0.verdict) {
                next
            } else {
                worst
            }
        })?;
        let gaps_m = runs.iter().filter_map(|run| run.min_gap_m);
        let braking_mps2 = runs.iter().map(|run| run.max_brake_mps2);
        Some(Self {
            verdict: worst.verdict.clone(),
            min_gap_m: gaps_m.reduce(f64::min),
            max_brake_mps2: braking_mps2.fold(0.0, f64::max),
            seed,
            failed_seeds: runs.iter().map(|run| run.failed_seeds).sum(),
        })
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
            let grid = TestGrid::new(spec, test, format!("{}: {}", clause.clause, clause.summary))?;
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
            requirement: test.requirement.clone(),
            is_as_stated: test.is_as_stated(),
            holds_speed: test.holds_speed,
            parameters: test.parameters.clone(),
            ranges: test.ranges.clone(),
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
        statement: DISCLAIMER.to_owned(),
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
    /// Number of runs of each point that the suite states.
    seeds: Option<u32>,
    about: String,
    test: &'t TestSpec,
    criterion: Option<Criterion>,
    grid: Vec<Vec<f64>>,
    runs: Vec<PointRun>,
}

impl<'t> TestGrid<'t> {
    fn new(suite: &SuiteSpec, test: &'t TestSpec, about: String) -> Result<Self, InvalidField> {
        let grid = if test.lead.is_some() {
            test.grid()
        } else {
            Vec::new()
        };
        let name = format!("{}-{}", suite.name, test.name);
        let mut runs = Vec::new();
        for (point, number) in grid.iter().zip(1..) {
            let about = format!("{about} ({}.) {DISCLAIMER}", test.describe_point(point));
            runs.push(test.point_run(&format!("{name}-{number:03}"), &about, point)?);
        }
        Ok(Self {
            name,
            seeds: suite.seeds,
            about: format!("{about} {DISCLAIMER}"),
            test,
            criterion: test.criterion(),
            grid,
            runs,
        })
    }

    fn run(
        &self,
        controller: &NamedController,
        estimator: EstimatorKind,
        cache: &mut PreventabilityCache,
    ) -> ControllerResult {
        let setup = ControllerSetup::new(controller, estimator, self.seeds);
        let results = match (self.criterion, &self.test.refusal_reason) {
            (Some(criterion), _) => setup.run_points(criterion, &self.runs),
            (None, reason) => vec![RunResult::refused(reason.clone().unwrap_or_default())],
        };
        let verdict = TestVerdict::worst(results.iter().map(|result| &result.verdict))
            .unwrap_or(&TestVerdict::Passed);
        let passed = results.iter().filter(|result| result.verdict.is_passed());
        let gaps_m = results.iter().filter_map(|result| result.min_gap_m);
        ControllerResult {
            controller: controller.name.clone(),
            seeds: setup.seeds,
            verdict: verdict.clone(),
            points: self.grid.len(),
            passed_points: passed.count(),
            min_gap_m: gaps_m.reduce(f64::min),
            margins: self
                .criterion
                .map(|criterion| find_margins(self.test, criterion, &setup))
                .unwrap_or_default(),
            worst_in_tolerance: self.worst_in_tolerance(&setup, cache),
            failed_points: self.failed_points(&self.grid, &self.runs, &results, &setup, cache),
            warning: self.warning_origin(&setup),
        }
    }

    /// Returns the origin of the warning after which the driver brakes. Known only after the runs, for a program states
    /// it in its handshake.
    fn warning_origin(&self, setup: &ControllerSetup<'_>) -> Option<WarningOrigin> {
        let origin = || match setup.controller.reports_warnings() {
            true => WarningOrigin::Controller,
            false => WarningOrigin::Reference,
        };
        self.test.has_warning().then(origin)
    }

    fn worst_in_tolerance(
        &self,
        setup: &ControllerSetup<'_>,
        cache: &mut PreventabilityCache,
    ) -> Option<WorstInTolerance> {
        let WorstPoint {
            point,
            run,
            result,
            points_run,
            failures,
            unanswered,
        } = find_worst(&self.name, &self.about, self.test, self.criterion?, setup)?;
        let description = self.test.describe_point(&point);
        let results = std::slice::from_ref(&result);
        let failed_point = self
            .failed_points(&[point], &[run], results, setup, cache)
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
        runs: &[PointRun],
        results: &[RunResult],
        setup: &ControllerSetup<'_>,
        cache: &mut PreventabilityCache,
    ) -> Vec<FailedPoint> {
        let failed: Vec<_> = points
            .iter()
            .zip(runs)
            .zip(results)
            .filter(|(_, result)| result.verdict.is_failure())
            .filter_map(|((point, run), result)| {
                Some((point, run.seeded(result.seed).ok()?, result))
            })
            .collect();
        // Other failures may have ended without a collision.
        let collisions: Vec<&PointRun> = failed
            .iter()
            .filter(|(_, _, result)| result.is_collision())
            .map(|(_, run, _)| run)
            .collect();
        let mut preventabilities = self
            .criterion
            .map(|criterion| assess_preventability(criterion, &collisions, cache))
            .unwrap_or_default()
            .into_iter();
        let failed_runs = failed.iter().map(|(_, run, _)| run);
        let mut replays = self.replay_with_multi_body(setup, failed_runs).into_iter();
        let mut failed_points = Vec::new();
        for (point, run, result) in &failed {
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
                failed_seeds: (setup.seeds > 1).then_some(result.failed_seeds),
                test_driver: run.test_driver.clone(),
                references,
                avoidability: classification.avoidability,
                survives_multi_body: replays.next().flatten(),
                escape_survives_multi_body: classification.escape_survives,
                escape: classification.escape,
                scenario_name: run.scenario.spec().name.clone(),
                scenario: Some(run.scenario.clone()),
            });
        }
        failed_points
    }
}

impl TestGrid<'_> {
    /// Replays points with the multi-body plant. Returns which fail; `None` if the controller refuses the plant.
    fn replay_with_multi_body<'r>(
        &self,
        setup: &ControllerSetup<'_>,
        runs: impl Iterator<Item = &'r PointRun>,
    ) -> Vec<Option<bool>> {
        let with_plant: Result<Vec<_>, _> = runs.map(PointRun::with_multi_body).collect();
        let Some((with_plant, criterion)) = with_plant.ok().zip(self.criterion) else {
            return Vec::new();
        };
        setup
            .run_once(criterion, &with_plant)
            .into_iter()
            .map(|result| match result.verdict {
                TestVerdict::Refused { .. } => None,
                verdict => Some(verdict.is_failure()),
            })
            .collect()
    }
}

impl PointRun {
    fn has_manual_braking(&self) -> bool {
        let driver = self.test_driver.as_ref();
        driver.is_some_and(|driver| driver.brake_mps2 > 0.0)
    }

    /// Returns the point with a later seed, which its name then states.
    fn seeded(&self, seed: u32) -> Result<Self, InvalidField> {
        if seed == 0 {
            return Ok(self.clone());
        }
        let scenario = self.scenario.edited(|spec| {
            spec.seed += u64::from(seed);
            spec.name += &format!("-seed-{seed}");
        })?;
        Ok(Self {
            scenario,
            ..self.clone()
        })
    }

    fn with_multi_body(&self) -> Result<Self, InvalidField> {
        Ok(Self {
            scenario: self.scenario.with_plant(CONFIRMING_PLANT)?,
            ..self.clone()
        })
    }
}

impl<'c> ControllerSetup<'c> {
    /// Describes runs with the number of seeds that the suite states, or else that the controller needs.
    fn new(controller: &'c NamedController, estimator: EstimatorKind, seeds: Option<u32>) -> Self {
        let default = match controller.source.acts_at_random() {
            true => RANDOM_CONTROLLER_SEEDS,
            false => 1,
        };
        Self {
            controller: &controller.source,
            estimator,
            seeds: seeds.unwrap_or(default).max(1),
        }
    }

    /// Runs each point with each seed, and returns the worst result of each point.
    pub(super) fn run_points(&self, criterion: Criterion, points: &[PointRun]) -> Vec<RunResult> {
        if self.seeds == 1 {
            return self.run_once(criterion, points);
        }
        let seeded = points
            .iter()
            .flat_map(|point| (0..self.seeds).map(|seed| point.seeded(seed)));
        match seeded.collect::<Result<Vec<_>, _>>() {
            Ok(seeded) => self
                .run_once(criterion, &seeded)
                .chunks(self.seeds as usize)
                .filter_map(RunResult::worst)
                .collect(),
            Err(invalid) => vec![RunResult::refused(invalid.to_string()); points.len()],
        }
    }

    /// Runs each point with the seed of its scenario.
    fn run_once(&self, criterion: Criterion, points: &[PointRun]) -> Vec<RunResult> {
        if criterion.lead.is_false_activation() && self.estimator == EstimatorKind::Truth {
            let reason =
                "the estimator `truth` ignores the sensors, so that no ghost object is observed";
            return vec![RunResult::refused(reason.to_owned()); points.len()];
        }
        let mut refused = Vec::new();
        let mut runs = Vec::new();
        let mut admitted = Vec::new();
        for point in points {
            let run = self.prepare(point);
            refused.push(
                run.as_ref()
                    .err()
                    .map(|error| RunResult::refused(error.to_string())),
            );
            admitted.extend(run.is_ok().then_some(point));
            runs.extend(run.ok());
        }
        let mut results = simulate_batch(&runs, RecordingLevel::Trace, |index, simulated| {
            admitted
                .get(index)
                .map(|point| judge(criterion, point, &simulated))
        })
        .into_iter()
        .flatten();
        refused
            .into_iter()
            .map(|refused| {
                refused
                    .or_else(|| results.next())
                    .unwrap_or_else(|| RunResult::refused("was not run".to_owned()))
            })
            .collect()
    }

    fn prepare(&self, point: &PointRun) -> Result<Run, RunError> {
        let controller = Arc::clone(self.controller);
        let options = match &point.test_driver {
            Some(settings) => RunOptions::new(TestDriverSource {
                controller,
                settings: settings.clone(),
            }),
            None => RunOptions::new(controller),
        };
        Run::new(&point.scenario, options.with_estimator(self.estimator))
    }
}

fn judge(criterion: Criterion, point: &PointRun, simulated: &SimulationResult) -> RunResult {
    let lead = criterion.lead;
    let trace = simulated.trace.as_ref();
    let end_s = trace.and_then(|trace| match point.false_braking {
        Some(limit) => false_activation_end_s(limit, lead, trace),
        None => test_end_s(lead, trace),
    });
    let own = simulated.vehicles.get(lead.under_test_index());
    let max_brake_mps2 = match (point.false_braking, trace) {
        (Some(_), Some(trace)) => added_braking_mps2(point, lead, trace, end_s),
        _ => own.map_or(0.0, |own| own.max_brake_mps2),
    };
    let limit = point.false_braking;
    let is_false_braking = limit.is_some_and(|limit| max_brake_mps2 >= limit.allowed_mps2);
    let verdict = match &simulated.outcome {
        Outcome::Collision(collision) if criterion.fails(collision, end_s) => TestVerdict::Failed {
            time_s: collision.time_s,
            impact_speed_mps: collision.impact_speed_mps,
        },
        Outcome::ControllerFailed(failed) => TestVerdict::ControllerFailed {
            time_s: failed.time_s,
            reason: failed.failure.to_string(),
        },
        _ if is_false_braking => TestVerdict::Braked {
            max_brake_mps2,
            is_beyond_manual: point.has_manual_braking(),
        },
        Outcome::NoCollision | Outcome::Collision(_) => TestVerdict::Passed,
    };
    RunResult::new(verdict, own.and_then(|own| own.min_gap_m), max_brake_mps2)
}

/// Returns the time at which a test without a vehicle in the way ends: at its place, or at standstill.
fn false_activation_end_s(
    limit: FalseBrakingLimit,
    lead: LeadManeuver,
    trace: &Trace,
) -> Option<f64> {
    let own = trace.vehicles.get(lead.under_test_index())?;
    let mut states = own.position_m.iter().zip(&own.speed_mps);
    let sample = states
        .position(|(&position_m, &speed_mps)| position_m >= limit.end_m || speed_mps == 0.0)?;
    trace.time_s.get(sample).copied()
}

/// Returns the hardest braking beyond that of the driver until a time, in m/s².
fn added_braking_mps2(
    point: &PointRun,
    lead: LeadManeuver,
    trace: &Trace,
    end_s: Option<f64>,
) -> f64 {
    let Some(own) = trace.vehicles.get(lead.under_test_index()) else {
        return 0.0;
    };
    let driver = point.test_driver.as_ref();
    let onset_s = driver.and_then(|driver| manual_onset_s(driver, own, &trace.time_s));
    let added_mps2 = trace
        .time_s
        .iter()
        .zip(&own.acceleration_mps2)
        .take_while(|(time_s, _)| end_s.is_none_or(|end_s| **time_s < end_s))
        .map(|(time_s, acceleration_mps2)| {
            let manual_mps2 = driver.zip(onset_s).map_or(0.0, |(driver, onset_s)| {
                driver.manual_brake_mps2(time_s - onset_s)
            });
            -acceleration_mps2 - manual_mps2
        });
    added_mps2.fold(0.0, f64::max)
}

/// Returns the time at which a vehicle reaches the place where its driver brakes.
fn manual_onset_s(driver: &TestDriverSettings, own: &Track, time_s: &[f64]) -> Option<f64> {
    let is_reached = |position_m: &f64| *position_m >= driver.after_m;
    let sample = own.position_m.iter().position(is_reached)?;
    let beyond_m = own.position_m.get(sample)? - driver.after_m;
    let speed_mps = own.speed_mps.get(sample)?;
    Some(time_s.get(sample)? - beyond_m / speed_mps.max(1.0))
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
        LeadManeuver::Ghost | LeadManeuver::PassThrough => false,
    }
}
