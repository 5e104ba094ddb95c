//! Commands of the egos of a set until the next decision: a held acceleration, or those of a residual policy.
//!
//! A residual policy commands a new acceleration at every step. New uncertainty within a decision interval belongs to
//! no symbol; it becomes symbols at the decision. The unclipped update of a vehicle that stops within the step ends at
//! a speed of at least -b h, so lower speeds are discarded. Over the last step before the next decision the set is
//! split into moving and standing members, as [`ego_set`](super::ego_set) does for a whole interval.

use super::braking::VehicleState;
use super::ego_set::{EgoSet, MotionMode, advance_ego};
use super::form::AffineForm;
use crate::interval::Interval;

pub(super) enum CommandProfile {
    /// A held acceleration.
    Constant(AffineForm),
    /// A new acceleration at each step.
    Stepwise(StepCommands),
}

pub(super) struct StepCommands {
    /// At the begin of each step, and at the end of the last.
    egos: Vec<VehicleState>,
    accelerations: Vec<AffineForm>,
}

impl CommandProfile {
    /// Simulates egos with the acceleration that the closure returns for each step and state.
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
            let later = VehicleState { acceleration: AffineForm::default(), ..advance_ego(&ego, &wanted, step, step) };
            egos.push(std::mem::replace(&mut ego, later));
            accelerations.push(wanted);
        }
        egos.push(ego);
        Self::Stepwise(StepCommands { egos, accelerations })
    }

    /// Returns all egos `steps` steps into the interval; leaves their acceleration open.
    pub(super) fn ego_after(&self, members: &EgoSet, step: Interval, steps: u32) -> VehicleState {
        match self {
            Self::Constant(wanted) => members.ego_after(wanted, step, steps),
            Self::Stepwise(StepCommands { egos, .. }) => egos.get(steps as usize).unwrap_or(&members.ego).clone(),
        }
    }

    pub(super) fn accelerations_mps2(&self) -> Interval {
        match self {
            Self::Constant(wanted) => wanted.range(),
            Self::Stepwise(StepCommands { accelerations, .. }) => {
                accelerations.iter().map(AffineForm::range).reduce(Interval::hull).unwrap_or(Interval::ENTIRE)
            }
        }
    }

    /// True if no ego that moves at the end has stopped before.
    pub(super) fn is_moving_throughout(&self, speed_at_end: &AffineForm) -> bool {
        let moves = |speed: &AffineForm| speed.range().low() > 0.0;
        let within = match self {
            Self::Constant(_) => true,
            Self::Stepwise(StepCommands { egos, .. }) => egos.iter().all(|ego| moves(&ego.speed)),
        };
        within && moves(speed_at_end)
    }

    /// Returns the egos at the next decision: those that move at the beginning of the last step before it, and those
    /// that stand.
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

    pub(super) fn is_standing_throughout(&self, mode: MotionMode) -> bool {
        let stood = match self {
            Self::Constant(_) => true,
            Self::Stepwise(StepCommands { egos, .. }) => egos.iter().all(|ego| ego.speed.is_zero()),
        };
        mode == MotionMode::Standing && stood && self.accelerations_mps2().high() <= 0.0
    }
}

#[cfg(test)]
mod tests;
