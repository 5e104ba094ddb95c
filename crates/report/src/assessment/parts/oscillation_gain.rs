//! Gain: the growth of speed oscillations from vehicle to vehicle in a line with one controller.

use serde::{Deserialize, Serialize};

use super::ControllerUsefulness;
use crate::assessment::Rounded;
use crate::assessment::claims::{Domain, MAX_GAIN, Strength};
use crate::assessment::table::{CellMark, ReportCell, ReportTable};
use crate::draw::{
    Anchor, Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, LEFT_MARGIN, Panel, PixelRect, Stroke, Svg,
    draw_legend,
};
use crumple_measure::{
    GAIN_FREQUENCIES_RAD_PER_S, GAIN_SPEEDS_MPS, GainSurvey, NoGain, OSCILLATION_AMPLITUDE_MPS,
    OperatingPoint,
};
use crumple_sim::engine::FailedControllerRuns;
use maud::{Markup, html};

/// Growth of speed oscillations in a line of vehicles with one controller that observes the true state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OscillationGain {
    /// Largest gain; absent if there is none.
    pub largest: Option<LargestGain>,
    /// Number of operating points: pairs of mean speed and frequency.
    pub points: u64,
    /// Operating points with a larger gain than 1.000.
    pub amplified: u64,
    /// Operating points at which the vehicles do not reach the leader's speed, or keep no constant gap.
    pub not_settled: u64,
    /// Operating points at which the oscillation does not become periodic.
    pub not_steady: u64,
    /// Operating points at which vehicles collide.
    pub collisions: u64,
    /// Operating points at which a controller gave no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unanswered: Option<FailedControllerRuns>,
    /// Gain over the frequency at each mean speed.
    pub curves: Vec<GainCurve>,
}

/// The largest gain, and its operating point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LargestGain {
    /// Amplitude of a vehicle's speed, divided by that of the vehicle ahead.
    pub gain: Rounded<3>,
    /// Mean speed, in m/s.
    pub mean_speed_mps: Rounded<1>,
    /// Frequency, in rad/s.
    pub frequency_rad_per_s: Rounded<2>,
}

/// Gains at one mean speed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GainCurve {
    /// Mean speed, in m/s.
    pub mean_speed_mps: f64,
    /// Frequencies, in rad/s, increasing.
    pub frequency_rad_per_s: Vec<Rounded<3>>,
    /// Gain at each frequency.
    pub gain: Vec<Rounded<3>>,
}

fn count_points_without_gain(survey: &GainSurvey, reason: &NoGain) -> u64 {
    survey
        .points
        .iter()
        .filter(|point| point.gain.as_ref() == Err(reason))
        .count() as u64
}

impl OscillationGain {
    pub(super) fn new(survey: &GainSurvey) -> Self {
        let mut unanswered = None;
        for point in &survey.points {
            if let Err(NoGain::Unanswered(reason)) = &point.gain {
                let failed = FailedControllerRuns {
                    runs: 1,
                    reason: reason.clone(),
                };
                FailedControllerRuns::merge(&mut unanswered, Some(failed));
            }
        }
        let gains = survey
            .points
            .iter()
            .filter_map(|point| point.gain.as_ref().ok());
        let curves = GAIN_SPEEDS_MPS
            .iter()
            .map(|&speed_mps| GainCurve::new(speed_mps, survey));
        Self {
            largest: survey
                .largest()
                .map(|(at, gain)| LargestGain::new(at, gain)),
            points: survey.points.len() as u64,
            amplified: gains
                .filter(|gain| Rounded::<3>::new(**gain).value() > MAX_GAIN)
                .count() as u64,
            not_settled: count_points_without_gain(survey, &NoGain::NotSettled),
            not_steady: count_points_without_gain(survey, &NoGain::NotSteady),
            collisions: count_points_without_gain(survey, &NoGain::Collision),
            unanswered,
            curves: curves.filter(|curve| !curve.gain.is_empty()).collect(),
        }
    }

    /// Returns the domain of claims about the gain.
    pub(super) fn domain() -> Domain {
        let [slowest_mps, fastest_mps] = [
            GAIN_SPEEDS_MPS[0],
            GAIN_SPEEDS_MPS[GAIN_SPEEDS_MPS.len() - 1],
        ];
        Domain::Oscillations {
            amplitude_mps: OSCILLATION_AMPLITUDE_MPS.into(),
            frequencies_rad_per_s: GAIN_FREQUENCIES_RAD_PER_S.map(Rounded::new),
            mean_speeds_mps: [slowest_mps, fastest_mps].map(Rounded::new),
        }
    }

