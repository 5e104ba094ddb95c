//! Cells of a map, distinguished by shape, and their legend.

use std::fmt::Write;

use maud::{Markup, html};

use super::label::{PixelRect, text_width};
use super::panel::{Anchor, draw_line, draw_text};
use super::theme::{Ink, Stroke, TEXT_SIZE};

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
}

impl CellStyle {
    fn ink(self) -> Ink {
        match self {
            Self::Blank => Ink::Series(2),
            Self::Crossed => Ink::Alert,
        }
    }

    fn fill_opacity(self) -> &'static str {
        match self {
            Self::Blank => "0.16",
            Self::Crossed => "0.2",
        }
    }
}

/// Draws all cells of one style.
pub fn draw_cells(style: CellStyle, frames: impl Iterator<Item = PixelRect>) -> Markup {
    let mut outline = String::new();
    let mut strokes = String::new();
    for PixelRect {
        left,
        top,
        width,
        height,
    } in frames
    {
        // Writing to a string cannot fail.
        let _ = write!(
            outline,
            "M{left:.1} {top:.1}h{width:.1}v{height:.1}h{:.1}z",
            -width
        );
        match style {
            CellStyle::Blank => {}
            CellStyle::Crossed => {
                let arm = 0.2 * width.min(height);
                let from = -2.0 * arm;
                let to = 2.0 * arm;
                let _ = write!(
                    strokes,
                    "M{:.1} {:.1}l{to:.1} {to:.1}m0 {from:.1}l{from:.1} {to:.1}",
                    left + width / 2.0 - arm,
                    top + height / 2.0 - arm
                );
            }
        }
    }
    let ink = style.ink();
    let opacity = style.fill_opacity();
    html! {
        @if !outline.is_empty() { path d=(outline) fill=(ink.hex()) fill-opacity=(opacity) {} }
        @if !strokes.is_empty() { path d=(strokes) fill="none" stroke=(ink.hex()) stroke-width="1.1" {} }
    }
}

/// Draws a legend of lines and their meanings, in rows no wider than the figure, and returns its height.
#[must_use]
pub fn draw_legend(entries: &[(Stroke, &str)], width: f64) -> (Markup, f64) {
    let mut x = 0.0;
    let mut row = 0.0;
    let mut drawn = Vec::new();
    for &(stroke, text) in entries {
        let entry_width = SWATCH_SIZE + 7.0 + text_width(text, TEXT_SIZE);
        if x > 0.0 && x + entry_width > width {
            x = 0.0;
            row += 1.0;
        }
        let y = LEGEND_ROW_HEIGHT * (row + 0.5);
        let sample =
            PixelRect::from_center((x + SWATCH_SIZE / 2.0 + 1.0, y), SWATCH_SIZE, SWATCH_SIZE);
        let after = x + SWATCH_SIZE + 7.0;
        drawn.push(html! {
            (draw_line((sample.left, y), (sample.right(), y), stroke))
            (draw_text((after, y + TEXT_SIZE * 0.35), Anchor::Start, text, TEXT_SIZE, Ink::Text, false))
        });
        x += entry_width + 16.0;
    }
    (
        html! { @for entry in drawn { (entry) } },
        LEGEND_ROW_HEIGHT * (row + 1.0),
    )
}
