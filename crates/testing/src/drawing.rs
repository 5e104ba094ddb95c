//! Drawings of a run: lines of text for a terminal, and an SVG file.

use std::fmt::Write;

use crumple_sim::engine::Trace;
use crumple_sim::scenario::Scenario;

const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
const COLUMNS: usize = 60;
/// Width and height of a panel of the SVG file, in pixels.
const PANEL: [f64; 2] = [600.0, 90.0];
const MARGIN: f64 = 20.0;

/// A quantity over the time of a run.
pub(super) struct Curve {
    name: String,
    values: Vec<f64>,
}

/// Returns gap and speed of each vehicle under test.
pub(super) fn curves(scenario: &Scenario, trace: &Trace) -> Vec<Curve> {
    let under_test = trace
        .vehicles
        .iter()
        .enumerate()
        .filter(|(index, _)| scenario.is_under_test(*index));
    let of_vehicle = |(index, track): (usize, &crumple_sim::engine::Track)| {
        let gaps_m: Vec<f64> = trace.gaps_m(index).into_iter().flatten().collect();
        let gap = Curve {
            name: format!("gap ahead of vehicle {index}, m"),
            values: gaps_m,
        };
        [
            gap,
            Curve {
                name: format!("speed of vehicle {index}, m/s"),
                values: track.speed_mps.clone(),
            },
        ]
    };
    under_test
        .flat_map(of_vehicle)
        .filter(|curve| !curve.values.is_empty())
        .collect()
}

impl Curve {
    fn max(&self) -> f64 {
        self.values
            .iter()
            .copied()
            .fold(f64::MIN_POSITIVE, f64::max)
    }

    /// Returns the values of as many samples, each as a share of the largest.
    fn shares(&self, samples: usize) -> impl Iterator<Item = f64> {
        let (last, max) = (self.values.len() - 1, self.max());
        (0..samples)
            .map(move |sample| (self.values[sample * last / (samples - 1)] / max).clamp(0.0, 1.0))
    }
}

/// Draws each curve as a line of bars.
pub(super) fn to_text(curves: &[Curve]) -> String {
    let line = |curve: &Curve| {
        let bars: String = curve
            .shares(COLUMNS)
            .map(|share| BARS[(share * 7.0).round() as usize])
            .collect();
        format!("  {bars} {}, at most {:.1}\n", curve.name, curve.max())
    };
    curves.iter().map(line).collect()
}

/// Draws each curve in a panel of its own.
pub(super) fn to_svg(curves: &[Curve], duration_s: f64) -> String {
    let [width, height] = PANEL;
    let [total_width, total_height] = [
        width + 2.0 * MARGIN,
        (height + MARGIN) * curves.len() as f64 + MARGIN,
    ];
    let mut svg = format!(
        "<svg xmlns='http://www.w3.org/2000/svg' width='{total_width}' height='{total_height}' \
         font-family='sans-serif' font-size='12'>\n"
    );
    for (index, curve) in curves.iter().enumerate() {
        let top = MARGIN + (height + MARGIN) * index as f64;
        let samples = curve.values.len().clamp(2, width as usize);
        let place = |(sample, share): (usize, f64)| {
            let x = MARGIN + width * sample as f64 / (samples - 1) as f64;
            format!("{x:.1},{:.1}", top + height * (1.0 - share))
        };
        let points: Vec<_> = curve.shares(samples).enumerate().map(place).collect();
        let (name, max, base) = (&curve.name, curve.max(), top + height);
        // Writing to a string does not fail.
        let _ = write!(
            svg,
            "<text x='{MARGIN}' y='{:.1}'>{name}: 0 to {max:.1}, over {duration_s:.1} s</text>\n\
             <path d='M{MARGIN} {base}h{width}' stroke='grey'/>\n\
             <polyline points='{}' fill='none' stroke='black'/>\n",
            top - 4.0,
            points.join(" ")
        );
    }
    svg + "</svg>\n"
}
