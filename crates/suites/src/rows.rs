//! What was found of a test and a controller, as a shard's file holds it: the scenarios of failures too.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::margin::Margin;
use super::prevention::ReferenceRun;
use super::result::{Failed, TestVerdict, Tested};
use super::worst_in_tolerance::Within;
use crumple_search::falsify::counterexample::Avoidability;
use crumple_world::scenario::file;
use crumple_world::sim::Unanswered;

/// [`Tested`].
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

/// [`Within`].
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
    unanswered: Option<Unanswered>,
    #[serde(rename = "failed")]
    failed_point: Option<FailedPointRow>,
}

/// [`Failed`].
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
    pub(super) fn encode(tested: &Tested) -> Result<Self, toml::ser::Error> {
        let Tested { controller, verdict, points, passed, min_gap_m, margins, within, failed } = tested.clone();
        Ok(Self {
            controller,
            verdict,
            points,
            passed,
            min_gap_m,
            margins,
            within: within.map(WorstInToleranceRow::of).transpose()?,
            failed: failed.into_iter().map(FailedPointRow::of).collect::<Result<_, _>>()?,
        })
    }

    /// What it was, unless it cannot be that.
    pub(super) fn decode(self) -> Result<Tested, String> {
        let Self { controller, verdict, points, passed, min_gap_m, margins, within, failed } = self;
        let within = within.map(WorstInToleranceRow::read).transpose()?;
        let failed = failed.into_iter().map(FailedPointRow::read).collect::<Result<_, _>>()?;
        Ok(Tested { controller, verdict, points, passed, min_gap_m, margins, within, failed })
    }
}

impl WorstInToleranceRow {
    fn encode(within: Within) -> Result<Self, toml::ser::Error> {
        let Within { point, verdict, min_gap_m, tried, failures, unanswered, failed } = within;
        let failed = failed.map(FailedPointRow::of).transpose()?;
        Ok(Self { point, verdict, min_gap_m, tried, failures, unanswered, failed })
    }

    fn decode(self) -> Result<Within, String> {
        let Self { point, verdict, min_gap_m, tried, failures, unanswered, failed } = self;
        let failed = failed.map(FailedPointRow::read).transpose()?;
        Ok(Within { point, verdict, min_gap_m, tried, failures, unanswered, failed })
    }
}

impl FailedPointRow {
    fn encode(failed: Failed) -> Result<Self, toml::ser::Error> {
        let scenario = file::to_toml(&failed.scenario)?;
        let escape = failed.escape.as_ref().map(file::to_toml).transpose()?;
        let Failed { point, verdict, references, avoidability, .. } = failed;
        Ok(Self { point, verdict, references, avoidability, escape, scenario })
    }

    fn decode(self) -> Result<Failed, String> {
        let Self { point, verdict, references, avoidability, escape, scenario } = self;
        let read = |text: &str| file::from_toml(text, Path::new("scenario")).map_err(|error| error.to_string());
        let (scenario, escape) = (read(&scenario)?, escape.as_deref().map(read).transpose()?);
        let scenario_name = scenario.spec().name.clone();
        Ok(Failed { point, verdict, references, avoidability, escape, scenario_name, scenario })
    }
}
