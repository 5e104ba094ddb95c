//! Pictures from typed data: SVG for pages and print, PNG for everything else.
//!
//! A [`Panel`] is one chart: axes, and lines, bands, bars, marks and labels in the units of the data. [`motion()`] puts
//! three of them together into the paper's time-space, time-speed and spacing diagrams, and [`animation()`] shows the run
//! from above.
//!
//! A figure carries its light colours as plain attributes and is complete by itself; in a page that holds [`STYLE`] it
//! follows the reader's colour scheme (see [`Ink`]). Nothing is said by colour alone. The same data give the same
//! bytes: there is no clock, no random identifier and no system font in them.

mod animation;
mod animation_data;
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
mod scale;
mod theme;
mod vehicle_names;

use maud::{Markup, PreEscaped, html};

pub use animation::{ANIMATION_SCRIPT, ANIMATION_STYLE, draw_animation};
pub use axis::{Axis, BOTTOM_MARGIN, LEFT_MARGIN};
pub(crate) use cells::grid_rects;
pub use cells::{CellStyle, LegendEntry, draw_cells, draw_legend};
pub use label::{PixelRect, text_width};
pub use motion::{MotionFigure, PanelArrangement, draw_motion, draw_motion_on_axes, draw_motion_responsive};
pub(crate) use motion::{draw_motion_columns, draw_motions_side_by_side};
pub use motion_axes::MotionAxes;
pub(crate) use panel::TaggedLine;
pub use panel::{Anchor, HEADING_HEIGHT, Marker, Panel, draw_marker, draw_text};
pub(crate) use path::PixelPoint;
#[cfg(feature = "png")]
pub use png::DrawError;
pub(crate) use scale::Ticks;
pub use scale::{extent, format_number, pad_interval};
pub use theme::{Ink, SMALL_TEXT_SIZE, STYLE, Stroke};
pub use vehicle_names::vehicle_names;

use crumple_core::quoting::TerminalLines;
pub(crate) use label::strip_unprintable;
use path::Px;

/// Pixels of a PNG to one unit of the figure: sharp on a dense screen, and a wide figure has 300 dots an inch at 16 cm.
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
    /// A figure of `width` by `height` pixels at full size.
    ///
    /// `title` and `description` are what a screen reader says. Identifiers inside the figure begin with `prefix`,
    /// which must differ between the figures of a page; see [`Svg::id`].
    #[must_use]
    pub fn new(prefix: &str, (width, height): (f64, f64), title: &str, description: &str, content: Markup) -> Self {
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

    /// The same as something that holds links: what is in a picture a screen reader does not tell of.
    #[must_use]
    pub fn with_links(self) -> Self {
        Self { role: "group", ..self }
    }

    /// The identifier `name` of the figure with that prefix, as [`Panel::draw`] wants it.
    #[must_use]
    pub fn id(prefix: &str, name: &str) -> String {
        format!("{}-{}", sanitize_id(prefix), sanitize_id(name))
    }

    /// Width and height at full size, in pixels.
    #[must_use]
    pub(crate) fn size(&self) -> (f64, f64) {
        (self.width, self.height)
    }

    /// The figure as an element of an HTML page that holds [`STYLE`]; its ground is the page's.
    #[must_use]
    pub fn inline(&self) -> Markup {
        self.element(false)
    }

    /// The figure as a file: an SVG document on a white ground.
    #[must_use]
    pub fn document(&self) -> String {
        let element = self.element(true).into_string();
        format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{}\n", TerminalLines(&element))
    }

    /// The figure as a PNG file on a white ground, `scale` pixels to a unit, usually [`PNG_SCALE`].
    ///
    /// # Errors
    /// [`DrawError::Size`] if `scale` makes the picture empty or larger than 268 million pixels; the other variants
    /// are faults of this library.
    #[cfg(feature = "png")]
    pub fn to_png(&self, scale: f64) -> Result<Vec<u8>, DrawError> {
        png::encode(&self.document(), scale)
    }

    fn element(&self, alone: bool) -> Markup {
        let (width, height) = (Px(self.width), Px(self.height));
        let (title, description) = (format!("{}-title", self.prefix), format!("{}-desc", self.prefix));
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

/// Letters, digits, hyphens and underscores of `text`, after a letter.
fn sanitize_id(text: &str) -> String {
    let plain = |letter: char| if letter.is_ascii_alphanumeric() || "-_".contains(letter) { letter } else { '-' };
    let name: String = text.chars().map(plain).collect();
    if name.starts_with(|letter: char| letter.is_ascii_alphabetic()) { name } else { format!("f{name}") }
}

#[cfg(test)]
#[cfg(feature = "png")]
mod tests;
