//! A pair of axes and the layers between them, in the units of the data.

use maud::{Markup, html};

use super::axis::{Axis, LEFT_MARGIN};
use super::label::{PixelRect, place_line_labels, text_width};
use super::path::{self, PixelPoint, Px};
use super::scale::LinearScale;
use super::theme::{Ink, SMALL_TEXT_SIZE, Stroke, TEXT_SIZE};
use crumple_core::quoting::strip_unprintable;

const TAG_HEIGHT: f64 = 14.0;

/// The shape of a marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Marker {
    /// A ring.
    Ring,
    /// A diagonal cross.
    Cross,
    /// A star with eight points: collision.
    Burst,
}

/// The anchor of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// Left end.
    Start,
    /// Middle.
    Middle,
    /// Right end.
    End,
}

/// A line that gets a tag; see [`Panel::add_tags`].
#[derive(Debug, Clone)]
pub(crate) struct TaggedLine {
    /// Points of the line, from left to right.
    pub points: Vec<(f64, f64)>,
    /// Text of the tag: a word or two.
    pub tag: String,
    /// Colour of the line and its tag.
    pub ink: Ink,
}

/// A chart: axes, and layers in the order of their addition. Lines, bands and bars are clipped at the frame.
#[derive(Debug, Clone)]
pub struct Panel {
    pub(super) frame: PixelRect,
    title: String,
    x: Axis,
    y: Axis,
    x_scale: LinearScale,
    y_scale: LinearScale,
    clipped: Vec<Markup>,
    overlays: Vec<Markup>,
    occupied: Vec<PixelRect>,
}

impl Panel {
    /// Creates an empty chart with the data area `frame`; ticks and titles lie outside it, see [`Axis`].
    #[must_use]
    pub fn new(frame: PixelRect, title: &str, x: Axis, y: Axis) -> Self {
        let x_scale = LinearScale::new(x.domain, (frame.left, frame.right()));
        let y_scale = LinearScale::new(y.domain, (frame.bottom(), frame.top));
        let title = title.to_owned();
        Self {
            frame,
            title,
            x,
            y,
            x_scale,
            y_scale,
            clipped: Vec::new(),
            overlays: Vec::new(),
            occupied: Vec::new(),
        }
    }

    /// Converts a pair of values to pixels.
    #[must_use]
    pub fn to_pixels(&self, (x, y): (f64, f64)) -> PixelPoint {
        (self.x_scale.to_px(x), self.y_scale.to_px(y))
    }

    /// Converts pairs of values to pixels, without pairs that are not finite.
    #[must_use]
    pub(crate) fn points_to_pixels(&self, points: &[(f64, f64)]) -> Vec<PixelPoint> {
        points
            .iter()
            .filter(|(x, y)| x.is_finite() && y.is_finite())
            .map(|&point| self.to_pixels(point))
            .collect()
    }

    /// Adds a line through points; a single point is a dot.
    pub fn add_line(&mut self, points: &[(f64, f64)], stroke: Stroke) {
        let places = self.points_to_pixels(points);
        let Some((&(x, y), rest)) = places.split_first() else {
            return;
        };
        let dash = (!stroke.dash.is_empty()).then_some(stroke.dash);
        self.clipped.push(if rest.iter().all(|&other| other == (x, y)) {
            html! { circle cx=(Px(x)) cy=(Px(y)) r=(Px(stroke.width)) fill=(stroke.ink.hex()) {} }
        } else {
            html! {
                path d=(path::polyline_data(&places)) fill="none" stroke=(stroke.ink.hex())
                    stroke-width=(Px(stroke.width)) stroke-dasharray=[dash] stroke-linejoin="round" {}
            }
        });
    }

    /// Adds a translucent area between two lines, such as a mean plus and minus a standard deviation.
    pub(crate) fn add_band(&mut self, upper: &[(f64, f64)], lower: &[(f64, f64)], ink: Ink) {
        let outline = path::area_data(&self.points_to_pixels(upper), &self.points_to_pixels(lower));
        self.clipped
            .push(html! { path d=(outline) fill=(ink.hex()) fill-opacity="0.22" {} });
    }

