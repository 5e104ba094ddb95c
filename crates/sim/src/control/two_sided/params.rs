//! Assumptions of a two-sided shield about its vehicle and both neighbours.

use crate::control::{ErrorBounds, ViabilityKernel};

/// Bounds of the errors of the observed follower, both non-negative.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RearErrorBounds {
    /// Error bound of the gap behind, in metres.
    pub gap_m: f64,
    /// Error bound of the speed of the follower, in m/s.
    pub speed_mps: f64,
}

/// Event that makes a follower brake.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FollowerTrigger {
    /// The time to collision falls below this time at a step, in seconds. The follower then brakes to standstill.
    TimeToCollision(f64),
    /// The ego vehicle brakes by at least [`NOTICED_BRAKE_MPS2`] or stands. The follower brakes as long as it does so.
    LeaderBrakes,
}

/// Deceleration of the ego vehicle that a follower with [`FollowerTrigger::LeaderBrakes`] notices, in m/s²: above it,
/// brake lights must be lit also for electric braking (UN R13-H, 5.2.22.4).
pub const NOTICED_BRAKE_MPS2: f64 = 1.3;

/// Speed below which a follower behind a standing ego vehicle is not covered, in m/s: the class allows it to roll into
/// a standing vehicle.
pub const CREEP_SPEED_MPS: f64 = 0.5;

/// A class of followers: all that behave as described, and no others.
///
/// From the trigger on a follower brakes within `reaction_s` at `brake_mps2` or more. Before that, its acceleration is
/// within `drift_mps2` of 0; after the trigger, and in the second class, only the upper limit counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FollowerClass {
    /// Event that makes the follower brake.
    pub trigger: FollowerTrigger,
    /// Maximum time from the trigger to braking, in seconds.
    pub reaction_s: f64,
    /// Minimum deceleration from then on, in m/s², positive.
    pub brake_mps2: f64,
    /// Maximum magnitude of the acceleration before, in m/s².
    pub drift_mps2: f64,
}

/// All assumptions of a two-sided shield.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoSidedParams {
    /// Time between decisions, in seconds.
    pub step_s: f64,
    /// Full braking without noise, in m/s², positive.
    pub brake_mps2: f64,
    /// Maximum acceleration, in m/s².
    pub accel_mps2: f64,
    /// Maximum deviation of the own acceleration from the response of the actuator, in m/s².
    pub noise_mps2: f64,
    /// Steps from a command to the actuator.
    pub delay_steps: usize,
    /// Share of the difference to the command that the actuator covers in a step; 1 without lag.
    pub response_fraction: f64,
    /// Deceleration of the leader up to which the shield protects, in m/s²: the level that it keeps.
    pub level_mps2: f64,
    /// Error bounds of the own speed and of the leader.
    pub errors: ErrorBounds,
    /// Error bounds of the follower.
    pub rear_errors: RearErrorBounds,
    /// The follower, if there is one.
    pub follower: Option<FollowerClass>,
    /// Smallest gap that a plan keeps on either side, in metres; covers rounding.
    pub margin_m: f64,
    /// True if the shield executes its plan before it must, while the leader brakes hard and the level is lower than
    /// the one to keep.
    pub raises: bool,
}

impl TwoSidedParams {
    /// Returns the kernel of a fully braking ego vehicle behind a leader that brakes at up to `ahead_brake_mps2`.
    pub(super) fn kernel(&self, ahead_brake_mps2: f64) -> ViabilityKernel {
        ViabilityKernel {
            own_brake_mps2: self.brake_mps2 - self.noise_mps2,
            ahead_brake_mps2,
        }
    }

    /// Returns the effective lag τ' of the actuator, in seconds; see `ShieldParams::lag_s`.
    pub(super) fn lag_s(&self) -> f64 {
        self.step_s * (1.0 - self.response_fraction) / self.response_fraction
    }

    /// Returns the acceleration of plans after the follower's brake has fired, in m/s²: the limit of the vehicle, but
    /// not more than its braking, because both need the friction of the road.
    ///
    /// Behind a leader that may brake at least as hard as the ego vehicle, more acceleration for a shorter time is
    /// never worse: both end at the same place, and until then the ego vehicle is at least as far from the follower.
    /// Behind other leaders, few states have a plan with less acceleration only.
    pub(super) fn plan_accel_mps2(&self) -> f64 {
        self.accel_mps2.min(self.brake_mps2)
    }

    /// True if the ego vehicle observes the step in which the follower's brake fires.
    pub(super) fn observes_firing(&self) -> bool {
        self.rear_errors == RearErrorBounds::default() && self.errors.speed_mps == 0.0
    }

    /// Returns the response of the actuator, in m/s², over the step in which `due_mps2` takes effect.
    pub(super) fn response_mps2(&self, response_mps2: f64, due_mps2: f64) -> f64 {
        response_mps2 + self.response_fraction * (due_mps2 - response_mps2)
    }
}
