//! Scenarios from files: recorded traffic, and others that the configuration names.

use crumple_verify::Certificate;
use rayon::prelude::*;
use serde::Serialize;

use super::{ScenarioCases, scenario_cases};
use crate::assessment::avoidance::{CertifiedAvoidance, REGRET_EXPLANATION, label_avoidance};
use crate::assessment::case::{CaseResult, CaseVerdict, MotionRetention, run_cases};
use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{ContentId, Evidence, Property};
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::file_stem;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CrumpleCommand};
use crumple_core::text_file::is_default;
use crumple_sim::engine::RunError;
use crumple_sim::scenario::Scenario;

const MAX_DETAILED: usize = 12;

pub(in crate::assessment) const ANCHOR: &str = "traffic";

/// Every controller in every scenario that the configuration names.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FileScenarios {
    /// One entry per scenario.
    pub scenarios: Vec<ScenarioCases>,
    /// Number of scenarios whose last vehicle is under test: no collision from behind can happen.
    #[serde(skip_serializing_if = "is_default")]
    pub without_vehicle_behind: u64,
    /// Parts of recordings that are no scenarios, with reasons.
    pub dropped: Vec<String>,
    /// Indices of the scenarios shown in detail.
    #[serde(skip)]
    closest_first: Vec<usize>,
}

impl FileScenarios {
    pub(in crate::assessment) fn gather(
        work: &GatherContext<'_>,
    ) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        if plan.file_scenarios.is_empty() {
            return Ok(None);
        }
        let indices: Vec<usize> = (0..plan.file_scenarios.len()).collect();
        let mut scenarios = run_file_scenarios(plan, &indices, MotionRetention::Drop)?;
        // Keep motion only for figures: hundreds of traces would not fit in memory.
        let closest_first = closest_scenarios(&scenarios);
        work.add_runs((indices.len() * plan.controllers.len()) as u64)?;
        let detailed = run_detailed(&closest_first, work)?;
        for (&index, detailed) in closest_first.iter().zip(detailed) {
            scenarios[index] = detailed;
        }
        let files = plan.file_scenarios.iter();
        let without_vehicle_behind = files
            .filter(|(_, scenario)| scenario.ends_under_test())
            .count() as u64;
        Ok(Some(Self {
            scenarios,
            without_vehicle_behind,
            dropped: plan.dropped.iter().map(ToString::to_string).collect(),
            closest_first,
        }))
    }

    fn describe_dropped(&self) -> String {
        format!(
            "parts of the recordings that are no scenario: {}",
            self.dropped.len()
        )
    }

    fn overview_table(&self) -> ReportTable {
        let names = self
            .scenarios
            .first()
            .map_or(&[][..], |scenario| &scenario.cases)
            .iter()
            .map(|case| case.controller.as_str());
        let header: Vec<&str> = std::iter::once("scenario")
            .chain(names)
            .chain(["best escape found"])
            .collect();
        let mut table = ReportTable::new(&header);
        for scenario in &self.scenarios {
            let cells = scenario
                .cases
                .iter()
                .map(|case| ReportCell::with_mark(format_case(case), case.verdict.mark()));
            let avoidance = scenario.avoidance.as_ref();
            let best = ReportCell::text(avoidance.map_or("–".to_owned(), label_avoidance));
            table.push_row(
                std::iter::once(ReportCell::text(&scenario.scenario))
                    .chain(cells)
                    .chain([best])
                    .collect(),
            );
        }
        table
    }
}

fn run_file_scenarios(
    plan: &AssessmentPlan,
    indices: &[usize],
    motion: MotionRetention,
) -> Result<Vec<ScenarioCases>, RunError> {
    let selected = indices
        .iter()
        .filter_map(|&index| plan.file_scenarios.get(index));
    let scenarios: Vec<&Scenario> = selected.map(|(_, scenario)| scenario).collect();
    let cases = run_cases(&scenarios, &plan.controllers, plan.config.estimator, motion)?;
    Ok(scenarios
        .iter()
        .zip(cases)
        .map(|(scenario, cases)| {
            let replay = CrumpleCommand::new(["simulate".to_owned(), scenario_path(scenario)])
                .with_args(plan.estimator_args().iter().copied());
            ScenarioCases::new(scenario, replay, cases)
        })
        .collect())
}

/// Runs scenarios again with their motion, and computes their best escapes.
fn run_detailed(
    indices: &[usize],
    work: &GatherContext<'_>,
) -> Result<Vec<ScenarioCases>, AssessError> {
    let files = &work.plan.file_scenarios;
    let avoidances = indices
        .par_iter()
        .map(|&index| CertifiedAvoidance::load_or_compute(&files[index].1, work))
        .collect::<Result<Vec<_>, _>>()?;
    let drawn = run_file_scenarios(work.plan, indices, MotionRetention::Keep)?;
    let detailed = drawn
        .into_iter()
        .zip(avoidances)
        .map(|(cases, avoidance)| cases.with_avoidance(avoidance));
    Ok(detailed.collect())
}

