//! The paper's three scenarios.

use crumple_verify::Certificate;
use rayon::prelude::*;
use serde::Serialize;

use super::scenario_cases::level_note;
use super::{ScenarioCases, scenario_cases};
use crate::assessment::avoidance::{CertifiedAvoidance, REGRET_EXPLANATION};
use crate::assessment::case::{CaseResult, MotionRetention, run_cases};
use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{Evidence, Property};
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::report_block::ReportBlock;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::{AssessError, AssessmentPlan, CrumpleCommand};
use crumple_sim::scenario::{Scenario, built_in_scenario, built_in_scenario_names};

/// Every controller in the paper's three scenarios.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PaperScenarios {
    /// One entry per scenario.
    pub scenarios: Vec<ScenarioCases>,
    /// Indices of the cases whose figures are next to each other.
    #[serde(skip)]
    side_by_side: Vec<usize>,
}

pub(in crate::assessment) const ANCHOR: &str = "paper";

impl PaperScenarios {
    /// Returns the paper's scenarios with the seed of the plan; none if the plan leaves the paper out.
    pub(in crate::assessment) fn scenarios(
        plan: &AssessmentPlan,
    ) -> Result<Vec<Scenario>, AssessError> {
        let names = built_in_scenario_names()
            .into_iter()
            .filter(|_| plan.config.paper);
        let scenarios = names.filter_map(|(name, _)| built_in_scenario(name));
        Ok(scenarios
            .map(|scenario| scenario.edited(|spec| spec.seed = plan.config.seed))
            .collect::<Result<Vec<_>, _>>()?)
    }

    pub(in crate::assessment) fn gather(
        work: &GatherContext<'_>,
    ) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        if !plan.config.paper {
            return Ok(None);
        }
        let scenarios = Self::scenarios(plan)?;
        let references: Vec<&Scenario> = scenarios.iter().collect();
        let cases = run_cases(
            &references,
            &plan.controllers,
            plan.config.estimator,
            MotionRetention::Keep,
        )?;
        work.add_runs((references.len() * plan.controllers.len()) as u64)?;
        let avoidances = scenarios
            .par_iter()
            .map(|scenario| CertifiedAvoidance::load_or_compute(scenario, work))
            .collect::<Result<Vec<_>, _>>()?;
        let scenarios = scenarios
            .iter()
            .zip(cases)
            .zip(avoidances)
            .map(|((scenario, cases), avoidance)| {
                ScenarioCases::new(scenario, replay_command(plan, scenario), cases)
                    .with_avoidance(avoidance)
            })
            .collect();
        // The first controller, and the subject or else the second.
        let side_by_side = [0, plan.subject_index.max(1)]
            .into_iter()
            .filter(|&index| index < plan.controllers.len());
        Ok(Some(Self {
            scenarios,
            side_by_side: side_by_side.collect(),
        }))
    }

    /// Returns the cases of the combined figure (`true`), or the others.
    fn select_cases<'a>(
        &self,
        scenario: &'a ScenarioCases,
        is_side_by_side: bool,
    ) -> Vec<&'a CaseResult> {
        scenario
            .cases
            .iter()
            .enumerate()
            .filter(|(index, _)| self.side_by_side.contains(index) == is_side_by_side)
            .map(|(_, case)| case)
            .collect()
    }
}

/// Returns the command that simulates a scenario, without the controller.
fn replay_command(plan: &AssessmentPlan, scenario: &Scenario) -> CrumpleCommand {
    let command = CrumpleCommand::new(["simulate", scenario.spec().name.as_str()])
        .with_args(plan.estimator_args().iter().copied());
    match plan.config.seed {
        0 => command,
        seed => command.with_args(["--seed".to_owned(), seed.to_string()]),
    }
}

const INTRODUCTION: &str = "A leader at 90 km/h brakes at 3 m/s². The vehicles under test follow at 16 m; behind them, \
    a vehicle brakes fully at TTC < 1.4 s, like the baseline. Measures are the worst among the vehicles under test, \
    until the first collision; the pile-up is simulated further. The glossary explains the measures.";

impl ReportPart for PaperScenarios {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::StatedScenarios,
            anchor: ANCHOR,
            title: "The paper's scenarios",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        if !plan.config.paper {
            return 0;
        }
        plan.runs_of_all(built_in_scenario_names().len() as u64)
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(INTRODUCTION);
        out.paragraph(REGRET_EXPLANATION);
        out.paragraph(level_note());
        self.scenarios
            .iter()
            .for_each(|scenario| self.write_scenario(scenario, out));
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

    fn files(&self) -> Vec<(String, Vec<u8>)> {
        self.scenarios
            .iter()
            .map(|scenario| self.figure_file(scenario))
            .collect()
    }
}

impl PaperScenarios {
    fn write_scenario(&self, scenario: &ScenarioCases, out: &mut ReportDocument) {
        let side_by_side = self.select_cases(scenario, true);
        out.heading(&scenario.scenario);
        out.paragraph(&scenario.about);
        out.figure(scenario.figures_side_by_side(&side_by_side));
        out.push(ReportBlock::Commands(
            scenario.replay_commands(&side_by_side),
        ));
        out.paragraph(scenario.describe_avoidance());
        scenario.write_tables(out);
        for case in self.select_cases(scenario, false) {
            scenario.write_folded_figure(case, out);
        }
    }

    fn figure_file(&self, scenario: &ScenarioCases) -> (String, Vec<u8>) {
        let cases = self.select_cases(scenario, true);
        let figure = scenario.combined_figure(&cases).document();
        (
            format!("figures/{}.svg", scenario.scenario),
            figure.into_bytes(),
        )
    }
}
