//! Crash maps as small multiples: one panel per driver, with equal axes.

use maud::{Markup, html};

use super::map::{LEGEND, cell_letter, panel_title};
use crate::draw::{
    self, Anchor, Axis, BOTTOM_MARGIN, CellStyle, HEADING_HEIGHT, Ink, LEFT_MARGIN, LegendEntry, Marker, Panel,
    PixelRect, SMALL_TEXT_SIZE, Stroke, Svg, draw_text, grid_rects,
};
use crumple_suites::{Boundary, CrashMap, CrashMapAxis, MapPanel};

pub(super) fn draw_responsive(map: &CrashMap) -> Markup {
    draw::responsive(&draw(map, "map-wide", 960.0, column_count(map)), &draw(map, "map-narrow", 360.0, 1))
}

/// Draws a map as a separate figure.
#[must_use]
pub fn draw_map(map: &CrashMap) -> Svg {
    draw(map, "map", 960.0, column_count(map))
}

fn column_count(map: &CrashMap) -> usize {
    map.panels.len().clamp(1, 3)
}

fn cell_style(letter: char) -> CellStyle {
    match letter {
        'x' => CellStyle::Crossed,
        '!' => CellStyle::Lettered("!"),
        '~' => CellStyle::Hatched,
        '-' => CellStyle::Lettered("–"),
        _ => CellStyle::Blank,
    }
}

fn boundary_stroke(boundary: &Boundary) -> Stroke {
    match boundary.driver {
        None => Stroke::solid(Ink::Text, 2.4),
        Some(_) => Stroke { dash: "6 3", ..Stroke::solid(Ink::Series(0), 1.8) },
    }
}

fn draw(map: &CrashMap, prefix: &str, width: f64, columns: usize) -> Svg {
    let (key, key_height) = draw_legend(map, width);
    let column_width = width / columns as f64;
    let plot = (column_width - LEFT_MARGIN - 18.0, 0.8 * (column_width - LEFT_MARGIN - 18.0));
    let row_height = HEADING_HEIGHT + plot.1 + BOTTOM_MARGIN;
    let placed = |(index, panel): (usize, &MapPanel)| {
        let (column, row) = (index % columns, index / columns);
        let (left, top) =
            (column as f64 * column_width + LEFT_MARGIN, key_height + row as f64 * row_height + HEADING_HEIGHT);
        let frame = PixelRect { left, top, width: plot.0, height: plot.1 };
        self::draw_panel(map, panel, frame).draw(&Svg::id(prefix, &index.to_string()))
    };
    let content = html! { (key) @for one in map.panels.iter().enumerate() { (placed(one)) } };
    let height = key_height + map.panels.len().div_ceil(columns) as f64 * row_height;
    let description = "One panel per driver, one cell per scenario. Blank: no contact; cross: contact; hatched: \
        contact of a driver that never braked. Lines are closed forms.";
    let title = format!("{} {}", map.situation.description(), map.statement);
    Svg::new(prefix, (width, height), &title, description, content)
}

fn draw_panel(map: &CrashMap, shown: &MapPanel, frame: PixelRect) -> Panel {
    let axis = |of: &CrashMapAxis, title: &str| Axis::numeric(title, (of.low, of.high), 6);
    let mut panel = Panel::new(frame, &panel_title(shown), axis(&map.across, map.across.title), axis(&map.up, ""));
    let above = (frame.left - LEFT_MARGIN, frame.top - 8.0);
    panel.add_overlay(draw_text(above, Anchor::Start, map.up.title, SMALL_TEXT_SIZE, Ink::Muted, false));
    let (columns, rows) = (map.across.cells, map.up.cells);
    // Cells are ordered row by row from the bottom, frames from the top.
    let from_top = shown.cells.chunks(columns.max(1)).rev().flatten().map(cell_letter);
    let cells: Vec<(char, PixelRect)> = from_top.zip(grid_rects(frame, columns, rows)).collect();
    for (kind, _) in LEGEND {
        let of_kind = cells.iter().filter(|(letter, _)| *letter == kind).map(|(_, frame)| *frame);
        panel.add_clipped(draw::draw_cells(cell_style(kind), of_kind));
    }
    for boundary in &map.boundaries {
        let points: Vec<(f64, f64)> = boundary.points.iter().map(|&[across, up]| (across, up)).collect();
        panel.add_line(&points, boundary_stroke(boundary));
    }
    let stated: Vec<(f64, f64)> = map.stated_points.iter().map(|&[across, up]| (across, up)).collect();
    panel.add_markers(&stated, Marker::Disc, Ink::Text);
    panel
}

/// Draws the legend, without kinds that do not occur, and returns its height.
fn draw_legend(map: &CrashMap, width: f64) -> (Markup, f64) {
    let occurs = |kind: char| map.panels.iter().flat_map(|panel| &panel.cells).any(|cell| cell_letter(cell) == kind);
    let kinds =
        LEGEND.iter().filter(|(kind, _)| occurs(*kind)).map(|(kind, what)| LegendEntry::Cell(cell_style(*kind), what));
    let lines = map.boundaries.iter().map(|one| LegendEntry::Line(boundary_stroke(one), &one.label));
    let mut entries: Vec<LegendEntry<'_>> = kinds.chain(lines).collect();
    if !map.stated_points.is_empty() {
        entries.push(LegendEntry::Mark(Marker::Disc, "AFGBV: contact has to be avoided above"));
    }
    draw::draw_legend(&entries, width)
}
