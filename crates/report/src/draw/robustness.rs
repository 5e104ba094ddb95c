//! Robustness of the parts of a formula over time, below the trajectories.

use maud::html;

use super::axis::{Axis, BOTTOM_MARGIN, LEFT_MARGIN};
use super::label::{PixelRect, truncate_to_width};
use super::panel::{HEADING_HEIGHT, Panel};
use super::scale::{extent, pad_interval};
use super::theme::{Ink, Stroke, TEXT_SIZE};
use super::{PixelPoint, Svg};
use crumple_measure::LevelMeasures;
use crumple_measure::stl::FormulaPart;

/// Number of parts that are drawn; a figure with all parts of a long formula is unreadable.
const MAX_PARTS: usize = 12;
const PANEL_HEIGHT: f64 = 60.0;

/// Adds a panel for each of the first twelve parts of formulas below a figure; areas below zero are filled.
#[must_use]
pub fn add_robustness(prefix: &str, figure: &Svg, parts: &[FormulaPart], step_s: f64) -> Svg {
    let drawn = parts.get(..MAX_PARTS).unwrap_or(parts);
    let panels: Vec<PanelOfFrame<'_>> = drawn
        .iter()
        .map(|part| -> PanelOfFrame<'_> {
            Box::new(move |frame| robustness_panel(part, step_s, frame))
        })
        .collect();
    add_rows(prefix, figure, ("part", "Motion and robustness"), panels)
}

/// A panel that is drawn in a given frame.
type PanelOfFrame<'p> = Box<dyn FnOnce(PixelRect) -> Panel + 'p>;

/// Adds a row for each panel below a figure. `name` is the begin of identifiers, `title` is for screen readers.
fn add_rows(
    prefix: &str,
    figure: &Svg,
    (name, title): (&str, &str),
    panels: Vec<PanelOfFrame<'_>>,
) -> Svg {
    let (width, top) = figure.size();
    let row_height = HEADING_HEIGHT + PANEL_HEIGHT + BOTTOM_MARGIN;
    let height = top + row_height * panels.len() as f64;
    let rows = panels.into_iter().enumerate().map(|(row, panel)| {
        let frame = PixelRect {
            left: LEFT_MARGIN,
            top: top + row as f64 * row_height + HEADING_HEIGHT,
            width: width - 2.0 * LEFT_MARGIN,
            height: PANEL_HEIGHT,
        };
        panel(frame).draw(&Svg::id(prefix, &format!("{name}-{row}")))
    });
    let content = html! {
        (figure)
        @for row in rows { (row) }
    };
    let prefix = format!("{prefix}-{name}s");
    Svg::new(&prefix, (width, height), title, "", content)
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

/// Adds a panel with the level over time of each vehicle below a figure.
#[must_use]
pub fn add_levels(prefix: &str, figure: &Svg, levels: &[LevelMeasures]) -> Svg {
    let panel: PanelOfFrame<'_> = Box::new(move |frame| level_panel(levels, frame));
    add_rows(prefix, figure, ("level", "Motion and level"), vec![panel])
}

fn level_panel(levels: &[LevelMeasures], frame: PixelRect) -> Panel {
    let (_, high) = extent(
        levels
            .iter()
            .flat_map(|vehicle| vehicle.level_mps2.iter().copied()),
    );
    let (_, end_s) = extent(
        levels
            .iter()
            .flat_map(|vehicle| vehicle.time_s.iter().copied()),
    );
    let y = Axis::numeric("m/s²", pad_interval((0.0, high.max(1.0)), 0.05), 5);
    let x = Axis::numeric("Time (s)", (0.0, end_s.max(0.1)), 8);
    let mut panel = Panel::new(frame, "Level: hardest safe braking of the leader", x, y);
    for (series, vehicle) in levels.iter().enumerate() {
        let times_s = vehicle.time_s.iter().copied();
        let points: Vec<PixelPoint> = times_s.zip(vehicle.level_mps2.iter().copied()).collect();
        panel.add_line(&points, Stroke::series(series));
    }
    panel
}