    pub(crate) fn add_segment(&mut self, from: (f64, f64), to: (f64, f64), stroke: Stroke) {
        let line = draw_line(self.to_pixels(from), self.to_pixels(to), stroke);
        self.clipped.push(line);
    }

    pub(crate) fn add_vertical_line(&mut self, value: f64, stroke: Stroke) {
        let x = self.to_pixels((value, 0.0)).0;
        self.clipped.push(draw_line(
            (x, self.frame.top),
            (x, self.frame.bottom()),
            stroke,
        ));
    }

    /// Adds a horizontal line over the full width.
    pub fn add_horizontal_line(&mut self, value: f64, stroke: Stroke) {
        let y = self.to_pixels((0.0, value)).1;
        self.clipped.push(draw_line(
            (self.frame.left, y),
            (self.frame.right(), y),
            stroke,
        ));
    }

    /// Adds markers, which tags avoid. Markers outside the frame are omitted.
    pub fn add_markers(&mut self, points: &[(f64, f64)], marker: Marker, ink: Ink) {
        for point in self.points_to_pixels(points) {
            if self.frame.contains(point) {
                self.occupied
                    .push(PixelRect::from_center(point, 10.0, 10.0));
                self.overlays.push(draw_marker(point, marker, ink));
            }
        }
    }

    /// Adds text with a halo at a pair of values; tags avoid it.
    pub fn add_note(&mut self, at: (f64, f64), anchor: Anchor, text: &str, ink: Ink) {
        let point = self.to_pixels(at);
        let width = text_width(text, SMALL_TEXT_SIZE);
        let middle = match anchor {
            Anchor::Start => point.0 + width / 2.0,
            Anchor::Middle => point.0,
            Anchor::End => point.0 - width / 2.0,
        };
        self.occupied.push(PixelRect::from_center(
            (middle, point.1),
            width,
            SMALL_TEXT_SIZE * 1.2,
        ));
        let base = (point.0, point.1 + SMALL_TEXT_SIZE * 0.35);
        self.overlays
            .push(draw_text(base, anchor, text, SMALL_TEXT_SIZE, ink, true));
    }

    /// Adds content in pixels, above the data.
    pub fn add_overlay(&mut self, content: Markup) {
        self.overlays.push(content);
    }

    /// Adds a tag to each line that has room for one. Call this last: tags avoid the existing content.
    pub(crate) fn add_tags(&mut self, lines: &[TaggedLine]) {
        let simplified: Vec<_> = lines
            .iter()
            .map(|line| path::simplify(&self.points_to_pixels(&line.points)))
            .collect();
        let sizes: Vec<_> = lines
            .iter()
            .map(|line| (tag_width(&line.tag), TAG_HEIGHT))
            .collect();
        let centres = place_line_labels(&simplified, &sizes, self.frame, &mut self.occupied);
        for (line, centre) in lines.iter().zip(centres) {
            self.overlays
                .extend(centre.map(|centre| draw_tag(centre, &line.tag, line.ink)));
        }
    }

    /// Renders the chart. `id` must be unique in the page.
    #[must_use]
    pub fn draw(self, id: &str) -> Markup {
        let PixelRect {
            left,
            top,
            width,
            height,
        } = self.frame;
        html! {
            @if !self.title.is_empty() {
                text x=(Px(left - LEFT_MARGIN)) y=(Px(top - HEADING_HEIGHT + 16.0)) font-size=(Px(TEXT_SIZE))
                    font-weight="600" fill=(Ink::Text.hex()) { (strip_unprintable(&self.title)) }
            }
            (self.x.draw_horizontal(&self.x_scale, self.frame))
            (self.y.draw_vertical(&self.y_scale, self.frame))
            clipPath id=(id) {
                rect x=(Px(left)) y=(Px(top - 1.0)) width=(Px(width)) height=(Px(height + 2.0)) {}
            }
            g clip-path={ "url(#" (id) ")" } {
                @for layer in &self.clipped { (layer) }
            }
            @for layer in &self.overlays { (layer) }
        }
    }
}

