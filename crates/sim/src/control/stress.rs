//! Controllers that drive badly on purpose; they show the effect of a shield.

use rand::RngExt;

use super::{BuiltIn, Controller, ControllerFailure, Ego, NoSettings, Role};
use crate::observation::Observation;
use crate::random::{self, Purpose, Stream};

/// A controller that always accelerates at its maximum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FullThrottle {
    accel_mps2: f64,
}

impl BuiltIn for FullThrottle {
    const NAME: &'static str = "full-throttle";
    const SUMMARY: &'static str = "full acceleration at all times, to test a shield";
    const ROLE: Role = Role::Probe;
    type Settings = NoSettings;
    type Driver = Self;

    fn start(_settings: &NoSettings, ego: &Ego, _seed: u64) -> Self {
        Self {
            accel_mps2: ego.max_accel_mps2,
        }
    }
}

impl Controller for FullThrottle {
    fn decide(&mut self, _seen: &Observation) -> Result<f64, ControllerFailure> {
        Ok(self.accel_mps2)
    }
}

/// A controller with a random command at each step, uniform between full braking and full acceleration.
#[derive(Debug, Clone)]
pub struct RandomActions {
    ego: Ego,
    stream: Stream,
}

impl BuiltIn for RandomActions {
    const NAME: &'static str = "random-actions";
    const SUMMARY: &'static str = "a random action at each step, to test a shield";
    const ROLE: Role = Role::Probe;
    type Settings = NoSettings;
    type Driver = Self;

    fn acts_at_random(_settings: &NoSettings) -> bool {
        true
    }

    fn start(_settings: &NoSettings, ego: &Ego, seed: u64) -> Self {
        Self {
            ego: *ego,
            stream: random::stream(seed, Purpose::RandomActions, ego.vehicle as u64),
        }
    }
}

impl Controller for RandomActions {
    fn decide(&mut self, _seen: &Observation) -> Result<f64, ControllerFailure> {
        Ok(self
            .stream
            .random_range(-self.ego.max_brake_mps2..=self.ego.max_accel_mps2))
    }
}
