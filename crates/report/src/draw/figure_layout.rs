//! Where the parts of a motion figure go.

use maud::{Markup, html};

use super::axis::{BOTTOM_MARGIN, LEFT_MARGIN};
use super::label::{Frame, shortened, text_width, wrapped};
use super::motion::{Layout, MotionFigure};
use super::panel::{Anchor, HEADING_HEIGHT, tag, tag_width, words};
use super::theme::{Ink, TEXT, swatch};

/// Distance between successive labels, in pixels.
pub(super) const LABEL_STEP: f64 = 15.0;

/// The most a name beside the time-space diagram may take, in pixels.
const MAX_NAME_WIDTH: f64 = 140.0;

/// Size of the figure's title.
const TITLE_SIZE: f64 = 14.0;

/// Height of a row of the key, and width of the sample of a line in it.
const LEGEND_ROW_HEIGHT: f64 = 20.0;
const SWATCH_WIDTH: f64 = 24.0;

/// Where everything goes.
pub(super) struct FigureLayout {
    pub(super) arrangement: Layout,
    pub(super) width: f64,
    pub(super) height: f64,
    title: Vec<String>,
    pub(super) position: Frame,
    pub(super) speed: Frame,
    pub(super) gap: Frame,
    /// Where the column of labels beside the time-space diagram ends.
    pub(super) labels_right: f64,
    pub(super) widest_tag: f64,
}

impl FigureLayout {
    pub(super) fn new(figure: &MotionFigure<'_>, layout: Layout) -> Self {
        let vehicles = figure.trace.vehicles.len();
        let widest_tag = tag_width(&vehicles.saturating_sub(1).to_string());
        let tall = |least: f64| least.max(LABEL_STEP * vehicles as f64);
        let width = match layout {
            Layout::Wide => 960.0,
            Layout::Stacked => 360.0,
            Layout::Column => 470.0,
        };
        let title = if figure.title.is_empty() { vec![] } else { wrapped(figure.title, TITLE, width - 4.0) };
        let top = title.len() as f64 * TITLE * 1.3;
        match layout {
            Layout::Wide => {
                let name = |index| text_width(&name_of(figure, index), TEXT);
                let names = (0..vehicles).map(name).fold(0.0, f64::max).min(MAX_NAME_WIDTH);
                let labels = 14.0 + widest_tag + names;
                let unit = (width - 3.0 * LEFT_MARGIN - labels - 36.0) / 3.3;
                let frame = |left, width| Frame { left, top: top + HEADING_HEIGHT, width, height: tall(240.0) };
                let space = frame(LEFT_MARGIN, 1.3 * unit);
                let speed = frame(space.right() + labels + LEFT_MARGIN + 8.0, unit);
                let spacing = frame(speed.right() + LEFT_MARGIN + 16.0, unit);
                let labels_right = space.right() + labels;
                let height = space.bottom() + BOTTOM_MARGIN;
                Self { layout, width, height, title, space, speed, spacing, labels_right, widest_tag }
            }
            Layout::Stacked | Layout::Column => {
                let (first, others) = if layout == Layout::Stacked { (230.0, 190.0) } else { (190.0, 130.0) };
                let plot = width - LEFT_MARGIN - widest_tag - 18.0;
                let frame = |above: f64, height| Frame { left: LEFT_MARGIN, top: above + HEADING_HEIGHT, width: plot, height };
                let space = frame(top + KEY_ROW * key(figure, width).len() as f64, tall(first));
                let speed = frame(space.bottom() + BOTTOM_MARGIN, others);
                let spacing = frame(speed.bottom() + BOTTOM_MARGIN, others);
                let height = spacing.bottom() + BOTTOM_MARGIN;
                Self { layout, width, height, title, space, speed, spacing, labels_right: width, widest_tag }
            }
        }
    }

    /// What stands above the panels: the title and, where names have no room beside the lines, a key.
    pub(super) fn draw_title_and_legend(&self, figure: &MotionFigure<'_>) -> Markup {
        let below_title = self.title.len() as f64 * TITLE * 1.3;
        html! {
            g font-weight="600" {
                @for (line, text) in self.title.iter().enumerate() {
                    @let base = TITLE * (1.0 + 1.3 * line as f64);
                    (words((0.0, base), Anchor::Start, text, TITLE, Ink::Text, false))
                }
            }
            @if self.layout != Layout::Wide {
                @for (row, entries) in key(figure, self.width).iter().enumerate() {
                    @let y = below_title + KEY_ROW * (row as f64 + 0.6);
                    @for &(x, index) in entries {
                        @let number = index.to_string();
                        @let after = x + tag_width(&number);
                        (swatch(index, x, y, SWATCH_WIDTH))
                        (tag((SWATCH_WIDTH + 3.0 + (x + after) / 2.0, y), &number, Ink::Series(index)))
                        (words((after + SWATCH_WIDTH + 7.0, y + TEXT * 0.35), Anchor::Start, &name_of(figure, index), TEXT,
                            Ink::Text, false))
                    }
                }
            }
        }
    }
}

/// Rows of the key: where each entry begins and which vehicle it names.
fn legend_rows(figure: &MotionFigure<'_>, width: f64) -> Vec<Vec<(f64, usize)>> {
    let mut rows: Vec<Vec<(f64, usize)>> = Vec::new();
    let mut x = f64::INFINITY;
    for index in 0..figure.trace.vehicles.len() {
        let name = text_width(&name_of(figure, index), TEXT);
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

/// The name of a vehicle, not too long to stand beside its line.
pub(super) fn vehicle_name(figure: &MotionFigure<'_>, index: usize) -> String {
    figure.labels.get(index).map_or_else(String::new, |name| shortened(name, TEXT, MAX_NAME_WIDTH))
}
