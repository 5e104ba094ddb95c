//! Figures of trainings, retrainings, recordings, and fitted scenario spaces.

mod fit;

use maud::html;

pub use fit::draw_fit;

use crate::draw::{
    Anchor, Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, LEFT_MARGIN, Marker, Panel, PixelRect,
    Stroke, Svg, extent, pad_interval,
};
use crumple_exchange::recording::{HardestBrakingResult, Preview, SpeedLine};
use crumple_sim::policy::{COLLISION_FREE_REWARD, CurvePoint, LearningCurve};

/// Width of a figure, and height of its panel, in pixels.
const FIGURE_WIDTH: f64 = 720.0;
const PANEL_HEIGHT: f64 = 260.0;
/// Size of a figure with one panel.
const FIGURE_SIZE: (f64, f64) = (FIGURE_WIDTH, HEADING_HEIGHT + PANEL_HEIGHT + BOTTOM_MARGIN);

/// Returns the frame of a panel as wide as the figure.
fn panel_frame(top: f64) -> PixelRect {
    PixelRect {
        left: LEFT_MARGIN + 24.0,
        top,
        width: FIGURE_WIDTH - LEFT_MARGIN - 40.0,
        height: PANEL_HEIGHT,
    }
}

/// A learning curve's result that a source states in words, without the numbers of the curve.
#[derive(Debug, Clone, PartialEq)]
pub struct StatedConvergence<'a> {
    /// Source of the statement.
    pub source: &'a str,
    /// Reward that is reached.
    pub reward: f64,
    /// First episode at about that reward.
    pub from_episode: u64,
}

/// Draws a learning curve: the mean evaluation reward over all seeds, and its standard deviation.
#[must_use]
pub fn draw_learning_curve(curve: &LearningCurve) -> Svg {
    draw_learning_curve_with_reference(curve, None)
}

/// Draws a learning curve, and a stated result of another one: a ring at its first episode, and a line from there.
#[must_use]
pub fn draw_learning_curve_with_reference(
    curve: &LearningCurve,
    stated: Option<&StatedConvergence<'_>>,
) -> Svg {
    let title = format!(
        "Reward in evaluation, preset {}, {} seeds: mean and standard deviation",
        curve.preset, curve.seeds
    );
    let mut figure = LearningCurveFigure::new(&curve.points, stated, &title);
    figure.add_mean_and_deviation(&curve.points);
    figure.add_note(0.0, "dashes: 22 500, no collision", Ink::Muted);
    // The reward before any training is not learned.
    if let Some(untrained) = curve.points.first().filter(|point| point.episode == 0) {
        figure.add_untrained_reward(untrained.mean_reward);
    }
    if let Some(stated) = stated {
        figure.add_stated_convergence(stated);
    }
    let content = figure.panel.draw(&Svg::id("learning-curve", "frame"));
    Svg::new(
        "learning-curve",
        FIGURE_SIZE,
        &title,
        &figure.description,
        content,
    )
}

/// The figure of a learning curve while its lines and notes are added.
struct LearningCurveFigure {
    panel: Panel,
    description: String,
    /// Right end of the axis.
    last_episode: f64,
    /// Height of the first note, as a share of the reward without a collision.
    first_note_height: f64,
}

impl LearningCurveFigure {
    fn new(points: &[CurvePoint], stated: Option<&StatedConvergence<'_>>, title: &str) -> Self {
        let trained = points.last().map_or(1.0, |point| point.episode as f64);
        // The stated result may lie beyond the trained episodes.
        let last_episode = stated.map_or(trained, |stated| {
            1.1 * trained.max(stated.from_episode as f64)
        });
        let low = points
            .iter()
            .map(|point| point.mean_reward - point.deviation)
            .fold(0.0, f64::min);
        let x = Axis::numeric("episode", (0.0, last_episode), 8);
        let y = Axis::numeric("", (low, COLLISION_FREE_REWARD * 1.06), 6);
        // Put notes where the right end of the curve is not.
        let right: Vec<f64> = points
            .iter()
            .filter(|point| point.episode as f64 > 0.6 * trained)
            .map(|point| point.mean_reward)
            .collect();
        let is_high = right.iter().sum::<f64>() > 0.5 * COLLISION_FREE_REWARD * right.len() as f64;
        Self {
            panel: Panel::new(panel_frame(HEADING_HEIGHT), title, x, y),
            description: "The mean over all seeds; a seed that has ended keeps its best. 22 500 is an episode without \
                          a collision."
                .to_owned(),
            last_episode,
            first_note_height: if is_high { 0.14 } else { 0.72 },
        }
    }

