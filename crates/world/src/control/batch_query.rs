//! One question for many: controllers from outside that look, ask when a decision is due, and hold the answer in between.

use super::ControllerFailure;
use crate::observation::Observation;

/// A controller that asks for its answers.
pub(super) trait BatchQuery: Sized {
    /// Looks, if a decision is due at this step; counts the step. Whether one is.
    fn sample(&mut self, seen: &Observation) -> bool;

    /// Decides on what was seen last, asking for itself alone.
    fn query(&mut self) -> Result<(), ControllerFailure>;

    /// Whether one question can be asked for both.
    fn shares_batch_with(&self, other: &Self) -> bool;

    /// The answers to what several such saw last, an entry each; none if each has to ask for itself.
    fn query_batch(all: &[&Self]) -> Option<Vec<f64>>;

    /// Takes an answer to what it saw last.
    fn set_command(&mut self, answer_mps2: f64) -> Result<(), ControllerFailure>;

    /// Its answer until the next decision.
    fn command_mps2(&self) -> f64;
}

/// One of them by itself ([`super::Controller::decide`]).
pub(super) fn decide(one: &mut impl BatchQuery, seen: &Observation) -> Result<f64, ControllerFailure> {
    if one.sample(seen) {
        one.query()?;
    }
    Ok(one.command_mps2())
}

/// Many of them ([`super::Controller::decide_together`]): one question for each row of those that can share it.
///
/// Where there is no answer, whose fault it is shows when each asks for itself: a run ends as it would have alone.
pub(super) fn decide_batch<C: BatchQuery>(
    all: &mut [C],
    mut see: impl FnMut(usize) -> Observation,
    commands_mps2: &mut [f64],
    failed: &mut Vec<(usize, ControllerFailure)>,
) {
    let mut due = Vec::new();
    for (place, one) in all.iter_mut().enumerate() {
        if one.sample(&see(place)) {
            due.push(place);
        }
    }
    let groups: Vec<&[usize]> = due.chunk_by(|&a, &b| all[a].shares_batch_with(&all[b])).collect();
    for group in groups {
        let alike: Vec<&C> = group.iter().map(|&place| &all[place]).collect();
        let together = if alike.len() > 1 { C::query_batch(&alike) } else { None };
        for (index, &place) in group.iter().enumerate() {
            let decided = match together.as_ref().and_then(|answers_mps2| answers_mps2.get(index)) {
                Some(&answer_mps2) => all[place].set_command(answer_mps2),
                None => all[place].query(),
            };
            if let Err(failure) = decided {
                failed.push((place, failure));
            }
        }
    }
    for (command_mps2, one) in commands_mps2.iter_mut().zip(all) {
        *command_mps2 = one.command_mps2();
    }
}
