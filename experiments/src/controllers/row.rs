//! Results of one controller.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::drives::ImportedDrives;
use crate::ExperimentError;
use crumple::evidence::DriveReport;
use crumple::measure::{CollisionRole, GainSurvey};
use crumple::sim::engine::{
    NamedController, RecordingLevel, Run, RunOptions, SimulationResult, simulate_batch,
};
use crumple::sim::observation::EstimatorKind;
use crumple::sim::random::derived_seed;
use crumple::sim::scenario::Scenario;
use crumple::spaces::{ScenarioSpace, SpaceParameter, built_in_space};
use crumple::suites::{
    ControllerResult, Margin, MarginEnd, SHIPPED_SUITES, SuiteResult, TestSuite,
};
use crumple_core::observer::Quiet;

/// Space whose parameter [`FOLLOWER`] chooses the kind of follower.
pub(super) const SPACE: &str = "followers";
const FOLLOWER: &str = "follower";
pub(super) const SEED: u64 = 0;
/// Random scenarios that are simulated together.
const BLOCK: u64 = 500;

/// Extent of a table.
pub(super) struct RowConfig {
    /// Random scenarios with each kind of follower.
    pub(super) draws: u64,
    pub(super) drives: Option<ImportedDrives>,
}

impl RowConfig {
    /// Returns a text that differs between configurations with different rows.
    pub(super) fn identity(&self) -> String {
        let drives = self.drives.as_ref().map(|drives| drives.set.identity());
        format!("{} {SEED} {}", self.draws, drives.unwrap_or("none"))
    }
}

/// Results of a controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct ControllerRow {
    pub(super) controller: String,
    pub(super) suites: Vec<SuiteScore>,
    pub(super) followers: Vec<FollowerCounts>,
    /// Absent if drives are not counted.
    pub(super) drives: Option<DriveScore>,
    /// Largest gain of a line, with the true state; absent if no line settles.
    pub(super) largest_gain: Option<f64>,
}

/// Result of a suite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct SuiteScore {
    pub(super) suite: String,
    pub(super) passed: usize,
    /// Number of tests that can be run.
    pub(super) run: usize,
    /// Number of tests that cannot be run with this controller.
    pub(super) refused: usize,
    /// Mean over the tests that can be run of the smallest share of a margin that passes, in percent; 0 for a failed
    /// test.
    pub(super) margin_percent: f64,
}

/// Collisions with a kind of follower.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct FollowerCounts {
    pub(super) follower: String,
    /// The vehicle under test hits its leader first.
    pub(super) hits: u64,
    /// The follower hits the vehicle under test first.
    pub(super) hit_from_behind: u64,
    /// The controller gave no answer.
    pub(super) unanswered: u64,
}

/// Results on recorded drives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct DriveScore {
    /// Drives that hit the leader, or end without an answer.
    pub(super) hits: u64,
    /// Drives that the simulated human behind hits.
    pub(super) hit_from_behind: u64,
    /// Unnecessary braking per hour that counts against the controller, and the ends of its interval.
    pub(super) unnecessary_per_hour: [f64; 3],
    /// Unnecessary braking per hour that only the vehicle behind causes.
    pub(super) caused_behind_per_hour: f64,
}

impl ControllerRow {
    pub(super) fn measure(
        controller: &NamedController,
        config: &RowConfig,
    ) -> Result<Self, ExperimentError> {
        let suites = SHIPPED_SUITES
            .iter()
            .map(|(name, text)| SuiteScore::measure(controller, name, text));
        let drives = config.drives.as_ref();
        let survey = GainSurvey::new(&controller.source)?;
        Ok(Self {
            controller: controller.name.clone(),
            suites: suites.collect::<Result<_, _>>()?,
            followers: count_by_follower(controller, config.draws)?,
            drives: drives
                .map(|drives| DriveScore::measure(controller, drives))
                .transpose()?,
            largest_gain: survey.largest().map(|(_, gain)| gain),
        })
    }
}

impl SuiteScore {
    fn measure(
        controller: &NamedController,
        name: &str,
        text: &str,
    ) -> Result<Self, ExperimentError> {
        let suite = TestSuite::from_toml(text, Path::new(name))?;
        let controllers = std::slice::from_ref(controller);
        let result = crumple::suites::run(&suite, controllers, EstimatorKind::Kalman)?;
        Ok(Self::new(&result))
    }

    fn new(result: &SuiteResult) -> Self {
        let tests = result.tests().flat_map(|(_, test)| &test.controllers);
        let (refused, run): (Vec<_>, Vec<&ControllerResult>) =
            tests.partition(|tested| tested.verdict.is_refusal());
        let shares = run.iter().map(|tested| margin_share(tested));
        Self {
            suite: result.suite.clone(),
            passed: run.iter().filter(|tested| tested.is_passed()).count(),
            run: run.len(),
            refused: refused.len(),
            margin_percent: 100.0 * shares.sum::<f64>() / run.len().max(1) as f64,
        }
    }
}

