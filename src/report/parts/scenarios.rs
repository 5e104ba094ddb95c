//! All controllers in one scenario: a table, and a figure for each.

use maud::{Markup, html};
use serde::Serialize;

use crate::draw::{MotionFigure, motion_responsive};
use crate::report::case::Case;
use crate::report::rounded::or_dash;
use crate::report::table::{Cell, Table};
use crate::scenario::{Driver, Scenario};

/// What came of every controller in one scenario.
#[derive(Debug, Clone, Serialize)]
pub struct ScenarioCases {
    /// Name of the scenario.
    pub scenario: String,
    /// Why it exists.
    pub about: String,
    /// How to run it again.
    pub replay: String,
    /// One case a controller.
    pub cases: Vec<Case>,
    /// Names of the vehicles, for figures.
    #[serde(skip)]
    labels: Vec<String>,
}

impl ScenarioCases {
    /// The cases of a scenario that `crumple simulate` finds under `reach`.
    pub(in crate::report) fn new(scenario: &Scenario, reach: &str, cases: Vec<Case>) -> Self {
        Self {
            scenario: scenario.spec().name.clone(),
            about: scenario.spec().about.clone(),
            replay: format!("crumple simulate {reach}"),
            cases,
            labels: labels(scenario),
        }
    }

    /// Outcomes and measures, one row a controller.
    pub(in crate::report) fn table(&self) -> Table {
        let mut table = Table::new(&[
            "controller",
            "outcome",
            "pile-up",
            "min gap ahead m",
            "min gap behind m",
            "min TTC s",
            "min time gap s",
            "max DRAC m/s²",
            "TET s",
            "TIT s²",
            "peak brake m/s²",
            "peak jerk m/s³",
            "brake imposed behind m/s²",
            "max delta-v m/s",
        ]);
        for case in &self.cases {
            let pile_up = case.pile_up.map_or("–".to_owned(), |p| format!("{} vehicles", p.vehicles));
            table.row(vec![
                Cell::text(case.controller),
                Cell::judged(case.verdict.words(), case.verdict.is_safe()),
                Cell::text(pile_up),
                Cell::number(or_dash(case.ahead.min_gap_m)),
                Cell::number(or_dash(case.behind.min_gap_m)),
                Cell::number(or_dash(case.ahead.min_ttc_s)),
                Cell::number(or_dash(case.ahead.min_time_gap_s)),
                Cell::number(or_dash(case.ahead.max_drac_mps2)),
                Cell::number(case.ahead.tet_s),
                Cell::number(case.ahead.tit_s2),
                Cell::number(or_dash(case.peak_brake_mps2)),
                Cell::number(or_dash(case.peak_jerk_mps3)),
                Cell::number(or_dash(case.imposed_brake_mps2)),
                Cell::number(or_dash(case.pile_up.and_then(|pile_up| pile_up.max_delta_v_mps))),
            ]);
        }
        table
    }

    /// The paper's three diagrams of one case.
    pub(in crate::report) fn figure(&self, case: &Case) -> Markup {
        let Some((trace, impacts)) = &case.motion else { return html! {} };
        let title = format!("{}, {}", self.scenario, case.controller);
        let prefix = format!("{}-{}", self.scenario, case.controller);
        motion_responsive(&MotionFigure { prefix: &prefix, title: &title, labels: &self.labels, trace, impacts })
    }

    /// The figure of one case, folded away behind its outcome.
    pub(in crate::report) fn folded_figure(&self, case: &Case) -> Markup {
        html! {
            details {
                summary { (case.controller) ": " (case.verdict.words()) }
                (self.figure(case))
                p.replay { code { (self.replay) " --controller " (case.controller) } }
            }
        }
    }
}

fn labels(scenario: &Scenario) -> Vec<String> {
    let under_test = scenario.vehicles().iter().filter(|vehicle| vehicle.driver == Driver::UnderTest).count();
    let mut tested = 0;
    let label = |(index, vehicle): (usize, &crate::scenario::VehicleSpec)| {
        let class = vehicle.class.name();
        match vehicle.driver {
            Driver::UnderTest => {
                tested += 1;
                if under_test == 1 { format!("ego ({class})") } else { format!("ego {tested} ({class})") }
            }
            _ if index == 0 => format!("leader ({class})"),
            _ => format!("follower ({class})"),
        }
    };
    scenario.vehicles().iter().enumerate().map(label).collect()
}
