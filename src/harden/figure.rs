//! Contacts of every checkpoint, round by round.

use super::report::Report;
use crate::draw::{Anchor, Axis, BELOW, Frame, HEADING, Ink, LEFT, Marker, Panel, Stroke, Svg};

/// Width of the figure, and height of its panel, in pixels.
const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 260.0;

impl Report {
    /// Contacts in the selection over episodes; a ring is a candidate, a vertical line the end of a round.
    #[must_use]
    pub fn figure(&self) -> Svg {
        let (mut done, mut points, mut candidates, mut ends) = (0, Vec::new(), Vec::new(), Vec::new());
        for round in &self.rounds {
            let trained = &round.trained;
            // Episodes are counted on over learners that began anew.
            let place = |episode: u64| (done + episode.saturating_sub(trained.from_episode)) as f64;
            for checkpoint in &trained.checkpoints {
                if let Some(contacts) = checkpoint.contacts {
                    points.push((place(checkpoint.episode), contacts as f64));
                    if checkpoint.episode == trained.best_episode {
                        candidates.push((place(checkpoint.episode), contacts as f64));
                    }
                }
            }
            let word = if round.ruling.is_accepted() { "accepted" } else { "rejected" };
            done += self.settings.episodes;
            ends.push((done as f64, format!("round {} {word}", round.round)));
        }
        let most = points.iter().map(|point| point.1).fold(1.0, f64::max);
        let frame = Frame { left: LEFT + 24.0, top: HEADING, width: WIDTH - LEFT - 40.0, height: HEIGHT };
        let title = "Contacts in the avoidable draws that select checkpoints";
        let x = Axis::numbers("episode", (0.0, done.max(1) as f64), 8);
        let mut panel = Panel::new(frame, title, x, Axis::numbers("", (0.0, most * 1.15), 6));
        for (end, words) in &ends {
            panel.rule_x(*end, Stroke { dash: "8 3.5", ..Stroke::solid(Ink::Muted, 1.2) });
            panel.note((*end * 0.995, most * 1.08), Anchor::End, words, Ink::Muted);
        }
        panel.line(&points, Stroke::series(0));
        panel.marks(&candidates, Marker::Ring, Ink::Series(1));
        let content = panel.draw(&Svg::id("hardening", "frame"));
        let description =
            "A ring is the candidate of its round. Checkpoints that touch somebody in what the paper has are left out.";
        Svg::new("hardening", (WIDTH, HEADING + HEIGHT + BELOW), title, description, content)
    }
}
