//! Copying the vehicle ahead: a trivial controller that any learned one must be compared with.

use super::Controller;
use crate::estimate::Observation;

/// Commands the acceleration that the vehicle ahead is seen to have; holds speed on an empty road.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MatchLeader;

impl Controller for MatchLeader {
    #[inline]
    fn act(&mut self, seen: &Observation) -> f64 {
        seen.ahead.map_or(0.0, |ahead| ahead.acceleration_mps2)
    }
}
