//! The paper's baseline ADAS (algorithm 2) and its unlatched variant.

use super::{BuiltIn, Controller, ControllerFailure, Ego};
use crate::observation::{Neighbour, Observation};
use crate::settings::settings;

/// Time to collision below which the paper's emergency brake fires, in seconds (algorithm 2).
pub(crate) const FIRING_TTC_S: f64 = 1.4;

settings! {
    /// Settings of the emergency brake of the baseline controllers.
    AebSettings {
        /// Time to collision below which the controller brakes, in seconds (paper, algorithm 2: 1.4).
        ttc_s: FIRING_TTC_S, 0.0..=100.0, 0.0..=4.0;
    }
}

/// A controller that holds its speed and brakes fully to standstill once time to collision falls below a threshold.
#[derive(Debug, Clone, PartialEq)]
pub struct Baseline {
    aeb: Aeb,
    braking: bool,
}

impl BuiltIn for Baseline {
    const NAME: &'static str = "baseline";
    const SUMMARY: &'static str =
        "the paper's ADAS: hold speed, then full braking to standstill once TTC < 1.4 s";
    type Settings = AebSettings;
    type Driver = Self;

    fn start(settings: &AebSettings, ego: &Ego, _seed: u64) -> Self {
        Self {
            aeb: Aeb::new(settings.ttc_s, ego),
            braking: false,
        }
    }
}

impl Controller for Baseline {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        self.braking |= self.aeb.demands_braking(observation);
        Ok(if self.braking {
            -self.aeb.max_brake_mps2
        } else {
            0.0
        })
    }
}

/// The baseline without memory: brakes fully only while time to collision is below the threshold.
///
/// The command chatters around the threshold, which spares the follower in the paper's scenario 2 only.
#[derive(Debug, Clone, PartialEq)]
pub struct BaselineUnlatched {
    aeb: Aeb,
}

impl BuiltIn for BaselineUnlatched {
    const NAME: &'static str = "baseline-unlatched";
    const SUMMARY: &'static str = "like baseline, but releases the brake when TTC recovers";
    type Settings = AebSettings;
    type Driver = Self;

    fn start(settings: &AebSettings, ego: &Ego, _seed: u64) -> Self {
        Self {
            aeb: Aeb::new(settings.ttc_s, ego),
        }
    }
}

impl Controller for BaselineUnlatched {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        Ok(if self.aeb.demands_braking(observation) {
            -self.aeb.max_brake_mps2
        } else {
            0.0
        })
    }
}

/// Trigger and strength of an automatic emergency brake.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Aeb {
    ttc_s: f64,
    pub(super) max_brake_mps2: f64,
}

impl Aeb {
    pub(super) fn new(ttc_s: f64, ego: &Ego) -> Self {
        Self {
            ttc_s,
            max_brake_mps2: ego.max_brake_mps2,
        }
    }

    /// True if time to collision is below the threshold.
    ///
    /// Computed as gap - θ (v - v_ahead) < 0. For gaps >= 0 this equals TTC < θ, also if the gap grows.
    #[inline]
    pub(super) fn demands_braking(&self, observation: &Observation) -> bool {
        observation.ahead.is_some_and(
            |Neighbour {
                 gap_m, speed_mps, ..
             }| gap_m - self.ttc_s * (observation.speed_mps - speed_mps) < 0.0,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind};
    use super::*;

    #[test]
    fn the_unlatched_variant_releases_the_brake() {
        let mut baseline = BaselineUnlatched::start(&AebSettings::default(), &EGO, 0);
        assert_eq!(command_behind(&mut baseline, 20.0, 13.99, 10.0, 0.0), -7.5);
        assert_eq!(command_behind(&mut baseline, 5.0, 50.0, 10.0, 0.0), 0.0);
    }
}
