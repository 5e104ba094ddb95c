//! Scenarios from files: recorded traffic, and others that the configuration names.

use maud::html;
use rayon::prelude::*;
use serde::Serialize;

use super::{ScenarioCases, scenario_cases};
use crate::assessment::avoidance::{CertifiedAvoidance, REGRET_EXPLANATION, RoundedAvoidance};
use crate::assessment::case::{CaseResult, CaseVerdict, MotionRetention, run_cases};
use crate::assessment::claims::{Domain, Evidence};
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::file_stem;
use crate::assessment::prose::prose_to_html;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CrumpleCommand, ReportPart};
use crumple_sim::engine::RunError;
use crumple_sim::scenario::Scenario;

const MAX_DETAILED: usize = 12;

const ANCHOR: &str = "traffic";

/// Every controller in every scenario that the configuration names.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FileScenarios {
    /// One entry per scenario.
    pub scenarios: Vec<ScenarioCases>,
    /// Parts of recordings that are no scenarios, with reasons.
    pub left_out: Vec<String>,
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
        let run = |indices: &[usize],
                   motion: MotionRetention|
         -> Result<Vec<ScenarioCases>, RunError> {
            let chosen: Vec<_> = indices
                .iter()
                .filter_map(|&index| plan.file_scenarios.get(index))
                .collect();
            let scenarios: Vec<_> = chosen.iter().map(|(_, scenario)| scenario).collect();
            let cases = run_cases(&scenarios, &plan.controllers, plan.config.estimator, motion)?;
            let named = chosen.iter().zip(cases).map(|((_, scenario), cases)| {
                let replay = CrumpleCommand::new(["simulate".to_owned(), scenario_path(scenario)])
                    .with_args(plan.estimator_args().iter().copied());
                ScenarioCases::new(scenario, replay, cases)
            });
            Ok(named.collect())
        };
        let mut scenarios = run(
            &(0..plan.file_scenarios.len()).collect::<Vec<_>>(),
            MotionRetention::Drop,
        )?;
        // Keep motion only for figures: hundreds of traces would not fit in memory.
        let closest_first = closest_scenarios(&scenarios);
        work.add_runs((plan.file_scenarios.len() * plan.controllers.len()) as u64)?;
        let best = |&index: &usize| {
            CertifiedAvoidance::load_or_compute(&plan.file_scenarios[index].1, work)
        };
        let bests = closest_first
            .par_iter()
            .map(best)
            .collect::<Result<Vec<_>, _>>()?;
        let drawn = run(&closest_first, MotionRetention::Keep)?;
        for ((&index, drawn), best) in closest_first.iter().zip(drawn).zip(bests) {
            scenarios[index] = drawn.with_avoidance(best);
        }
        let left_out = plan.left_out.iter().map(ToString::to_string).collect();
        Ok(Some(Self {
            scenarios,
            left_out,
            closest_first,
        }))
    }

    pub(in crate::assessment) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        scenario_cases::evidence(plan, &self.scenarios, ANCHOR)
    }

    pub(in crate::assessment) fn domain(&self) -> Domain {
        scenario_cases::domain(&self.scenarios, ANCHOR)
    }

    fn describe_left_out(&self) -> String {
        format!(
            "parts of the recordings that are no scenario: {}",
            self.left_out.len()
        )
    }

    fn overview_table(&self) -> ReportTable {
        let names = self
            .scenarios
            .first()
            .map_or(&[][..], |scenario| &scenario.cases)
            .iter()
            .map(|c| c.controller.as_str());
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
            let best = ReportCell::text(
                scenario
                    .avoidance
                    .as_ref()
                    .map_or("–".to_owned(), RoundedAvoidance::label),
            );
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

/// Returns the indices of the scenarios to show in detail: the smallest gaps first.
fn closest_scenarios(scenarios: &[ScenarioCases]) -> Vec<usize> {
    let closest_m = |index: &usize| {
        let gaps = scenarios[*index]
            .cases
            .iter()
            .flat_map(|case| [case.ahead.min_gap_m, case.behind.min_gap_m]);
        gaps.flatten()
            .map(|gap| gap.value())
            .fold(f64::INFINITY, f64::min)
    };
    let mut indices: Vec<usize> = (0..scenarios.len()).collect();
    indices.sort_by(|a, b| closest_m(a).total_cmp(&closest_m(b)));
    indices.truncate(MAX_DETAILED);
    indices
}

pub(in crate::assessment) fn scenario_path(scenario: &Scenario) -> String {
    format!("scenarios/{}.toml", file_stem(&scenario.spec().name))
}

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

impl ReportPart for FileScenarios {
    fn write(&self, out: &mut ReportDocument) {
        let telling: Vec<_> = self
            .closest_first
            .iter()
            .filter_map(|&index| self.scenarios.get(index))
            .collect();
        out.paragraph(INTRODUCTION);
        out.push_html(
            html! { p { (prose_to_html(REGRET_EXPLANATION)) " Escapes are computed for the scenarios with details." } },
        );
        out.markdown_mut().paragraph(REGRET_EXPLANATION);
        out.table(&self.overview_table());
        if !self.left_out.is_empty() {
            out.markdown_mut().paragraph(self.describe_left_out() + ":");
            out.collapsible(&self.describe_left_out(), |out| out.list(&self.left_out));
        }
        let details = match telling.len() < self.scenarios.len() {
            true => format!(
                "Details of the {} of {} scenarios with the smallest gaps:",
                telling.len(),
                self.scenarios.len()
            ),
            false => "Details, smallest gap first:".to_owned(),
        };
        out.push_html(html! {
            p { (details) }
            @for scenario in telling {
                details {
                    summary { (scenario.scenario) }
                    p { (scenario.about) }
                    p { (scenario.describe_avoidance()) }
                    (scenario.table().to_html())
                    details { summary { "further measures" } (scenario.further_measures().to_html()) }
                    @for case in &scenario.cases { (scenario.collapsible_figure(case)) }
                }
            }
        });
    }
}
