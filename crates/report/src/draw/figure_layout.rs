//! The layout of a motion figure.

use maud::{Markup, html};

use super::axis::{BOTTOM_MARGIN, LEFT_MARGIN};
use super::label::{PixelRect, text_width, truncate_to_width, wrap_to_width};
use super::motion::{MotionFigure, PanelArrangement};
use super::panel::{Anchor, HEADING_HEIGHT, draw_tag, draw_text, tag_width};
use super::theme::{Ink, TEXT_SIZE, draw_swatch};

/// Distance between successive labels, in pixels.
pub(super) const LABEL_STEP: f64 = 15.0;

/// Maximum width of a name beside the time-space diagram, in pixels.
const MAX_NAME_WIDTH: f64 = 165.0;

const TITLE_SIZE: f64 = 14.0;

/// Height of a panel where two are above each other, in pixels.
const ROW_HEIGHT: f64 = 150.0;

/// Distance between panels above each other, in pixels: ticks of the upper one, heading of the lower one.
const BETWEEN_ROWS: f64 = BOTTOM_MARGIN + HEADING_HEIGHT;

/// Height of a row of the legend, and width of its line samples, in pixels.
const LEGEND_ROW_HEIGHT: f64 = 20.0;
const SWATCH_WIDTH: f64 = 24.0;

pub(super) struct FigureLayout {
    pub(super) arrangement: PanelArrangement,
    pub(super) width: f64,
    pub(super) height: f64,
    title: Vec<String>,
    pub(super) position: PixelRect,
    pub(super) speed: PixelRect,
    pub(super) gap: PixelRect,
    pub(super) acceleration: PixelRect,
    pub(super) ttc: PixelRect,
    /// Right end of the column of labels beside the time-space diagram.
    pub(super) labels_right: f64,
    pub(super) widest_tag: f64,
}

impl FigureLayout {
    pub(super) fn new(figure: &MotionFigure<'_>, arrangement: PanelArrangement) -> Self {
        let width = match arrangement {
            PanelArrangement::Wide => 960.0,
            PanelArrangement::Stacked => 360.0,
            PanelArrangement::Column => 470.0,
        };
        let title = if figure.title.is_empty() {
            vec![]
        } else {
            wrap_to_width(figure.title, TITLE_SIZE, width - 4.0)
        };
        let top = title.len() as f64 * TITLE_SIZE * 1.3;
        let vehicles = figure.trace.vehicles.len();
        let widest_tag = tag_width(&vehicles.saturating_sub(1).to_string());
        let frames = match arrangement {
            PanelArrangement::Wide => PanelFrames::in_row(figure, width, top, widest_tag),
            PanelArrangement::Stacked => {
                PanelFrames::in_column(figure, width, top, widest_tag, [230.0, 190.0])
            }
            PanelArrangement::Column => {
                PanelFrames::in_column(figure, width, top, widest_tag, [190.0, 130.0])
            }
        };
        // In a row all panels end at the same height.
        let height = frames.ttc.bottom() + BOTTOM_MARGIN;
        Self {
            arrangement,
            width,
            height,
            title,
            position: frames.position,
            speed: frames.speed,
            gap: frames.gap,
            acceleration: frames.acceleration,
            ttc: frames.ttc,
            labels_right: frames.labels_right,
            widest_tag,
        }
    }

    /// Draws the title and, if names have no room beside the lines, a legend.
    pub(super) fn draw_title_and_legend(&self, figure: &MotionFigure<'_>) -> Markup {
        let below_title = self.title.len() as f64 * TITLE_SIZE * 1.3;
        html! {
            g font-weight="600" {
                @for (line, text) in self.title.iter().enumerate() {
                    @let base = TITLE_SIZE * (1.0 + 1.3 * line as f64);
                    (draw_text((0.0, base), Anchor::Start, text, TITLE_SIZE, Ink::Text, false))
                }
            }
            @if self.arrangement != PanelArrangement::Wide {
                @for (row, entries) in legend_rows(figure, self.width).iter().enumerate() {
                    @let y = below_title + LEGEND_ROW_HEIGHT * (row as f64 + 0.6);
                    @for &(x, index) in entries {
                        @let number = index.to_string();
                        @let after = x + tag_width(&number);
                        (draw_swatch(index, x, y, SWATCH_WIDTH))
                        (draw_tag((SWATCH_WIDTH + 3.0 + (x + after) / 2.0, y), &number, Ink::Series(index)))
                        (draw_text((after + SWATCH_WIDTH + 7.0, y + TEXT_SIZE * 0.35), Anchor::Start,
                            &vehicle_name(figure, index), TEXT_SIZE, Ink::Text, false))
                    }
                }
            }
        }
    }
}

