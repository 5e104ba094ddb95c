//! The paper's three scenarios.

use maud::html;
use rayon::prelude::*;
use serde::Serialize;

use super::scenario_cases::FURTHER_MEASURES_NOTE;
use super::{ScenarioCases, scenario_cases};
use crate::assessment::avoidance::{CertifiedAvoidance, REGRET_EXPLANATION};
use crate::assessment::case::{CaseResult, MotionRetention, run_cases};
use crate::assessment::claims::{Domain, Evidence};
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::{AssessError, AssessmentPlan, CrumpleCommand, ReportPart};
use crate::draw::Svg;
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

pub(super) const ANCHOR: &str = "paper";

impl PaperScenarios {
    /// Returns the paper's scenarios with the seed of the plan; none if the plan leaves the paper out.
    pub(in crate::assessment) fn scenarios(
        plan: &AssessmentPlan,
    ) -> Result<Vec<Scenario>, AssessError> {
        let seeded = |scenario: Scenario| scenario.edited(|spec| spec.seed = plan.config.seed);
        let names = built_in_scenario_names()
            .into_iter()
            .filter(|_| plan.config.paper);
        let known = names.filter_map(|(name, _)| built_in_scenario(name));
        Ok(known.map(seeded).collect::<Result<Vec<_>, _>>()?)
    }

    pub(in crate::assessment) fn gather(
        work: &GatherContext<'_>,
    ) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        if !plan.config.paper {
            return Ok(None);
        }
        let scenarios = Self::scenarios(plan)?;
        let all: Vec<&Scenario> = scenarios.iter().collect();
        let cases = run_cases(
            &all,
            &plan.controllers,
            plan.config.estimator,
            MotionRetention::Keep,
        )?;
        work.add_runs((all.len() * plan.controllers.len()) as u64)?;
        let best = |scenario: &Scenario| CertifiedAvoidance::load_or_compute(scenario, work);
        let bests = scenarios
            .par_iter()
            .map(best)
            .collect::<Result<Vec<_>, _>>()?;
        let with_avoidance = |((scenario, cases), best): ((&Scenario, _), _)| {
            let mut replay = CrumpleCommand::new(["simulate", scenario.spec().name.as_str()])
                .with_args(plan.estimator_args().iter().copied());
            if plan.config.seed != 0 {
                replay = replay.with_args(["--seed".to_owned(), plan.config.seed.to_string()]);
            }
            ScenarioCases::new(scenario, replay, cases).with_avoidance(best)
        };
        let scenarios = scenarios
            .iter()
            .zip(cases)
            .zip(bests)
            .map(with_avoidance)
            .collect();
        // The first controller, and the subject or else the second.
        let beside = [0, plan.subject_index.max(1)]
            .into_iter()
            .filter(|&index| index < plan.controllers.len());
        Ok(Some(Self {
            scenarios,
            side_by_side: beside.collect(),
        }))
    }

    pub(in crate::assessment) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        scenario_cases::evidence(plan, &self.scenarios, ANCHOR)
    }

    pub(in crate::assessment) fn domain(&self) -> Domain {
        scenario_cases::domain(&self.scenarios, ANCHOR)
    }

    pub(in crate::assessment) fn figure_files(&self) -> impl Iterator<Item = (String, Svg)> {
        self.scenarios.iter().map(|scenario| {
            let (beside, _) = self.split_cases(scenario);
            (
                format!("figures/{}.svg", scenario.scenario),
                scenario.combined_figure(&beside),
            )
        })
    }

    /// Returns the cases of the combined figure, and the others.
    fn split_cases<'a>(
        &self,
        scenario: &'a ScenarioCases,
    ) -> (Vec<&'a CaseResult>, Vec<&'a CaseResult>) {
        let numbered = scenario.cases.iter().enumerate();
        let (beside, others): (Vec<_>, Vec<_>) =
            numbered.partition(|(index, _)| self.side_by_side.contains(index));
        let cases = |numbered: Vec<(usize, &'a CaseResult)>| {
            numbered.into_iter().map(|(_, case)| case).collect()
        };
        (cases(beside), cases(others))
    }
}

const INTRODUCTION: &str = "A leader at 90 km/h brakes at 3 m/s². The vehicles under test follow at 16 m; behind them, \
    a vehicle brakes fully at TTC < 1.4 s, like the baseline. Measures are the worst among the vehicles under test, \
    until the first collision; the pile-up is simulated further. The glossary explains the measures.";

impl ReportPart for PaperScenarios {
    fn write(&self, out: &mut ReportDocument) {
        [INTRODUCTION, REGRET_EXPLANATION, FURTHER_MEASURES_NOTE]
            .iter()
            .for_each(|words| out.paragraph(words));
        for scenario in &self.scenarios {
            let (beside, others) = self.split_cases(scenario);
            out.heading(&scenario.scenario);
            out.paragraph(&scenario.about);
            out.figure(scenario.figures_side_by_side(&beside));
            out.push_html(
                html! { p.replay { @for case in &beside { (scenario.replay_html(case)) } } },
            );
            out.paragraph(&scenario.describe_avoidance());
            scenario.write_tables(out);
            others
                .iter()
                .for_each(|case| out.push_html(scenario.collapsible_figure(case)));
        }
    }
}
