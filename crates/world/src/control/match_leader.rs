//! Copying the vehicle ahead: a trivial controller that any learned one must be compared with.

use super::{BuiltIn, Controller, ControllerFailure, Ego, NoSettings};
use crate::observation::Observation;

/// Commands the acceleration that the vehicle ahead is seen to have; holds speed on an empty road.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MatchLeader;

impl Controller for MatchLeader {
    #[inline]
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        Ok(seen.ahead.map_or(0.0, |ahead| ahead.acceleration_mps2))
    }
}

impl BuiltIn for MatchLeader {
    const NAME: &'static str = "match-leader";
    const SUMMARY: &'static str = "command the acceleration the vehicle ahead is seen to have";
    type Settings = NoSettings;
    type Driver = Self;

    fn start(_settings: &NoSettings, _ego: &Ego, _seed: u64) -> Self {
        Self
    }
}
