//! Failure maps as small multiples: one panel a controller, all on the same axes.

use std::fmt::Write;

use maud::{Markup, html};

use super::{FailureMap, FailureMaps, MapAxis, MapCell};
use crate::draw::{
    Anchor, Axis, BELOW, Frame, HEADING, Ink, LEFT, Panel, SMALL, Stroke, Svg, TEXT, Ticks, signed, straight,
    text_width, words,
};

/// Height of a row of the key, and side of a sample in it, in pixels.
const KEY_ROW: f64 = 22.0;
const SAMPLE: f64 = 14.0;

/// Width of the line around what is unavoidable.
const LINE: f64 = 2.4;

/// Both arrangements, of which the page shows the one that fits.
pub(super) fn responsive(maps: &FailureMaps) -> Markup {
    let columns = match maps.maps.len() {
        0 | 1 => 1,
        3 => 3,
        _ => 2,
    };
    html! {
        div.draw-wide { (draw(maps, "maps-wide", 960.0, columns)) }
        div.draw-narrow { (draw(maps, "maps-narrow", 360.0, 1)) }
    }
}

fn draw(maps: &FailureMaps, prefix: &str, width: f64, columns: usize) -> Svg {
    let (key, key_height) = key(width);
    let column_width = (width / columns as f64).min(600.0);
    let plot = (column_width - LEFT - 18.0, 0.66 * (column_width - LEFT - 18.0));
    let row_height = HEADING + plot.1 + BELOW;
    let panel = |(index, map): (usize, &FailureMap)| {
        let (column, row) = (index % columns, index / columns);
        let (left, top) = (column as f64 * column_width + LEFT, key_height + row as f64 * row_height + HEADING);
        let frame = Frame { left, top, width: plot.0, height: plot.1 };
        let (x, y) = (axis(&maps.across, &maps.across.title), axis(&maps.up, ""));
        let mut panel = Panel::new(frame, &map.controller, x, y);
        panel.overlay(words((left - LEFT, top - 8.0), Anchor::Start, &maps.up.title, SMALL, Ink::Muted, false));
        panel.overlay(cells(map, frame));
        panel.draw(&Svg::id(prefix, &map.controller))
    };
    let content = html! { (key) @for placed in maps.maps.iter().enumerate() { (panel(placed)) } };
    let height = key_height + maps.maps.len().div_ceil(columns) as f64 * row_height;
    let description = "One panel a controller; every cell is a scenario. Blank: no contact; cross: contact though avoidable; \
        hatched: contact, unavoidable; question mark: undecided. A thick line surrounds what is unavoidable.";
    Svg::new(prefix, (width, height), "Failure maps", description, content)
}

/// An axis from 0 to 1 with round values of the parameter marked.
fn axis(of: &MapAxis, title: &str) -> Axis {
    let (low, high) = (of.low.value(), of.high.value());
    let marks: Vec<(f64, String)> = if of.by_factor {
        let powers =
            (-3..6).flat_map(|exponent| [1.0, 2.0, 5.0].map(|factor| (factor * 10f64.powi(exponent), exponent)));
        let inside = powers.filter(|(value, _)| (low..=high).contains(value));
        inside.map(|(value, exponent)| (value, signed(value, usize::try_from(-exponent).unwrap_or(0)))).collect()
    } else {
        Ticks::within((low, high), 6).labelled().collect()
    };
    Axis::marked(title, (0.0, 1.0), marks.into_iter().map(|(value, label)| (of.share(value), label)).collect())
}

/// Every cell, told apart by what is drawn on it, and the line around what is unavoidable.
fn cells(map: &FailureMap, frame: Frame) -> Markup {
    let (columns, rows) = (map.rows.first().map_or(1, |row| row.0.len().max(1)), map.rows.len().max(1));
    let (width, height) = (frame.width / columns as f64, frame.height / rows as f64);
    let placed = || {
        map.rows.iter().enumerate().flat_map(move |(row, cells)| {
            cells.0.iter().enumerate().map(move |(column, &cell)| {
                let (left, top) = (frame.left + column as f64 * width, frame.top + row as f64 * height);
                (cell, Frame { left, top, width, height })
            })
        })
    };
    html! {
        @for kind in MapCell::ALL {
            (area(kind, placed().filter(|(cell, _)| *cell == kind).map(|(_, frame)| frame)))
        }
        path d=(boundary(map, frame, (width, height))) fill="none" stroke=(Ink::Text.hex()) stroke-width=(LINE)
            stroke-linecap="square" {}
    }
}

