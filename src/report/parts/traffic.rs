//! Scenarios from files: recorded traffic, and whatever else the configuration names.

use maud::{Markup, html};
use serde::Serialize;

use super::ScenarioCases;
use crate::report::case::{Case, run_cases};
use crate::report::table::{Cell, Table};
use crate::report::{Part, Plan};
use crate::sim::RunError;

/// Scenarios whose figures are shown: a page of hundreds is no use to anybody.
const MOST_FIGURES: usize = 12;

/// Every controller in every scenario the configuration names.
#[derive(Debug, Clone, Serialize)]
pub struct Traffic {
    /// One entry a scenario.
    pub scenarios: Vec<ScenarioCases>,
}

impl Traffic {
    pub(in crate::report) fn gather(plan: &Plan) -> Result<Option<Self>, RunError> {
        if plan.traffic.is_empty() {
            return Ok(None);
        }
        let scenarios: Vec<_> = plan.traffic.iter().map(|(_, scenario)| scenario).collect();
        let cases = run_cases(&scenarios, &plan.controllers, plan.config.estimator)?;
        let options = plan.simulate_options();
        let scenarios = plan
            .traffic
            .iter()
            .zip(cases)
            .map(|((path, scenario), cases)| {
                ScenarioCases::new(scenario, &format!("{}{options}", path.display()), cases)
            })
            .collect();
        Ok(Some(Self { scenarios }))
    }

    /// How many scenarios each controller got through, in the order of the cases.
    pub(super) fn safe_counts(&self) -> Vec<usize> {
        let controllers = self.scenarios.first().map_or(0, |scenario| scenario.cases.len());
        let safe = |index: usize| {
            self.scenarios.iter().filter(|s| s.cases.get(index).is_some_and(|case| case.verdict.is_safe())).count()
        };
        (0..controllers).map(safe).collect()
    }

    fn overview(&self) -> Table {
        let names = self.scenarios.first().map_or(&[][..], |scenario| &scenario.cases).iter().map(|c| c.controller);
        let header: Vec<&str> = std::iter::once("scenario").chain(names).collect();
        let mut table = Table::new(&header);
        for scenario in &self.scenarios {
            let cells = scenario.cases.iter().map(|case| Cell::judged(words(case), case.verdict.is_safe()));
            table.row(std::iter::once(Cell::text(&scenario.scenario)).chain(cells).collect());
        }
        table
    }

    /// Those with a collision first, then those in which somebody came closest.
    fn most_telling(&self) -> Vec<&ScenarioCases> {
        let mut scenarios: Vec<_> = self.scenarios.iter().collect();
        let closest_m = |s: &ScenarioCases| {
            let gaps = s.cases.iter().flat_map(|case| [case.ahead.min_gap_m, case.behind.min_gap_m]);
            gaps.flatten().map(|gap| gap.value()).fold(f64::INFINITY, f64::min)
        };
        scenarios.sort_by(|a, b| closest_m(a).total_cmp(&closest_m(b)));
        scenarios.truncate(MOST_FIGURES);
        scenarios
    }
}

fn words(case: &Case) -> String {
    let gaps = [case.ahead.min_gap_m, case.behind.min_gap_m].into_iter().flatten();
    match gaps.min_by(|a, b| a.value().total_cmp(&b.value())) {
        Some(gap_m) if case.verdict.is_safe() => format!("{gap_m} m"),
        _ => case.verdict.words(),
    }
}

const INTRODUCTION: &str = "Each scenario the configuration names, under every controller: the smallest gap ahead of or \
    behind a vehicle under test, or the first contact.";

impl Part for Traffic {
    fn id(&self) -> &'static str {
        "traffic"
    }

    fn title(&self) -> String {
        "Recorded traffic and other scenarios".to_owned()
    }

    fn html(&self) -> Markup {
        let telling = self.most_telling();
        html! {
            p { (INTRODUCTION) }
            (self.overview().html())
            p {
                @if telling.len() < self.scenarios.len() {
                    "Details of the " (telling.len()) " of " (self.scenarios.len()) " scenarios in which somebody came closest:"
                } @else {
                    "Details, closest first:"
                }
            }
            @for scenario in telling {
                details {
                    summary { (scenario.scenario) }
                    p { (scenario.about) }
                    (scenario.tables())
                    @for case in &scenario.cases { (scenario.folded_figure(case)) }
                }
            }
        }
    }

    fn markdown(&self) -> String {
        format!("{INTRODUCTION}\n\n{}", self.overview().markdown())
    }
}
