//! A trivial controller that copies the acceleration of its leader; a reference for learned ones.

use super::{BuiltIn, Controller, ControllerFailure, Ego, NoSettings};
use crate::observation::Observation;

/// A controller that commands the observed acceleration of its leader, and holds its speed on an empty road.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MatchLeader;

impl Controller for MatchLeader {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        Ok(observation
            .ahead
            .map_or(0.0, |ahead| ahead.acceleration_mps2))
    }
}

impl BuiltIn for MatchLeader {
    const NAME: &'static str = "match-leader";
    const SUMMARY: &'static str = "commands the observed acceleration of the vehicle ahead";
    type Settings = NoSettings;
    type Driver = Self;

    fn start(_settings: &NoSettings, _ego: &Ego, _seed: u64) -> Self {
        Self
    }
}
