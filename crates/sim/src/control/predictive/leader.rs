//! The leader: how hard it brakes.

use crate::observation::Neighbour;

/// Averaged acceleration above which the leader speeds up, and below whose negative it brakes, in m/s².
const CHANGING_MPS2: f64 = 0.5;
/// Speed of the ego vehicle above that of the leader up to which both are equally fast, in m/s.
const MATCHED_MPS: f64 = 0.5;
/// Averaging time, in seconds.
const AVERAGING_S: f64 = 0.2;

/// Averaged acceleration of the leader, and whether it brakes harder than in everyday traffic.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Leader {
    /// Averaged decelerations from which waking begins, and beyond everyday traffic, in m/s².
    thresholds_mps2: [f64; 2],
    step_s: f64,
    averaged_mps2: f64,
    /// Largest averaged deceleration until the braking is over, in m/s².
    hardest_mps2: f64,
}

impl Leader {
    pub(super) fn new(thresholds_mps2: [f64; 2], step_s: f64) -> Self {
        Self {
            thresholds_mps2,
            step_s,
            averaged_mps2: 0.0,
            hardest_mps2: 0.0,
        }
    }

    /// Adds an observation. Braking is over once the leader speeds up, or does not brake and the ego vehicle, at
    /// `own_mps`, is as slow.
    pub(super) fn observe(&mut self, ahead: &Neighbour, own_mps: f64) {
        let share = (self.step_s / AVERAGING_S).min(1.0);
        self.averaged_mps2 += share * (ahead.acceleration_mps2 - self.averaged_mps2);
        let is_matched =
            self.averaged_mps2 > -CHANGING_MPS2 && own_mps < ahead.speed_mps + MATCHED_MPS;
        if is_matched || self.averaged_mps2 > CHANGING_MPS2 {
            self.hardest_mps2 = 0.0;
        } else {
            self.hardest_mps2 = self.hardest_mps2.max(-self.averaged_mps2);
        }
    }

    /// True from hard braking until it is over.
    pub(super) fn brakes_hard(&self) -> bool {
        self.hardest_mps2 > self.thresholds_mps2[1]
    }

    /// Returns how hard the leader brakes, or has braked until the braking is over: 0 below the first threshold, 1 from
    /// the second one on.
    pub(super) fn severity(&self) -> f64 {
        let [from_mps2, to_mps2] = self.thresholds_mps2;
        if self.brakes_hard() {
            return 1.0;
        }
        let share = (self.hardest_mps2 - from_mps2) / (to_mps2 - from_mps2).max(f64::MIN_POSITIVE);
        share.clamp(0.0, 1.0)
    }
}
