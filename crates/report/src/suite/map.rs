//! Crash maps as text and as a page.

use std::fmt::Write;

use maud::{DOCTYPE, Markup, html};

use super::map_figure;
use super::page::{SUITE_STYLE, describe_estimator};
use crate::html_head;
use crumple_core::quoting::{TerminalLines, TerminalText};
use crumple_suites::{CrashCell, CrashMap, MapPanel, TestVerdict};

const NO_PUBLISHED_COUNTS: &str =
    "There are no readable counts of published maps. The map shows closed forms and stated points for comparison.";

pub(super) fn cell_letter(cell: &CrashCell) -> char {
    match cell.verdict {
        _ if cell.is_without_reaction() => '~',
        TestVerdict::Passed => '.',
        TestVerdict::Failed { .. } => 'x',
        TestVerdict::ControllerFailed { .. } => '!',
        TestVerdict::Refused { .. } => '-',
    }
}

/// Meaning of the letters, in the order of legends.
pub(super) const LEGEND: [(char, &str); 5] = [
    ('.', "no contact"),
    ('x', "contact"),
    ('~', "contact, never braked"),
    ('!', "controller failed"),
    ('-', "cannot be run"),
];

fn describe_panel(panel: &MapPanel) -> String {
    let MapPanel { contacts, without_reaction, unlike_closed_form, cells, .. } = panel;
    let mut words = format!("contact in {contacts} of {} cells", cells.len());
    if *without_reaction > 0 {
        words += &format!(" ({without_reaction} without braking)");
    }
    for (letter, what) in LEGEND.iter().skip(3) {
        let count = cells.iter().filter(|cell| cell_letter(cell) == *letter).count();
        if count > 0 {
            words += &format!(", {what} in {count}");
        }
    }
    if let Some(unlike) = unlike_closed_form {
        words += &format!(", different from the closed form in {unlike}");
    }
    words
}

pub(super) fn panel_title(panel: &MapPanel) -> String {
    if panel.is_reference { format!("reference: {}", panel.driver) } else { panel.driver.clone() }
}

/// Renders a map for a terminal: one letter per cell, the highest row first.
#[must_use]
pub fn render_map_text(map: &CrashMap) -> String {
    let CrashMap { situation, across, up, .. } = map;
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(out, "{}: {}", situation.name(), situation.description());
    let _ = writeln!(out, "  {}", map.statement);
    for (name, axis) in [("across", across), ("up", up)] {
        let _ = writeln!(out, "  {name}: {}, {} to {}, {} cells", axis.title, axis.low, axis.high, axis.cells);
    }
    let meanings: Vec<_> = LEGEND.iter().map(|(letter, what)| format!("{letter} {what}")).collect();
    let _ = writeln!(out, "  {}", meanings.join(", "));
    for line in &map.boundaries {
        let _ = writeln!(out, "  {}", line.label);
    }
    for panel in &map.panels {
        let _ = writeln!(out, "\n{}: {}", TerminalText(&panel_title(panel)), describe_panel(panel));
        for row in panel.cells.chunks(across.cells.max(1)).rev() {
            let row: String = row.iter().map(cell_letter).collect();
            let _ = writeln!(out, "  {row}");
        }
    }
    let _ = writeln!(out, "\n{NO_PUBLISHED_COUNTS}");
    out
}

/// Renders a map as one self-contained page.
#[must_use]
pub fn render_map_html(map: &CrashMap) -> String {
    let title = format!("Crash map: {}", map.situation.name());
    let page: Markup = html! {
        (DOCTYPE)
        html lang="en" {
            (html_head(&title, SUITE_STYLE))
            body {
                header {
                    p.kicker { "crumple " (env!("CARGO_PKG_VERSION")) }
                    h1 { (title) }
                    p.answer { (map.statement) }
                    p { (map.situation.description()) " Reference drivers observe the true state. Sensors of the \
                        controllers: " (describe_estimator(map.estimator)) "." }
                }
                main {
                    figure { (map_figure::draw_responsive(map)) }
                    div.scroll tabindex="0" { table {
                        thead { tr { th scope="col" { "driver" } th scope="col" { "result" } } }
                        tbody { @for panel in &map.panels { tr {
                            th scope="row" { (panel_title(panel)) } td { (describe_panel(panel)) }
                        } } }
                    } }
                    ul { @for line in &map.boundaries { li { (line.label) } } }
                    p { "Each cell is the scenario at its centre, simulated for every driver. " (NO_PUBLISHED_COUNTS) }
                }
                footer.statement { (map.statement) }
            }
        }
    };
    TerminalLines(&page.into_string()).to_string()
}
