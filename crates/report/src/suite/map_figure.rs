//! Crash maps as small multiples: one panel a driver, all on the same axes.

use maud::{Markup, html};

use super::map::{LETTERS, heading, letter};
use crate::draw::{
    self, Anchor, Axis, BELOW, CellLook, Frame, HEADING, Ink, KeyEntry, LEFT, Marker, Panel, SMALL, Stroke, Svg,
    grid_frames, words,
};
use crumple_suites::{Boundary, CrashMap, MapAxis, MapPanel};

/// Both arrangements, of which the page shows the one that fits.
pub(super) fn responsive(map: &CrashMap) -> Markup {
    html! {
        div.draw-wide { (draw(map, "map-wide", 960.0, columns(map))) }
        div.draw-narrow { (draw(map, "map-narrow", 360.0, 1)) }
    }
}

/// A map as a figure by itself.
#[must_use]
pub fn map_figure(map: &CrashMap) -> Svg {
    draw(map, "map", 960.0, columns(map))
}

fn columns(map: &CrashMap) -> usize {
    map.panels.len().clamp(1, 3)
}

fn look(letter: char) -> CellLook {
    match letter {
        'x' => CellLook::Crossed,
        '!' => CellLook::Lettered("!"),
        '~' => CellLook::Hatched,
        '-' => CellLook::Lettered("–"),
        _ => CellLook::Blank,
    }
}

fn line(boundary: &Boundary) -> Stroke {
    match boundary.driver {
        None => Stroke::solid(Ink::Text, 2.4),
        Some(_) => Stroke { dash: "6 3", ..Stroke::solid(Ink::Series(0), 1.8) },
    }
}

fn draw(map: &CrashMap, prefix: &str, width: f64, columns: usize) -> Svg {
    let (key, key_height) = key(map, width);
    let column_width = width / columns as f64;
    let plot = (column_width - LEFT - 18.0, 0.8 * (column_width - LEFT - 18.0));
    let row_height = HEADING + plot.1 + BELOW;
    let placed = |(index, panel): (usize, &MapPanel)| {
        let (column, row) = (index % columns, index / columns);
        let (left, top) = (column as f64 * column_width + LEFT, key_height + row as f64 * row_height + HEADING);
        let frame = Frame { left, top, width: plot.0, height: plot.1 };
        self::panel(map, panel, frame).draw(&Svg::id(prefix, &index.to_string()))
    };
    let content = html! { (key) @for one in map.panels.iter().enumerate() { (placed(one)) } };
    let height = key_height + map.panels.len().div_ceil(columns) as f64 * row_height;
    let description = "One panel a driver; every cell is a scenario. Blank: no contact; cross: contact; hatched: contact of a driver that never braked. Lines are closed forms.";
    let title = format!("{} {}", map.situation.words(), map.statement);
    Svg::new(prefix, (width, height), &title, description, content)
}

fn panel(map: &CrashMap, shown: &MapPanel, frame: Frame) -> Panel {
    let axis = |of: &MapAxis, title: &str| Axis::numbers(title, (of.low, of.high), 6);
    let mut panel = Panel::new(frame, &heading(shown), axis(&map.across, map.across.title), axis(&map.up, ""));
    let above = (frame.left - LEFT, frame.top - 8.0);
    panel.overlay(words(above, Anchor::Start, map.up.title, SMALL, Ink::Muted, false));
    let (columns, rows) = (map.across.cells, map.up.cells);
    // Cells come row by row from the bottom, frames from the top.
    let from_top = shown.cells.chunks(columns.max(1)).rev().flatten().map(letter);
    let cells: Vec<(char, Frame)> = from_top.zip(grid_frames(frame, columns, rows)).collect();
    for (kind, _) in LETTERS {
        let of_kind = cells.iter().filter(|(letter, _)| *letter == kind).map(|(_, frame)| *frame);
        panel.layer(draw::cells(look(kind), of_kind));
    }
    for boundary in &map.boundaries {
        let points: Vec<(f64, f64)> = boundary.points.iter().map(|&[across, up]| (across, up)).collect();
        panel.line(&points, line(boundary));
    }
    let stated: Vec<(f64, f64)> = map.stated.iter().map(|&[across, up]| (across, up)).collect();
    panel.marks(&stated, Marker::Disc, Ink::Text);
    panel
}

/// What is drawn, and the height that this takes. What does not occur is left out.
fn key(map: &CrashMap, width: f64) -> (Markup, f64) {
    let occurs = |kind: char| map.panels.iter().flat_map(|panel| &panel.cells).any(|cell| letter(cell) == kind);
    let kinds = LETTERS.iter().filter(|(kind, _)| occurs(*kind)).map(|(kind, what)| KeyEntry::Cell(look(*kind), what));
    let lines = map.boundaries.iter().map(|one| KeyEntry::Line(line(one), &one.words));
    let mut entries: Vec<KeyEntry<'_>> = kinds.chain(lines).collect();
    if !map.stated.is_empty() {
        entries.push(KeyEntry::Mark(Marker::Disc, "AFGBV: contact has to be avoided above"));
    }
    draw::key(&entries, width)
}
