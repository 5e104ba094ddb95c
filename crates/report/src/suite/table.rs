//! Results of several suites with the same controllers, as one Markdown table.

use super::description::{format_boundary, min_margins};
use crumple_core::markdown::Markdown;
use crumple_suites::{
    ControllerResult, DISCLAIMER, Margin, MarginEnd, SuiteResult, TestVerdict, WarningOrigin,
};

/// Renders one row per test and one column per controller: passed points of the grid, the highest impact speed, and the
/// margin in the first direction of a test that passes.
#[must_use]
pub fn render_markdown_table(results: &[SuiteResult]) -> String {
    let tests: Vec<_> = results
        .iter()
        .flat_map(|result| {
            result
                .tests()
                .map(move |(clause, test)| (result, clause, test))
        })
        .collect();
    let mut text = Markdown::default();
    text.heading(1, "Suites modelled on regulations");
    text.paragraph(DISCLAIMER);
    text.paragraph(
        "✓: every point of the grid passes, and a search within the tolerances of the document found no failure; ✗: \
         a point of the grid or of the search fails; –: refused, because the test needs more than one lane, or because \
         a shield has no guarantee in it. Then the number of passed points. If a point fails, the highest impact speed \
         follows. Otherwise, the parameter follows that makes the test harder (the first one of the test), with the \
         value up to which the controller passes.",
    );
    let Some((_, _, first)) = tests.first() else {
        return text.into_string();
    };
    let names = first
        .controllers
        .iter()
        .map(|tested| tested.controller.clone());
    let header: Vec<String> = ["suite", "clause", "test"]
        .map(str::to_owned)
        .into_iter()
        .chain(names)
        .collect();
    let columns = vec!["---"; header.len()];
    let rows = tests.iter().map(|(result, clause, test)| {
        let chosen = if test.is_as_stated { "" } else { "*" };
        let head = [
            result.suite.clone(),
            clause.clause.clone(),
            format!("{}{chosen}", test.name),
        ];
        head.into_iter()
            .chain(test.controllers.iter().map(format_marked_cell))
            .collect()
    });
    text.table(&header, &columns, rows);
    text.paragraph("*: crumple chose some parameters, because the document does not state them.");
    let warnings = tests.iter().flat_map(|(_, _, test)| &test.controllers);
    if warnings
        .filter_map(|tested| tested.warning)
        .any(is_reference)
    {
        text.paragraph(
            "†: the driver brakes after the reference warning of the suite, because the controller reports none.",
        );
    }
    text.into_string()
}

fn is_reference(warning: WarningOrigin) -> bool {
    warning == WarningOrigin::Reference
}

/// Returns the cell of a controller; `†` marks the reference warning.
fn format_marked_cell(tested: &ControllerResult) -> String {
    let mark = if tested.warning.is_some_and(is_reference) {
        " †"
    } else {
        ""
    };
    let seeds = match tested.seeds {
        1 => String::new(),
        seeds => format!(", worst of {seeds} seeds"),
    };
    format_cell(tested) + &seeds + mark
}

fn format_cell(tested: &ControllerResult) -> String {
    let points = format!("{}/{}", tested.passed_points, tested.points);
    if tested.points == 0 {
        return "–".to_owned();
    }
    if !tested.is_passed() {
        let collisions = tested
            .failures()
            .filter(|failed| matches!(failed.verdict, TestVerdict::Failed { .. }));
        let fastest = collisions
            .map(|failed| failed.verdict.impact_speed_mps())
            .reduce(f64::max);
        let sign = if tested.verdict.is_refusal() {
            "–"
        } else {
            "✗"
        };
        let impact = fastest.map_or_else(String::new, |mps| format!(", {mps:.1} m/s"));
        return format!("{sign} {points}{impact}");
    }
    let margin = min_margins(&tested.margins)
        .first()
        .map_or_else(String::new, |least| {
            let end = describe_margin_end(least.margin);
            format!(", {} {end}", least.margin.parameter.label())
        });
    format!("✓ {points}{margin}")
}

fn describe_margin_end(margin: &Margin) -> String {
    let Margin { unit, to, .. } = margin;
    match margin.end {
        MarginEnd::None { .. } => "not at all".to_owned(),
        MarginEnd::Holds { .. } => format!("to {to} {unit}"),
        MarginEnd::Boundary {
            passes_at,
            fails_at,
            ..
        } => {
            let [passes, _] = format_boundary(passes_at, fails_at, 2);
            format!("to {passes} {unit}")
        }
    }
}
