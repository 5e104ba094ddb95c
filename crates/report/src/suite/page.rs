//! The result of a suite as one self-contained page: the matrix, then each test with its failures and figures.

use maud::{DOCTYPE, Markup, html};

use super::description::{
    describe_impact_limit, describe_min_margins, describe_outcome, describe_prevention, describe_verdict,
    describe_worst_in_tolerance, format_points,
};
use crate::draw::{MotionFigure, draw_motion_responsive, vehicle_names};
use crate::html_head;
use crate::units::insert_nbsp_before_units;
use crumple_core::quoting::TerminalLines;
use crumple_suites::{ClauseResult, ControllerResult, FailedPoint, SuiteResult, TestResult};
use crumple_world::observation::EstimatorKind;
use crumple_world::sim::{NamedController, RecordingLevel, Run, RunOptions, simulate};

pub(super) const SUITE_STYLE: &str = include_str!("page.css");

/// Maximum number of failures drawn per test and controller, those with the highest impact speeds.
const MAX_FIGURES: usize = 2;

/// Renders the result of a suite as a page. `controllers` simulate the drawn failures again. `replay` returns the
/// command that simulates a failure, or `None` if its scenario was not written.
#[must_use]
pub fn render_html(
    result: &SuiteResult,
    controllers: &[NamedController],
    replay: impl Fn(&FailedPoint, &ControllerResult) -> Option<String>,
) -> String {
    let page = Page { result, controllers, replay: &replay };
    insert_nbsp_before_units(&TerminalLines(&page.to_markup().into_string()).to_string())
}

struct Page<'a> {
    result: &'a SuiteResult,
    controllers: &'a [NamedController],
    replay: &'a dyn Fn(&FailedPoint, &ControllerResult) -> Option<String>,
}

impl Page<'_> {
    fn to_markup(&self) -> Markup {
        let SuiteResult { statement, suite, document, edition, parameter_source: figures_from, clauses, .. } =
            self.result;
        let title = format!("{suite}: {document}");
        html! {
            (DOCTYPE)
            html lang="en" {
                (html_head(&title, SUITE_STYLE))
                body {
                    header {
                        p.kicker { "crumple " (env!("CARGO_PKG_VERSION")) }
                        h1 { (title) }
                        p.answer { (statement) }
                        p { (edition) ". Source of the parameters: " (figures_from) " Sensors of the controllers: "
                            (describe_estimator(self.result.estimator)) "." }
                        nav {
                            a href="#matrix" { "Matrix" }
                            @for (index, clause) in clauses.iter().enumerate() {
                                " " a href={ "#clause-" (index) } { (clause.clause) }
                            }
                            " " a href="#outside" { "Limits" }
                        }
                    }
                    main {
                        section id="matrix" { h2 { "Matrix" } (self.matrix()) }
                        @for (index, clause) in clauses.iter().enumerate() { (self.clause(index, clause)) }
                        section id="outside" { h2 { "Limits" } (self.limitations()) }
                    }
                    footer.statement { (statement) }
                }
            }
        }
    }

    /// Renders tests as rows, controllers as columns.
    fn matrix(&self) -> Markup {
        let names = self.result.tests().next().map(|(_, test)| &test.controllers);
        html! {
            div.scroll tabindex="0" { table {
                thead { tr {
                    th scope="col" { "test" }
                    th scope="col" { "clause" }
                    @for tested in names.into_iter().flatten() { th scope="col" { (tested.controller) } }
                } }
                tbody { @for (clause, test) in self.result.tests() { tr {
                    th scope="row" { a href={ "#test-" (test.name) } { (test.name) } }
                    td { (clause.clause) }
                    @for tested in &test.controllers { td.judged.(class_and_sign(tested).0) { (matrix_cell(tested)) } }
                } } }
            } }
            p.kicker { "✓ every point of the grid passes, and no failure was found within the tolerances; ✗ some \
                point fails; – cannot be run." }
        }
    }

    fn clause(&self, index: usize, clause: &ClauseResult) -> Markup {
        html! {
            section id={ "clause-" (index) } {
                h2 { (clause.clause) }
                p { (clause.summary) }
                @for test in &clause.tests { (self.test(test)) }
            }
        }
    }

    fn test(&self, test: &TestResult) -> Markup {
        html! {
            h3 id={ "test-" (test.name) } { (test.name) }
            @if test.parameters.iter().next().is_some() { (parameter_list(test)) }
            div.scroll tabindex="0" { table {
                thead { tr { @for name in ["controller", "verdict", "margins", "worst within tolerances"] {
                    th scope="col" { (name) }
                } } }
                tbody { @for tested in &test.controllers { tr {
                    th scope="row" { (tested.controller) }
                    @let (class, sign) = class_and_sign(tested);
                    td.judged.(class) { (sign) (describe_outcome(tested)) (format_points(tested)) }
                    td.wide { @for line in describe_min_margins(&tested.margins) { p { (line) } } }
                    td.wide { @if let Some(within) = &tested.worst_in_tolerance {
                        (describe_worst_in_tolerance(within))
                    } @else { "–" } }
                } } }
            } }
            @for tested in &test.controllers {
                @if tested.failures().next().is_some() { (self.failures(test, tested)) }
            }
        }
    }

    /// Renders the failures: a table of all points, and figures of the highest impact speeds.
    fn failures(&self, test: &TestResult, tested: &ControllerResult) -> Markup {
        let mut worst: Vec<&FailedPoint> = tested.failures().collect();
        let all = worst.len();
        worst.sort_by(|a, b| b.verdict.impact_speed_mps().total_cmp(&a.verdict.impact_speed_mps()));
        worst.truncate(MAX_FIGURES);
        // A point without an answer has no references: there may have been nothing to prevent.
        let drivers = tested.failures().map(|failed| &failed.references).find(|references| !references.is_empty());
        let asked = drivers.map_or(0, Vec::len);
        html! {
            details {
                summary { (test.name) ", " (tested.controller) ": " (all) " point" @if all != 1 { "s" } " failed" }
                div.scroll tabindex="0" { table {
                    thead { tr {
                        th scope="col" { "point" }
                        th scope="col" { "outcome" }
                        @for run in drivers.into_iter().flatten() { th scope="col" { (run.driver) } }
                        th scope="col" { "avoidable" }
                    } }
                    tbody { @for failed in tested.failures() { tr {
                        th scope="row" { (failed.point) }
                        td { (describe_verdict(&failed.verdict)) }
                        @for run in &failed.references { td { (describe_prevention(run.prevention)) } }
                        @for _ in failed.references.len()..asked { td { "–" } }
                        td { (failed.avoidability.describe().unwrap_or_else(|| "not examined".to_owned())) }
                    } } }
                } }
                @for failed in tested.failures() {
                    @if let Some(command) = (self.replay)(failed, tested) { p.replay { code { (command) } } }
                }
                @for failed in &worst { (self.figure(failed, tested)) }
                @if all > worst.len() { p.kicker { "Figures of the fastest impacts, " (worst.len()) " of " (all) "." } }
            }
        }
    }

    fn figure(&self, failed: &FailedPoint, tested: &ControllerResult) -> Markup {
        let named = self.controllers.iter().find(|one| one.name == tested.controller);
        let options = named.map(|one| RunOptions::new(one.kind.clone()).with_estimator(self.result.estimator));
        let run = options.and_then(|options| Run::new(&failed.scenario, options).ok());
        let simulated = run.map(|run| simulate(&run, RecordingLevel::Trace));
        let place = self.controllers.iter().position(|one| one.name == tested.controller).unwrap_or_default();
        let prefix = format!("{}-{place}", failed.scenario_name);
        let title = format!("{}, {}", failed.point, tested.controller);
        let labels = vehicle_names(&failed.scenario);
        html! {
            @if let Some(simulated) = simulated { @if let Some(trace) = &simulated.trace {
                @let impacts = &simulated.impacts;
                figure {
                    @let motion = MotionFigure { prefix: &prefix, title: &title, labels: &labels, trace, impacts };
                    (draw_motion_responsive(&motion))
                    figcaption { (tested.controller) " at " (failed.point) ": " (describe_verdict(&failed.verdict)) }
                }
            } }
        }
    }

    fn limitations(&self) -> Markup {
        html! {
            @let lists = [("Not modelled", &self.result.not_modelled), ("Omitted", &self.result.omitted_parameters)];
            @for (title, list) in lists {
                @if !list.is_empty() { h3 { (title) } ul { @for entry in list { li { (entry) } } } }
            }
            p { "Reference drivers, who observe the true state, and a search for an escape with knowledge of the \
                future show if a failure is preventable, for the first three points of a test and controller. The \
                points that passed prove nothing about others." }
        }
    }
}

