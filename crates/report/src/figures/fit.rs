//! Goodness of fit of a fitted scenario space.

use maud::html;

use crate::draw::{
    Anchor, Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, LEFT_MARGIN, Panel, PixelRect, Stroke, Svg,
    extent, pad_interval,
};
use crumple_evidence::fit::{FittedFeature, FittedSpace, GoodnessOfFit, format_p_value};

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
    let panels = fitted.features.iter().enumerate().map(|(index, feature)| {
        let row = index / 2;
        let column = index % 2;
        let frame = PixelRect {
            left: LEFT_MARGIN + 24.0 + column as f64 * step.0,
            top: HEADING_HEIGHT + row as f64 * step.1,
            width: PANEL_SIZE.0,
            height: PANEL_SIZE.1,
        };
        fit_panel(feature, frame).draw(&Svg::id("fitted", &feature.name))
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

fn fit_panel(feature: &FittedFeature, frame: PixelRect) -> Panel {
    let point_mass = feature.point_mass.map(|point| point.at);
    let ends = [feature.tails.smallest, feature.tails.largest]
        .into_iter()
        .chain(point_mass);
    let range = pad_interval(extent(ends), 0.08);
    let unit = if feature.unit == "1" {
        ""
    } else {
        feature.unit
    };
    let x = Axis::numeric(unit, range, 6);
    let title = format!("{}: {}", feature.name, feature.chosen.family.name());
    let mut panel = Panel::new(frame, &title, x, Axis::numeric("", (0.0, 1.0), 5));
    panel.add_line(
        &empirical_distribution(&feature.sorted, range),
        Stroke::series(1),
    );
    if let Ok(distribution) = feature.distribution.build() {
        let line: Vec<_> = fitted_curve_values(range, point_mass)
            .into_iter()
            .map(|value| (value, distribution.cdf(value)))
            .collect();
        panel.add_line(&line, Stroke::series(0));
    }
    let note = describe_goodness(&feature.goodness);
    panel.add_note((range.1, 0.06), Anchor::End, &note, Ink::Muted);
    panel.add_note(
        (range.1, 0.18),
        Anchor::End,
        "dashes: observed, line: fitted",
        Ink::Muted,
    );
    panel
}

fn describe_goodness(goodness: &GoodnessOfFit) -> String {
    format!(
        "KS {:.3} (p {}), CvM {:.3} (p {})",
        goodness.kolmogorov_smirnov,
        format_p_value(goodness.kolmogorov_smirnov_p),
        goodness.cramer_von_mises,
        format_p_value(goodness.cramer_von_mises_p)
    )
}

/// Returns the steps of the empirical distribution function of sorted values.
fn empirical_distribution(sorted: &[f64], (low, high): (f64, f64)) -> Vec<(f64, f64)> {
    let n = sorted.len() as f64;
    let mut steps = vec![(low, 0.0)];
    for (index, &value) in sorted.iter().enumerate() {
        steps.extend([(value, index as f64 / n), (value, (index + 1) as f64 / n)]);
    }
    steps.push((high, 1.0));
    steps
}

/// Returns the values at which the fitted distribution is drawn, with a step at a value that has a probability of its
/// own.
fn fitted_curve_values((low, high): (f64, f64), point_mass: Option<f64>) -> Vec<f64> {
    let even =
        (0..=CURVE_POINTS).map(|point| low + (high - low) * point as f64 / CURVE_POINTS as f64);
    let step = point_mass
        .into_iter()
        .flat_map(|value| [value.next_down(), value]);
    let mut values: Vec<f64> = even.chain(step).collect();
    values.sort_by(f64::total_cmp);
    values
}
