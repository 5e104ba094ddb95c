//! What a run of a suite found: clause, test, verdict, margin.

use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::Scenario;
use crumple_world::sim::FailedControllerRuns;
use serde::{Deserialize, Serialize};

use super::margin::Margin;
use super::parameter::{ImpactLimit, TestParameters};
use super::prevention::ReferenceRun;
use super::worst_in_tolerance::WorstInTolerance;
use crumple_search::falsify::counterexample::Avoidability;

/// What goes with every result.
pub const DISCLAIMER: &str = "After the document, on a point-mass model in one lane. This is no certification.";

/// What a run of a suite found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SuiteResult {
    /// What it is and is not: [`DISCLAIMER`].
    pub statement: &'static str,
    /// Name of the suite.
    pub suite: String,
    /// The document that it is after.
    pub document: String,
    /// Its edition.
    pub edition: String,
    /// What the figures were read from.
    #[serde(rename = "figures_from")]
    pub parameter_source: String,
    /// What the document asks for and the model does not have.
    #[serde(rename = "outside")]
    pub not_modelled: Vec<String>,
    /// Figures that were left out, and why.
    #[serde(rename = "left_out")]
    pub omitted_parameters: Vec<String>,
    /// What the controllers looked through. Reference drivers see the truth.
    pub estimator: EstimatorKind,
    /// The clauses.
    pub clauses: Vec<ClauseResult>,
}

/// What was found of a clause.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClauseResult {
    /// Its number in the document.
    pub clause: String,
    /// What it says, in short.
    #[serde(rename = "says")]
    pub summary: String,
    /// Its tests.
    pub tests: Vec<TestResult>,
}

/// What was found of a test.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TestResult {
    /// Its name.
    pub name: String,
    /// Whether the document states its figures; else some were chosen here.
    pub is_as_stated: bool,
    /// Its figures, each with who says so.
    #[serde(rename = "figures")]
    pub parameters: TestParameters,
    /// The fastest contact at which it passes; none if no contact does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub impact_at_most: Option<ImpactLimit>,
    /// An entry a controller.
    pub controllers: Vec<ControllerResult>,
}

/// What was found of a test and a controller.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControllerResult {
    /// The controller's name.
    pub controller: String,
    /// The worst of all points.
    pub verdict: TestVerdict,
    /// How many points there are.
    pub points: usize,
    /// How many of them passed.
    #[serde(rename = "passed")]
    pub passed_points: usize,
    /// The smallest gap at any point, in metres.
    pub min_gap_m: Option<f64>,
    /// How far the test can be pushed until it fails.
    pub margins: Vec<Margin>,
    /// The worst point found within the ranges that the clause allows; none where it states none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[serde(rename = "within")]
    pub worst_in_tolerance: Option<WorstInTolerance>,
    /// The points of the grid that failed.
    #[serde(rename = "failed")]
    pub failed_points: Vec<FailedPoint>,
}

/// A point that failed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FailedPoint {
    /// The point in words.
    pub point: String,
    /// What happened.
    pub verdict: TestVerdict,
    /// What the reference drivers do there, seeing the truth.
    pub references: Vec<ReferenceRun>,
    /// Whether anybody could have avoided the contact who knows the future.
    #[serde(flatten)]
    pub avoidability: Avoidability,
    /// How it could have been avoided, where it is avoidable: a script in place of the vehicle under test, and nobody touches.
    #[serde(skip)]
    pub escape: Option<Scenario>,
    /// Name of the scenario's file, without its ending.
    pub scenario_name: String,
    /// The scenario.
    #[serde(skip)]
    pub scenario: Scenario,
}

/// How a test ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum TestVerdict {
    /// No contact before the test ended, or none faster than the test allows.
    Passed,
    /// A contact, faster than the test allows.
    Failed {
        /// When, in seconds.
        time_s: f64,
        /// Difference of the speeds, in m/s.
        impact_speed_mps: f64,
    },
    /// The controller gave no usable answer.
    ControllerFailed {
        /// When, in seconds.
        time_s: f64,
        /// Why.
        reason: String,
    },
    /// The test could not be run.
    Refused {
        /// Why not.
        reason: String,
    },
}

impl ControllerResult {
    /// Points of its grid in which the controller gave no answer: they are among those that failed.
    #[must_use]
    pub fn unanswered(&self) -> Option<FailedControllerRuns> {
        let mut all = None;
        self.failed_points.iter().for_each(|failed| FailedControllerRuns::merge(&mut all, failed.verdict.unanswered()));
        all
    }

    /// Every failure: of the grid, and the worst within the ranges.
    pub fn failures(&self) -> impl Iterator<Item = &FailedPoint> {
        self.failed_points
            .iter()
            .chain(self.worst_in_tolerance.as_ref().and_then(|within| within.failed_point.as_ref()))
    }

    /// Whether it passed on the grid, and nothing was found to fail within the ranges.
    #[must_use]
    pub fn is_passed(&self) -> bool {
        self.verdict.is_passed() && self.worst_in_tolerance.as_ref().is_none_or(|within| !within.verdict.is_failure())
    }
}

impl TestVerdict {
    /// Whether the test passed.
    #[must_use]
    pub fn is_passed(&self) -> bool {
        *self == Self::Passed
    }

    /// Whether the test was run and did not pass.
    #[must_use]
    pub fn is_failure(&self) -> bool {
        matches!(self, Self::Failed { .. } | Self::ControllerFailed { .. })
    }

    /// That its controller gave no answer, and why; nothing where it did.
    #[must_use]
    pub fn unanswered(&self) -> Option<FailedControllerRuns> {
        let Self::ControllerFailed { time_s, reason } = self else { return None };
        Some(FailedControllerRuns { runs: 1, because: format!("at {time_s:.2} s, {reason}") })
    }

    /// Whether the test could not be run.
    #[must_use]
    pub fn is_refusal(&self) -> bool {
        matches!(self, Self::Refused { .. })
    }

    /// How bad it is: contacts by their speed, then failures of controllers, then refusals.
    fn severity_key(&self) -> (u8, f64) {
        match self {
            Self::Passed => (0, 0.0),
            Self::Refused { .. } => (1, 0.0),
            Self::ControllerFailed { .. } => (2, 0.0),
            Self::Failed { impact_speed_mps, .. } => (3, *impact_speed_mps),
        }
    }

    /// The worst of some, the first of equals; none of none.
    pub(super) fn worst<'v>(all: impl Iterator<Item = &'v Self>) -> Option<&'v Self> {
        let worse = |worst: &'v Self, next: &'v Self| {
            let ((class, speed), (next_class, next_speed)) = (worst.severity_key(), next.severity_key());
            if (next_class, next_speed.total_cmp(&speed)) > (class, std::cmp::Ordering::Equal) { next } else { worst }
        };
        all.reduce(worse)
    }
}

impl SuiteResult {
    /// Every clause with every test of it.
    pub fn tests(&self) -> impl Iterator<Item = (&ClauseResult, &TestResult)> {
        self.clauses.iter().flat_map(|clause| clause.tests.iter().map(move |test| (clause, test)))
    }
}
