//! What a shield takes for granted about its vehicle and the two beside it.

use super::{Real, ViabilityKernel};

/// Bounds of the errors of what is seen, all not negative.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ErrorBounds {
    /// Of the gap ahead, in metres.
    pub gap_m: f64,
    /// Of the own speed, in m/s.
    pub speed_mps: f64,
    /// Of the speed of the vehicle ahead, in m/s.
    pub ahead_speed_mps: f64,
}

/// What the user of a shield may set.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ShieldSettings {
    /// What the vehicle ahead is assumed never to brake harder than on a dry road, in m/s². None for its own limit: as if
    /// vehicles told each other.
    pub ahead_brake_mps2: Option<f64>,
    /// Bounds of what is seen. None for what can be proved of the estimator: nothing with the true state.
    pub errors: Option<ErrorBounds>,
}

impl ShieldSettings {
    /// The settings as they stand after `shield` on a command line, each with a comma before it.
    #[must_use]
    pub fn to_arg(&self) -> String {
        let errors = self.errors.map(|errors| {
            let ErrorBounds { gap_m, speed_mps, ahead_speed_mps } = errors;
            format!(",gap-error={gap_m},speed-error={speed_mps},ahead-speed-error={ahead_speed_mps}")
        });
        let ahead = self.ahead_brake_mps2.map(|limit| format!(",ahead={limit}"));
        ahead.into_iter().chain(errors).collect()
    }
}

/// The vehicle behind, as far as a shield cares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RearVehicleParams {
    /// What it can brake at, in m/s².
    pub brake_mps2: f64,
    /// Time in which it holds its speed before it brakes, in seconds.
    pub reaction_s: f64,
}

/// Everything a shield takes for granted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShieldParams<R = f64> {
    /// The time between decisions, in seconds.
    pub step_s: R,
    /// What full braking is, in m/s², positive, noise left aside.
    pub brake_mps2: R,
    /// Largest acceleration, in m/s².
    pub accel_mps2: R,
    /// Largest deviation of the own acceleration from the actuator's, in m/s².
    pub noise_mps2: R,
    /// What the vehicle ahead never brakes harder than, in m/s².
    pub ahead_brake_mps2: R,
    /// Steps from a command to the actuator.
    pub delay_steps: usize,
    /// Share of the way to the command that the actuator covers in a step: 1 without lag.
    pub response_fraction: R,
    /// Bounds of what is seen.
    pub errors: ErrorBounds,
    /// The vehicle behind, if there is one.
    pub behind: Option<RearVehicleParams>,
    /// Demanded on top of the kernel's gap, in metres: it pays for rounding, and keeps the gap from being exactly zero. Half
    /// of it is for what comes after an action was let through, see `Travel::margin_m`.
    pub margin_m: R,
}

impl<R: Real> ShieldParams<R> {
    /// The kernel against the vehicle ahead. What noise may take away from the own brake is not counted on.
    #[must_use]
    #[inline]
    pub(crate) fn kernel(&self) -> ViabilityKernel<R> {
        ViabilityKernel { own_brake_mps2: self.brake_mps2 - self.noise_mps2, ahead_brake_mps2: self.ahead_brake_mps2 }
    }

    /// τ' = h (1 - σ)/σ for an actuator that covers the share σ of its way in a step h.
    ///
    /// For a lag τ this is h/(exp(h/τ) - 1), a little less than τ. With response r, z = v + τ' (r + b) loses exactly b h in a
    /// step of full braking, since r + b shrinks to its share 1 - σ; and z bounds the speed. So a vehicle that brakes fully is
    /// at no instant faster, nor further, than one without lag that starts at z, and z takes the place of v in the kernel.
    #[must_use]
    #[inline]
    pub fn lag_s(&self) -> R {
        self.step_s * (R::from_f64(1.0) - self.response_fraction) / self.response_fraction
    }
}
