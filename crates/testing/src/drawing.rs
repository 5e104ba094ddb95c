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
    under_test
        .flat_map(|(index, track)| {
            let gap = Curve {
                name: format!("gap ahead of vehicle {index}, m"),
                values: trace.gaps_m(index).into_iter().flatten().collect(),
            };
            let speed = Curve {
                name: format!("speed of vehicle {index}, m/s"),
                values: track.speed_mps.clone(),
            };
            [gap, speed]
        })
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
        let last = self.values.len() - 1;
        let max = self.max();
        (0..samples)
            .map(move |sample| (self.values[sample * last / (samples - 1)] / max).clamp(0.0, 1.0))
    }
}

/// Draws each curve as a line of bars.
pub(super) fn to_text(curves: &[Curve]) -> String {
    let mut text = String::new();
    for curve in curves {
        let bars: String = curve
            .shares(COLUMNS)
            .map(|share| BARS[(share * 7.0).round() as usize])
            .collect();
        // Writing to a string does not fail.
        let _ = writeln!(text, "  {bars} {}, at most {:.1}", curve.name, curve.max());
    }
    text
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
        let points: Vec<_> = curve
            .shares(samples)
            .enumerate()
            .map(|(sample, share)| {
                let x = MARGIN + width * sample as f64 / (samples - 1) as f64;
                format!("{x:.1},{:.1}", top + height * (1.0 - share))
            })
            .collect();
        let name = &curve.name;
        let max = curve.max();
        let base = top + height;
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
