//! Progress of `crumple retrain` on a terminal.

use std::time::Instant;

use indicatif::ProgressBar;

use super::super::progress;
use crumple_learn::retrain::RetrainingProgress;
use crumple_search::falsify::campaign::ExaminationStep;

/// Progress on a terminal, with the time left of the present step.
pub(super) struct ProgressLine<'a> {
    pub(super) bar: &'a ProgressBar,
    pub(super) rounds: u64,
    /// Name of the step, its beginning, and the share of it that was done then.
    pub(super) step: Option<(&'static str, Instant, f64)>,
}

impl ProgressLine<'_> {
    pub(super) fn show(&mut self, state: &RetrainingProgress) {
        let share = |done: u64, total: u64| Some(done as f64 / total.max(1) as f64);
        let (round, step, part, message) = match state {
            RetrainingProgress::Gathering { file, done, wanted } => {
                let message = format!("{file}: {done} of {wanted} avoidable random scenarios");
                return self.print(file, share(*done, *wanted), &message);
            }
            RetrainingProgress::SimulatingDraws { round, draws } => (
                round,
                "draws",
                None,
                format!("simulating {draws} random scenarios, classifying collisions"),
            ),
            RetrainingProgress::Searching {
                round,
                space,
                space_index: [index, spaces],
                progress: state,
            } => {
                // The time of an examination is not known.
                let part = state
                    .method
                    .as_ref()
                    .and(share(state.evaluations, state.total));
                let part = part.map(|part| (*index as f64 + part) / *spaces as f64);
                let examination = state
                    .examination
                    .map_or("writing the results", ExaminationStep::describe);
                let method = state
                    .method
                    .as_ref()
                    .map_or(examination.to_owned(), ToString::to_string);
                let (done, total, failures) = (state.evaluations, state.total, state.failures);
                (
                    round,
                    "search",
                    part,
                    format!("{method} in {space}, {done} of {total} runs, {failures} failures"),
                )
            }
            RetrainingProgress::Attacking { round, scenarios } => (
                round,
                "attack",
                None,
                format!("worst-case braking in {scenarios} scenarios, then training"),
            ),
            RetrainingProgress::Imitating { round, imitation } => {
                let (done, rounds) = (u64::from(imitation.round), u64::from(imitation.rounds));
                (
                    round,
                    "imitation",
                    share(done, rounds),
                    format!("imitation {done} of {rounds}"),
                )
            }
            RetrainingProgress::Training {
                round,
                episode,
                episodes,
                fewest_contacts: fewest,
            } => {
                let fewest = fewest.map_or("no checkpoint yet".to_owned(), |fewest| {
                    format!("best checkpoint {fewest} collisions")
                });
                let message = format!("episode {episode} of {episodes}, {fewest}");
                (round, "training", share(*episode, *episodes), message)
            }
            RetrainingProgress::Evaluating { round } => (
                round,
                "evaluation",
                None,
                "evaluating the candidate".to_owned(),
            ),
        };
        self.print(
            step,
            part,
            &format!("round {round} of {}: {message}", self.rounds),
        );
    }

    /// Prints a message with the time left of its step, if the done `part` of the step is known.
    fn print(&mut self, step: &'static str, part: Option<f64>, message: &str) {
        let part = part.unwrap_or(0.0);
        let (_, begin, from) = match self.step {
            Some(known) if known.0 == step => known,
            _ => *self.step.insert((step, Instant::now(), part)),
        };
        let left = progress::format_time_left(begin.elapsed(), part - from, 1.0 - from);
        self.bar.set_message(format!("{message}{left}"));
        self.bar.tick();
    }
}
