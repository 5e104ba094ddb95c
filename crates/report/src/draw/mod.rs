//! Figures from typed data: SVG for pages and print, PNG for other uses.
//!
//! A [`Panel`] is one chart: axes, and lines, bands, bars, markers and labels in the units of the data. [`draw_motion`]
//! combines three of them into the paper's time-space, time-speed and spacing diagrams.
//!
//! A figure has its light colours as plain attributes and is complete by itself; in a page with [`STYLE`] it follows
//! the reader's colour scheme (see [`Ink`]). Colour is never the only carrier of meaning. Equal data give equal bytes:
//! figures contain no clock, random identifier or system font.

mod axis;
mod cells;
mod closeup;
mod figure_layout;
mod label;
mod motion;
mod motion_axes;
mod panel;
mod path;
#[cfg(feature = "png")]
mod png;
mod png_error;
mod robustness;
mod scale;
mod theme;
mod vehicle_names;

use maud::{Markup, PreEscaped, html};

pub use axis::{Axis, BOTTOM_MARGIN, LEFT_MARGIN};
pub use cells::{CellStyle, draw_cells, draw_legend};
pub use label::{PixelRect, text_width};
pub use motion::{
    MotionFigure, PanelArrangement, draw_motion, draw_motion_on_axes, draw_motion_responsive,
};
pub(crate) use motion::{draw_motion_columns, draw_motions_side_by_side};
pub use motion_axes::MotionAxes;
pub use panel::{Anchor, HEADING_HEIGHT, Marker, Panel, draw_text};
pub(crate) use path::PixelPoint;
pub use png_error::DrawError;
pub use robustness::{add_levels, add_robustness};
pub use scale::{extent, format_number, pad_interval};
pub use theme::{Ink, SMALL_TEXT_SIZE, STYLE, Stroke};
pub use vehicle_names::vehicle_names;

use crumple_core::quoting::{TerminalLines, strip_unprintable};
use path::Px;

/// True if this build draws PNG.
pub const WRITES_PNG: bool = cfg!(feature = "png");

/// Pixels of a PNG per unit of the figure; a wide figure has 300 dots per inch at 16 cm.
pub const PNG_SCALE: f64 = 2.0;

/// A finished figure.
#[derive(Debug, Clone)]
pub struct Svg {
    width: f64,
    height: f64,
    prefix: String,
    title: String,
    description: String,
    content: Markup,
    role: &'static str,
}

impl Svg {
    /// Creates a figure of `width` by `height` pixels. `title` and `description` are for screen readers. `prefix`
    /// begins every identifier of the figure and must be unique in the page; see [`Svg::id`].
    #[must_use]
    pub fn new(
        prefix: &str,
        (width, height): (f64, f64),
        title: &str,
        description: &str,
        content: Markup,
    ) -> Self {
        let prefix = sanitize_id(prefix);
        Self {
            width,
            height,
            prefix,
            title: strip_unprintable(title),
            description: strip_unprintable(description),
            content,
            role: "img",
        }
    }

    /// Marks the figure as a group with links, which screen readers skip in a picture.
    #[must_use]
    pub fn with_links(self) -> Self {
        Self {
            role: "group",
            ..self
        }
    }

    /// Returns the identifier `name` of the figure with that prefix, for [`Panel::draw`].
    #[must_use]
    pub fn id(prefix: &str, name: &str) -> String {
        format!("{}-{}", sanitize_id(prefix), sanitize_id(name))
    }

    #[must_use]
    pub(crate) fn size(&self) -> (f64, f64) {
        (self.width, self.height)
    }

    /// Returns the figure as an element of an HTML page with [`STYLE`], on the page's background.
    #[must_use]
    pub fn inline(&self) -> Markup {
        self.element(false)
    }

    /// Returns the figure as a file: an SVG document on a white background.
    #[must_use]
    pub fn document(&self) -> String {
        let element = self.element(true).into_string();
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{}\n",
            TerminalLines(&element)
        )
    }

    /// Returns the figure as a PNG file on a white background, `scale` pixels per unit, usually [`PNG_SCALE`].
    ///
    /// # Errors
    /// [`DrawError::NeedsPng`] if this build lacks the feature `png` ([`WRITES_PNG`]); [`DrawError::Size`] if `scale`
    /// makes the picture empty or larger than 268 million pixels; the other variants are faults of this library.
    #[cfg(feature = "png")]
    pub fn to_png(&self, scale: f64) -> Result<Vec<u8>, DrawError> {
        png::encode(&self.document(), scale)
    }

    /// Refuses: this build lacks the feature `png`.
    ///
    /// # Errors
    /// [`DrawError::NeedsPng`].
    #[cfg(not(feature = "png"))]
    pub fn to_png(&self, _: f64) -> Result<Vec<u8>, DrawError> {
        Err(DrawError::NeedsPng)
    }

    fn element(&self, alone: bool) -> Markup {
        let width = Px(self.width);
        let height = Px(self.height);
        let title = format!("{}-title", self.prefix);
        let description = format!("{}-desc", self.prefix);
        html! {
            svg xmlns="http://www.w3.org/2000/svg" class="draw" width=(width) height=(height)
                viewBox={ "0 0 " (width) " " (height) } font-family=(theme::FONT_FAMILY) role=(self.role)
                aria-labelledby={ (title) " " (description) } {
                title id=(title) { (self.title) }
                desc id=(description) { (self.description) }
                @if alone {
                    rect width="100%" height="100%" fill=(Ink::Paper.hex()) {}
                }
                (self.content)
            }
        }
    }
}

impl maud::Render for Svg {
    fn render(&self) -> Markup {
        PreEscaped(self.inline().into_string())
    }
}

/// Renders both forms of a figure for a page with [`STYLE`], which shows the one that fits.
pub(crate) fn responsive(wide: &Svg, narrow: &Svg) -> Markup {
    html! { div.draw-wide { (wide) } div.draw-narrow { (narrow) } }
}

fn sanitize_id(text: &str) -> String {
    let name: String = text
        .chars()
        .map(|letter| {
            if letter.is_ascii_alphanumeric() || "-_".contains(letter) {
                letter
            } else {
                '-'
            }
        })
        .collect();
    if name.starts_with(|letter: char| letter.is_ascii_alphabetic()) {
        name
    } else {
        format!("f{name}")
    }
}

#[cfg(test)]
#[cfg(feature = "png")]
mod tests;
