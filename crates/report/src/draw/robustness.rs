//! Robustness of the parts of a formula over time, below the trajectories.

use maud::html;

use super::axis::{Axis, BOTTOM_MARGIN, LEFT_MARGIN};
use super::label::{PixelRect, truncate_to_width};
use super::panel::{HEADING_HEIGHT, Panel};
use super::scale::{extent, pad_interval};
use super::theme::{Ink, Stroke, TEXT_SIZE};
use super::{PixelPoint, Svg};
use crumple_measure::stl::FormulaPart;

/// Number of parts that are drawn; a figure with all parts of a long formula is unreadable.
const MAX_PARTS: usize = 12;
const PANEL_HEIGHT: f64 = 60.0;

/// Adds a panel for each of the first twelve parts of formulas below a figure; areas below zero are filled.
#[must_use]
pub fn add_robustness(prefix: &str, figure: &Svg, parts: &[FormulaPart], step_s: f64) -> Svg {
    let (width, top) = figure.size();
    let row_height = HEADING_HEIGHT + PANEL_HEIGHT + BOTTOM_MARGIN;
    let drawn = parts.get(..MAX_PARTS).unwrap_or(parts);
    let panels = drawn.iter().enumerate().map(|(row, part)| {
        let frame = PixelRect {
            left: LEFT_MARGIN,
            top: top + row as f64 * row_height + HEADING_HEIGHT,
            width: width - 2.0 * LEFT_MARGIN,
            height: PANEL_HEIGHT,
        };
        robustness_panel(part, step_s, frame).draw(&Svg::id(prefix, &format!("part-{row}")))
    });
    let height = top + row_height * drawn.len() as f64;
    let content = html! {
        (figure)
        @for panel in panels { (panel) }
    };
    Svg::new(
        &format!("{prefix}-parts"),
        (width, height),
        "Motion and robustness",
        "",
        content,
    )
}

fn robustness_panel(part: &FormulaPart, step_s: f64, frame: PixelRect) -> Panel {
    let title = format!("{}{}", "\u{203a} ".repeat(part.depth), part.formula);
    let title = truncate_to_width(&format!("Robustness of {title}"), TEXT_SIZE, frame.width);
    let (low, high) = extent(part.robustness.iter().copied());
    let y = Axis::numeric("", pad_interval((low.min(0.0), high.max(0.0)), 0.05), 5);
    let x = Axis::numeric("Time (s)", (0.0, step_s * part.robustness.len() as f64), 8);
    let mut panel = Panel::new(frame, &title, x, y);
    let points: Vec<PixelPoint> = part
        .robustness
        .iter()
        .enumerate()
        .map(|(sample, &value)| (sample as f64 * step_s, value))
        .collect();
    let below: Vec<PixelPoint> = points
        .iter()
        .map(|&(time_s, value)| (time_s, value.min(0.0)))
        .collect();
    let zero: Vec<PixelPoint> = points.iter().map(|&(time_s, _)| (time_s, 0.0)).collect();
    panel.add_horizontal_line(0.0, Stroke::solid(Ink::Text, 1.0));
    panel.add_band(&zero, &below, Ink::Alert);
    panel.add_line(&points, Stroke::series(0));
    panel
}
