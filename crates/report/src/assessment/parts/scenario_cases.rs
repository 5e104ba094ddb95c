//! All controllers in one scenario: a table, and a figure for each.

use crumple_verify::Certificate;
use maud::{Markup, html};
use serde::Serialize;

#[cfg(feature = "schema")]
use crate::assessment::avoidance::AvoidanceJson;
use crate::assessment::avoidance::{CertifiedAvoidance, regret_m, serialize_rounded};
use crate::assessment::case::CaseResult;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, Subject, UncomparedText,
};
use crate::assessment::document::ReportDocument;
use crate::assessment::report_block::{CaptionedDrawing, ReportBlock};
use crate::assessment::run_ends::RunEnds;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessmentPlan, CrumpleCommand};
use crate::draw::{
    MotionFigure, Svg, draw_motion_columns, draw_motion_responsive, draw_motions_side_by_side,
    vehicle_names,
};
use crumple_core::markdown::prose_name;
use crumple_measure::DEFAULT_CLASS_WORDS;
use crumple_search::worst_case::AvoidReport;
use crumple_sim::scenario::Scenario;

/// The results of every controller in one scenario.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ScenarioCases {
    /// Name of the scenario.
    pub scenario: String,
    /// Purpose of the scenario.
    pub about: String,
    /// Command that repeats the run, without the controller.
    pub replay: CrumpleCommand,
    /// Avoidability and best escape; absent if not computed.
    #[serde(serialize_with = "serialize_rounded")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<AvoidanceJson>"))]
    pub avoidance: Option<AvoidReport>,
    /// One case per controller.
    pub cases: Vec<CaseResult>,
    /// Scenario with the names of its vehicles, for figures.
    #[serde(skip)]
    pub(super) full_scenario: Scenario,
    #[serde(skip)]
    labels: Vec<String>,
    /// Certificate of the claims of `avoidance` about every driver.
    #[serde(skip)]
    certificate: Option<Certificate>,
}

/// Returns the evidence of `NoCollision` per controller, without runs in which other vehicles collide first.
pub(super) fn evidence(
    plan: &AssessmentPlan,
    scenarios: &[ScenarioCases],
    part: &str,
) -> Vec<Evidence> {
    plan.claim_subjects()
        .into_iter()
        .enumerate()
        .map(|(index, subject)| evidence_about(index, subject, scenarios, part))
        .collect()
}

fn evidence_about(
    index: usize,
    subject: Subject,
    scenarios: &[ScenarioCases],
    part: &str,
) -> Evidence {
    let verdicts = scenarios
        .iter()
        .filter_map(|scenario| scenario.cases.get(index))
        .map(|case| &case.verdict);
    let runs = verdicts.clone().count() as u64;
    let ends = RunEnds::from_verdicts(verdicts);
    let description = format!("{} runs", runs - ends.ended_by_others);
    Evidence {
        claim: AssuranceClaim {
            subject,
            property: Property::NoCollision,
            domain: domain(scenarios, part),
        },
        strength: ends.strength(runs),
        first_violation: None,
        source: EvidenceSource::from_part(part, description),
    }
}

pub(super) fn domain(scenarios: &[ScenarioCases], part: &str) -> Domain {
    let about = match part {
        super::paper::ANCHOR => "the paper's scenarios",
        _ => "scenario files and recordings",
    };
    let content_ids = scenarios.iter().map(ScenarioCases::content_id).collect();
    Domain::Scenarios {
        about: UncomparedText(about.to_owned()),
        all: content_ids,
    }
}

/// Explains the column of the level.
pub(super) fn level_note() -> String {
    format!(
        "Level: only for {DEFAULT_CLASS_WORDS}. As long as the leader brakes at most at the level, a plan avoids a \
         collision on both sides."
    )
}

impl ScenarioCases {
    pub(in crate::assessment) fn new(
        scenario: &Scenario,
        replay: CrumpleCommand,
        cases: Vec<CaseResult>,
    ) -> Self {
        Self {
            scenario: prose_name(&scenario.spec().name),
            about: scenario.spec().about.clone(),
            replay,
            avoidance: None,
            cases,
            full_scenario: scenario.clone(),
            labels: vehicle_names(scenario),
            certificate: None,
        }
    }

