//! Shares of runs in percent, with exact bounds.

use serde::{Deserialize, Serialize};

use crate::assessment::Rounded;
use crate::draw::{
    Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, Marker, Panel, PixelRect, SMALL_TEXT_SIZE, Stroke,
    Svg, text_width,
};
use crumple_evidence::RateInterval;

/// Confidence level of the bounds.
pub(super) const CONFIDENCE: f64 = 0.95;

/// A share in percent with its bounds.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PercentInterval {
    /// Observed share.
    pub observed: Rounded<2>,
    /// Lower bound.
    pub lower: Rounded<2>,
    /// Upper bound.
    pub upper: Rounded<2>,
}

impl PercentInterval {
    pub(super) fn format_bounds(&self) -> String {
        format!("{} – {}", self.lower, self.upper)
    }

    /// Returns the share of `count` and its exact bounds, rounded outwards. Runs that ended early count in the upper
    /// bound only.
    pub(super) fn clopper_pearson([count, ended_by_others]: [u64; 2], total: u64) -> Self {
        let lower = RateInterval::clopper_pearson(count, total, CONFIDENCE).lower;
        let upper = RateInterval::clopper_pearson(count + ended_by_others, total, CONFIDENCE).upper;
        let observed = if total == 0 {
            0.0
        } else {
            count as f64 / total as f64
        };
        Self {
            observed: Rounded::new(100.0 * observed),
            lower: Rounded::down(100.0 * lower),
            upper: Rounded::up(100.0 * upper),
        }
    }
}

/// A share in a row of a figure.
#[derive(Clone, Copy)]
pub(super) struct ShareMark {
    pub(super) share: PercentInterval,
    /// Upward offset from the middle of the row, in rows.
    pub(super) offset: f64,
    pub(super) ink: Ink,
    pub(super) marker: Marker,
}

impl ShareMark {
    /// Adds the mark and its bounds to a panel with numbered rows.
    fn draw(&self, row: usize, panel: &mut Panel) {
        let y = row as f64 + self.offset;
        panel.add_segment(
            (self.share.lower.value(), y),
            (self.share.upper.value(), y),
            Stroke::solid(self.ink, 2.5),
        );
        panel.add_markers(&[(self.share.observed.value(), y)], self.marker, self.ink);
    }
}

/// The texts of a figure: heading, axis, title and description.
pub(super) struct ShareFigure<'a> {
    pub(super) heading: &'a str,
    pub(super) axis: &'a str,
    pub(super) title: &'a str,
    pub(super) description: &'a str,
    pub(super) row_height: f64,
}

impl ShareFigure<'_> {
    /// Draws shares with their bounds: one row for each name, from the top.
    pub(super) fn draw(&self, id: &str, rows: &[(&str, Vec<ShareMark>)]) -> Svg {
        let names: Vec<_> = rows.iter().map(|(name, _)| *name).collect();
        let left = names
            .iter()
            .map(|name| text_width(name, SMALL_TEXT_SIZE))
            .fold(0.0, f64::max)
            + 16.0;
        let width = 480.0;
        let frame = PixelRect {
            left,
            top: HEADING_HEIGHT,
            width: width - left - 24.0,
            height: self.row_height * names.len() as f64,
        };
        let axis = Axis::numeric(self.axis, (0.0, 100.0), 5);
        let mut panel = Panel::new(
            frame,
            self.heading,
            axis,
            Axis::categorical("", &names).reversed(),
        );
        for (index, (_, marks)) in rows.iter().enumerate() {
            for mark in marks {
                mark.draw(rows.len() - 1 - index, &mut panel);
            }
        }
        let size = (width, frame.bottom() + BOTTOM_MARGIN);
        Svg::new(
            id,
            size,
            self.title,
            self.description,
            panel.draw(&Svg::id(id, "panel")),
        )
    }
}
