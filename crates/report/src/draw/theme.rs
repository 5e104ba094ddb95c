//! The visual style of all figures: inks, strokes, dashes, and the style sheet with dark colours.

use maud::{Markup, html};

use super::path::Px;

/// Requested fonts, best first. The page decides; the layout assumes the widest.
pub(super) const FONT_FAMILY: &str =
    "system-ui, 'Segoe UI', Roboto, Ubuntu, 'Helvetica Neue', Arial, sans-serif";

/// Size of ordinary text, in the figure's units (CSS pixels at full size).
pub(crate) const TEXT_SIZE: f64 = 12.0;

/// Size of tick labels, tags and notes.
pub const SMALL_TEXT_SIZE: f64 = 11.0;

/// Number of series colours. It is coprime to the number of [`DASHES`], so that their combinations repeat late.
pub(crate) const SERIES_COLOUR_COUNT: usize = 5;

/// Dash patterns, solid first; a series has the same pattern in every panel.
pub(crate) const DASHES: [&str; 4] = ["", "8 3.5", "2.2 2.6", "9 3 2.2 3"];

/// A colour by its role. Light colours are plain attributes of the figure, so that it needs no style sheet. [`STYLE`]
/// selects elements by those values and replaces them by CSS variables, which have other values in dark mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Ink {
    /// Titles, tick labels and other main text.
    Text,
    /// Notes and axis titles.
    Muted,
    /// Axis lines and ticks.
    Axis,
    /// Grid lines.
    Grid,
    /// Background and halos.
    Paper,
    /// Collision and failure. Always accompanied by a marker or a word.
    Alert,
    /// The `n`-th series; colours repeat after `SERIES_COLOUR_COUNT`.
    Series(usize),
}

impl Ink {
    /// Returns the light-mode colour, different for each ink. Series have the Okabe–Ito palette (Okabe and Ito, "Color
    /// Universal Design", 2008) with its lighter hues darkened until each has a contrast of 4.5 to 1 against white.
    #[must_use]
    pub fn hex(self) -> &'static str {
        match self {
            Self::Text => "#1b1f24",
            Self::Muted => "#59626d",
            Self::Axis => "#8b939d",
            Self::Grid => "#e4e7eb",
            Self::Paper => "#ffffff",
            Self::Alert => "#b3001b",
            Self::Series(index) => match index % SERIES_COLOUR_COUNT {
                0 => "#0067a3",
                1 => "#b84a00",
                2 => "#007355",
                3 => "#974a80",
                _ => "#806000",
            },
        }
    }
}

/// The stroke of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    /// Colour.
    pub ink: Ink,
    /// Width in pixels.
    pub width: f64,
    /// SVG dash pattern; empty for solid.
    pub dash: &'static str,
}

impl Stroke {
    /// Creates a solid stroke.
    #[must_use]
    pub fn solid(ink: Ink, width: f64) -> Self {
        Self {
            ink,
            width,
            dash: "",
        }
    }

    /// Returns the stroke of the `index`-th series: colour and dash repeat together only after twenty.
    #[must_use]
    pub fn series(index: usize) -> Self {
        Self {
            ink: Ink::Series(index),
            width: 1.8,
            dash: series_dash(index),
        }
    }
}

fn series_dash(index: usize) -> &'static str {
    DASHES
        .get(index % DASHES.len())
        .copied()
        .unwrap_or_default()
}

/// Draws a sample of a series' line, for legends.
pub(super) fn draw_swatch(index: usize, x: f64, y: f64, width: f64) -> Markup {
    let Stroke {
        ink,
        width: stroke_width,
        dash,
    } = Stroke::series(index);
    let dash = (!dash.is_empty()).then_some(dash);
    html! {
        path d={ "M" (Px(x)) " " (Px(y)) "h" (Px(width)) } fill="none" stroke=(ink.hex())
            stroke-width=(Px(stroke_width)) stroke-dasharray=[dash] {}
    }
}