    fn add_mean_and_deviation(&mut self, points: &[CurvePoint]) {
        self.panel.add_band(
            &curve_points(points, |point| point.mean_reward + point.deviation),
            &curve_points(points, |point| point.mean_reward - point.deviation),
            Ink::Series(0),
        );
        self.panel.add_horizontal_line(
            COLLISION_FREE_REWARD,
            Stroke {
                dash: "8 3.5",
                ..Stroke::solid(Ink::Muted, 1.2)
            },
        );
        self.panel.add_line(
            &curve_points(points, |point| point.mean_reward),
            Stroke::series(0),
        );
    }

    fn add_untrained_reward(&mut self, reward: f64) {
        self.panel.add_horizontal_line(
            reward,
            Stroke {
                dash: "2 3",
                ..Stroke::solid(Ink::Muted, 1.2)
            },
        );
        let note = format!("dots: {}, before any training", format_thousands(reward));
        self.add_note(1.0, &note, Ink::Muted);
        self.description += &format!(" Untrained networks stand at {reward:.0}.");
    }

    /// Adds a stated result: a ring at its first episode, and a line from there.
    fn add_stated_convergence(&mut self, stated: &StatedConvergence<'_>) {
        let StatedConvergence {
            source,
            reward,
            from_episode,
        } = *stated;
        let start = (from_episode as f64, reward);
        self.panel.add_segment(
            start,
            (self.last_episode, reward),
            Stroke {
                width: 2.4,
                ..Stroke::series(1)
            },
        );
        self.panel
            .add_markers(&[start], Marker::Ring, Ink::Series(1));
        let statement = format!(
            "{} from about episode {from_episode} on",
            format_thousands(reward)
        );
        let note = format!("ring and line: {source}, by its text: {statement}");
        self.add_note(-1.0, &note, Ink::Series(1));
        self.description += &format!(
            " Of {source} only what its text states is drawn, {statement}: its curve has no numbers."
        );
    }

    /// Adds a note at the right edge, so many lines below the first note.
    fn add_note(&mut self, lines_below: f64, text: &str, ink: Ink) {
        let position = (
            self.last_episode * 0.995,
            COLLISION_FREE_REWARD * (self.first_note_height - 0.09 * lines_below),
        );
        self.panel.add_note(position, Anchor::End, text, ink);
    }
}

/// Returns a line over the episodes of a learning curve.
fn curve_points(points: &[CurvePoint], value: impl Fn(&CurvePoint) -> f64) -> Vec<(f64, f64)> {
    points
        .iter()
        .map(|point| (point.episode as f64, value(point)))
        .collect()
}

/// Formats a reward as in 22 500.
fn format_thousands(reward: f64) -> String {
    format!("{} {:03}", reward as i64 / 1000, reward as i64 % 1000)
}

/// Draws the boundary of an invariant set: the smallest gap against the closing speed, one line for each own speed.
#[must_use]
pub fn draw_invariant_set(lines: &[(String, Vec<(f64, f64)>)], most_m: f64) -> Svg {
    let title = "Smallest gap of the set by own speed, in metres";
    let heights = lines
        .iter()
        .flat_map(|(_, points)| points.iter().map(|point| point.1));
    let most_m = most_m.min(1.1 * heights.fold(1.0, f64::max));
    let closing_mps = lines
        .iter()
        .flat_map(|(_, points)| points.iter().map(|point| point.0));
    let least_mps = closing_mps.clone().fold(0.0, f64::min);
    let most_mps = closing_mps.fold(1.0, f64::max);
    let x = Axis::numeric("closing speed, m/s", (least_mps, most_mps), 8);
    let mut panel = Panel::new(
        panel_frame(HEADING_HEIGHT),
        title,
        x,
        Axis::numeric("", (0.0, most_m), 6),
    );
    for (series, (name, points)) in lines.iter().enumerate() {
        let inside: Vec<_> = points
            .iter()
            .copied()
            .filter(|point| point.1 <= most_m)
            .collect();
        panel.add_line(&inside, Stroke::series(series));
        if let Some(&last) = inside.last() {
            panel.add_note((last.0, last.1), Anchor::End, name, Ink::Series(series));
        }
    }
    let content = panel.draw(&Svg::id("invariant", "frame"));
    let description = "From a gap on or above the line of its own speed, the controller never \
        collides with the leader.";
    Svg::new("invariant", FIGURE_SIZE, title, description, content)
}

