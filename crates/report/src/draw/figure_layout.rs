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
const MAX_NAME_WIDTH: f64 = 140.0;

const TITLE_SIZE: f64 = 14.0;

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
    /// Right end of the column of labels beside the time-space diagram.
    pub(super) labels_right: f64,
    pub(super) widest_tag: f64,
}

impl FigureLayout {
    pub(super) fn new(figure: &MotionFigure<'_>, layout: PanelArrangement) -> Self {
        let vehicles = figure.trace.vehicles.len();
        let widest_tag = tag_width(&vehicles.saturating_sub(1).to_string());
        let tall = |least: f64| least.max(LABEL_STEP * vehicles as f64);
        let width = match layout {
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
        let ([position, speed, gap], labels_right) = match layout {
            PanelArrangement::Wide => {
                let name = |index| text_width(&vehicle_name(figure, index), TEXT_SIZE);
                let names = (0..vehicles)
                    .map(name)
                    .fold(0.0, f64::max)
                    .min(MAX_NAME_WIDTH);
                let labels = 14.0 + widest_tag + names;
                let unit = (width - 3.0 * LEFT_MARGIN - labels - 36.0) / 3.3;
                let frame = |left, width| PixelRect {
                    left,
                    top: top + HEADING_HEIGHT,
                    width,
                    height: tall(240.0),
                };
                let position = frame(LEFT_MARGIN, 1.3 * unit);
                let speed = frame(position.right() + labels + LEFT_MARGIN + 8.0, unit);
                let gap = frame(speed.right() + LEFT_MARGIN + 16.0, unit);
                ([position, speed, gap], position.right() + labels)
            }
            PanelArrangement::Stacked | PanelArrangement::Column => {
                let (first, others) = if layout == PanelArrangement::Stacked {
                    (230.0, 190.0)
                } else {
                    (190.0, 130.0)
                };
                let width_of_plot = width - LEFT_MARGIN - widest_tag - 18.0;
                let frame = |above: f64, height| PixelRect {
                    left: LEFT_MARGIN,
                    top: above + HEADING_HEIGHT,
                    width: width_of_plot,
                    height,
                };
                let position = frame(
                    top + LEGEND_ROW_HEIGHT * legend_rows(figure, width).len() as f64,
                    tall(first),
                );
                let speed = frame(position.bottom() + BOTTOM_MARGIN, others);
                (
                    [
                        position,
                        speed,
                        frame(speed.bottom() + BOTTOM_MARGIN, others),
                    ],
                    width,
                )
            }
        };
        // In a row all panels end at the same height.
        let height = gap.bottom() + BOTTOM_MARGIN;
        Self {
            arrangement: layout,
            width,
            height,
            title,
            position,
            speed,
            gap,
            labels_right,
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
