//! Results of a suite: clauses, tests, verdicts and margins.

use std::path::Path;

use crumple_core::quoting::ShellWord;
use crumple_core::text_file::is_one;
use crumple_sim::control::TestDriverSettings;
use crumple_sim::engine::FailedControllerRuns;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use serde::{Deserialize, Serialize};

use super::margin::Margin;
use super::parameter::{ImpactLimit, ParameterKind, TestParameters};
use super::prevention::ReferenceRun;
use super::worst_in_tolerance::WorstInTolerance;
use crumple_search::falsify::counterexample::Avoidability;

/// Statement that goes with every result.
pub const DISCLAIMER: &str =
    "Modelled on a regulation or protocol, for point masses in one lane. This is no certification.";

/// Result of a suite. Reading its JSON returns the same result without the scenarios of failed points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SuiteResult {
    /// Scope of the result: [`DISCLAIMER`].
    pub statement: String,
    /// Name of the suite.
    pub suite: String,
    /// Document that the suite is modelled on.
    pub document: String,
    /// Edition of the document.
    pub edition: String,
    /// Source of the parameters.
    pub parameter_source: String,
    /// Requirements of the document that the model cannot represent.
    pub not_modelled: Vec<String>,
    /// Omitted parameters, each with the reason.
    pub omitted_parameters: Vec<String>,
    /// Estimator of the controllers. Reference drivers observe the true state.
    pub estimator: EstimatorKind,
    /// Results of the clauses.
    pub clauses: Vec<ClauseResult>,
}

/// Result of a clause.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClauseResult {
    /// Number of the clause in the document.
    pub clause: String,
    /// Summary of the clause.
    pub summary: String,
    /// Results of the tests.
    pub tests: Vec<TestResult>,
}

/// Result of a test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TestResult {
    /// Name of the test.
    pub name: String,
    /// Names of the requirements that the test verifies.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub requirement: Vec<String>,
    /// True if the document states all parameters; otherwise crumple chose some.
    pub is_as_stated: bool,
    /// True if the test driver holds the speed of the start.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub holds_speed: bool,
    /// Parameters, each with its origin.
    pub parameters: TestParameters,
    /// Parameters for which the document allows every value from the smallest to the largest.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ranges: Vec<ParameterKind>,
    /// Largest impact speed that passes; `None` if no collision passes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub impact_at_most: Option<ImpactLimit>,
    /// Results, one per controller.
    pub controllers: Vec<ControllerResult>,
}

/// Result of a test with a controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ControllerResult {
    /// Name of the controller.
    pub controller: String,
    /// Number of runs of each point, each with another seed; the worst one counts.
    #[serde(default = "one_seed", skip_serializing_if = "is_one")]
    pub seeds: u32,
    /// Worst verdict of all points.
    pub verdict: TestVerdict,
    /// Number of points.
    pub points: usize,
    /// Number of points that passed.
    pub passed_points: usize,
    /// Smallest gap at any point, in metres.
    pub min_gap_m: Option<f64>,
    /// Margins of the test.
    pub margins: Vec<Margin>,
    /// Worst point found within the ranges and tolerances of the clause; `None` if it states none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub worst_in_tolerance: Option<WorstInTolerance>,
    /// Points of the grid that failed.
    pub failed_points: Vec<FailedPoint>,
    /// Warning after which the driver brakes; `None` in tests without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<WarningOrigin>,
}

/// Origin of the warning after which the driver of a test brakes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WarningOrigin {
    /// The controller reports it.
    Controller,
    /// Reference warning of the suite, at a time to collision: the controller reports none.
    Reference,
}

/// A point that failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FailedPoint {
    /// Description of the point.
    pub point: String,
    /// Verdict of the point, with several seeds the worst one.
    pub verdict: TestVerdict,
    /// Number of seeds with which the point failed; absent if it was run once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed_seeds: Option<u32>,
    /// Test driver of the vehicle under test, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub test_driver: Option<TestDriverSettings>,
    /// Behaviour of the reference drivers at the point, with the true state.
    pub references: Vec<ReferenceRun>,
    /// Avoidability of the collision with knowledge of the future.
    #[serde(flatten)]
    pub avoidability: Avoidability,
    /// True if the point also fails with the multi-body plant; absent if the controller refuses the plant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub survives_multi_body: Option<bool>,
    /// True if the escape has no collision with the multi-body plant either; absent without an escape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub escape_survives_multi_body: Option<bool>,
    /// Scenario in which a script in place of the vehicle under test avoids the collision, if it is avoidable. `None`
    /// in a result that was read from JSON.
    #[serde(skip)]
    pub escape: Option<Scenario>,
    /// File name of the scenario, without extension.
    pub scenario_name: String,
    /// Scenario of the point; `None` in a result that was read from JSON.
    #[serde(skip)]
    pub scenario: Option<Scenario>,
}

