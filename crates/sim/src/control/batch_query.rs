//! Controllers that obtain their commands by queries, of which several can be combined.

use std::any::Any;

use super::{Controller, ControllerFailure};
use crate::observation::Observation;

/// A controller that obtains its commands by queries, and holds an answer between two decisions.
///
/// Lockstep runs combine queries of controllers that [share batches](Self::shares_batch_with). If the combined query
/// fails, each controller queries by itself, so that each run ends as it would have ended alone.
pub trait BatchQuery: Any {
    /// Stores the observation if a decision is due, and counts the step. Returns true if a decision is due.
    fn sample(&mut self, observation: &Observation) -> bool;

    /// Queries for the stored observation.
    ///
    /// # Errors
    /// [`ControllerFailure`] if there is no answer.
    fn query(&mut self) -> Result<(), ControllerFailure>;

    /// Returns true if one query can serve both.
    fn shares_batch_with(&self, other: &dyn BatchQuery) -> bool;

    /// Returns the answers to the stored observations of several controllers that share batches with this one, which
    /// is the first; `None` if each has to query by itself.
    fn query_batch(&self, members: &[&dyn BatchQuery]) -> Option<Vec<f64>>;

    /// Accepts the answer to the stored observation, in m/s².
    ///
    /// # Errors
    /// [`ControllerFailure`] if the answer cannot be used.
    fn set_command(&mut self, answer_mps2: f64) -> Result<(), ControllerFailure>;

    /// Returns the current command, in m/s².
    fn command_mps2(&self) -> f64;
}

impl dyn BatchQuery {
    /// Returns the controller as its own type, if it is a `T`.
    #[must_use]
    pub fn downcast_ref<T: BatchQuery>(&self) -> Option<&T> {
        (self as &dyn Any).downcast_ref()
    }
}

/// Decides for one controller: [`Controller::decide`].
///
/// # Errors
/// [`ControllerFailure`] of the query.
pub fn decide_by_query(
    controller: &mut impl BatchQuery,
    observation: &Observation,
) -> Result<f64, ControllerFailure> {
    if controller.sample(observation) {
        controller.query()?;
    }
    Ok(controller.command_mps2())
}

/// Decides for many controllers, with one query for each group of adjacent controllers that can share it.
pub(super) fn decide_batch(
    all: &mut [Box<dyn Controller>],
    mut observe: impl FnMut(usize) -> Observation,
    commands_mps2: &mut [f64],
    failed: &mut Vec<(usize, ControllerFailure)>,
) {
    let mut due: Vec<(usize, &mut dyn BatchQuery)> = Vec::new();
    let controllers = all.iter_mut().zip(&mut *commands_mps2).enumerate();
    for (index, (controller, command_mps2)) in controllers {
        let observation = observe(index);
        // Not `if let ... else`: the borrow of the first branch would last through the second.
        if controller.as_batch_query().is_none() {
            match controller.decide(&observation) {
                Ok(answer_mps2) => *command_mps2 = answer_mps2,
                Err(failure) => failed.push((index, failure)),
            }
        } else if let Some(query) = controller.as_batch_query() {
            if query.sample(&observation) {
                due.push((index, query));
            } else {
                *command_mps2 = query.command_mps2();
            }
        }
    }
    for group in due.chunk_by_mut(|(_, a), (_, b)| a.shares_batch_with(&**b)) {
        answer_group(group, commands_mps2, failed);
    }
}

/// Answers the stored observations of controllers that share a batch.
fn answer_group(
    group: &mut [(usize, &mut dyn BatchQuery)],
    commands_mps2: &mut [f64],
    failed: &mut Vec<(usize, ControllerFailure)>,
) {
    let answers_mps2 = match &*group {
        [(_, first), _, ..] => {
            let members: Vec<&dyn BatchQuery> = group.iter().map(|(_, query)| &**query).collect();
            first.query_batch(&members)
        }
        _ => None,
    };
    for (member, (index, query)) in group.iter_mut().enumerate() {
        let answer_mps2 = answers_mps2
            .as_ref()
            .and_then(|answers| answers.get(member));
        let decided = match answer_mps2 {
            Some(&answer_mps2) => query.set_command(answer_mps2),
            None => query.query(),
        };
        match decided {
            Ok(()) => commands_mps2[*index] = query.command_mps2(),
            Err(failure) => failed.push((*index, failure)),
        }
    }
}
