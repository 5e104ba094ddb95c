//! What the egos of a set do from one decision to the next: hold an acceleration, or follow a law from which they depart.
//!
//! Who follows a law accelerates anew at every step. What that adds within a decision interval belongs to no symbol; at the decision it becomes symbols. Who
//! stops within a step would have reversed at b h at most, if it brakes at b, so that a speed below that is none of a member's. Over the last step before the
//! next decision the set is split in those who move and those who stand, as [`members`](super::members) does for the whole of an interval.

use super::braking::VehicleState;
use super::ego_set::{EgoSet, MotionMode};
use super::form::AffineForm;
use super::relax::{relu, relu_above};
use crate::interval::Interval;

/// What is done until the next decision.
pub(super) enum CommandProfile {
    /// One acceleration.
    Constant(AffineForm),
    /// Another one at each step.
    Stepwise(StepCommands),
}

/// Accelerations step by step, and what comes of them.
pub(super) struct StepCommands {
    /// At the begin of each step, and at the end of the last.
    egos: Vec<VehicleState>,
    accelerations: Vec<AffineForm>,
}

impl CommandProfile {
    /// Of egos that accelerate, at each step in turn, at what is said of them then.
    pub(super) fn from_steps(
        start: &VehicleState,
        steps: u32,
        step: Interval,
        mut acceleration: impl FnMut(u32, &VehicleState) -> AffineForm,
    ) -> Self {
        let (mut egos, mut accelerations) = (Vec::new(), Vec::new());
        let mut ego = start.clone();
        for j in 0..steps {
            let wanted = acceleration(j, &ego);
            let later = advance_step(&ego, &wanted, step);
            egos.push(std::mem::replace(&mut ego, later));
            accelerations.push(wanted);
        }
        egos.push(ego);
        Self::Stepwise(StepCommands { egos, accelerations })
    }

    /// All egos `steps` steps into the interval; what they accelerate at is left open.
    pub(super) fn ego_after(&self, members: &EgoSet, step: Interval, steps: u32) -> VehicleState {
        match self {
            Self::Constant(wanted) => members.ego_after(wanted, step, steps),
            Self::Stepwise(StepCommands { egos, .. }) => egos.get(steps as usize).unwrap_or(&members.ego).clone(),
        }
    }

    /// All accelerations that are asked for.
    pub(super) fn accelerations_mps2(&self) -> Interval {
        match self {
            Self::Constant(wanted) => wanted.range(),
            Self::Stepwise(StepCommands { accelerations, .. }) => {
                accelerations.iter().map(AffineForm::range).reduce(Interval::hull).unwrap_or(Interval::ENTIRE)
            }
        }
    }

    /// Whether nobody has stopped who moves at the end.
    pub(super) fn is_moving_throughout(&self, speed_at_end: &AffineForm) -> bool {
        let moves = |speed: &AffineForm| speed.range().low() > 0.0;
        let within = match self {
            Self::Constant(_) => true,
            Self::Stepwise(StepCommands { egos, .. }) => egos.iter().all(|ego| moves(&ego.speed)),
        };
        within && moves(speed_at_end)
    }

    /// The egos at the next decision: those that move at the beginning of the last step before it, and those that stand.
    pub(super) fn after_decision(&self, members: &EgoSet, step: Interval, decision_steps: u32) -> [Option<EgoSet>; 2] {
        match self {
            Self::Constant(wanted) => members.after_decision(wanted, step, decision_steps),
            Self::Stepwise(StepCommands { egos, accelerations }) => match (&egos[..], &accelerations[..]) {
                ([.., before_last, _], [.., wanted]) => {
                    members.clone().with_ego(before_last.clone()).after_decision(wanted, step, 1)
                }
                _ => [None, None],
            },
        }
    }

    /// Whether egos that stand go on standing.
    pub(super) fn is_standing_throughout(&self, kind: MotionMode) -> bool {
        let stood = match self {
            Self::Constant(_) => true,
            Self::Stepwise(StepCommands { egos, .. }) => egos.iter().all(|ego| ego.speed.is_zero()),
        };
        kind == MotionMode::Standing && stood && self.accelerations_mps2().high() <= 0.0
    }
}

/// Egos a step later. Those that were there before are as many: who stops is among them with a speed of 0.
fn advance_step(
    VehicleState { distance, speed, .. }: &VehicleState,
    wanted: &AffineForm,
    step: Interval,
) -> VehicleState {
    let half = Interval::point(0.5);
    if speed.is_zero() {
        // Who stands accelerates at max(0, u).
        let acceleration = relu(wanted);
        let distance = distance.clone().plus(&acceleration.scaled(step.sqr() * half));
        return VehicleState { distance, speed: acceleration.scaled(step), acceleration: AffineForm::default() };
    }
    let end = speed.clone().plus(&wanted.scaled(step));
    let most_reversing = (-wanted.range()).max(Interval::ZERO) * step;
    let reversing = (-end.range()).max(Interval::ZERO).min(most_reversing).hull(Interval::ZERO);
    let mut distance = distance.clone().plus(&speed.scaled(step)).plus(&wanted.scaled(step.sqr() * half));
    distance.shift((reversing * step * half).hull(Interval::ZERO));
    VehicleState { distance, speed: relu_above(&end, -most_reversing.high()), acceleration: AffineForm::default() }
}

#[cfg(test)]
mod tests;