/// Height above a panel's frame for its heading and a line of notes, in pixels.
pub const HEADING_HEIGHT: f64 = 40.0;

/// Draws text at a point on its baseline, in pixels; a halo makes it readable over lines.
#[must_use]
pub fn draw_text(
    (x, y): PixelPoint,
    anchor: Anchor,
    text: &str,
    size: f64,
    ink: Ink,
    halo: bool,
) -> Markup {
    let anchor = match anchor {
        Anchor::Start => None,
        Anchor::Middle => Some("middle"),
        Anchor::End => Some("end"),
    };
    let stroke = halo.then_some(Ink::Paper.hex());
    let width = halo.then_some("3");
    let join = halo.then_some("round");
    let order = halo.then_some("stroke");
    html! {
        text x=(Px(x)) y=(Px(y)) text-anchor=[anchor] font-size=(Px(size)) fill=(ink.hex()) stroke=[stroke]
            stroke-width=[width] stroke-linejoin=[join]
            paint-order=[order] { (strip_unprintable(text)) }
    }
}

#[must_use]
pub(crate) fn tag_width(text: &str) -> f64 {
    (text_width(text, SMALL_TEXT_SIZE) + 7.0).max(TAG_HEIGHT + 1.0)
}

/// Draws a short label in a rounded box around `centre`, in pixels.
#[must_use]
pub(crate) fn draw_tag(centre: PixelPoint, text: &str, ink: Ink) -> Markup {
    let PixelRect {
        left,
        top,
        width,
        height,
    } = PixelRect::from_center(centre, tag_width(text), TAG_HEIGHT);
    html! {
        rect x=(Px(left)) y=(Px(top)) width=(Px(width)) height=(Px(height)) rx=(Px(height / 2.0))
            fill=(Ink::Paper.hex()) stroke=(ink.hex()) stroke-width="1.2" {}
        (draw_text((centre.0, centre.1 + SMALL_TEXT_SIZE * 0.35), Anchor::Middle, text, SMALL_TEXT_SIZE, ink, false))
    }
}

#[must_use]
pub(crate) fn draw_line(from: PixelPoint, to: PixelPoint, stroke: Stroke) -> Markup {
    let dash = (!stroke.dash.is_empty()).then_some(stroke.dash);
    html! {
        path d=(path::polyline_data(&[from, to])) stroke=(stroke.ink.hex()) stroke-width=(Px(stroke.width))
            stroke-dasharray=[dash] {}
    }
}

/// Draws a marker with a thin halo at a point, in pixels.
#[must_use]
pub(crate) fn draw_marker((x, y): PixelPoint, marker: Marker, ink: Ink) -> Markup {
    let paper = Ink::Paper.hex();
    let ink = ink.hex();
    match marker {
        Marker::Ring => {
            html! { circle cx=(Px(x)) cy=(Px(y)) r="3.6" fill=(paper) stroke=(ink) stroke-width="1.6" {} }
        }
        Marker::Cross => html! {
            path d={ "M" (Px(x - 3.2)) " " (Px(y - 3.2)) "l6.4 6.4m0-6.4l-6.4 6.4" } stroke=(ink) stroke-width="1.6" {}
        },
        Marker::Burst => {
            html! { path d=(burst_path(x, y)) fill=(ink) stroke=(paper) stroke-width="1" {} }
        }
    }
}

fn burst_path(x: f64, y: f64) -> String {
    let corners = (0..16_u32).map(|index| {
        let radius = if index.is_multiple_of(2) { 7.5 } else { 3.4 };
        let (sin, cos) = (f64::from(index) * std::f64::consts::PI / 8.0).sin_cos();
        format!("{} {}", Px(x + radius * sin), Px(y - radius * cos))
    });
    format!("M{}Z", corners.collect::<Vec<_>>().join(" "))
}