pub(super) fn describe_estimator(estimator: EstimatorKind) -> &'static str {
    match estimator {
        EstimatorKind::Truth => "none, they observe the true state",
        EstimatorKind::Kalman => "noisy, with a Kalman filter",
    }
}

/// Lists every figure of a test with its source.
fn parameter_list(test: &TestResult) -> Markup {
    html! {
        ul.short { @for (parameter, figure) in test.parameters.iter() {
            @let values: Vec<String> = figure.values.iter().map(f64::to_string).collect();
            li {
                (parameter.label()) ": " (values.join(", ")) " " (figure.unit) " (" (figure.origin.label()) ")"
                @if !figure.note.is_empty() { ". " (figure.note) }
            }
        }
        @if let Some(limit) = &test.impact_at_most { li {
            (describe_impact_limit(limit))
            @if !limit.note.is_empty() { ". " (limit.note) }
        } } }
    }
}

/// Returns the CSS class of a verdict, and the sign before it.
fn class_and_sign(tested: &ControllerResult) -> (&'static str, &'static str) {
    match tested.is_passed() {
        true => ("good", "✓ "),
        false if tested.verdict.is_refusal() => ("refused", "– "),
        false => ("bad", "✗ "),
    }
}

/// Renders a cell of the matrix: passed points, the worst impact, and the first margin.
fn matrix_cell(tested: &ControllerResult) -> Markup {
    let worst_mps = tested.failures().map(|failed| failed.verdict.impact_speed_mps()).fold(0.0, f64::max);
    html! {
        (class_and_sign(tested).1)
        @if tested.points == 0 { "not run" } @else { (tested.passed_points) " of " (tested.points) }
        @if worst_mps > 0.0 { br; "worst " (format!("{worst_mps:.1}")) " m/s" }
    }
}
