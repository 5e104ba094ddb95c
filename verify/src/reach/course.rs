//! What the egos of a set do from one decision to the next: hold an acceleration, or follow a law from which they depart.
//!
//! Who follows a law accelerates anew at every step. What that adds within a decision interval belongs to no symbol; at the decision it becomes symbols. Who
//! stops within a step would have reversed at b h at most, if it brakes at b, so that a speed below that is none of a member's. Over the last step before the
//! next decision the set is split in those who move and those who stand, as [`members`](super::members) does for the whole of an interval.

use super::braking::Seen;
use super::form::Form;
use super::members::{Kind, Members};
use super::relax::{rectified, rectified_above};
use crate::interval::Interval;

/// What is done until the next decision.
pub(super) enum Course {
    /// One acceleration.
    Held(Form),
    /// Another one at each step.
    Steps(Steps),
}

/// Accelerations step by step, and what comes of them.
pub(super) struct Steps {
    /// At the begin of each step, and at the end of the last.
    egos: Vec<Seen>,
    accelerations: Vec<Form>,
}

impl Course {
    /// Of egos that accelerate, at each step in turn, at what is said of them then.
    pub(super) fn stepwise(
        start: &Seen,
        steps: u32,
        step: Interval,
        mut acceleration: impl FnMut(u32, &Seen) -> Form,
    ) -> Self {
        let (mut egos, mut accelerations) = (Vec::new(), Vec::new());
        let mut ego = start.clone();
        for j in 0..steps {
            let wanted = acceleration(j, &ego);
            let later = stepped(&ego, &wanted, step);
            egos.push(std::mem::replace(&mut ego, later));
            accelerations.push(wanted);
        }
        egos.push(ego);
        Self::Steps(Steps { egos, accelerations })
    }

    /// All egos `steps` steps into the interval; what they accelerate at is left open.
    pub(super) fn moved(&self, members: &Members, step: Interval, steps: u32) -> Seen {
        match self {
            Self::Held(wanted) => members.moved(wanted, step, steps),
            Self::Steps(Steps { egos, .. }) => egos.get(steps as usize).unwrap_or(&members.ego).clone(),
        }
    }

    /// All accelerations that are asked for.
    pub(super) fn acts_mps2(&self) -> Interval {
        match self {
            Self::Held(wanted) => wanted.range(),
            Self::Steps(Steps { accelerations, .. }) => {
                accelerations.iter().map(Form::range).reduce(Interval::hull).unwrap_or(Interval::LINE)
            }
        }
    }

    /// Whether nobody has stopped who moves at the end.
    pub(super) fn moves_throughout(&self, speed_at_end: &Form) -> bool {
        let moves = |speed: &Form| speed.range().low() > 0.0;
        let within = match self {
            Self::Held(_) => true,
            Self::Steps(Steps { egos, .. }) => egos.iter().all(|ego| moves(&ego.speed)),
        };
        within && moves(speed_at_end)
    }

    /// The egos at the next decision: those that move at the beginning of the last step before it, and those that stand.
    pub(super) fn after(&self, members: &Members, step: Interval, decision_steps: u32) -> [Option<Members>; 2] {
        match self {
            Self::Held(wanted) => members.after_decision(wanted, step, decision_steps),
            Self::Steps(Steps { egos, accelerations }) => match (&egos[..], &accelerations[..]) {
                ([.., before_last, _], [.., wanted]) => {
                    members.clone().driven(before_last.clone()).after_decision(wanted, step, 1)
                }
                _ => [None, None],
            },
        }
    }

    /// Whether egos that stand go on standing.
    pub(super) fn stands(&self, kind: Kind) -> bool {
        let stood = match self {
            Self::Held(_) => true,
            Self::Steps(Steps { egos, .. }) => egos.iter().all(|ego| ego.speed.is_zero()),
        };
        kind == Kind::Standing && stood && self.acts_mps2().high() <= 0.0
    }
}

/// Egos a step later. Those that were there before are as many: who stops is among them with a speed of 0.
fn stepped(Seen { distance, speed, .. }: &Seen, wanted: &Form, step: Interval) -> Seen {
    let half = Interval::point(0.5);
    if speed.is_zero() {
        // Who stands accelerates at max(0, u).
        let acceleration = rectified(wanted);
        let distance = distance.clone().plus(&acceleration.scaled(step.sqr() * half));
        return Seen { distance, speed: acceleration.scaled(step), acceleration: Form::default() };
    }
    let end = speed.clone().plus(&wanted.scaled(step));
    let most_reversing = (-wanted.range()).max(Interval::ZERO) * step;
    let reversing = (-end.range()).max(Interval::ZERO).min(most_reversing).hull(Interval::ZERO);
    let mut distance = distance.clone().plus(&speed.scaled(step)).plus(&wanted.scaled(step.sqr() * half));
    distance.shift((reversing * step * half).hull(Interval::ZERO));
    Seen { distance, speed: rectified_above(&end, -most_reversing.high()), acceleration: Form::default() }
}

#[cfg(test)]
mod tests;
