//! Results of suites as text, as a page and as JUnit.

mod description;
mod junit;
mod table;

use std::fmt::Write;

use crumple_core::quoting::TerminalText;
use crumple_suites::{ControllerResult, FailedPoint, SuiteResult, TestResult};

pub use description::{
    MinMargin, describe_ghost, describe_impact_limit, describe_outcome, describe_parameters,
    describe_verdict, describe_warning, describe_worst_in_tolerance, format_points, min_margins,
};
pub(crate) use description::{describe_min_margins, describe_preventability};
pub use junit::render_junit;
pub use table::render_markdown_table;

/// Renders the matrix of clause, test, controller, verdict and margin, the failures, and the limits. `replay` returns
/// the command that simulates a failure, or `None` if its scenario was not written.
#[must_use]
pub fn render_text(
    result: &SuiteResult,
    replay: impl Fn(&FailedPoint, &ControllerResult) -> Option<String>,
) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(
        out,
        "{}: {}, {}",
        result.suite, result.document, result.edition
    );
    let _ = writeln!(out, "  {}", result.statement);
    let _ = writeln!(
        out,
        "  source of the parameters: {}",
        result.parameter_source
    );
    for clause in &result.clauses {
        let _ = writeln!(out, "\n{}  {}", clause.clause, clause.summary);
        for test in &clause.tests {
            write_test(&mut out, test, &replay);
        }
    }
    for (title, list) in [
        (
            "requirements that the model cannot represent",
            &result.not_modelled,
        ),
        ("values that the suite omits", &result.omitted_parameters),
    ] {
        if !list.is_empty() {
            let _ = writeln!(out, "\n{title}");
        }
        for entry in list {
            let _ = writeln!(out, "  {entry}");
        }
    }
    out
}

fn write_test(
    out: &mut String,
    test: &TestResult,
    replay: &impl Fn(&FailedPoint, &ControllerResult) -> Option<String>,
) {
    let chosen = if test.is_as_stated {
        ""
    } else {
        " (crumple chose the values marked `chosen`)"
    };
    let _ = writeln!(out, "  {}{chosen}", test.name);
    let parameters = describe_parameters(&test.parameters, &test.ranges);
    if !parameters.is_empty() {
        let _ = writeln!(out, "    {parameters}");
    }
    if let Some(ghost) = describe_ghost(&test.parameters) {
        let _ = writeln!(out, "    {ghost}");
    }
    if let Some(limit) = &test.impact_at_most {
        let _ = writeln!(out, "    {}", describe_impact_limit(limit));
    }
    for tested in &test.controllers {
        write_controller_result(out, tested);
        for failed in &tested.failed_points {
            write_failed_point(out, "fails at", failed, replay(failed, tested));
        }
        let within = tested.worst_in_tolerance.as_ref();
        if let Some(failed) = within.and_then(|within| within.failed_point.as_ref()) {
            let label = "worst point within the tolerances:";
            write_failed_point(out, label, failed, replay(failed, tested));
        }
    }
}

fn write_controller_result(out: &mut String, tested: &ControllerResult) {
    let _ = writeln!(
        out,
        "    {}: {}{}",
        TerminalText(&tested.controller),
        TerminalText(&describe_outcome(tested)),
        format_points(tested)
    );
    if let Some(warning) = tested.warning {
        let _ = writeln!(out, "      {}", describe_warning(warning));
    }
    for line in describe_min_margins(&tested.margins) {
        let _ = writeln!(out, "      {line}");
    }
    if let Some(within) = &tested.worst_in_tolerance {
        let worst = describe_worst_in_tolerance(within);
        let _ = writeln!(out, "      {}", TerminalText(&worst));
    }
}

fn write_failed_point(out: &mut String, label: &str, failed: &FailedPoint, replay: Option<String>) {
    let verdict = describe_verdict(&failed.verdict);
    let seeds = failed.failed_seeds.map_or_else(String::new, |failed| {
        format!(" (fails with {failed} seeds)")
    });
    let _ = writeln!(
        out,
        "      {label} {}: {}{seeds}",
        failed.point,
        TerminalText(&verdict)
    );
    let preventable = Some(describe_preventability(failed)).filter(|text| !text.is_empty());
    for line in preventable.into_iter().chain(replay) {
        let _ = writeln!(out, "        {}", TerminalText(&line));
    }
}