/// Verdict of a test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum TestVerdict {
    /// No collision before the test ended, or none faster than the test allows.
    Passed,
    /// A collision that is faster than the test allows.
    Failed {
        /// Time of the collision, in seconds.
        time_s: f64,
        /// Impact speed, in m/s.
        impact_speed_mps: f64,
    },
    /// Braking although nothing is in the way.
    Braked {
        /// Hardest braking beyond manual braking, in m/s².
        max_brake_mps2: f64,
        /// True if the driver brakes in the test.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        is_beyond_manual: bool,
    },
    /// The controller gave no valid answer.
    ControllerFailed {
        /// Time of the failure, in seconds.
        time_s: f64,
        /// Reason of the failure.
        reason: String,
    },
    /// The test could not be run.
    Refused {
        /// Reason of the refusal.
        reason: String,
    },
}

/// Number of seeds that the JSON of a result leaves out.
fn one_seed() -> u32 {
    1
}

impl ControllerResult {
    /// Returns the number of simulated points, of the grid and of the search within the tolerances.
    #[must_use]
    pub fn points_run(&self) -> usize {
        let within = self.worst_in_tolerance.as_ref();
        self.passed_points + self.failed_points.len() + within.map_or(0, |within| within.points_run)
    }

    /// Returns the number of simulated points that failed.
    #[must_use]
    pub fn points_failed(&self) -> usize {
        let within = self.worst_in_tolerance.as_ref();
        self.failed_points.len() + within.map_or(0, |within| within.failures)
    }

    /// Returns the failure with the highest impact speed; the last of equals.
    #[must_use]
    pub fn fastest_failure(&self) -> Option<&FailedPoint> {
        self.failures().max_by(|a, b| {
            let impact_mps = a.verdict.impact_speed_mps();
            impact_mps.total_cmp(&b.verdict.impact_speed_mps())
        })
    }

    /// Returns the points of the search within the tolerances at which the controller gave no answer.
    #[must_use]
    pub fn unanswered_in_tolerance(&self) -> Option<FailedControllerRuns> {
        self.worst_in_tolerance.as_ref()?.unanswered.clone()
    }

    /// Returns the number of runs without an answer, of grid and search, and the reason of the first.
    #[must_use]
    pub fn total_unanswered(&self) -> Option<FailedControllerRuns> {
        let mut unanswered = self.unanswered();
        FailedControllerRuns::merge(&mut unanswered, self.unanswered_in_tolerance());
        unanswered
    }

    /// Returns true if the controller passed the test, and false if it failed; `None` if the test could not be run.
    #[must_use]
    pub fn outcome(&self) -> Option<bool> {
        let is_passed = self.is_passed();
        (is_passed || !self.verdict.is_refusal()).then_some(is_passed)
    }

    /// Returns the points of the grid at which the controller gave no answer; they also count as failed.
    #[must_use]
    pub fn unanswered(&self) -> Option<FailedControllerRuns> {
        let mut all = None;
        self.failed_points
            .iter()
            .for_each(|failed| FailedControllerRuns::merge(&mut all, failed.verdict.unanswered()));
        all
    }

    /// Iterates over all failures: those of the grid, and the worst within the ranges.
    pub fn failures(&self) -> impl Iterator<Item = &FailedPoint> {
        self.failed_points.iter().chain(
            self.worst_in_tolerance
                .as_ref()
                .and_then(|within| within.failed_point.as_ref()),
        )
    }

    /// True if all points of the grid passed and no failure was found within the ranges.
    #[must_use]
    pub fn is_passed(&self) -> bool {
        self.verdict.is_passed()
            && self
                .worst_in_tolerance
                .as_ref()
                .is_none_or(|within| !within.verdict.is_failure())
    }
}

impl TestVerdict {
    /// True if the test passed.
    #[must_use]
    pub fn is_passed(&self) -> bool {
        *self == Self::Passed
    }

    /// True if the test was run and did not pass.
    #[must_use]
    pub fn is_failure(&self) -> bool {
        matches!(
            self,
            Self::Failed { .. } | Self::Braked { .. } | Self::ControllerFailed { .. }
        )
    }