/// Draws a recording: speeds of its vehicles, and the gaps behind them, over time.
#[must_use]
pub fn draw_recording(preview: &Preview, file: &str) -> Svg {
    let step = PANEL_HEIGHT + BOTTOM_MARGIN + HEADING_HEIGHT;
    let [second, third] = [1.0, 2.0].map(|panels| HEADING_HEIGHT + panels * step);
    let content = html! {
        (recording_panel(preview, HEADING_HEIGHT, "Speed (m/s)", |line| &line.speed_mps)
            .draw(&Svg::id("recorded", "speeds")))
        (recording_panel(preview, second, "Speed of the vehicle behind (m/s)", |line| &line.speed_behind_mps)
            .draw(&Svg::id("recorded", "speeds-behind")))
        (recording_panel(preview, third, "Bumper gap to the vehicle behind (m)", |line| &line.gap_behind_m)
            .draw(&Svg::id("recorded", "gaps")))
    };
    let description = format!(
        "Of {} vehicles, the {} longest recorded. The dots mark the hardest braking.",
        preview.lead_vehicles,
        preview.lines.len()
    );
    Svg::new(
        "recorded",
        (FIGURE_WIDTH, third + PANEL_HEIGHT + BOTTOM_MARGIN),
        file,
        &description,
        content,
    )
}

/// Returns a panel with one quantity of each recorded vehicle over time.
fn recording_panel(
    preview: &Preview,
    top: f64,
    title: &str,
    quantity: fn(&SpeedLine) -> &Vec<(f64, f64)>,
) -> Panel {
    let points = preview.lines.iter().flat_map(quantity);
    let times_s = points.clone().map(|point| point.0);
    let values = points.map(|point| point.1).chain([0.0]);
    let time = Axis::numeric("s", extent(times_s), 8);
    let value = Axis::numeric("", pad_interval(extent(values), 0.04), 6);
    let mut panel = Panel::new(panel_frame(top), title, time, value);
    // A line is interrupted at gaps of the recording.
    let max_step_s = (3.0 * preview.step_s.unwrap_or(0.0)).max(0.5);
    for (index, line) in preview.lines.iter().enumerate() {
        for part in quantity(line).chunk_by(|a, b| b.0 - a.0 <= max_step_s) {
            panel.add_line(
                part,
                Stroke {
                    width: 1.0,
                    ..Stroke::series(index)
                },
            );
        }
    }
    if let HardestBrakingResult::Braking(hardest) = &preview.hardest {
        panel.add_vertical_line(
            hardest.from_s,
            Stroke {
                dash: "2 3",
                ..Stroke::solid(Ink::Muted, 1.2)
            },
        );
    }
    panel
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_learning_curve_names_its_seeds_and_the_best_reward() {
        let point = |episode| CurvePoint {
            episode,
            mean_reward: 1000.0,
            deviation: 10.0,
        };
        for first in [0, 5] {
            let curve = LearningCurve {
                preset: "fast".to_owned(),
                seeds: 2,
                points: vec![point(first), point(10)],
            };
            let svg = draw_learning_curve(&curve).document();
            assert!(svg.contains("2 seeds") && svg.contains("22 500"));
            assert_eq!(svg.contains("dots: 1 000, before any training"), first == 0);
            assert!(!svg.contains("by its text"));
        }
    }

    /// A stated result is drawn as a ring and a line with its source, so that it is not mistaken for a curve.
    #[test]
    fn a_stated_result_of_another_curve_is_labelled_with_its_source() {
        let points = vec![CurvePoint {
            episode: 300,
            mean_reward: 1000.0,
            deviation: 10.0,
        }];
        let curve = LearningCurve {
            preset: "fast".to_owned(),
            seeds: 2,
            points,
        };
        let stated = StatedConvergence {
            source: "the paper",
            reward: COLLISION_FREE_REWARD,
            from_episode: 400,
        };
        let svg = draw_learning_curve_with_reference(&curve, Some(&stated)).document();
        assert!(
            svg.contains("ring and line: the paper, by its text: 22 500 from about episode 400 on"),
            "{svg}"
        );
        // The axis includes the stated episode.
        assert!(svg.contains(">400<"), "{svg}");
    }
}
