//! Failure maps as small multiples: one panel per controller, with equal axes.

use std::fmt::Write;

use maud::{Markup, html};

use super::{FailureMap, FailureMapAxis, FailureMaps, MapCell};
use crate::draw::{
    self, Anchor, Axis, BOTTOM_MARGIN, CellStyle, HEADING_HEIGHT, Ink, LEFT_MARGIN, LegendEntry, Panel, PixelRect,
    SMALL_TEXT_SIZE, Stroke, Svg, Ticks, draw_text, format_number, grid_rects,
};

const BOUNDARY_WIDTH: f64 = 2.4;

pub(super) fn draw_responsive(maps: &FailureMaps) -> Markup {
    let columns = match maps.maps.len() {
        0 | 1 => 1,
        3 => 3,
        _ => 2,
    };
    draw::responsive(&draw(maps, "maps-wide", 960.0, columns), &draw(maps, "maps-narrow", 360.0, 1))
}

fn draw(maps: &FailureMaps, prefix: &str, width: f64, columns: usize) -> Svg {
    let (key, key_height) = draw_legend(width);
    let column_width = (width / columns as f64).min(600.0);
    let plot = (column_width - LEFT_MARGIN - 18.0, 0.66 * (column_width - LEFT_MARGIN - 18.0));
    let row_height = HEADING_HEIGHT + plot.1 + BOTTOM_MARGIN;
    let panel = |(index, map): (usize, &FailureMap)| {
        let (column, row) = (index % columns, index / columns);
        let (left, top) =
            (column as f64 * column_width + LEFT_MARGIN, key_height + row as f64 * row_height + HEADING_HEIGHT);
        let frame = PixelRect { left, top, width: plot.0, height: plot.1 };
        let (x, y) = (parameter_axis(&maps.across, &maps.across.title), parameter_axis(&maps.up, ""));
        let mut panel = Panel::new(frame, &map.controller, x, y);
        let above = (left - LEFT_MARGIN, top - 8.0);
        panel.add_overlay(draw_text(above, Anchor::Start, &maps.up.title, SMALL_TEXT_SIZE, Ink::Muted, false));
        panel.add_overlay(draw_map_cells(map, frame));
        panel.draw(&Svg::id(prefix, &map.controller))
    };
    let content = html! { (key) @for placed in maps.maps.iter().enumerate() { (panel(placed)) } };
    let height = key_height + maps.maps.len().div_ceil(columns) as f64 * row_height;
    let description = "One panel per controller, one cell per scenario. Blank: no collision; cross: avoidable \
        collision; \
        hatched: unavoidable collision; question mark: undecided. A thick line surrounds the unavoidable cells.";
    Svg::new(prefix, (width, height), "Failure maps", description, content)
}

fn parameter_axis(of: &FailureMapAxis, title: &str) -> Axis {
    let (low, high) = (of.low.value(), of.high.value());
    let marks: Vec<(f64, String)> = if of.is_logarithmic {
        let powers =
            (-3..6).flat_map(|exponent| [1.0, 2.0, 5.0].map(|factor| (factor * 10f64.powi(exponent), exponent)));
        let inside = powers.filter(|(value, _)| (low..=high).contains(value));
        inside.map(|(value, exponent)| (value, format_number(value, usize::try_from(-exponent).unwrap_or(0)))).collect()
    } else {
        Ticks::new((low, high), 6).labels().collect()
    };
    Axis::with_ticks(title, (0.0, 1.0), marks.into_iter().map(|(value, label)| (of.normalize(value), label)).collect())
}

/// Draws every cell with the style of its kind, and the boundary of the unavoidable cells.
fn draw_map_cells(map: &FailureMap, frame: PixelRect) -> Markup {
    let (columns, rows) = (map.rows.first().map_or(1, |row| row.0.len().max(1)), map.rows.len().max(1));
    let (width, height) = (frame.width / columns as f64, frame.height / rows as f64);
    let placed = || map.rows.iter().flat_map(|row| row.0.iter().copied()).zip(grid_rects(frame, columns, rows));
    html! {
        @for kind in MapCell::ALL {
            (draw::draw_cells(cell_style(kind), placed().filter(|(cell, _)| *cell == kind).map(|(_, frame)| frame)))
        }
        path d=(boundary_path(map, frame, (width, height))) fill="none" stroke=(Ink::Text.hex())
            stroke-width=(BOUNDARY_WIDTH) stroke-linecap="square" {}
    }
}

fn boundary_path(map: &FailureMap, frame: PixelRect, (width, height): (f64, f64)) -> String {
    let cell = |row: usize, column: usize| map.rows.get(row).and_then(|cells| cells.0.get(column)).copied();
    let differ = |one: Option<MapCell>, other: Option<MapCell>| {
        let lost = |cell: MapCell| cell == MapCell::Unavoidable;
        matches!((one, other), (Some(one), Some(other)) if lost(one) != lost(other))
    };
    let mut data = String::new();
    for (row, cells) in map.rows.iter().enumerate() {
        for column in 0..cells.0.len() {
            let (left, top) = (frame.left + column as f64 * width, frame.top + row as f64 * height);
            if differ(cell(row, column), cell(row, column + 1)) {
                let _ = write!(data, "M{:.1} {top:.1}v{height:.1}", left + width);
            }
            if differ(cell(row, column), cell(row + 1, column)) {
                let _ = write!(data, "M{left:.1} {:.1}h{width:.1}", top + height);
            }
        }
    }
    data
}

fn cell_style(kind: MapCell) -> CellStyle {
    match kind {
        MapCell::NoContact => CellStyle::Blank,
        MapCell::Avoidable => CellStyle::Crossed,
        MapCell::Unavoidable => CellStyle::Hatched,
        MapCell::Undecided => CellStyle::Lettered("?"),
    }
}

fn draw_legend(width: f64) -> (Markup, f64) {
    let line = LegendEntry::Line(Stroke::solid(Ink::Text, BOUNDARY_WIDTH), "boundary of the unavoidable cells");
    let kinds = MapCell::ALL.map(|kind| LegendEntry::Cell(cell_style(kind), kind.label()));
    draw::draw_legend(&kinds.into_iter().chain([line]).collect::<Vec<_>>(), width)
}
