//! Runs of suites, told: a matrix for readers, JUnit for build servers.

mod junit;

use std::fmt::Write;

use crumple_search::suite::{
    Failed, Margin, MarginEnd, Prevention, SuiteResult, TestResult, TestVerdict, Tested, Within,
};
use crumple_world::quoted::Terminal;

pub use junit::{JunitError, xml};

/// The matrix clause, test, controller, verdict and margin, what failed, and what it does not say. `replay` is the command that
/// shows a failure of a controller; none where its scenario was not written.
#[must_use]
pub fn text(result: &SuiteResult, replay: impl Fn(&Failed, &Tested) -> Option<String>) -> String {
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
    for tested in &test.controllers {
        let points =
            if tested.points == 0 { String::new() } else { format!(", {} of {} pass", tested.passed, tested.points) };
        let _ = writeln!(out, "    {}: {}{points}", Terminal(&tested.controller), Terminal(&verdict(&tested.verdict)));
        for line in least_margins(&tested.margins) {
            let _ = writeln!(out, "      {line}");
        }
        if let Some(within) = &tested.within {
            let _ = writeln!(out, "      {}", Terminal(&within_in_words(within)));
        }
        for failed in tested.failures() {
            let _ = writeln!(out, "      fails at {}: {}", failed.point, Terminal(&verdict(&failed.verdict)));
            let _ = writeln!(out, "        {}", Terminal(&preventable(failed)));
            if let Some(command) = replay(failed, tested) {
                let _ = writeln!(out, "        {}", Terminal(&command));
            }
        }
    }
}

/// A verdict in words.
fn verdict(verdict: &TestVerdict) -> String {
    match verdict {
        TestVerdict::Passed => "PASSED".to_owned(),
        TestVerdict::Failed { time_s, impact_speed_mps } => {
            format!("FAILED, contact at {time_s:.2} s with {impact_speed_mps:.1} m/s")
        }
        TestVerdict::ControllerFailed { time_s, reason } => format!("CONTROLLER FAILED at {time_s:.2} s: {reason}"),
        TestVerdict::Refused { reason } => format!("REFUSED: {reason}"),
    }
}

/// The worst point within the ranges of a clause, in words.
fn within_in_words(within: &Within) -> String {
    let Within { point, verdict: found, min_gap_m, tried, .. } = within;
    let gap =
        min_gap_m.filter(|_| found.is_passed()).map_or(String::new(), |gap_m| format!(", smallest gap {gap_m:.2} m"));
    format!("worst of {tried} points within the ranges: {}{gap}, at {point}", verdict(found))
}

/// In each direction the least margin, in words, and of how many it is the least.
fn least_margins(margins: &[Margin]) -> Vec<String> {
    let mut directions: Vec<_> = margins.iter().map(|margin| (margin.push, margin.to)).collect();
    directions.dedup();
    let least = |&(push, to): &(_, f64)| {
        let along: Vec<_> = margins.iter().filter(|margin| (margin.push, margin.to) == (push, to)).collect();
        let least =
            along.iter().copied().reduce(|least, next| if share(next) < share(least) { next } else { least })?;
        let of = if along.len() > 1 { format!(" (the least of {})", along.len()) } else { String::new() };
        Some(margin_in_words(least) + &of)
    };
    directions.iter().filter_map(least).collect()
}

/// The share of its direction that passes.
fn share(margin: &Margin) -> f64 {
    match margin.end {
        MarginEnd::None => -1.0,
        MarginEnd::Holds { .. } => 1.0,
        MarginEnd::Boundary { passes_at, .. } => (passes_at - margin.from) / (margin.to - margin.from),
    }
}

/// A margin in words.
fn margin_in_words(margin: &Margin) -> String {
    let Margin { push, unit, from, to, held, end } = margin;
    let held = if held.is_empty() { String::new() } else { format!(" at {held}") };
    let push = push.words();
    match end {
        MarginEnd::None => format!("margin of {push}{held}: none, it fails at {from} {unit}"),
        MarginEnd::Holds { parts } => {
            format!("margin of {push}{held}: passes from {from} to {to} {unit} at the ends of {parts} parts")
        }
        MarginEnd::Boundary { passes_at, fails_at, is_monotone, parts } => {
            let apart = (passes_at - fails_at).abs();
            // As many digits as tell the two apart.
            let digits = if apart > 0.0 { (1.0 - apart.log10().floor()).clamp(3.0, 9.0) as usize } else { 3 };
            let words =
                format!("margin of {push}{held}: passes at {passes_at:.digits$}, fails at {fails_at:.digits$} {unit}");
            match is_monotone {
                true => words,
                false => format!(
                    "{words}: the first failure found on {parts} parts to {to} {unit}, and it passes again beyond"
                ),
            }
        }
    }
}

/// Who could have prevented a failure, in words.
fn preventable(failed: &Failed) -> String {
    let does = |prevention| match prevention {
        Prevention::Prevents => "prevents it",
        Prevention::Collides => "collides",
        Prevention::DoesNotReact => "does not react",
    };
    let mut words: Vec<_> =
        failed.references.iter().map(|run| format!("{} {}", run.driver, does(run.prevention))).collect();
    words.extend(failed.avoidability.describe());
    words.join("; ")
}