    /// Returns the identifier of the scenario, as domains of claims list it.
    pub(super) fn content_id(&self) -> ContentId {
        ContentId::from_scenario(self.scenario.as_str(), &self.full_scenario)
    }

    /// True if a controller fails in the scenario.
    pub(super) fn fails(&self, controller: &str) -> bool {
        let mut cases = self.cases.iter();
        cases.any(|case| case.controller == controller && case.verdict.is_failure())
    }

    /// Adds the avoidance of the scenario, and each controller's regret.
    pub(in crate::assessment) fn with_avoidance(mut self, avoidance: CertifiedAvoidance) -> Self {
        for case in &mut self.cases {
            case.regret_m = regret_m(&avoidance.report, case);
        }
        self.avoidance = Some(avoidance.report);
        self.certificate = avoidance.certificate;
        self
    }

    pub(in crate::assessment) fn named_certificate(&self) -> Option<(&str, &Certificate)> {
        Some((&self.scenario, self.certificate.as_ref()?))
    }

    /// States what `crumple avoid` prints, in a sentence.
    pub(super) fn describe_avoidance(&self) -> String {
        let Some(report) = &self.avoidance else {
            return String::new();
        };
        format!("Avoidability: {}.", report.main_statements().join("; "))
    }

    pub(super) fn table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.cases,
            &[
                ("controller", &|case| ReportCell::text(&case.controller)),
                ("outcome", &|case| {
                    ReportCell::with_mark(case.verdict.describe(), case.verdict.mark())
                }),
                ("min gap ahead (m)", &|case| {
                    ReportCell::optional(case.ahead.min_gap_m)
                }),
                ("min gap behind (m)", &|case| {
                    ReportCell::optional(case.behind.min_gap_m)
                }),
                ("regret (m)", &|case| ReportCell::optional(case.regret_m)),
                ("min TTC (s)", &|case| {
                    ReportCell::optional(case.ahead.min_ttc_s)
                }),
                ("peak brake (m/s²)", &|case| {
                    ReportCell::optional(case.peak_brake_mps2)
                }),
                ("induced braking (m/s²)", &|case| {
                    ReportCell::optional(case.induced_brake_mps2)
                }),
                ("min level (m/s²)", &|case| {
                    ReportCell::optional(case.min_level_mps2)
                }),
                ("pile-up (vehicles)", &|case| {
                    ReportCell::optional(case.pile_up.map(|pile_up| pile_up.vehicles))
                }),
                ("max delta-v (m/s)", &|case| {
                    ReportCell::optional(case.pile_up.and_then(|pile_up| pile_up.max_delta_v_mps))
                }),
            ],
        )
    }

    /// Returns the other measures, one row per controller.
    pub(super) fn further_measures(&self) -> ReportTable {
        ReportTable::from_items(
            &self.cases,
            &[
                ("controller", &|case| ReportCell::text(&case.controller)),
                ("min time headway (s)", &|case| {
                    ReportCell::optional(case.ahead.min_time_headway_s)
                }),
                ("min time gap (s)", &|case| {
                    ReportCell::optional(case.ahead.min_time_gap_s)
                }),
                ("max DRAC (m/s²)", &|case| {
                    ReportCell::optional(case.ahead.max_drac_mps2)
                }),
                ("required brake (m/s²)", &|case| {
                    ReportCell::optional(case.ahead.max_required_brake_mps2)
                }),
                ("TET (s)", &|case| ReportCell::number(case.ahead.tet_s)),
                ("TIT (s²)", &|case| ReportCell::number(case.ahead.tit_s2)),
                ("peak jerk (m/s³)", &|case| {
                    ReportCell::optional(case.peak_jerk_mps3)
                }),
                ("standstill gap ahead (m)", &|case| {
                    ReportCell::optional(case.ahead.standstill_gap_m)
                }),
                ("standstill gap behind (m)", &|case| {
                    ReportCell::optional(case.behind.standstill_gap_m)
                }),
                ("max DRAC behind (m/s²)", &|case| {
                    ReportCell::optional(case.behind.max_drac_mps2)
                }),
                ("TET behind (s)", &|case| {
                    ReportCell::number(case.behind.tet_s)
                }),
            ],
        )
    }

    /// Writes both tables.
    pub(in crate::assessment) fn write_tables(&self, out: &mut ReportDocument) {
        out.table(self.table());
        out.collapsible("further measures", self.further_measures());
    }

    pub(in crate::assessment) fn replay_command(
        &self,
        case: &CaseResult,
    ) -> Option<CrumpleCommand> {
        Some(
            self.replay
                .clone()
                .with_args(["--controller", case.controller_arg.as_deref()?]),
        )
    }

    /// Returns the commands that repeat these cases, as far as their controllers have command-line arguments.
    pub(in crate::assessment) fn replay_commands(&self, cases: &[&CaseResult]) -> Vec<String> {
        let commands = cases.iter().filter_map(|case| self.replay_command(case));
        commands.map(|command| command.to_string()).collect()
    }

    /// Returns the drawing of each case with its outcome.
    pub(super) fn captioned_drawings(&self) -> Vec<CaptionedDrawing> {
        self.cases
            .iter()
            .map(|case| CaptionedDrawing {
                drawing: self.figure(case),
                caption: case.verdict.describe(),
                command: self.replay_command(case).map(|command| command.to_string()),
            })
            .collect()
    }

    pub(in crate::assessment) fn figure(&self, case: &CaseResult) -> Markup {
        let Some((trace, impacts)) = &case.motion else {
            return html! {};
        };
        let title = format!("{}, {}", self.scenario, case.controller);
        let prefix = format!("{}-{}", self.scenario, case.controller);
        draw_motion_responsive(&MotionFigure {
            prefix: &prefix,
            title: &title,
            labels: &self.labels,
            trace,
            impacts,
        })
    }

    /// Draws the motion of several cases next to each other, on the same axes.
    pub(in crate::assessment) fn figures_side_by_side(&self, cases: &[&CaseResult]) -> Markup {
        self.with_figures(cases, draw_motions_side_by_side)
    }

    /// Draws the motion of several cases as a separate file.
    pub(in crate::assessment) fn combined_figure(&self, cases: &[&CaseResult]) -> Svg {
        self.with_figures(cases, |figures| {
            draw_motion_columns(&self.scenario, &self.scenario, figures)
        })
    }

    fn with_figures<T>(
        &self,
        cases: &[&CaseResult],
        draw: impl FnOnce(&[MotionFigure<'_>]) -> T,
    ) -> T {
        let recorded: Vec<_> = cases
            .iter()
            .filter_map(|case| Some((*case, case.motion.as_ref()?)))
            .collect();
        let names: Vec<_> = recorded
            .iter()
            .map(|(case, _)| {
                (
                    format!("{}-{}", self.scenario, case.controller),
                    format!("{}, {}", self.scenario, case.controller),
                )
            })
            .collect();
        let figures =
            recorded
                .iter()
                .zip(&names)
                .map(|((_, (trace, impacts)), (prefix, title))| MotionFigure {
                    prefix,
                    title,
                    labels: &self.labels,
                    trace,
                    impacts,
                });
        draw(&figures.collect::<Vec<_>>())
    }

    /// Writes the figure of one case, folded behind its outcome.
    pub(in crate::assessment) fn write_folded_figure(
        &self,
        case: &CaseResult,
        out: &mut ReportDocument,
    ) {
        let mut figure = ReportDocument::new();
        figure.push(ReportBlock::Drawing(self.figure(case)));
        figure.push(ReportBlock::Commands(self.replay_commands(&[case])));
        let summary = format!("{}: {}", case.controller, case.verdict.describe());
        out.collapsible(summary, figure);
    }
}
