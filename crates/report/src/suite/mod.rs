//! Runs of suites, told: a matrix for readers as text or as a page, JUnit for build servers; crash maps as pictures.

mod junit;
mod map;
mod map_figure;
mod page;
mod table;
mod description;

use std::fmt::Write;

use crumple_core::quoted::Terminal;
use crumple_suites::{Failed, SuiteResult, TestResult, Tested};

pub use junit::xml;
pub use map::{map_html, map_text};
pub use map_figure::map_figure;
pub use page::html;
pub use table::table;
use description::headline;
pub(crate) use description::{least_margins, preventable, verdict, within_in_words};

/// The matrix clause, test, controller, verdict and margin, what failed, and what it does not say. `replay` is the command that
/// shows a failure of a controller; none where its scenario was not written.
#[must_use]
pub fn render_text(result: &SuiteResult, replay: impl Fn(&Failed, &Tested) -> Option<String>) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(out, "{}: {}, {}", result.suite, result.document, result.edition);
    let _ = writeln!(out, "  {}", result.statement);
    let _ = writeln!(out, "  figures from: {}", result.figures_from);
    for clause in &result.clauses {
        let _ = writeln!(out, "\n{}  {}", clause.clause, clause.says);
        for test in &clause.tests {
            write_test(&mut out, test, &replay);
        }
    }
    for (title, list) in [("outside the model", &result.outside), ("left out", &result.left_out)] {
        if !list.is_empty() {
            let _ = writeln!(out, "\n{title}");
        }
        for entry in list {
            let _ = writeln!(out, "  {entry}");
        }
    }
    out
}

fn write_test(out: &mut String, test: &TestResult, replay: &impl Fn(&Failed, &Tested) -> Option<String>) {
    let chosen = if test.is_as_stated { "" } else { " (some figures are chosen, not the document's)" };
    let _ = writeln!(out, "  {}{chosen}", test.name);
    if let Some(limit) = &test.impact_at_most {
        let _ = writeln!(out, "    {}", description::allowed(limit));
    }
    for tested in &test.controllers {
        let points =
            if tested.points == 0 { String::new() } else { format!(", {} of {} pass", tested.passed, tested.points) };
        let _ = writeln!(out, "    {}: {}{points}", Terminal(&tested.controller), Terminal(&headline(tested)));
        for line in least_margins(&tested.margins) {
            let _ = writeln!(out, "      {line}");
        }
        if let Some(within) = &tested.within {
            let _ = writeln!(out, "      {}", Terminal(&within_in_words(within)));
        }
        for failed in tested.failures() {
            let _ = writeln!(out, "      fails at {}: {}", failed.point, Terminal(&verdict(&failed.verdict)));
            let preventable = preventable(failed);
            if !preventable.is_empty() {
                let _ = writeln!(out, "        {}", Terminal(&preventable));
            }
            if let Some(command) = replay(failed, tested) {
                let _ = writeln!(out, "        {}", Terminal(&command));
            }
        }
    }
}