/// The frames of the panels, and the right end of the labels beside the time-space diagram.
struct PanelFrames {
    position: PixelRect,
    speed: PixelRect,
    gap: PixelRect,
    acceleration: PixelRect,
    ttc: PixelRect,
    labels_right: f64,
}

impl PanelFrames {
    /// Returns the time-space diagram on the left, with room for names, and two rows of two frames beside it.
    fn in_row(figure: &MotionFigure<'_>, width: f64, top: f64, widest_tag: f64) -> Self {
        let names = (0..figure.trace.vehicles.len())
            .map(|index| text_width(&vehicle_name(figure, index), TEXT_SIZE))
            .fold(0.0, f64::max)
            .min(MAX_NAME_WIDTH);
        let labels = 14.0 + widest_tag + names;
        let unit = (width - 3.0 * LEFT_MARGIN - labels - 36.0) / 3.3;
        let position = PixelRect {
            left: LEFT_MARGIN,
            top: top + HEADING_HEIGHT,
            width: 1.3 * unit,
            height: height_for_labels(figure, 2.0 * ROW_HEIGHT + BETWEEN_ROWS),
        };
        let speed = PixelRect {
            left: position.right() + labels + LEFT_MARGIN + 8.0,
            width: unit,
            height: (position.height - BETWEEN_ROWS) / 2.0,
            ..position
        };
        let gap = PixelRect {
            left: speed.right() + LEFT_MARGIN + 16.0,
            ..speed
        };
        Self {
            position,
            speed,
            gap,
            acceleration: below(speed),
            ttc: below(gap),
            labels_right: position.right() + labels,
        }
    }

    /// Returns frames below each other and below the legend, with the heights of the first and of the other panels.
    fn in_column(
        figure: &MotionFigure<'_>,
        width: f64,
        top: f64,
        widest_tag: f64,
        [first_height, other_height]: [f64; 2],
    ) -> Self {
        let legend_height = LEGEND_ROW_HEIGHT * legend_rows(figure, width).len() as f64;
        let position = PixelRect {
            left: LEFT_MARGIN,
            top: top + legend_height + HEADING_HEIGHT,
            width: width - LEFT_MARGIN - widest_tag - 18.0,
            height: height_for_labels(figure, first_height),
        };
        let speed = PixelRect {
            top: position.bottom() + BOTTOM_MARGIN + HEADING_HEIGHT,
            height: other_height,
            ..position
        };
        let gap = below(speed);
        let acceleration = below(gap);
        Self {
            position,
            speed,
            gap,
            acceleration,
            ttc: below(acceleration),
            labels_right: width,
        }
    }
}

/// Returns the frame below another one.
fn below(frame: PixelRect) -> PixelRect {
    PixelRect {
        top: frame.bottom() + BETWEEN_ROWS,
        ..frame
    }
}

/// Returns the height of a panel that has room for the labels of all vehicles.
fn height_for_labels(figure: &MotionFigure<'_>, min_height: f64) -> f64 {
    min_height.max(LABEL_STEP * figure.trace.vehicles.len() as f64)
}

fn legend_rows(figure: &MotionFigure<'_>, width: f64) -> Vec<Vec<(f64, usize)>> {
    let mut rows: Vec<Vec<(f64, usize)>> = Vec::new();
    let mut x = f64::INFINITY;
    for index in 0..figure.trace.vehicles.len() {
        let name = text_width(&vehicle_name(figure, index), TEXT_SIZE);
        let entry = SWATCH_WIDTH + tag_width(&index.to_string()) + 10.0 + name;
        if x + entry > width {
            rows.push(Vec::new());
            x = 0.0;
        }
        if let Some(row) = rows.last_mut() {
            row.push((x, index));
        }
        x += entry + 10.0;
    }
    rows
}

/// Returns the name of a vehicle, truncated to fit beside its line.
pub(super) fn vehicle_name(figure: &MotionFigure<'_>, index: usize) -> String {
    figure.labels.get(index).map_or_else(String::new, |name| {
        truncate_to_width(name, TEXT_SIZE, MAX_NAME_WIDTH)
    })
}