    /// Returns the strength of the claim that no oscillation grows. Operating points without a gain are no evidence,
    /// but a collision refutes the claim.
    pub(super) fn strength(&self) -> Strength {
        let Self {
            points,
            amplified,
            collisions,
            ..
        } = *self;
        if self.unanswered.is_some() {
            let failures = amplified + collisions;
            return Strength::from_counts_with_unanswered(
                failures,
                points,
                self.unanswered.as_ref(),
                false,
            );
        }
        match self.largest {
            _ if collisions > 0 => Strength::FailedPoints {
                failures: amplified + collisions,
                points,
            },
            Some(largest) if largest.is_above_one() || self.is_complete() => Strength::Gain {
                largest: largest.gain,
                points,
            },
            _ => Strength::NotShown,
        }
    }

    /// True if every operating point has a gain.
    fn is_complete(&self) -> bool {
        self.not_settled + self.not_steady + self.collisions == 0 && self.unanswered.is_none()
    }

    /// True if every operating point has a gain, and no oscillation grows.
    pub(in crate::assessment) fn damps_all(&self) -> bool {
        self.is_complete() && self.largest.is_some_and(|largest| !largest.is_above_one())
    }

    pub(in crate::assessment) fn describe(&self) -> String {
        let mut parts: Vec<String> = self.largest.iter().map(LargestGain::describe).collect();
        let reasons = [
            (
                self.not_settled,
                "the vehicles do not settle behind their leaders",
            ),
            (self.not_steady, "the oscillation does not become periodic"),
            (self.collisions, "vehicles collide"),
        ];
        for (count, reason) in reasons.iter().filter(|(count, _)| *count > 0) {
            let points = self.points;
            parts.push(format!("at {count} of {points} operating points {reason}"));
        }
        parts.extend(
            self.unanswered
                .iter()
                .map(|failed| format!("it {}", failed.describe(self.points))),
        );
        parts.join("; ")
    }

    pub(super) fn table_cell(&self) -> ReportCell {
        match self.largest {
            _ if self.unanswered.is_some() => ReportCell::with_mark("no answer", CellMark::Bad),
            _ if self.collisions > 0 => ReportCell::with_mark("collides", CellMark::Bad),
            Some(largest) if largest.is_above_one() => {
                ReportCell::with_mark(largest.gain, CellMark::Bad)
            }
            Some(largest) if self.is_complete() => {
                ReportCell::with_mark(largest.gain, CellMark::Good)
            }
            _ => ReportCell::text("unsettled"),
        }
    }

    /// Returns the largest gain on the curve of a mean speed.
    fn largest_at(&self, mean_speed_mps: f64) -> Option<Rounded<3>> {
        let curve = self
            .curves
            .iter()
            .find(|curve| curve.mean_speed_mps == mean_speed_mps)?;
        curve
            .gain
            .iter()
            .copied()
            .max_by(|a, b| a.value().total_cmp(&b.value()))
    }
}

impl LargestGain {
    fn new(at: OperatingPoint, gain: f64) -> Self {
        let OperatingPoint {
            mean_speed_mps,
            frequency_rad_per_s,
        } = at;
        Self {
            gain: gain.into(),
            mean_speed_mps: mean_speed_mps.into(),
            frequency_rad_per_s: frequency_rad_per_s.into(),
        }
    }

    fn is_above_one(&self) -> bool {
        self.gain.value() > MAX_GAIN
    }

    fn describe(&self) -> String {
        let Self {
            gain,
            mean_speed_mps,
            frequency_rad_per_s,
        } = self;
        format!("largest gain {gain}, at {mean_speed_mps} m/s and {frequency_rad_per_s} rad/s")
    }
}

impl GainCurve {
    fn new(mean_speed_mps: f64, survey: &GainSurvey) -> Self {
        let curve = survey.curve(mean_speed_mps);
        let (frequency_rad_per_s, gain) = curve
            .into_iter()
            .map(|(frequency, gain)| (Rounded::new(frequency), Rounded::new(gain)))
            .unzip();
        Self {
            mean_speed_mps,
            frequency_rad_per_s,
            gain,
        }
    }
}