/// All cells of one kind.
fn area(kind: MapCell, frames: impl Iterator<Item = Frame>) -> Markup {
    let (mut outline, mut strokes, mut marks) = (String::new(), String::new(), Vec::new());
    for Frame { left, top, width, height } in frames {
        let (x, y) = (left + width / 2.0, top + height / 2.0);
        // Writing to a string cannot fail.
        let _ = write!(outline, "M{left:.1} {top:.1}h{width:.1}v{height:.1}h{:.1}z", -width);
        match kind {
            MapCell::NoContact => {}
            MapCell::Avoidable => {
                let arm = 0.2 * width.min(height);
                let (from, to) = (-2.0 * arm, 2.0 * arm);
                let _ = write!(strokes, "M{:.1} {:.1}l{to:.1} {to:.1}m0 {from:.1}l{from:.1} {to:.1}", x - arm, y - arm);
            }
            MapCell::Unavoidable => {
                let (w, h) = (width / 2.0, height / 2.0);
                let bottom = top + height;
                let _ = write!(
                    strokes,
                    "M{left:.1} {y:.1}l{w:.1} {:.1}M{left:.1} {bottom:.1}l{width:.1} {:.1}",
                    -h, -height
                );
                let _ = write!(strokes, "M{x:.1} {bottom:.1}l{w:.1} {:.1}", -h);
            }
            MapCell::Undecided => {
                marks.push(words((x, y + SMALL * 0.35), Anchor::Middle, "?", SMALL, Ink::Text, false));
            }
        }
    }
    let (ink, opacity) = match kind {
        MapCell::NoContact => (Ink::Series(2), "0.16"),
        MapCell::Avoidable => (Ink::Alert, "0.2"),
        MapCell::Unavoidable => (Ink::Muted, "0.3"),
        MapCell::Undecided => (Ink::Series(4), "0.25"),
    };
    html! {
        @if !outline.is_empty() { path d=(outline) fill=(ink.hex()) fill-opacity=(opacity) {} }
        @if !strokes.is_empty() { path d=(strokes) fill="none" stroke=(ink.hex()) stroke-width="1.1" {} }
        @for mark in marks { (mark) }
    }
}

/// Path data of every edge between a cell that is unavoidable and one that is not.
fn boundary(map: &FailureMap, frame: Frame, (width, height): (f64, f64)) -> String {
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

/// What each kind of cell and the line look like, in rows no wider than the figure, and their height.
fn key(width: f64) -> (Markup, f64) {
    let (mut x, mut row) = (0.0, 0.0);
    let mut entries = Vec::new();
    let line = (None, "beyond it nobody avoids contact");
    for (kind, text) in MapCell::ALL.map(|kind| (Some(kind), kind.words())).into_iter().chain([line]) {
        let entry = SAMPLE + 7.0 + text_width(text, TEXT);
        if x > 0.0 && x + entry > width {
            (x, row) = (0.0, row + 1.0);
        }
        let y = KEY_ROW * (row + 0.5);
        let sample = Frame::around((x + SAMPLE / 2.0 + 1.0, y), SAMPLE, SAMPLE);
        let after = x + SAMPLE + 7.0;
        entries.push(html! {
            @if let Some(kind) = kind {
                (area(kind, std::iter::once(sample)))
                rect x=(format!("{:.1}", sample.left)) y=(format!("{:.1}", sample.top)) width=(SAMPLE) height=(SAMPLE)
                    fill="none" stroke=(Ink::Axis.hex()) stroke-width="0.8" {}
            } @else {
                (straight((sample.left, y), (sample.right(), y), Stroke::solid(Ink::Text, LINE)))
            }
            (words((after, y + TEXT * 0.35), Anchor::Start, text, TEXT, Ink::Text, false))
        });
        x += entry + 16.0;
    }
    (html! { @for entry in entries { (entry) } }, KEY_ROW * (row + 1.0))
}
