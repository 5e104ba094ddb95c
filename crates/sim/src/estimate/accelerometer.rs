//! An ideal accelerometer.

use super::KnownChange;

/// An ideal accelerometer. It measures changes of the vehicle's own motion, but neither speed nor position.
///
/// A vehicle that stops within a step, or is hit, does not keep its acceleration over the step; the sensor measures
/// this change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accelerometer {
    speed_mps: f64,
    acceleration_mps2: f64,
}

impl Accelerometer {
    /// Creates the accelerometer of a vehicle that has moved at constant speed so far.
    #[must_use]
    pub fn new(speed_mps: f64) -> Self {
        Self {
            speed_mps,
            acceleration_mps2: 0.0,
        }
    }

    /// Returns by how much speed and acceleration differ from those of a motion that keeps its previous acceleration
    /// over the last step.
    ///
    /// `acceleration_mps2` was held over the step that ends now, as in
    /// [`Observation`](crate::observation::Observation).
    #[inline]
    pub fn measure_change(
        &mut self,
        step_s: f64,
        speed_mps: f64,
        acceleration_mps2: f64,
    ) -> KnownChange {
        let change = KnownChange {
            rate_mps: speed_mps - (self.speed_mps + step_s * self.acceleration_mps2),
            acceleration_mps2: acceleration_mps2 - self.acceleration_mps2,
        };
        *self = Self {
            speed_mps,
            acceleration_mps2,
        };
        change
    }
}
