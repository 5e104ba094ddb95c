//! Form of the results of suites in the JSON of the assessment.

use serde::Serialize;

use super::distinct_failure::EscapeFile;
use super::suites::{PlannedSuiteResult, SuiteOutcome};
use crate::assessment::CrumpleCommand;
use crate::assessment::claims::ContentId;
use crate::suite::{
    describe_min_margins, describe_preventability, describe_verdict, describe_warning,
    describe_worst_in_tolerance,
};
use crumple_sim::engine::FailedControllerRuns;

/// The findings of one suite.
#[derive(Debug, Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "SuiteFindings")
)]
pub(super) struct SuiteJson<'s> {
    /// Identifier of the suite.
    suite: &'s ContentId,
    /// Document that the suite is modelled on, and its edition.
    document: String,
    /// Source of the parameters.
    parameter_source: &'s str,
    /// Requirements of the document that the model cannot represent.
    not_modelled: &'s [String],
    /// Omitted parameters, each with the reason.
    omitted_parameters: &'s [String],
    /// Tested controllers, in the order of the outcomes of each test.
    controllers: &'s [String],
    /// Tests of the suite.
    tests: Vec<SuiteTestJson<'s>>,
}

/// The findings of one test.
#[derive(Debug, Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "SuiteTest")
)]
struct SuiteTestJson<'s> {
    /// Clause of the document.
    clause: &'s str,
    /// Name of the test.
    name: &'s str,
    /// Names of the requirements that the test verifies.
    #[serde(default, skip_serializing_if = "<[String]>::is_empty")]
    requirement: &'s [String],
    /// True if the document states all parameters; otherwise crumple chose some.
    is_as_stated: bool,
    /// One entry per controller.
    outcomes: Vec<SuiteOutcomeJson<'s>>,
}

/// The outcome of a test for one controller.
#[derive(Debug, Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "SuiteOutcome")
)]
struct SuiteOutcomeJson<'s> {
    /// True if the test passed; absent if it could not be run.
    passed: Option<bool>,
    /// Worst point of the grid, in words.
    verdict: String,
    /// Number of points of the grid.
    points: u64,
    /// Number of points that passed.
    points_passed: u64,
    /// Number of points that failed; the rest cannot be run.
    points_failed: u64,
    /// Failed points at which the controller gave no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    unanswered: Option<FailedControllerRuns>,
    /// Number of simulated points, of the grid and of the search within ranges and tolerances.
    runs: u64,
    /// Number of simulated points that failed.
    failures: u64,
    /// Failed points of the search at which the controller gave no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    unanswered_in_tolerance: Option<FailedControllerRuns>,
    /// Warning after which the driver brakes, in words; absent in tests without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    warning: Option<&'static str>,
    /// Margins to failure, in words.
    margins: Vec<String>,
    /// Worst point found within the ranges and tolerances of the clause, in words; absent if the clause has none.
    worst_in_tolerance: Option<String>,
    /// Failure with the highest impact speed.
    worst: Option<SuiteFailureJson<'s>>,
}

/// A point that failed.
#[derive(Debug, Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "SuiteFailure")
)]
struct SuiteFailureJson<'s> {
    /// Path of the scenario file, relative to the report folder.
    file: &'s str,
    /// SHA-256 of that file.
    sha256: &'s str,
    /// Command that simulates the failure; absent for an external controller and for one that failed.
    replay: Option<&'s CrumpleCommand>,
    /// Parameters of the point.
    point: &'s str,
    /// Description of the failure.
    description: String,
    /// Preventability by reference drivers.
    preventable: String,
    /// Escape, if the failure is avoidable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    escape: Option<&'s EscapeFile>,
}

impl<'s> SuiteJson<'s> {
    pub(super) fn new(suite: &'s PlannedSuiteResult) -> Self {
        let result = &suite.result;
        Self {
            suite: &suite.content_id,
            document: format!("{}, {}", result.document, result.edition),
            parameter_source: &result.parameter_source,
            not_modelled: &result.not_modelled,
            omitted_parameters: &result.omitted_parameters,
            controllers: &suite.controllers,
            tests: result
                .tests()
                .zip(suite.tests())
                .map(|((clause, test), outcomes)| SuiteTestJson {
                    clause: &clause.clause,
                    name: &test.name,
                    requirement: &test.requirement,
                    is_as_stated: test.is_as_stated,
                    outcomes: outcomes.into_iter().map(SuiteOutcomeJson::new).collect(),
                })
                .collect(),
        }
    }
}

impl<'s> SuiteOutcomeJson<'s> {
    fn new(outcome: SuiteOutcome<'s>) -> Self {
        let tested = outcome.tested;
        let worst = tested.worst_in_tolerance.as_ref();
        Self {
            passed: tested.outcome(),
            verdict: describe_verdict(&tested.verdict),
            points: tested.points as u64,
            points_passed: tested.passed_points as u64,
            points_failed: tested.failed_points.len() as u64,
            unanswered: tested.unanswered(),
            runs: tested.points_run() as u64,
            failures: tested.points_failed() as u64,
            unanswered_in_tolerance: tested.unanswered_in_tolerance(),
            warning: tested.warning.map(describe_warning),
            margins: describe_min_margins(&tested.margins),
            worst_in_tolerance: worst.map(describe_worst_in_tolerance),
            worst: SuiteFailureJson::new(outcome),
        }
    }
}

impl<'s> SuiteFailureJson<'s> {
    fn new(outcome: SuiteOutcome<'s>) -> Option<Self> {
        let failed = outcome.tested.fastest_failure()?;
        let failure = outcome.failure?;
        Some(Self {
            file: &failure.file,
            sha256: &failure.sha256,
            replay: failure.replay.as_ref(),
            point: &failed.point,
            description: describe_verdict(&failed.verdict),
            preventable: describe_preventability(failed),
            escape: failure.escape.as_ref(),
        })
    }
}
