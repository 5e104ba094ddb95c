//! Controllers nobody would drive with: they show what a shield is worth.

use rand::RngExt;

use super::{Controller, Ego};
use crate::estimate::Observation;
use crate::random::Stream;

/// Accelerates as hard as it can, whatever it sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FullThrottle {
    accel_mps2: f64,
}

impl FullThrottle {
    /// The controller for a vehicle.
    #[must_use]
    pub fn new(ego: &Ego) -> Self {
        Self { accel_mps2: ego.max_accel_mps2 }
    }
}

impl Controller for FullThrottle {
    fn act(&mut self, _seen: &Observation) -> f64 {
        self.accel_mps2
    }
}

/// A new action each step, uniform between full braking and full acceleration.
#[derive(Debug, Clone)]
pub struct RandomActions {
    ego: Ego,
    stream: Stream,
}

impl RandomActions {
    /// The controller for a vehicle, with its stream of random numbers.
    #[must_use]
    pub fn new(ego: &Ego, stream: Stream) -> Self {
        Self { ego: *ego, stream }
    }
}

impl Controller for RandomActions {
    fn act(&mut self, _seen: &Observation) -> f64 {
        self.stream.random_range(-self.ego.max_brake_mps2..=self.ego.max_accel_mps2)
    }
}
