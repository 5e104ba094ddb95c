//! Cells of a map, distinguished by shape, and their legend.

use std::fmt::Write;

use maud::{Markup, html};

use super::label::{PixelRect, text_width};
use super::panel::{Anchor, Marker, draw_line, draw_marker, draw_text};
use super::theme::{Ink, SMALL_TEXT_SIZE, Stroke, TEXT_SIZE};

/// Height of a row of the legend, and side of a sample in it, in pixels.
const LEGEND_ROW_HEIGHT: f64 = 22.0;
const SWATCH_SIZE: f64 = 14.0;

/// The style of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellStyle {
    /// Blank, on a neutral background.
    Blank,
    /// Crossed, on an alert background.
    Crossed,
    /// Hatched, on a grey background.
    Hatched,
    /// A letter.
    Lettered(&'static str),
}

/// An entry of a legend.
#[derive(Debug, Clone, Copy)]
pub enum LegendEntry<'a> {
    /// A cell and its meaning.
    Cell(CellStyle, &'a str),
    /// A line and its meaning.
    Line(Stroke, &'a str),
    /// A marker and its meaning.
    Mark(Marker, &'a str),
}

/// Returns the cells of a grid within a frame, row by row from the top.
pub(crate) fn grid_rects(frame: PixelRect, columns: usize, rows: usize) -> impl Iterator<Item = PixelRect> {
    let (width, height) = (frame.width / columns.max(1) as f64, frame.height / rows.max(1) as f64);
    (0..rows).flat_map(move |row| {
        (0..columns).map(move |column| {
            let (left, top) = (frame.left + column as f64 * width, frame.top + row as f64 * height);
            PixelRect { left, top, width, height }
        })
    })
}

/// Draws all cells of one style.
pub fn draw_cells(look: CellStyle, frames: impl Iterator<Item = PixelRect>) -> Markup {
    let (mut outline, mut strokes, mut marks) = (String::new(), String::new(), Vec::new());
    for PixelRect { left, top, width, height } in frames {
        let (x, y) = (left + width / 2.0, top + height / 2.0);
        // Writing to a string cannot fail.
        let _ = write!(outline, "M{left:.1} {top:.1}h{width:.1}v{height:.1}h{:.1}z", -width);
        match look {
            CellStyle::Blank => {}
            CellStyle::Crossed => {
                let arm = 0.2 * width.min(height);
                let (from, to) = (-2.0 * arm, 2.0 * arm);
                let _ = write!(strokes, "M{:.1} {:.1}l{to:.1} {to:.1}m0 {from:.1}l{from:.1} {to:.1}", x - arm, y - arm);
            }
            CellStyle::Hatched => {
                let (w, h, up) = (width / 2.0, -height / 2.0, -height);
                let bottom = top + height;
                let _ = write!(strokes, "M{left:.1} {y:.1}l{w:.1} {h:.1}M{left:.1} {bottom:.1}l{width:.1} {up:.1}");
                let _ = write!(strokes, "M{x:.1} {bottom:.1}l{w:.1} {h:.1}");
            }
            CellStyle::Lettered(letter) => {
                let base = (x, y + SMALL_TEXT_SIZE * 0.35);
                marks.push(draw_text(base, Anchor::Middle, letter, SMALL_TEXT_SIZE, Ink::Text, false));
            }
        }
    }
    let (ink, opacity) = match look {
        CellStyle::Blank => (Ink::Series(2), "0.16"),
        CellStyle::Crossed => (Ink::Alert, "0.2"),
        CellStyle::Hatched => (Ink::Muted, "0.3"),
        CellStyle::Lettered(_) => (Ink::Series(4), "0.25"),
    };
    html! {
        @if !outline.is_empty() { path d=(outline) fill=(ink.hex()) fill-opacity=(opacity) {} }
        @if !strokes.is_empty() { path d=(strokes) fill="none" stroke=(ink.hex()) stroke-width="1.1" {} }
        @for mark in marks { (mark) }
    }
}

/// Draws a legend in rows no wider than the figure, and returns its height.
#[must_use]
pub fn draw_legend(entries: &[LegendEntry<'_>], width: f64) -> (Markup, f64) {
    let (mut x, mut row) = (0.0, 0.0);
    let mut drawn = Vec::new();
    for entry in entries {
        let (LegendEntry::Cell(_, text) | LegendEntry::Line(_, text) | LegendEntry::Mark(_, text)) = *entry;
        let wide = SWATCH_SIZE + 7.0 + text_width(text, TEXT_SIZE);
        if x > 0.0 && x + wide > width {
            (x, row) = (0.0, row + 1.0);
        }
        let y = LEGEND_ROW_HEIGHT * (row + 0.5);
        let sample = PixelRect::from_center((x + SWATCH_SIZE / 2.0 + 1.0, y), SWATCH_SIZE, SWATCH_SIZE);
        let after = x + SWATCH_SIZE + 7.0;
        drawn.push(html! {
            @match entry {
                LegendEntry::Cell(look, _) => {
                    (draw_cells(*look, std::iter::once(sample)))
                    rect x=(format!("{:.1}", sample.left)) y=(format!("{:.1}", sample.top)) width=(SWATCH_SIZE)
                        height=(SWATCH_SIZE) fill="none" stroke=(Ink::Axis.hex()) stroke-width="0.8" {}
                }
                LegendEntry::Mark(marker, _) => (draw_marker((sample.left + SWATCH_SIZE / 2.0, y), *marker, Ink::Text))
                LegendEntry::Line(stroke, _) => (draw_line((sample.left, y), (sample.right(), y), *stroke))
            }
            (draw_text((after, y + TEXT_SIZE * 0.35), Anchor::Start, text, TEXT_SIZE, Ink::Text, false))
        });
        x += wide + 16.0;
    }
    (html! { @for entry in drawn { (entry) } }, LEGEND_ROW_HEIGHT * (row + 1.0))
}
