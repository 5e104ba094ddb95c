//! Axes with numbers or names.

use maud::{Markup, html};

use super::label::PixelRect;
use super::panel::{Anchor, draw_line, draw_text};
use super::path::Px;
use super::scale::{LinearScale, Ticks, drawable_interval};
use super::theme::{Ink, SMALL_TEXT_SIZE, Stroke};
use crumple_core::quoting::strip_unprintable;

/// Width left of a panel's frame for ticks and their labels, in pixels.
pub const LEFT_MARGIN: f64 = 38.0;

/// Height below a panel's frame for ticks, their labels and the axis title, in pixels.
pub const BOTTOM_MARGIN: f64 = 36.0;

/// An axis of a panel. Only the horizontal axis has a title; that of the vertical axis is the panel's title.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    title: String,
    pub(super) domain: (f64, f64),
    ticks: Vec<(f64, String)>,
    has_grid: bool,
}

impl Axis {
    /// Creates an axis of numbers with at most `max_labels` (clamped to 5 to 10) labels.
    #[must_use]
    pub fn numeric(title: &str, domain: (f64, f64), max_labels: usize) -> Self {
        let domain = drawable_interval(domain);
        let marks = Ticks::new(domain, max_labels).labels().collect();
        Self {
            title: title.to_owned(),
            domain,
            ticks: marks,
            has_grid: true,
        }
    }

    /// Creates an axis with given labels, for scales that are not linear, such as logarithmic ones.
    #[must_use]
    pub fn with_ticks(title: &str, domain: (f64, f64), marks: Vec<(f64, String)>) -> Self {
        Self {
            title: title.to_owned(),
            domain: drawable_interval(domain),
            ticks: marks,
            has_grid: true,
        }
    }

    /// Creates an axis of names: the `n`-th at the value `n`, with half a unit around. Vertical axes need space for
    /// them left of the frame: the [`text_width`](super::text_width) of the longest.
    #[must_use]
    pub fn categorical<S: AsRef<str>>(title: &str, names: &[S]) -> Self {
        let marks = names
            .iter()
            .enumerate()
            .map(|(index, name)| (index as f64, name.as_ref().to_owned()))
            .collect();
        let domain = (-0.5, names.len().max(1) as f64 - 0.5);
        Self {
            title: title.to_owned(),
            domain,
            ticks: marks,
            has_grid: false,
        }
    }

    /// Creates an axis that is not drawn.
    #[must_use]
    pub fn hidden(domain: (f64, f64)) -> Self {
        Self {
            title: String::new(),
            domain: drawable_interval(domain),
            ticks: Vec::new(),
            has_grid: false,
        }
    }

    /// Reverses the axis, for names that read from top to bottom.
    #[must_use]
    pub(crate) fn reversed(mut self) -> Self {
        let (low, high) = self.domain;
        for (value, _) in &mut self.ticks {
            *value = low + high - *value;
        }
        self
    }

    pub(super) fn draw_horizontal(&self, scale: &LinearScale, frame: PixelRect) -> Markup {
        let bottom = frame.bottom();
        html! {
            @for (value, label) in &self.ticks {
                @let x = scale.to_px(*value);
                @if self.has_grid {
                    (draw_line((x, frame.top), (x, bottom), Stroke::solid(Ink::Grid, 0.8)))
                    (draw_line((x, bottom), (x, bottom + 4.0), Stroke::solid(Ink::Axis, 1.0)))
                }
                (draw_text((x, bottom + 15.0), Anchor::Middle, label, SMALL_TEXT_SIZE, Ink::Text, false))
            }
            @if !self.ticks.is_empty() {
                (draw_line((frame.left, bottom), (frame.right(), bottom), Stroke::solid(Ink::Axis, 1.0)))
            }
            @if !self.title.is_empty() {
                @let baseline = (frame.right(), bottom + 30.0);
                (draw_text(baseline, Anchor::End, &self.title, SMALL_TEXT_SIZE, Ink::Muted, false))
            }
        }
    }

    pub(super) fn draw_vertical(&self, scale: &LinearScale, frame: PixelRect) -> Markup {
        html! {
            @for (value, label) in &self.ticks {
                @let y = scale.to_px(*value);
                @if self.has_grid {
                    (draw_line((frame.left, y), (frame.right(), y), Stroke::solid(Ink::Grid, 0.8)))
                }
                text x=(Px(frame.left - 6.0)) y=(Px(y + SMALL_TEXT_SIZE * 0.35)) text-anchor="end"
                    font-size=(Px(SMALL_TEXT_SIZE)) fill=(Ink::Text.hex()) { (strip_unprintable(label)) }
            }
        }
    }
}
