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
    let LearningCurve {
        preset,
        seeds,
        points,
    } = curve;
    let trained = points.last().map_or(1.0, |point| point.episode as f64);
    // The stated result may lie beyond the trained episodes.
    let last = stated.map_or(trained, |stated| {
        1.1 * trained.max(stated.from_episode as f64)
    });
    let low = points
        .iter()
        .map(|point| point.mean_reward - point.deviation)
        .fold(0.0, f64::min);
    let title = format!(
        "Reward in evaluation, preset {preset}, {seeds} seeds: mean and standard deviation"
    );
    let x = Axis::numeric("episode", (0.0, last), 8);
    let y = Axis::numeric("", (low, COLLISION_FREE_REWARD * 1.06), 6);
    let mut panel = Panel::new(panel_frame(HEADING_HEIGHT), &title, x, y);
    let line = |of: &dyn Fn(&CurvePoint) -> f64| {
        points
            .iter()
            .map(|p| (p.episode as f64, of(p)))
            .collect::<Vec<_>>()
    };
    panel.add_band(
        &line(&|p| p.mean_reward + p.deviation),
        &line(&|p| p.mean_reward - p.deviation),
        Ink::Series(0),
    );
    panel.add_horizontal_line(
        COLLISION_FREE_REWARD,
        Stroke {
            dash: "8 3.5",
            ..Stroke::solid(Ink::Muted, 1.2)
        },
    );
    panel.add_line(&line(&|p| p.mean_reward), Stroke::series(0));
    // Put notes where the right end of the curve is not.
    let right: Vec<f64> = points
        .iter()
        .filter(|p| p.episode as f64 > 0.6 * trained)
        .map(|p| p.mean_reward)
        .collect();
    let is_high = right.iter().sum::<f64>() > 0.5 * COLLISION_FREE_REWARD * right.len() as f64;
    let words_at = |line: f64| {
        (
            last * 0.995,
            COLLISION_FREE_REWARD * (if is_high { 0.14 } else { 0.72 } - 0.09 * line),
        )
    };
    panel.add_note(
        words_at(0.0),
        Anchor::End,
        "dashes: 22 500, no collision",
        Ink::Muted,
    );
    let mut description =
        "The mean over all seeds; a seed that has ended keeps its best. 22 500 is an episode without a collision."
            .to_owned();
    // The reward before any training is not learned.
    if let Some(untrained) = points
        .first()
        .filter(|point| point.episode == 0)
        .map(|point| point.mean_reward)
    {
        let words = format!("dots: {}, before any training", format_thousands(untrained));
        panel.add_horizontal_line(
            untrained,
            Stroke {
                dash: "2 3",
                ..Stroke::solid(Ink::Muted, 1.2)
            },
        );
        panel.add_note(words_at(1.0), Anchor::End, &words, Ink::Muted);
        description += &format!(" Untrained networks stand at {untrained:.0}.");
    }
    if let Some(StatedConvergence {
        source,
        reward,
        from_episode,
    }) = stated
    {
        let at = (*from_episode as f64, *reward);
        panel.add_segment(
            at,
            (last, *reward),
            Stroke {
                width: 2.4,
                ..Stroke::series(1)
            },
        );
        panel.add_markers(&[at], Marker::Ring, Ink::Series(1));
        let said = format!(
            "{} from about episode {from_episode} on",
            format_thousands(*reward)
        );
        let words = format!("ring and line: {source}, by its text: {said}");
        panel.add_note(words_at(-1.0), Anchor::End, &words, Ink::Series(1));
        description += &format!(
            " Of {source} only what its text states is drawn, {said}: its curve has no numbers."
        );
    }
    let content = panel.draw(&Svg::id("learning-curve", "frame"));
    Svg::new("learning-curve", FIGURE_SIZE, &title, &description, content)
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
    let closing = lines
        .iter()
        .flat_map(|(_, points)| points.iter().map(|point| point.0));
    let (low, high) = closing.fold((0.0_f64, 1.0_f64), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    let x = Axis::numeric("closing speed, m/s", (low, high), 8);
    let mut panel = Panel::new(
        panel_frame(HEADING_HEIGHT),
        title,
        x,
        Axis::numeric("", (0.0, most_m), 6),
    );
    for (place, (name, points)) in lines.iter().enumerate() {
        let inside: Vec<_> = points
            .iter()
            .copied()
            .filter(|point| point.1 <= most_m)
            .collect();
        panel.add_line(&inside, Stroke::series(place));
        if let Some(&last) = inside.last() {
            panel.add_note((last.0, last.1), Anchor::End, name, Ink::Series(place));
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
    type Points = Vec<(f64, f64)>;
    let panel = |name: &str, top: f64, title: &str, of: fn(&SpeedLine) -> &Points| {
        let all = || preview.lines.iter().flat_map(&of);
        let time = Axis::numeric("s", extent(all().map(|point| point.0)), 8);
        let value = Axis::numeric(
            "",
            pad_interval(extent(all().map(|point| point.1).chain([0.0])), 0.04),
            6,
        );
        let mut panel = Panel::new(panel_frame(top), title, time, value);
        for (index, line) in preview.lines.iter().enumerate() {
            // A line is interrupted at gaps of the recording.
            for part in of(line)
                .chunk_by(|a, b| b.0 - a.0 <= (3.0 * preview.step_s.unwrap_or(0.0)).max(0.5))
            {
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
        panel.draw(&Svg::id("recorded", name))
    };
    let second = FIGURE_SIZE.1 + HEADING_HEIGHT;
    let content = html! {
        (panel("speeds", HEADING_HEIGHT, "Speed (m/s)", |line| &line.speed_mps))
        (panel("gaps", second, "Bumper gap to the vehicle behind (m)", |line| &line.gap_behind_m))
    };
    let (all, shown) = (preview.lead_vehicles, preview.lines.len());
    let description = format!(
        "Of {all} vehicles, the {shown} longest recorded. The dots mark the hardest braking."
    );
    Svg::new(
        "recorded",
        (FIGURE_WIDTH, second + PANEL_HEIGHT + BOTTOM_MARGIN),
        file,
        &description,
        content,
    )
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
    fn what_is_stated_of_another_curve_is_labelled_as_such() {
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