/// Returns the indices of the scenarios to show in detail: the smallest gaps first.
fn closest_scenarios(scenarios: &[ScenarioCases]) -> Vec<usize> {
    let gaps_m: Vec<f64> = scenarios.iter().map(closest_m).collect();
    let mut indices: Vec<usize> = (0..scenarios.len()).collect();
    indices.sort_by(|&a, &b| gaps_m[a].total_cmp(&gaps_m[b]));
    indices.truncate(MAX_DETAILED);
    indices
}

/// Returns the smallest gap to a vehicle under test in any case.
fn closest_m(scenario: &ScenarioCases) -> f64 {
    scenario
        .cases
        .iter()
        .flat_map(|case| [case.ahead.min_gap_m, case.behind.min_gap_m])
        .flatten()
        .map(|gap_m| gap_m.value())
        .fold(f64::INFINITY, f64::min)
}

pub(in crate::assessment) fn scenario_path(scenario: &Scenario) -> String {
    let stem = file_stem(&scenario.spec().name);
    format!("{SCENARIO_FOLDER}/{stem}.toml")
}

impl FileScenarios {
    /// Returns the file of the first scenario of a domain in which a controller fails.
    pub(in crate::assessment) fn failing_file(
        &self,
        controller: &str,
        domain: &[ContentId],
    ) -> Option<String> {
        let mut scenarios = self.scenarios.iter();
        let failing = scenarios.find(|scenario| {
            scenario.fails(controller) && domain.contains(&scenario.content_id())
        })?;
        Some(scenario_path(&failing.full_scenario))
    }
}

/// Folder of the report with the scenarios from files and recordings.
pub(in crate::assessment) const SCENARIO_FOLDER: &str = "scenarios";

fn format_case(case: &CaseResult) -> String {
    let gaps = [case.ahead.min_gap_m, case.behind.min_gap_m]
        .into_iter()
        .flatten();
    match (
        gaps.min_by(|a, b| a.value().total_cmp(&b.value())),
        &case.verdict,
    ) {
        (
            Some(gap_m),
            CaseVerdict::Safe {
                closing_ttc_s: None,
            },
        ) => format!("{gap_m} m"),
        (
            Some(gap_m),
            CaseVerdict::Safe {
                closing_ttc_s: Some(ttc_s),
            },
        ) => {
            format!("{gap_m} m, closing (TTC {ttc_s} s)")
        }
        _ => case.verdict.describe(),
    }
}

const INTRODUCTION: &str = "Each scenario of the configuration, and each braking episode of its recordings, under \
    every controller: the smallest gap ahead of or behind a vehicle under test, or the first collision. \"closing\" \
    marks a run that ended while two vehicles approached each other.";

const ESCAPES_NOTE: &str = "Escapes are computed for the scenarios with details.";

impl ReportPart for FileScenarios {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::StatedScenarios,
            anchor: ANCHOR,
            title: "Scenario files and recordings",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        plan.runs_of_all(plan.file_scenarios.len() as u64)
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(INTRODUCTION);
        if self.without_vehicle_behind > 0 {
            out.paragraph(format!(
                "In {} of {} scenarios no vehicle is behind the last one under test: collisions from behind cannot \
                 happen.",
                self.without_vehicle_behind,
                self.scenarios.len()
            ));
        }
        out.paragraph(format!("{REGRET_EXPLANATION} {ESCAPES_NOTE}"));
        out.table(self.overview_table());
        self.write_dropped(out);
        self.write_details(out);
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        scenario_cases::evidence(plan, &self.scenarios, ANCHOR)
    }

    fn claims(&self, plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        let domain = scenario_cases::domain(&self.scenarios, ANCHOR);
        vec![ClaimDraft::about_all(
            plan,
            ANCHOR,
            Property::NoCollision,
            domain,
        )]
    }

    fn certificates(&self) -> Vec<(&str, &Certificate)> {
        self.scenarios
            .iter()
            .filter_map(ScenarioCases::named_certificate)
            .collect()
    }
}

impl FileScenarios {
    fn write_dropped(&self, out: &mut ReportDocument) {
        if self.dropped.is_empty() {
            return;
        }
        let mut parts = ReportDocument::new();
        parts.list(&self.dropped);
        out.collapsible(self.describe_dropped(), parts);
    }

    /// Writes the scenarios with the smallest gaps, each with its tables and figures.
    fn write_details(&self, out: &mut ReportDocument) {
        let shown = self
            .closest_first
            .iter()
            .filter_map(|&index| self.scenarios.get(index));
        let shown: Vec<&ScenarioCases> = shown.collect();
        out.paragraph(match shown.len() < self.scenarios.len() {
            true => format!(
                "Details of the {} of {} scenarios with the smallest gaps:",
                shown.len(),
                self.scenarios.len()
            ),
            false => "Details, smallest gap first:".to_owned(),
        });
        for scenario in shown {
            out.collapsible(&scenario.scenario, scenario_details(scenario));
        }
    }
}

fn scenario_details(scenario: &ScenarioCases) -> ReportDocument {
    let mut details = ReportDocument::new();
    details.paragraph(&scenario.about);
    details.paragraph(scenario.describe_avoidance());
    scenario.write_tables(&mut details);
    for case in &scenario.cases {
        scenario.write_folded_figure(case, &mut details);
    }
    details
}
