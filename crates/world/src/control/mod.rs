//! Who decides: one trait, one file for each controller.
//!
//! A controller sees an [`Observation`], nothing else of the world, and answers with the acceleration it wants. What the
//! vehicle then does (limits, lag, friction) is the simulation's business.

mod acc_aeb;
mod baseline;
mod constant_brake;
mod idm;
mod match_leader;
mod policy;
mod shield;
mod stress;
mod zero_order_hold;

pub use acc_aeb::AccAeb;
pub use baseline::{Baseline, BaselineUnlatched};
pub use constant_brake::ConstantBrake;
pub use idm::Idm;
pub use match_leader::MatchLeader;
pub use policy::PolicyDriver;
pub use shield::{Behind, ErrorBounds, Frame, Kernel, MARGIN_M, Override, Shield, ShieldSettings};
pub use stress::{FullThrottle, RandomActions};
pub use zero_order_hold::ZeroOrderHold;

use std::sync::Arc;

use crate::estimate::Observation;
use crate::policy::Policy;
use crate::scenario::ControllerSpec;

/// What a controller knows about its own vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ego {
    /// Largest deceleration on a dry road, in m/s², positive. Friction is not known to controllers.
    pub max_brake_mps2: f64,
    /// Largest acceleration, in m/s².
    pub max_accel_mps2: f64,
    /// Bumper to bumper, in metres.
    pub length_m: f64,
    /// The scenario's step, in seconds.
    pub step_s: f64,
}

/// Decides a vehicle's acceleration from what may be seen.
pub trait Controller: Send {
    /// The acceleration wanted until the next decision, in m/s². Values beyond the vehicle's limits are cut to them; a
    /// NaN counts as 0.
    fn act(&mut self, seen: &Observation) -> f64;

    /// Time between decisions in seconds, a multiple of the scenario's step; none to decide at every step.
    fn interval_s(&self) -> Option<f64> {
        None
    }
}

impl Controller for Box<dyn Controller> {
    fn act(&mut self, seen: &Observation) -> f64 {
        (**self).act(seen)
    }

    fn interval_s(&self) -> Option<f64> {
        (**self).interval_s()
    }
}

/// A command cut to what the vehicle can do; NaN counts as 0.
///
/// By hand, since of 0 and -0 `f64::max` and `f64::min` may give either, and then engines that are compiled apart differ.
#[inline]
pub(crate) fn within(command_mps2: f64, max_brake_mps2: f64, max_accel_mps2: f64) -> f64 {
    let command_mps2 = if command_mps2.is_nan() { 0.0 } else { command_mps2 };
    let command_mps2 = if command_mps2 < -max_brake_mps2 { -max_brake_mps2 } else { command_mps2 };
    if command_mps2 > max_accel_mps2 { max_accel_mps2 } else { command_mps2 }
}

/// A controller of any kind, ready to drive one vehicle.
pub enum AnyController {
    /// The paper's baseline.
    Baseline(Baseline),
    /// The baseline with a brake that is released.
    BaselineUnlatched(BaselineUnlatched),
    /// Copies the acceleration ahead.
    MatchLeader(MatchLeader),
    /// Brakes at a constant rate.
    ConstantBrake(ConstantBrake),
    /// Intelligent Driver Model.
    Idm(Idm),
    /// Cruise control with emergency brake.
    AccAeb(AccAeb),
    /// A learned policy.
    Policy(PolicyDriver),
    /// Any of them behind a shield.
    Shielded(Shield),
    /// Somebody else's.
    Custom(Box<dyn Controller>),
}

impl AnyController {
    /// Builds a built-in controller for a vehicle.
    #[must_use]
    pub fn built_in(spec: &ControllerSpec, ego: &Ego) -> Self {
        match spec {
            ControllerSpec::Baseline(settings) => Self::Baseline(Baseline::new(settings, ego)),
            ControllerSpec::BaselineUnlatched(settings) => {
                Self::BaselineUnlatched(BaselineUnlatched::new(settings, ego))
            }
            ControllerSpec::MatchLeader => Self::MatchLeader(MatchLeader),
            ControllerSpec::ConstantBrake(settings) => Self::ConstantBrake(ConstantBrake::new(settings, ego)),
            ControllerSpec::Idm(settings) => Self::Idm(Idm::new(settings)),
            ControllerSpec::AccAeb(settings) => Self::AccAeb(AccAeb::new(settings, ego)),
            ControllerSpec::Policy => Self::policy(Policy::reference(), ego),
        }
    }

    /// A policy as the controller of a vehicle.
    #[must_use]
    pub fn policy(policy: Arc<Policy>, ego: &Ego) -> Self {
        Self::Policy(PolicyDriver::new(policy, ego))
    }

    /// Wraps a controller from outside, held between its decisions if it does not decide at every step.
    #[must_use]
    pub fn custom(controller: Box<dyn Controller>, ego: &Ego) -> Self {
        Self::Custom(match controller.interval_s() {
            None => controller,
            Some(interval_s) => Box::new(ZeroOrderHold::new(controller, interval_s, ego.step_s)),
        })
    }
}

impl Controller for AnyController {
    #[inline]
    fn act(&mut self, seen: &Observation) -> f64 {
        match self {
            Self::Baseline(controller) => controller.act(seen),
            Self::BaselineUnlatched(controller) => controller.act(seen),
            Self::MatchLeader(controller) => controller.act(seen),
            Self::ConstantBrake(controller) => controller.act(seen),
            Self::Idm(controller) => controller.act(seen),
            Self::AccAeb(controller) => controller.act(seen),
            Self::Policy(controller) => controller.act(seen),
            Self::Shielded(controller) => controller.act(seen),
            Self::Custom(controller) => controller.act(seen),
        }
    }

    fn interval_s(&self) -> Option<f64> {
        match self {
            Self::Policy(controller) => controller.interval_s(),
            Self::Shielded(controller) => controller.interval_s(),
            Self::Custom(controller) => controller.interval_s(),
            _ => None,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::estimate::Neighbour;

    pub(crate) const EGO: Ego = Ego { max_brake_mps2: 7.5, max_accel_mps2: 3.0, length_m: 2.0, step_s: 0.01 };

    /// An ego at `speed_mps` behind a vehicle `gap_m` ahead at `ahead_mps` that accelerates at `ahead_mps2`.
    pub(crate) fn behind(speed_mps: f64, gap_m: f64, ahead_mps: f64, ahead_mps2: f64) -> Observation {
        let ahead = Neighbour { gap_m, speed_mps: ahead_mps, acceleration_mps2: ahead_mps2 };
        Observation { speed_mps, acceleration_mps2: 0.0, ahead: Some(ahead), behind: None }
    }

    #[test]
    fn every_built_in_controller_answers_an_empty_road_with_a_finite_command() {
        let alone = Observation { speed_mps: 20.0, acceleration_mps2: 0.0, ahead: None, behind: None };
        for spec in ControllerSpec::built_in() {
            let command = AnyController::built_in(&spec, &EGO).act(&alone);
            assert!(command.is_finite(), "{}: {command}", spec.name());
            let is_learned = spec == ControllerSpec::Policy;
            assert!(is_learned || command >= 0.0, "{} brakes for nobody: {command}", spec.name());
        }
    }
}
