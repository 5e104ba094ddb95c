//! Friction, from braking that falls short of the command.

use super::jitter::Jitter;
use crate::control::{Ego, clamp_command};
use crate::observation::Observation;

/// Time over which command and deceleration are averaged, in seconds.
const AVERAGING_S: f64 = 0.3;
/// Smallest deceleration from which friction is estimated, in m/s².
const MIN_BRAKE_MPS2: f64 = 2.0;
/// Speed below which a vehicle may stop within a step, in m/s.
const MIN_SPEED_MPS: f64 = 0.5;
/// Noise that the averaged shortfall must exceed, in standard deviations of the estimated acceleration. Averaging
/// reduces the noise, so this is about two standard deviations of the average.
const DEVIATIONS: f64 = 1.4;
/// Share of the command that the averages may fall short because they lag behind.
const LAGGING_SHARE: f64 = 0.05;
/// Smallest share of dry-road braking that is believed: ice.
const MIN_FRICTION: f64 = 0.15;

/// Estimate of the largest deceleration that the road allows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Friction {
    step_s: f64,
    max_brake_mps2: f64,
    max_accel_mps2: f64,
    /// Last two commands, the older one first, in m/s².
    commands_mps2: [f64; 2],
    jitter: Jitter,
    /// Average of commanded minus actual deceleration, then average of the actual deceleration, in m/s².
    shortfall_mps2: f64,
    achieved_mps2: f64,
    usable_mps2: f64,
}

impl Friction {
    pub(super) fn new(ego: &Ego) -> Self {
        Self {
            step_s: ego.step_s,
            max_brake_mps2: ego.max_brake_mps2,
            max_accel_mps2: ego.max_accel_mps2,
            commands_mps2: [0.0; 2],
            jitter: Jitter::new(ego.step_s),
            shortfall_mps2: 0.0,
            achieved_mps2: 0.0,
            usable_mps2: ego.max_brake_mps2,
        }
    }

    /// Records the command of this step, which is within the limits of the vehicle.
    pub(super) fn record(&mut self, command_mps2: f64) {
        self.commands_mps2 = [self.commands_mps2[1], command_mps2];
    }

    /// Replaces the command of this step by the one that was executed.
    pub(super) fn replace_last(&mut self, command_mps2: f64) {
        self.commands_mps2[1] = clamp_command(command_mps2, self.max_brake_mps2, self.max_accel_mps2);
    }

    /// Returns the largest deceleration that the road allows, in m/s². A shortfall beyond the noise lowers it to the
    /// deceleration achieved; a harder deceleration raises it again.
    pub(super) fn usable_brake_mps2(&mut self, seen: &Observation) -> f64 {
        let [before_mps2, last_mps2] = self.commands_mps2;
        self.jitter.observe(seen.acceleration_mps2, last_mps2 - before_mps2);
        let (wanted_mps2, actual_mps2) = (-last_mps2, -seen.acceleration_mps2);
        let share = (self.step_s / AVERAGING_S).min(1.0);
        self.shortfall_mps2 += share * (wanted_mps2 - actual_mps2 - self.shortfall_mps2);
        self.achieved_mps2 += share * (actual_mps2 - self.achieved_mps2);
        if wanted_mps2 > MIN_BRAKE_MPS2 && seen.speed_mps > MIN_SPEED_MPS {
            let noise_mps2 = DEVIATIONS * self.jitter.acceleration_variance().sqrt();
            if self.shortfall_mps2 > LAGGING_SHARE * wanted_mps2 + noise_mps2 {
                let found_mps2 = (wanted_mps2 - self.shortfall_mps2).max(MIN_FRICTION * self.max_brake_mps2);
                self.usable_mps2 = self.usable_mps2.min(found_mps2);
            } else {
                self.usable_mps2 = self.usable_mps2.max(self.achieved_mps2).min(self.max_brake_mps2);
            }
        }
        self.usable_mps2
    }
}
