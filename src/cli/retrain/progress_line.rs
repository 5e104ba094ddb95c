//! Progress of `crumple retrain` on a terminal.

use std::time::Instant;

use indicatif::ProgressBar;

use super::super::progress;
use crumple_learn::retrain::RetrainingProgress;
use crumple_search::falsify::campaign::{CampaignProgress, ExaminationStep};

/// Progress on a terminal, with the time left of the present step.
pub(super) struct ProgressLine<'a> {
    pub(super) bar: &'a ProgressBar,
    pub(super) rounds: u64,
    pub(super) step: Option<TimedStep>,
}

/// A step whose time left is estimated.
#[derive(Clone, Copy)]
pub(super) struct TimedStep {
    name: &'static str,
    begin: Instant,
    /// Share of the step that was done at `begin`.
    begin_share: f64,
}

/// A message about a step of a round.
struct StepMessage {
    step: &'static str,
    /// Share of the step that is done, if it is known.
    done_share: Option<f64>,
    text: String,
}

fn share(done: u64, total: u64) -> f64 {
    done as f64 / total.max(1) as f64
}

impl ProgressLine<'_> {
    pub(super) fn show(&mut self, state: &RetrainingProgress) {
        match state {
            RetrainingProgress::Gathering { file, done, wanted } => self.print(StepMessage {
                step: file,
                done_share: Some(share(*done, *wanted)),
                text: format!("{file}: {done} of {wanted} avoidable random scenarios"),
            }),
            RetrainingProgress::SimulatingDraws { round, draws } => self.print_in_round(
                *round,
                StepMessage {
                    step: "draws",
                    done_share: None,
                    text: format!("simulating {draws} random scenarios, classifying collisions"),
                },
            ),
            RetrainingProgress::Searching {
                round,
                space,
                space_index,
                progress,
            } => self.print_in_round(*round, describe_search(space, *space_index, progress)),
            RetrainingProgress::Attacking { round, scenarios } => self.print_in_round(
                *round,
                StepMessage {
                    step: "attack",
                    done_share: None,
                    text: format!("worst-case braking in {scenarios} scenarios, then training"),
                },
            ),
            RetrainingProgress::Imitating { round, imitation } => self.print_in_round(
                *round,
                StepMessage {
                    step: "imitation",
                    done_share: Some(share(imitation.round.into(), imitation.rounds.into())),
                    text: format!("imitation {} of {}", imitation.round, imitation.rounds),
                },
            ),
            RetrainingProgress::Training {
                round,
                episode,
                episodes,
                fewest_collisions,
            } => self.print_in_round(
                *round,
                describe_training(*episode, *episodes, *fewest_collisions),
            ),
            RetrainingProgress::Evaluating { round } => self.print_in_round(
                *round,
                StepMessage {
                    step: "evaluation",
                    done_share: None,
                    text: "evaluating the candidate".to_owned(),
                },
            ),
        }
    }

    fn print_in_round(&mut self, round: u64, message: StepMessage) {
        self.print(StepMessage {
            text: format!("round {round} of {}: {}", self.rounds, message.text),
            ..message
        });
    }

    /// Prints a message with the time left of its step, if it is known how much of it is done.
    fn print(&mut self, message: StepMessage) {
        let done_share = message.done_share.unwrap_or(0.0);
        let step = match self.step {
            Some(step) if step.name == message.step => step,
            _ => *self.step.insert(TimedStep {
                name: message.step,
                begin: Instant::now(),
                begin_share: done_share,
            }),
        };
        let left = progress::format_time_left(
            step.begin.elapsed(),
            done_share - step.begin_share,
            1.0 - step.begin_share,
        );
        self.bar.set_message(format!("{}{left}", message.text));
        self.bar.tick();
    }
}

fn describe_search(
    space: &str,
    [index, spaces]: [usize; 2],
    state: &CampaignProgress,
) -> StepMessage {
    // The time of an examination is not known.
    let done_share = state
        .method
        .as_ref()
        .map(|_| (index as f64 + share(state.evaluations, state.total)) / spaces as f64);
    let examination = state
        .examination
        .map_or("writing the results", ExaminationStep::describe);
    let method = state
        .method
        .as_ref()
        .map_or(examination.to_owned(), ToString::to_string);
    StepMessage {
        step: "search",
        done_share,
        text: format!(
            "{method} in {space}, {} of {} runs, {} failures",
            state.evaluations, state.total, state.failures
        ),
    }
}

fn describe_training(episode: u64, episodes: u64, fewest_collisions: Option<u64>) -> StepMessage {
    let best = fewest_collisions.map_or("no checkpoint yet".to_owned(), |collisions| {
        format!("best checkpoint {collisions} collisions")
    });
    StepMessage {
        step: "training",
        done_share: Some(share(episode, episodes)),
        text: format!("episode {episode} of {episodes}, {best}"),
    }
}
