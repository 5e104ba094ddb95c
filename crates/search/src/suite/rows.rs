//! What was found of a test and a controller, as a shard's file holds it: the scenarios of failures too.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::margin::Margin;
use super::preventable::ReferenceRun;
use super::result::{Failed, TestVerdict, Tested};
use super::within::Within;
use crate::falsify::counterexample::Avoidability;
use crumple_world::scenario::file;

/// [`Tested`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TestedRow {
    pub(super) controller: String,
    verdict: TestVerdict,
    points: usize,
    passed: usize,
    min_gap_m: Option<f64>,
    margins: Vec<Margin>,
    within: Option<WithinRow>,
    failed: Vec<FailedRow>,
}

/// [`Within`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WithinRow {
    point: String,
    verdict: TestVerdict,
    min_gap_m: Option<f64>,
    tried: usize,
    failures: usize,
    failed: Option<FailedRow>,
}

/// [`Failed`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FailedRow {
    point: String,
    verdict: TestVerdict,
    references: Vec<ReferenceRun>,
    avoidability: Avoidability,
    scenario: String,
}

impl TestedRow {
    pub(super) fn of(tested: &Tested) -> Result<Self, toml::ser::Error> {
        let Tested { controller, verdict, points, passed, min_gap_m, margins, within, failed } = tested.clone();
        Ok(Self {
            controller,
            verdict,
            points,
            passed,
            min_gap_m,
            margins,
            within: within.map(WithinRow::of).transpose()?,
            failed: failed.into_iter().map(FailedRow::of).collect::<Result<_, _>>()?,
        })
    }

    /// What it was, unless it cannot be that.
    pub(super) fn read(self) -> Result<Tested, String> {
        let Self { controller, verdict, points, passed, min_gap_m, margins, within, failed } = self;
        let within = within.map(WithinRow::read).transpose()?;
        let failed = failed.into_iter().map(FailedRow::read).collect::<Result<_, _>>()?;
        Ok(Tested { controller, verdict, points, passed, min_gap_m, margins, within, failed })
    }
}

impl WithinRow {
    fn of(within: Within) -> Result<Self, toml::ser::Error> {
        let Within { point, verdict, min_gap_m, tried, failures, failed } = within;
        Ok(Self { point, verdict, min_gap_m, tried, failures, failed: failed.map(FailedRow::of).transpose()? })
    }

    fn read(self) -> Result<Within, String> {
        let Self { point, verdict, min_gap_m, tried, failures, failed } = self;
        Ok(Within { point, verdict, min_gap_m, tried, failures, failed: failed.map(FailedRow::read).transpose()? })
    }
}

impl FailedRow {
    fn of(failed: Failed) -> Result<Self, toml::ser::Error> {
        let scenario = file::to_toml(&failed.scenario)?;
        let Failed { point, verdict, references, avoidability, .. } = failed;
        Ok(Self { point, verdict, references, avoidability, scenario })
    }

    fn read(self) -> Result<Failed, String> {
        let Self { point, verdict, references, avoidability, scenario } = self;
        let scenario = file::from_toml(&scenario, Path::new("scenario")).map_err(|error| error.to_string())?;
        let scenario_name = scenario.spec().name.clone();
        Ok(Failed { point, verdict, references, avoidability, scenario_name, scenario })
    }
}
