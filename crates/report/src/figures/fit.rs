//! Goodness of fit of a fitted scenario space.

use maud::html;

use crate::draw::{
    Anchor, Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, LEFT_MARGIN, Panel, PixelRect, Stroke, Svg,
    extent, pad_interval,
};
use crumple_evidence::fit::{FittedFeature, FittedSpace, format_p_value};

/// Size of a panel, and distance between two of them, in pixels.
const PANEL_SIZE: (f64, f64) = (340.0, 200.0);
const PANEL_SPACING: f64 = LEFT_MARGIN + 36.0;
const CURVE_POINTS: usize = 160;

/// Draws a panel for each feature: the empirical distribution function, and the fitted one.
#[must_use]
pub fn draw_fit(fitted: &FittedSpace) -> Svg {
    let step = (
        PANEL_SIZE.0 + PANEL_SPACING,
        PANEL_SIZE.1 + HEADING_HEIGHT + BOTTOM_MARGIN,
    );
    let panels = fitted.features.iter().enumerate().map(|(index, number)| {
        let (row, column) = (index / 2, index % 2);
        let (left, top) = (
            LEFT_MARGIN + 24.0 + column as f64 * step.0,
            HEADING_HEIGHT + row as f64 * step.1,
        );
        let frame = PixelRect {
            left,
            top,
            width: PANEL_SIZE.0,
            height: PANEL_SIZE.1,
        };
        fit_panel(number, frame).draw(&Svg::id("fitted", &number.name))
    });
    let panels: Vec<_> = panels.collect();
    let rows = panels.len().div_ceil(2) as f64;
    let size = (
        LEFT_MARGIN + 24.0 + 2.0 * PANEL_SIZE.0 + PANEL_SPACING + 24.0,
        rows * step.1,
    );
    let description = "Cumulative distributions: steps are observed, lines are fitted.";
    Svg::new(
        "fitted",
        size,
        fitted.space.name(),
        description,
        html! { @for panel in &panels { (panel) } },
    )
}

fn fit_panel(number: &FittedFeature, frame: PixelRect) -> Panel {
    let point = number.point_mass.map(|point| point.at);
    let ends = [number.tails.smallest, number.tails.largest]
        .into_iter()
        .chain(point);
    let (low, high) = pad_interval(extent(ends), 0.08);
    let x = Axis::numeric(
        if number.unit == "1" { "" } else { number.unit },
        (low, high),
        6,
    );
    let title = format!("{}: {}", number.name, number.chosen.family.name());
    let mut panel = Panel::new(frame, &title, x, Axis::numeric("", (0.0, 1.0), 5));
    let n = number.sorted.len() as f64;
    let mut steps = vec![(low, 0.0)];
    for (index, &value) in number.sorted.iter().enumerate() {
        steps.extend([(value, index as f64 / n), (value, (index + 1) as f64 / n)]);
    }
    steps.push((high, 1.0));
    panel.add_line(&steps, Stroke::series(1));
    if let Ok(ready) = number.distribution.build() {
        let even =
            (0..=CURVE_POINTS).map(|point| low + (high - low) * point as f64 / CURVE_POINTS as f64);
        // A step where a value has a probability of its own.
        let mut at: Vec<f64> = even
            .chain(point.into_iter().flat_map(|at| [at.next_down(), at]))
            .collect();
        at.sort_by(f64::total_cmp);
        let line: Vec<_> = at
            .into_iter()
            .map(|value| (value, ready.cdf(value)))
            .collect();
        panel.add_line(&line, Stroke::series(0));
    }
    let goodness = &number.goodness;
    let [ks_p, cvm_p] =
        [goodness.kolmogorov_smirnov_p, goodness.cramer_von_mises_p].map(format_p_value);
    let (ks, cvm) = (goodness.kolmogorov_smirnov, goodness.cramer_von_mises);
    let words = format!("KS {ks:.3} (p {ks_p}), CvM {cvm:.3} (p {cvm_p})");
    panel.add_note((high, 0.06), Anchor::End, &words, Ink::Muted);
    panel.add_note(
        (high, 0.18),
        Anchor::End,
        "dashes: observed, line: fitted",
        Ink::Muted,
    );
    panel
}