    /// Returns the time and the reason of a controller failure; `None` if the controller answered.
    #[must_use]
    pub fn unanswered(&self) -> Option<FailedControllerRuns> {
        let Self::ControllerFailed { time_s, reason } = self else {
            return None;
        };
        Some(FailedControllerRuns {
            runs: 1,
            reason: format!("at {time_s:.2} s, {reason}"),
        })
    }

    /// True if the test could not be run.
    #[must_use]
    pub fn is_refusal(&self) -> bool {
        matches!(self, Self::Refused { .. })
    }

    /// Returns the impact speed of a failed test in m/s; 0 if the test passed or could not be run.
    #[must_use]
    pub fn impact_speed_mps(&self) -> f64 {
        match self {
            Self::Failed {
                impact_speed_mps, ..
            } => *impact_speed_mps,
            _ => 0.0,
        }
    }

    /// Orders verdicts: collisions are the worst, then unnecessary braking, controller failures, then refusals.
    fn severity_class(&self) -> u8 {
        match self {
            Self::Passed => 0,
            Self::Refused { .. } => 1,
            Self::ControllerFailed { .. } => 2,
            Self::Braked { .. } => 3,
            Self::Failed { .. } => 4,
        }
    }

    /// Returns the impact speed in m/s of a collision, or the deceleration in m/s² of braking without a vehicle in the
    /// way; 0 for other verdicts.
    fn severity(&self) -> f64 {
        match self {
            Self::Braked { max_brake_mps2, .. } => *max_brake_mps2,
            _ => self.impact_speed_mps(),
        }
    }

    /// Returns the worst verdict, the first of equals; `None` without verdicts.
    pub(super) fn worst<'v>(all: impl Iterator<Item = &'v Self>) -> Option<&'v Self> {
        all.reduce(|worst, next| {
            if next.is_worse_than(worst) {
                next
            } else {
                worst
            }
        })
    }

    pub(super) fn is_worse_than(&self, other: &Self) -> bool {
        self.severity_class()
            .cmp(&other.severity_class())
            .then(self.severity().total_cmp(&other.severity()))
            .is_gt()
    }
}

impl SuiteResult {
    /// Iterates over all tests, each with its clause.
    pub fn tests(&self) -> impl Iterator<Item = (&ClauseResult, &TestResult)> {
        self.clauses
            .iter()
            .flat_map(|clause| clause.tests.iter().map(move |test| (clause, test)))
    }
    /// True if a controller failed a test.
    #[must_use]
    pub fn has_failures(&self) -> bool {
        self.tests()
            .flat_map(|(_, test)| &test.controllers)
            .any(|tested| tested.failures().next().is_some())
    }

    /// Returns the tests that did not pass, each with its controller. Tests that cannot be run at any point do not
    /// count.
    #[must_use]
    pub fn unpassed_tests(&self) -> Vec<String> {
        let mut unpassed = Vec::new();
        for (_, test) in self.tests() {
            for tested in &test.controllers {
                let cannot_run = tested.verdict.is_refusal() && tested.points == 0;
                if !tested.is_passed() && !cannot_run {
                    unpassed.push(format!("{} ({})", test.name, tested.controller));
                }
            }
        }
        unpassed
    }
}

impl FailedPoint {
    /// Returns the name of a controller with the test driver of the point.
    #[must_use]
    pub fn with_test_driver(&self, controller: &str) -> String {
        let driver = self.test_driver.as_ref();
        driver.map_or_else(String::new, TestDriverSettings::name_prefix) + controller
    }

    /// Returns the command that simulates the point again, from its scenario in a folder. `None` if the path of the
    /// folder is not UTF-8.
    #[must_use]
    pub fn replay_command(
        &self,
        folder: &Path,
        controller: &str,
        estimator: EstimatorKind,
    ) -> Option<String> {
        let mut path = folder.join(format!("{}.toml", self.scenario_name));
        // A path that begins with a hyphen would be an option.
        if path.to_str()?.starts_with('-') {
            path = Path::new(".").join(path);
        }
        let controller = self.with_test_driver(controller);
        let sign = if controller.starts_with('-') {
            "="
        } else {
            " "
        };
        Some(format!(
            "crumple simulate {} --controller{sign}{} --estimator {}",
            ShellWord(path.to_str()?),
            ShellWord(&controller),
            ShellWord(estimator.name())
        ))
    }
}