/// Returns the smallest share of a margin that passes; 0 for a failed test, and 1 for a passed test without margins.
fn margin_share(tested: &ControllerResult) -> f64 {
    let share = |margin: &Margin| match margin.end {
        MarginEnd::None { .. } => 0.0,
        MarginEnd::Holds { .. } => 1.0,
        MarginEnd::Boundary { passes_at, .. } => {
            (passes_at - margin.from) / (margin.to - margin.from)
        }
    };
    match tested.is_passed() {
        true => tested.margins.iter().map(share).fold(1.0, f64::min),
        false => 0.0,
    }
}

/// Counts collisions in the same random scenarios with each kind of follower.
pub(super) fn count_by_follower(
    controller: &NamedController,
    draws: u64,
) -> Result<Vec<FollowerCounts>, ExperimentError> {
    let space = built_in_space(SPACE).ok_or("no such space")?;
    let kinds = follower_kinds(&space)?;
    let options = RunOptions::new(controller.source.clone());
    let mut counted = Vec::new();
    for kind in &kinds {
        let mut counts = FollowerCounts {
            follower: kind.name.clone(),
            hits: 0,
            hit_from_behind: 0,
            unanswered: 0,
        };
        for from in (0..draws).step_by(BLOCK as usize) {
            let scenarios = (from..draws.min(from + BLOCK))
                .map(|index| kind.draw(&space, index))
                .collect::<Result<Vec<_>, _>>()?;
            counts.add(&scenarios, &options)?;
        }
        counted.push(counts);
    }
    controller.ensure_trusted()?;
    Ok(counted)
}

impl FollowerCounts {
    fn add(&mut self, scenarios: &[Scenario], options: &RunOptions) -> Result<(), ExperimentError> {
        let runs = scenarios
            .iter()
            .map(|scenario| Run::new(scenario, options.clone()))
            .collect::<Result<Vec<_>, _>>()?;
        let results = simulate_batch(&runs, RecordingLevel::Summary, |_, result| result);
        for (scenario, result) in scenarios.iter().zip(&results) {
            self.add_result(scenario, result);
        }
        Ok(())
    }

    fn add_result(&mut self, scenario: &Scenario, result: &SimulationResult) {
        self.unanswered += u64::from(result.outcome.failed_controller().is_some());
        let collision = result.outcome.collision();
        match collision.map(|collision| CollisionRole::new(collision, scenario)) {
            Some(CollisionRole::Hits) => self.hits += 1,
            Some(CollisionRole::HitFromBehind) => self.hit_from_behind += 1,
            _ => {}
        }
    }
}

/// A kind of follower, and its coordinate in points.
struct FollowerKind {
    name: String,
    index: usize,
    coordinate: f64,
}

impl FollowerKind {
    /// Draws a random scenario with this kind of follower; all else is the same for all kinds.
    fn draw(&self, space: &ScenarioSpace, index: u64) -> Result<Scenario, ExperimentError> {
        let mut point = space.draw_point(SEED, index);
        if let Some(coordinate) = point.get_mut(self.index) {
            *coordinate = self.coordinate;
        }
        Ok(space.scenario_at_with_seed(&point, derived_seed(SEED, index))?)
    }
}

/// Returns the kinds of follower, which are equally likely in the space.
fn follower_kinds(space: &ScenarioSpace) -> Result<Vec<FollowerKind>, ExperimentError> {
    let is_follower = |parameter: &&SpaceParameter| parameter.name() == FOLLOWER;
    let parameter = space
        .parameters()
        .iter()
        .find(is_follower)
        .ok_or("the space has no such parameter")?;
    let mut kinds: Vec<FollowerKind> = Vec::new();
    for step in 0..100 {
        let coordinate = (f64::from(step) + 0.5) / 100.0;
        let name = parameter.format_value(parameter.value(coordinate));
        if kinds.last().is_none_or(|last| last.name != name) {
            kinds.push(FollowerKind {
                name,
                index: parameter.coordinates().start,
                coordinate,
            });
        }
    }
    Ok(kinds)
}

impl DriveScore {
    fn measure(
        controller: &NamedController,
        drives: &ImportedDrives,
    ) -> Result<Self, ExperimentError> {
        let runs = drives
            .set
            .run(&RunOptions::new(controller.source.clone()), &Quiet)?;
        let report = DriveReport::new(&controller.name, &runs, &drives.set);
        let [caused_behind_per_hour, ..] = report.caused_by_vehicle_behind.per_hour_interval();
        Ok(Self {
            hits: report.hits_leader + report.no_answer,
            hit_from_behind: report.hit_from_behind,
            unnecessary_per_hour: report.comfort.unnecessary_braking.per_hour_interval(),
            caused_behind_per_hour,
        })
    }
}
