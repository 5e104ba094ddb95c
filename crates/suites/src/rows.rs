//! Serialised form of the result of a test with a controller, including the scenarios of failures.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::margin::Margin;
use super::prevention::ReferenceRun;
use super::result::{ControllerResult, FailedPoint, TestVerdict};
use super::worst_in_tolerance::WorstInTolerance;
use crumple_search::falsify::counterexample::Avoidability;
use crumple_world::scenario::file;
use crumple_world::sim::FailedControllerRuns;

/// Serialised [`ControllerResult`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerResultRow {
    pub(super) controller: String,
    verdict: TestVerdict,
    points: usize,
    #[serde(rename = "passed")]
    passed_points: usize,
    min_gap_m: Option<f64>,
    margins: Vec<Margin>,
    #[serde(rename = "within")]
    worst_in_tolerance: Option<WorstInToleranceRow>,
    #[serde(rename = "failed")]
    failed_points: Vec<FailedPointRow>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WorstInToleranceRow {
    point: String,
    verdict: TestVerdict,
    min_gap_m: Option<f64>,
    #[serde(rename = "tried")]
    points_run: usize,
    failures: usize,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    unanswered: Option<FailedControllerRuns>,
    #[serde(rename = "failed")]
    failed_point: Option<FailedPointRow>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FailedPointRow {
    point: String,
    verdict: TestVerdict,
    references: Vec<ReferenceRun>,
    avoidability: Avoidability,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    escape: Option<String>,
    scenario: String,
}

impl ControllerResultRow {
    pub(super) fn encode(tested: &ControllerResult) -> Result<Self, toml::ser::Error> {
        let tested = tested.clone();
        let failed_points = tested.failed_points.into_iter().map(FailedPointRow::encode);
        Ok(Self {
            controller: tested.controller,
            verdict: tested.verdict,
            points: tested.points,
            passed_points: tested.passed_points,
            min_gap_m: tested.min_gap_m,
            margins: tested.margins,
            worst_in_tolerance: tested.worst_in_tolerance.map(WorstInToleranceRow::encode).transpose()?,
            failed_points: failed_points.collect::<Result<_, _>>()?,
        })
    }

    /// Decodes the row; an error describes an impossible value.
    pub(super) fn decode(self) -> Result<ControllerResult, String> {
        let failed_points = self.failed_points.into_iter().map(FailedPointRow::decode);
        Ok(ControllerResult {
            controller: self.controller,
            verdict: self.verdict,
            points: self.points,
            passed_points: self.passed_points,
            min_gap_m: self.min_gap_m,
            margins: self.margins,
            worst_in_tolerance: self.worst_in_tolerance.map(WorstInToleranceRow::decode).transpose()?,
            failed_points: failed_points.collect::<Result<_, _>>()?,
        })
    }
}

impl WorstInToleranceRow {
    fn encode(within: WorstInTolerance) -> Result<Self, toml::ser::Error> {
        let WorstInTolerance { point, verdict, min_gap_m, points_run, failures, unanswered, failed_point } = within;
        let failed_point = failed_point.map(FailedPointRow::encode).transpose()?;
        Ok(Self { point, verdict, min_gap_m, points_run, failures, unanswered, failed_point })
    }

    fn decode(self) -> Result<WorstInTolerance, String> {
        let Self { point, verdict, min_gap_m, points_run, failures, unanswered, failed_point } = self;
        let failed_point = failed_point.map(FailedPointRow::decode).transpose()?;
        Ok(WorstInTolerance { point, verdict, min_gap_m, points_run, failures, unanswered, failed_point })
    }
}

impl FailedPointRow {
    fn encode(failed: FailedPoint) -> Result<Self, toml::ser::Error> {
        let scenario = file::to_toml(&failed.scenario)?;
        let escape = failed.escape.as_ref().map(file::to_toml).transpose()?;
        let FailedPoint { point, verdict, references, avoidability, .. } = failed;
        Ok(Self { point, verdict, references, avoidability, escape, scenario })
    }

    fn decode(self) -> Result<FailedPoint, String> {
        let Self { point, verdict, references, avoidability, escape, scenario } = self;
        let read = |text: &str| file::from_toml(text, Path::new("scenario")).map_err(|error| error.to_string());
        let (scenario, escape) = (read(&scenario)?, escape.as_deref().map(read).transpose()?);
        let scenario_name = scenario.spec().name.clone();
        Ok(FailedPoint { point, verdict, references, avoidability, escape, scenario_name, scenario })
    }
}