/// Explains the table and the figure of gains.
pub(super) fn gain_introduction() -> String {
    let [lowest, highest] = GAIN_FREQUENCIES_RAD_PER_S;
    format!(
        "Gain: vehicles with the controller follow each other, and their leader's speed oscillates with an amplitude \
         of {OSCILLATION_AMPLITUDE_MPS} m/s. The gain is the amplitude of a vehicle's speed divided by that of the \
         vehicle ahead, in steady oscillation and with the true state. Columns give the largest gain at each mean \
         speed on a grid of frequencies from {lowest} to {highest} rad/s. The column `all` also has finer points \
         around the largest gain, and can be larger. Above 1.000, an oscillation grows from vehicle to vehicle."
    )
}

/// The largest gain of each controller at each mean speed.
pub(super) fn gain_table(controllers: &[ControllerUsefulness]) -> ReportTable {
    let speeds = GAIN_SPEEDS_MPS.map(|speed_mps| format!("{speed_mps} m/s"));
    let header: Vec<&str> = ["largest gain at"]
        .into_iter()
        .chain(speeds.iter().map(String::as_str))
        .chain(["all", "operating point of the largest"])
        .collect();
    let mut table = ReportTable::new(&header);
    for useful in controllers {
        let gain = &useful.oscillation_gain;
        let mut row = vec![ReportCell::text(&useful.controller)];
        row.extend(
            GAIN_SPEEDS_MPS.map(|speed_mps| ReportCell::optional(gain.largest_at(speed_mps))),
        );
        row.push(gain.table_cell());
        let operating_point = gain.largest.map(|largest| {
            format!(
                "{} m/s, {} rad/s",
                largest.mean_speed_mps, largest.frequency_rad_per_s
            )
        });
        row.push(ReportCell::text(
            operating_point.unwrap_or_else(|| "–".to_owned()),
        ));
        table.push_row(row);
    }
    table
}

/// Speeds of the curves in the figure, in m/s; all are in [`GAIN_SPEEDS_MPS`].
const DRAWN_SPEEDS_MPS: [f64; 4] = [8.0, 15.0, 22.0, 30.0];

/// Size of a panel, and number of panels in a row.
const PANEL_SIZE: (f64, f64) = (190.0, 120.0);
const PANELS_IN_ROW: usize = 3;

/// Gains above this are not drawn.
const HIGHEST_DRAWN_GAIN: f64 = 1.3;

/// Draws the gain of each controller over the frequency: one panel for each controller with curves, a line for each
/// speed.
pub(super) fn draw_gains(id: &str, controllers: &[ControllerUsefulness]) -> Svg {
    let drawn: Vec<_> = controllers
        .iter()
        .filter(|useful| !useful.oscillation_gain.curves.is_empty())
        .collect();
    let step = (
        PANEL_SIZE.0 + LEFT_MARGIN + 24.0,
        PANEL_SIZE.1 + HEADING_HEIGHT + BOTTOM_MARGIN,
    );
    let columns = drawn.len().clamp(1, PANELS_IN_ROW);
    let width = (columns as f64 * step.0 + 12.0).max(4.0 * 80.0);
    let (legend, legend_height) = speed_legend(width);
    let panels = drawn.iter().enumerate().map(|(index, useful)| {
        let row = index / PANELS_IN_ROW;
        let column = index % PANELS_IN_ROW;
        let frame = PixelRect {
            left: LEFT_MARGIN + column as f64 * step.0,
            top: legend_height + HEADING_HEIGHT + row as f64 * step.1,
            width: PANEL_SIZE.0,
            height: PANEL_SIZE.1,
        };
        gain_panel(useful, frame).draw(&Svg::id(id, &format!("gain-{index}")))
    });
    let panels: Vec<_> = panels.collect();
    let rows = drawn.len().div_ceil(PANELS_IN_ROW) as f64;
    let descriptions: Vec<_> = drawn.iter().map(|useful| describe_gain(useful)).collect();
    let content = html! { (legend) @for panel in &panels { (panel) } };
    Svg::new(
        id,
        (width, legend_height + rows * step.1),
        "Gain over the frequency",
        &descriptions.join("; "),
        content,
    )
}

