//! Batched queries of external controllers, which hold an answer between two decisions.

use super::ControllerFailure;
use crate::observation::Observation;

/// A controller that obtains its commands by queries.
pub(super) trait BatchQuery: Sized {
    /// Stores the observation if a decision is due, and counts the step. Returns true if a decision is due.
    fn sample(&mut self, seen: &Observation) -> bool;

    fn query(&mut self) -> Result<(), ControllerFailure>;

    /// True if one query can serve both.
    fn shares_batch_with(&self, other: &Self) -> bool;

    /// Returns the answers to the stored observations of several controllers; `None` if each has to query by itself.
    fn query_batch(all: &[&Self]) -> Option<Vec<f64>>;

    fn set_command(&mut self, answer_mps2: f64) -> Result<(), ControllerFailure>;

    fn command_mps2(&self) -> f64;
}

pub(super) fn decide(
    one: &mut impl BatchQuery,
    seen: &Observation,
) -> Result<f64, ControllerFailure> {
    if one.sample(seen) {
        one.query()?;
    }
    Ok(one.command_mps2())
}

/// Decides for many controllers ([`super::Controller::decide_batch`]) with one query per group that can share it.
///
/// If the shared query fails, each controller queries by itself, so that each run ends as it would have ended alone.
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
    let groups: Vec<&[usize]> = due
        .chunk_by(|&a, &b| all[a].shares_batch_with(&all[b]))
        .collect();
    for group in groups {
        let members: Vec<&C> = group.iter().map(|&place| &all[place]).collect();
        let together = if members.len() > 1 {
            C::query_batch(&members)
        } else {
            None
        };
        for (index, &place) in group.iter().enumerate() {
            let decided = match together
                .as_ref()
                .and_then(|answers_mps2| answers_mps2.get(index))
            {
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
