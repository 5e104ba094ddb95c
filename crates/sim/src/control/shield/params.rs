//! Assumptions of a shield about its vehicle and both neighbours.

use super::{Real, ViabilityKernel};

/// Bounds of the errors of an observation, all non-negative.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ErrorBounds {
    /// Error bound of the gap ahead, in metres.
    pub gap_m: f64,
    /// Error bound of the own speed, in m/s.
    pub speed_mps: f64,
    /// Error bound of the speed of the leader, in m/s.
    pub ahead_speed_mps: f64,
}

/// Properties of the follower that a shield uses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RearVehicleParams {
    /// Deceleration that the follower can reach, in m/s².
    pub brake_mps2: f64,
    /// Reaction time, in which the follower holds its speed, in seconds.
    pub reaction_s: f64,
}

/// All assumptions of a shield.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShieldParams<R = f64> {
    /// Time between decisions, in seconds.
    pub step_s: R,
    /// Full braking without noise, in m/s², positive.
    pub brake_mps2: R,
    /// Maximum acceleration, in m/s².
    pub accel_mps2: R,
    /// Maximum deviation of the own acceleration from the response of the actuator, in m/s².
    pub noise_mps2: R,
    /// Deceleration that the leader never exceeds, in m/s².
    pub ahead_brake_mps2: R,
    /// Steps from a command to the actuator.
    pub delay_steps: usize,
    /// Share of the difference to the command that the actuator covers in a step; 1 without lag.
    pub response_fraction: R,
    /// Error bounds of observations.
    pub errors: ErrorBounds,
    /// The follower, if there is one.
    pub behind: Option<RearVehicleParams>,
    /// Distance beyond the kernel's gap, in metres: covers rounding and keeps the gap above zero. Half of it covers
    /// rounding after a command was admitted, see `MotionBounds::margin_m`.
    pub margin_m: R,
}

impl<R: Real> ShieldParams<R> {
    /// Returns the kernel against the leader; the own brake limit is reduced by the noise.
    #[inline]
    pub(crate) fn kernel(&self) -> ViabilityKernel<R> {
        ViabilityKernel {
            own_brake_mps2: self.brake_mps2 - self.noise_mps2,
            ahead_brake_mps2: self.ahead_brake_mps2,
        }
    }

    /// Returns the effective lag τ' = h (1 - σ)/σ of an actuator that in a step h covers the share σ of the difference
    /// between command and response.
    ///
    /// For a lag τ this is h/(exp(h/τ) - 1), slightly less than τ. For response r let z = v + τ' (r + b). A step of
    /// full braking decreases z by exactly b h, since it multiplies r + b by 1 - σ. z is at least the speed. Braking
    /// fully, the vehicle is never faster or further than one without lag that starts at z.
    #[must_use]
    #[inline]
    pub fn lag_s(&self) -> R {
        self.step_s * (R::from_f64(1.0) - self.response_fraction) / self.response_fraction
    }
}