fn describe_gain(useful: &ControllerUsefulness) -> String {
    let gain = useful.oscillation_gain.describe();
    format!("{}: {gain}", useful.controller)
}

/// Draws the legend of the lines of a panel, and returns its height.
fn speed_legend(width: f64) -> (Markup, f64) {
    let names = DRAWN_SPEEDS_MPS.map(|speed_mps| format!("{speed_mps} m/s"));
    let entries: Vec<_> = names
        .iter()
        .enumerate()
        .map(|(index, name)| (Stroke::series(index), name.as_str()))
        .collect();
    draw_legend(&entries, width)
}

fn gain_panel(useful: &ControllerUsefulness, frame: PixelRect) -> Panel {
    let ticks = [0.05, 0.1, 0.2, 0.5, 1.0, 2.0]
        .map(|frequency: f64| (frequency.log10(), frequency.to_string()));
    let [lowest, highest] = GAIN_FREQUENCIES_RAD_PER_S.map(f64::log10);
    let x = Axis::with_ticks("frequency (rad/s)", (lowest, highest), ticks.into());
    let y = Axis::numeric("", (0.0, HIGHEST_DRAWN_GAIN), 5);
    let mut panel = Panel::new(frame, &format!("Gain, {}", useful.controller), x, y);
    panel.add_horizontal_line(MAX_GAIN, Stroke::solid(Ink::Muted, 1.0));
    for (index, speed_mps) in DRAWN_SPEEDS_MPS.into_iter().enumerate() {
        let Some(curve) = useful
            .oscillation_gain
            .curves
            .iter()
            .find(|curve| curve.mean_speed_mps == speed_mps)
        else {
            continue;
        };
        let points = curve.frequency_rad_per_s.iter().zip(&curve.gain);
        let points: Vec<_> = points
            .map(|(frequency, gain)| (frequency.value().log10(), gain.value()))
            .collect();
        panel.add_line(&points, Stroke::series(index));
    }
    if let Some(largest) = useful.oscillation_gain.largest {
        panel.add_note(
            (highest, 0.1),
            Anchor::End,
            &format!("largest {}", largest.gain),
            Ink::Muted,
        );
    }
    panel
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_measure::MeasuredGain;

    fn measured(gains: Vec<Result<f64, NoGain>>) -> OscillationGain {
        let at = OperatingPoint {
            mean_speed_mps: 8.0,
            frequency_rad_per_s: 0.2,
        };
        OscillationGain::new(&GainSurvey {
            points: gains
                .into_iter()
                .map(|gain| MeasuredGain { at, gain })
                .collect(),
        })
    }

    #[test]
    fn the_rounded_largest_gain_decides() {
        let holds = measured(vec![Ok(0.5), Ok(1.0004)]);
        assert!(holds.damps_all() && !holds.strength().is_refutation());
        assert_eq!(
            holds.strength(),
            Strength::Gain {
                largest: Rounded::new(1.0),
                points: 2
            }
        );
        let amplifies = measured(vec![Ok(1.0006), Err(NoGain::NotSettled)]);
        assert!(!amplifies.damps_all() && amplifies.strength().is_refutation());
        assert_eq!((amplifies.amplified, amplifies.not_settled), (1, 1));
        assert!(
            amplifies
                .describe()
                .starts_with("largest gain 1.001, at 8.0 m/s and 0.20 rad/s; at 1 of 2 ")
        );
    }

    #[test]
    fn points_without_a_gain_are_no_evidence_and_collisions_refute() {
        let unsettled = measured(vec![Ok(0.9), Err(NoGain::NotSteady)]);
        assert_eq!(
            (unsettled.strength(), unsettled.damps_all()),
            (Strength::NotShown, false)
        );
        let collides = measured(vec![Ok(0.9), Err(NoGain::Collision)]);
        assert_eq!(
            collides.strength(),
            Strength::FailedPoints {
                failures: 1,
                points: 2
            }
        );
        let unanswered = measured(vec![
            Ok(0.9),
            Err(NoGain::Unanswered("at 1.00 s, it is gone".to_owned())),
        ]);
        assert!(matches!(
            unanswered.strength(),
            Strength::Unanswered {
                unanswered: 1,
                failures: 0,
                runs: 2,
                ..
            }
        ));
        assert_eq!(measured(Vec::new()).strength(), Strength::NotShown);
    }
}
