//! Figures of campaigns in the style of reports; their marks link to scenarios.

use crumple_report::draw::{
    Anchor, Axis, BOTTOM_MARGIN, CellStyle, HEADING_HEIGHT, Ink, LEFT_MARGIN, Panel, PixelRect,
    SMALL_TEXT_SIZE, Stroke, Svg, draw_cells, draw_legend, draw_text, extent, format_number,
    pad_interval, text_width,
};
use crumple_search::falsify::Method;
use maud::{Markup, html};

use super::CampaignView;
use super::grid::{FailureGrid, GridCell};

const HEIGHT: f64 = 240.0;
const CELL_HEIGHT: f64 = 30.0;

fn width(narrow: bool) -> f64 {
    if narrow { 380.0 } else { 720.0 }
}

fn panel_frame(narrow: bool) -> PixelRect {
    PixelRect {
        left: LEFT_MARGIN + 12.0,
        top: HEADING_HEIGHT,
        width: width(narrow) - LEFT_MARGIN - 24.0,
        height: HEIGHT,
    }
}

/// Draws the smallest robustness so far over the evaluations of each method.
pub(super) fn best_robustness_figure(shown: &[CampaignView<'_>], narrow: bool) -> Markup {
    let lines = robustness_lines(shown);
    let points: Vec<(f64, f64)> = lines.iter().flat_map(|(_, line)| line).copied().collect();
    let most = points.iter().map(|point| point.0).fold(1.0, f64::max);
    // The x-axis is logarithmic.
    let marks = (0..=most.log10().ceil().max(1.0) as i32)
        .map(|power| (f64::from(power), format!("{}", 10f64.powi(power))));
    let x = Axis::with_ticks(
        "evaluations of the method",
        (0.0, most.log10().max(1.0)),
        marks.collect(),
    );
    let robustness = points.iter().map(|point| point.1).chain([0.0]);
    let y = Axis::numeric("", pad_interval(extent(robustness), 0.05), 6);
    let title = "Lowest robustness (below 0 a failure)";
    let mut panel = Panel::new(panel_frame(narrow), title, x, y);
    panel.add_horizontal_line(0.0, Stroke::solid(Ink::Alert, 1.0));
    let mut entries = Vec::new();
    for (index, (name, line)) in lines.iter().enumerate() {
        let line: Vec<(f64, f64)> = line.iter().map(|(x, y)| (x.log10(), *y)).collect();
        panel.add_line(&line, Stroke::series(index));
        entries.push((Stroke::series(index), name.as_str()));
    }
    let description = "Smallest robustness that each method had found, against its number of \
        evaluations (logarithmic scale).";
    let (key, key_height) = draw_legend(&entries, width(narrow) - 12.0);
    let top = panel_frame(narrow).bottom() + BOTTOM_MARGIN + 6.0;
    let content = html! {
        (panel.draw(&Svg::id("best", "frame")))
        g transform={ "translate(12 " (top) ")" } { (key) }
    };
    Svg::new(
        "best",
        (width(narrow), top + key_height),
        title,
        description,
        content,
    )
    .inline()
}

/// Returns the name and the curve of each method of each campaign.
fn robustness_lines(shown: &[CampaignView<'_>]) -> Vec<(String, Vec<(f64, f64)>)> {
    let mut lines = Vec::new();
    for campaign in shown {
        for method in campaign.reader.methods() {
            let name = if shown.len() > 1 {
                format!("{}: {}", campaign.name, method.name())
            } else {
                method.name().to_owned()
            };
            lines.push((name, best_so_far(campaign, &method)));
        }
    }
    lines
}

/// Returns the points at which the smallest robustness of a method decreases, and its last point.
fn best_so_far(campaign: &CampaignView<'_>, wanted: &Method) -> Vec<(f64, f64)> {
    let mut line: Vec<(f64, f64)> = Vec::new();
    let mut least = f64::INFINITY;
    let mut last = 0;
    for (_, evaluated) in campaign
        .reader
        .evaluations()
        .iter()
        .filter(|(method, _)| method == wanted)
    {
        last = evaluated.number;
        let robustness = evaluated.verdict.robustness;
        if robustness.is_finite() && robustness < least {
            if least.is_finite() {
                line.push((last as f64, least));
            }
            least = robustness;
            line.push((last as f64, least));
        }
    }
    if least.is_finite() {
        line.push((last as f64, least));
    }
    line
}

/// Positions of the cells of a failure grid.
struct GridLayout {
    columns: usize,
    cell_width: f64,
    frame: PixelRect,
}

impl GridLayout {
    fn new(map: &FailureGrid, narrow: bool) -> Self {
        let widest = map
            .y_axis
            .cell_bounds
            .iter()
            .map(|(from, _)| text_width(from, SMALL_TEXT_SIZE))
            .fold(0.0, f64::max);
        let columns = map.x_axis.cell_bounds.len();
        let rows = map.y_axis.cell_bounds.len();
        let left = widest + 16.0;
        let cell_width = ((width(narrow) - left - 14.0) / columns as f64).min(2.0 * CELL_HEIGHT);
        Self {
            columns,
            cell_width,
            frame: PixelRect {
                left,
                top: HEADING_HEIGHT + 4.0,
                width: cell_width * columns as f64,
                height: CELL_HEIGHT * rows as f64,
            },
        }
    }

    /// Returns the frame of a cell. The smallest value is at the bottom.
    fn cell_frame(&self, index: usize) -> PixelRect {
        let row = index / self.columns;
        let column = index % self.columns;
        PixelRect {
            left: self.frame.left + column as f64 * self.cell_width,
            top: self.frame.bottom() - (row + 1) as f64 * CELL_HEIGHT,
            width: self.cell_width,
            height: CELL_HEIGHT,
        }
    }

    fn frames_where(
        &self,
        cells: &[GridCell],
        is_wanted: fn(&GridCell) -> bool,
    ) -> impl Iterator<Item = PixelRect> {
        cells
            .iter()
            .enumerate()
            .filter(move |(_, cell)| is_wanted(cell))
            .map(|(index, _)| self.cell_frame(index))
    }

    /// Draws which share of the evaluations in each cell fails.
    fn draw_counts(&self, cells: &[GridCell]) -> Markup {
        let safe = self.frames_where(cells, |cell| cell.total > 0 && cell.failing == 0);
        let mixed = self.frames_where(cells, |cell| cell.failing > 0 && cell.failing < cell.total);
        html! {
            (draw_cells(CellStyle::Blank, safe))
            (draw_cells(CellStyle::Crossed, mixed))
            @for (index, cell) in cells.iter().enumerate().filter(|(_, c)| c.failing > 0 && c.failing == c.total) {
                @let PixelRect { left, top, width, height } = self.cell_frame(index);
                rect x=(px(left)) y=(px(top)) width=(px(width)) height=(px(height)) fill=(Ink::Alert.hex())
                    fill-opacity="0.5" {}
                @let at = (left + width / 2.0, top + height / 2.0 + 4.0);
                (draw_text(at, Anchor::Middle, &cell.failing.to_string(), SMALL_TEXT_SIZE, Ink::Text, false))
            }
        }
    }

    /// Draws the lower bounds or the names of the cells, and the title of the x-axis.
    fn draw_axis_labels(&self, map: &FailureGrid) -> Markup {
        let frame = &self.frame;
        let x_cells = map.x_axis.cell_bounds.iter().enumerate();
        let x_title = format!("{} →", map.x_axis.title());
        html! {
            @for (index, (from, _)) in map.y_axis.cell_bounds.iter().enumerate() {
                @let cells_below = index as f64 + if map.y_axis.is_named { 0.5 } else { 0.0 };
                @let y = frame.bottom() - cells_below * CELL_HEIGHT + 4.0;
                (draw_text((frame.left - 5.0, y), Anchor::End, from, SMALL_TEXT_SIZE, Ink::Text, false))
            }
            @for (index, (from, _)) in x_cells.filter(|(index, _)| map.x_axis.is_named || index % 3 == 0) {
                @let x = frame.left + (index as f64 + if map.x_axis.is_named { 0.5 } else { 0.0 }) * self.cell_width;
                (draw_text((x, frame.bottom() + 15.0), Anchor::Middle, from, SMALL_TEXT_SIZE, Ink::Text, false))
            }
            @let at = (frame.right(), frame.bottom() + 31.0);
            (draw_text(at, Anchor::End, &x_title, SMALL_TEXT_SIZE, Ink::Muted, false))
        }
    }

    /// Draws a link to the worst scenario of each cell, with a description.
    fn draw_links(&self, map: &FailureGrid, campaign: usize) -> Markup {
        html! {
            @for (index, cell) in map.cells.iter().enumerate() {
                @if let Some((worst, robustness)) = cell.worst {
                    @let PixelRect { left, top, width, height } = self.cell_frame(index);
                    @let text = format!("{}, {}: {} of {} fail, worst robustness {}",
                        map.x_axis.cell_label(index % self.columns), map.y_axis.cell_label(index / self.columns),
                        cell.failing, cell.total, format_number(robustness, 2));
                    a href={ "./?campaign=" (campaign) "&evaluation=" (worst) } aria-label=(text) {
                        title { (text) }
                        rect class="cell" x=(px(left)) y=(px(top)) width=(px(width)) height=(px(height))
                            fill="transparent" {}
                    }
                }
            }
        }
    }
}

/// Draws the number of evaluations and failures in each cell.
pub(super) fn failure_grid_figure(
    shown: &CampaignView<'_>,
    map: &FailureGrid,
    narrow: bool,
) -> Markup {
    let layout = GridLayout::new(map, narrow);
    let frame = &layout.frame;
    let prefix = format!("map-{}", shown.index);
    let title = format!("{} over {}", map.y_axis.title(), map.x_axis.title());
    let content = html! {
        (draw_text((4.0, 15.0), Anchor::Start, shown.name, SMALL_TEXT_SIZE + 1.0, Ink::Text, false))
        @let y_title = format!("↑ {}", map.y_axis.title());
        (draw_text((4.0, 32.0), Anchor::Start, &y_title, SMALL_TEXT_SIZE, Ink::Muted, false))
        (layout.draw_counts(&map.cells))
        rect x=(px(frame.left)) y=(px(frame.top)) width=(px(frame.width)) height=(px(frame.height)) fill="none"
            stroke=(Ink::Axis.hex()) {}
        (layout.draw_axis_labels(map))
        (layout.draw_links(map, shown.index))
    };
    let description = "Green: no evaluation fails. Crossed: some fail. Red with a number: all fail. Blank: no \
    evaluation. Each cell links to its worst scenario.";
    let size = (
        (frame.right() + 14.0).max(width(narrow).min(320.0)),
        frame.bottom() + 40.0,
    );
    html! { div.map { (Svg::new(&prefix, size, &title, description, content).with_links()) } }
}

fn px(length: f64) -> String {
    format!("{length:.1}")
}
