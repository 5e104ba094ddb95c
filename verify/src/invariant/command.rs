//! Bounds of a memoryless controller's command over a box of observations.

use super::MotionModel;
use super::table::AXIS_COUNT;
use crate::Rejection;
use crate::interval::Interval;
use crate::reach::controller::OBSERVATION_SIZE;
use crate::reach::form::AffineForm;
use crate::reach::{ControllerInput, FollowerLaw, NeuralController};
use crate::work::{OPS_PER_INTERVAL_OP, OpBudget};

/// Gaps ahead and behind; speeds ahead, own, behind; accelerations ahead, own, behind.
const GAP: usize = 0;
const GAP_BEHIND: usize = 1;
const LEADER: usize = 2;
const OWN: usize = 3;
const FOLLOWER: usize = 4;
const LEADER_ACCELERATION: usize = 5;
const OWN_ACCELERATION: usize = 6;
const FOLLOWER_ACCELERATION: usize = 7;
const INTERVAL_OPS_PER_LAW: u64 = 200;

/// The controller of the vehicle under test.
#[derive(Debug)]
pub(super) enum CommandModel<'a> {
    /// A control law.
    Law(&'a FollowerLaw),
    /// A network; its limits, and those of the leader, are those of the observed accelerations.
    Network(Box<NeuralController>, [Interval; 2]),
}

/// True if an input depends on gap and relative speed of the pair only, or on a follower, which does not exist.
fn is_relative(input: &ControllerInput) -> bool {
    let factors = &input.coefficients;
    let is_about_follower = [GAP_BEHIND, FOLLOWER, FOLLOWER_ACCELERATION]
        .iter()
        .any(|&quantity| factors[quantity] != 0.0);
    if is_about_follower {
        input.absent_value.is_some()
    } else {
        factors[OWN] + factors[LEADER] == 0.0
            && factors[LEADER_ACCELERATION] == 0.0
            && factors[OWN_ACCELERATION] == 0.0
    }
}

impl CommandModel<'_> {
    /// Checks that a controller has no input that the model of motion does not have.
    pub(super) fn check_inputs(&self, motion: MotionModel) -> Result<(), Rejection> {
        let network = match (self, motion) {
            (_, MotionModel::Absolute) => return Ok(()),
            (Self::Law(_), MotionModel::Relative) => {
                return Err(Rejection::invalid(
                    "motion",
                    "is relative, and the controller depends on its own speed",
                ));
            }
            (Self::Network(network, _), MotionModel::Relative) => network,
        };
        if network.inputs.iter().all(is_relative) {
            Ok(())
        } else {
            Err(Rejection::invalid(
                "motion",
                "is relative, and the network has other inputs than gap and relative speed",
            ))
        }
    }

    /// Returns the commands for observed gaps, own and leader's speeds; the whole line if the budget is exceeded.
    pub(super) fn range(
        &self,
        observed: &[AffineForm; 3],
        limits: Interval,
        work: &OpBudget,
    ) -> Interval {
        let command = match self {
            Self::Law(law) => {
                if !work.charge(INTERVAL_OPS_PER_LAW * OPS_PER_INTERVAL_OP) {
                    return Interval::ENTIRE;
                }
                law.command_range(observed, limits)
            }
            Self::Network(network, [own_mps2, leader_mps2]) => {
                let mut forms: [AffineForm; OBSERVATION_SIZE] = Default::default();
                for (quantity, form) in [GAP, OWN, LEADER].into_iter().zip(observed) {
                    forms[quantity] = form.clone();
                }
                // There is no follower. Its substitute has the own speed and does not accelerate.
                forms[GAP_BEHIND] = AffineForm::constant(Interval::point(network.empty_gap_m));
                forms[FOLLOWER] = forms[OWN].clone();
                let accelerations = [
                    (LEADER_ACCELERATION, leader_mps2),
                    (OWN_ACCELERATION, own_mps2),
                ];
                for (symbol, (quantity, range)) in (AXIS_COUNT + 1..).zip(accelerations) {
                    forms[quantity] = AffineForm::symbol(symbol, *range);
                }
                network
                    .decide_with_budget(&forms, &[0.0; OBSERVATION_SIZE], false, work)
                    .range()
            }
        };
        command
            .max(Interval::point(limits.low()))
            .min(Interval::point(limits.high()))
    }
}
