//! The leader: how hard it brakes.

use crate::observation::Neighbour;

/// Averaged acceleration at which hard braking is over, in m/s².
const RECOVERY_MPS2: f64 = 0.5;
/// Averaging time, in seconds.
const AVERAGING_S: f64 = 0.2;

/// Averaged acceleration of the leader, and whether it brakes harder than in everyday traffic.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Leader {
    /// Averaged deceleration that exceeds everyday traffic, in m/s².
    everyday_brake_mps2: f64,
    step_s: f64,
    averaged_mps2: f64,
    brakes_hard: bool,
}

impl Leader {
    pub(super) fn new(everyday_brake_mps2: f64, step_s: f64) -> Self {
        Self {
            everyday_brake_mps2,
            step_s,
            averaged_mps2: 0.0,
            brakes_hard: false,
        }
    }

    pub(super) fn observe(&mut self, ahead: &Neighbour) {
        let share = (self.step_s / AVERAGING_S).min(1.0);
        self.averaged_mps2 += share * (ahead.acceleration_mps2 - self.averaged_mps2);
        if self.averaged_mps2 < -self.everyday_brake_mps2 {
            self.brakes_hard = true;
        } else if self.averaged_mps2 > RECOVERY_MPS2 {
            self.brakes_hard = false;
        }
    }

    /// True from hard braking until the leader speeds up.
    pub(super) fn brakes_hard(&self) -> bool {
        self.brakes_hard
    }
}
