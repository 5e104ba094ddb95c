//! What a vehicle feels of its own motion.

use super::KnownChange;

/// An ideal accelerometer: it tells changes of the own motion, and neither speed nor position.
///
/// A vehicle that comes to rest inside a step, or is hit, changes its speed by another amount than the acceleration it began
/// the step with would have; that is felt too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accelerometer {
    speed_mps: f64,
    acceleration_mps2: f64,
}

impl Accelerometer {
    /// Of a vehicle that has held this speed so far.
    #[must_use]
    pub fn new(speed_mps: f64) -> Self {
        Self { speed_mps, acceleration_mps2: 0.0 }
    }

    /// What was felt since the last call, one step ago: against going on with the acceleration of the step before that.
    ///
    /// `acceleration_mps2` is the one held over the step that ends now, as in [`Observation`](crate::observation::Observation).
    #[inline]
    pub fn measure_change(&mut self, step_s: f64, speed_mps: f64, acceleration_mps2: f64) -> KnownChange {
        let change = KnownChange {
            rate_mps: speed_mps - (self.speed_mps + step_s * self.acceleration_mps2),
            acceleration_mps2: acceleration_mps2 - self.acceleration_mps2,
        };
        *self = Self { speed_mps, acceleration_mps2 };
        change
    }
}