/// Style sheet of a page with figures: once per page, in a `<style>` element. Figures follow the reader's colour scheme
/// on screen and are light in print. A page sets its own colours through the `--draw-…` variables. Elements of class
/// `draw-wide` are shown on wide pages, those of class `draw-narrow` on narrow ones.
pub const STYLE: &str = r##"
:where(.draw){--draw-text:#1b1f24;--draw-muted:#59626d;--draw-axis:#8b939d;--draw-grid:#e4e7eb;--draw-paper:#fff;
--draw-alert:#b3001b;--draw-0:#0067a3;--draw-1:#b84a00;--draw-2:#007355;--draw-3:#974a80;--draw-4:#806000}
@media screen and (prefers-color-scheme:dark){
:where(.draw){--draw-text:#e8ebef;--draw-muted:#a7b0bb;--draw-axis:#6d7681;--draw-grid:#2a3037;--draw-paper:#14171b;
--draw-alert:#ff7a7a;--draw-0:#5cb8f0;--draw-1:#f59a4c;--draw-2:#3fcf9f;--draw-3:#e59bcb;--draw-4:#e2bd3c}}
.draw{display:block;max-width:100%;height:auto;break-inside:avoid}
.draw-narrow .draw{width:100%;max-width:480px}
.draw [fill="#1b1f24"]{fill:var(--draw-text)}.draw [stroke="#1b1f24"]{stroke:var(--draw-text)}
.draw [fill="#59626d"]{fill:var(--draw-muted)}.draw [stroke="#59626d"]{stroke:var(--draw-muted)}
.draw [fill="#8b939d"]{fill:var(--draw-axis)}.draw [stroke="#8b939d"]{stroke:var(--draw-axis)}
.draw [fill="#e4e7eb"]{fill:var(--draw-grid)}.draw [stroke="#e4e7eb"]{stroke:var(--draw-grid)}
.draw [fill="#ffffff"]{fill:var(--draw-paper)}.draw [stroke="#ffffff"]{stroke:var(--draw-paper)}
.draw [fill="#b3001b"]{fill:var(--draw-alert)}.draw [stroke="#b3001b"]{stroke:var(--draw-alert)}
.draw [fill="#0067a3"]{fill:var(--draw-0)}.draw [stroke="#0067a3"]{stroke:var(--draw-0)}
.draw [fill="#b84a00"]{fill:var(--draw-1)}.draw [stroke="#b84a00"]{stroke:var(--draw-1)}
.draw [fill="#007355"]{fill:var(--draw-2)}.draw [stroke="#007355"]{stroke:var(--draw-2)}
.draw [fill="#974a80"]{fill:var(--draw-3)}.draw [stroke="#974a80"]{stroke:var(--draw-3)}
.draw [fill="#806000"]{fill:var(--draw-4)}.draw [stroke="#806000"]{stroke:var(--draw-4)}
.draw-beside{display:grid;grid-template-columns:repeat(2,minmax(0,1fr));gap:.6rem 1.2rem;align-items:end}
.draw-narrow{display:none}
@media screen and (max-width:760px){.draw-wide{display:none}.draw-narrow{display:block}}
"##;

#[cfg(test)]
mod tests {
    use super::*;

    fn inks() -> Vec<Ink> {
        let series = (0..SERIES_COLOUR_COUNT).map(Ink::Series);
        [
            Ink::Text,
            Ink::Muted,
            Ink::Axis,
            Ink::Grid,
            Ink::Paper,
            Ink::Alert,
        ]
        .into_iter()
        .chain(series)
        .collect()
    }

    /// Returns the contrast of two colours by WCAG 2.1.
    fn contrast(ink: &str, background: &str) -> f64 {
        let luminance = |hex: &str| {
            let channel = |start: usize| {
                let value =
                    f64::from(u8::from_str_radix(&hex[start..start + 2], 16).expect("hexadecimal"))
                        / 255.0;
                if value <= 0.03928 {
                    value / 12.92
                } else {
                    ((value + 0.055) / 1.055).powf(2.4)
                }
            };
            0.2126 * channel(1) + 0.7152 * channel(3) + 0.0722 * channel(5)
        };
        let (a, b) = (luminance(ink), luminance(background));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    fn dark_value(variable: &str) -> &'static str {
        let block = STYLE
            .split("prefers-color-scheme:dark")
            .nth(1)
            .expect("a dark block");
        let value = block.split(variable).nth(1).expect("in the dark block");
        &value[1..8]
    }

    #[test]
    fn every_ink_is_recoloured_by_the_style_sheet() {
        for (index, ink) in inks().iter().enumerate() {
            let hex = ink.hex();
            assert!(
                STYLE.contains(&format!(".draw [fill=\"{hex}\"]{{fill:var(")),
                "{ink:?}"
            );
            assert!(
                STYLE.contains(&format!(".draw [stroke=\"{hex}\"]{{stroke:var(")),
                "{ink:?}"
            );
            assert!(
                inks()
                    .iter()
                    .skip(index + 1)
                    .all(|other| other.hex() != hex),
                "{ink:?} is not unique"
            );
        }
    }

    #[test]
    fn texts_and_lines_have_enough_contrast_in_both_modes() {
        let names = ["text", "muted", "alert", "0", "1", "2", "3", "4"];
        let inks = inks()
            .into_iter()
            .filter(|ink| !matches!(ink, Ink::Axis | Ink::Grid | Ink::Paper));
        for (ink, name) in inks.zip(names) {
            assert!(
                contrast(ink.hex(), Ink::Paper.hex()) >= 4.5,
                "{ink:?} on white"
            );
            let [own, paper] = [name, "paper"].map(|name| dark_value(&format!("--draw-{name}")));
            assert!(contrast(own, paper) >= 4.5, "{ink:?} in the dark");
        }
    }

    #[test]
    fn twenty_series_look_different() {
        let looks: std::collections::HashSet<_> = (0..20)
            .map(|i| (Ink::Series(i).hex(), series_dash(i)))
            .collect();
        assert_eq!(looks.len(), 20);
    }
}
