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
    /// Averages of 1 while the command is braking and 0 otherwise, and of the product with the actual deceleration.
    braking_share: f64,
    braking_sum_mps2: f64,
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
            braking_share: 0.0,
            braking_sum_mps2: 0.0,
            usable_mps2: ego.max_brake_mps2,
        }
    }

    /// Records the command of this step, which is within the limits of the vehicle.
    pub(super) fn record(&mut self, command_mps2: f64) {
        self.commands_mps2 = [self.commands_mps2[1], command_mps2];
    }

    /// Replaces the command of this step by the one that was executed.
    pub(super) fn replace_last(&mut self, command_mps2: f64) {
        self.commands_mps2[1] =
            clamp_command(command_mps2, self.max_brake_mps2, self.max_accel_mps2);
    }

    /// Returns the largest deceleration that the road allows, in m/s². A shortfall beyond the noise lowers it to the
    /// deceleration achieved; a harder deceleration raises it again.
    pub(super) fn usable_brake_mps2(&mut self, observation: &Observation) -> f64 {
        let [before_mps2, last_mps2] = self.commands_mps2;
        self.jitter
            .observe(observation.acceleration_mps2, last_mps2 - before_mps2);
        let wanted_mps2 = -last_mps2;
        let actual_mps2 = -observation.acceleration_mps2;
        let share = (self.step_s / AVERAGING_S).min(1.0);
        self.shortfall_mps2 += share * (wanted_mps2 - actual_mps2 - self.shortfall_mps2);
        self.achieved_mps2 += share * (actual_mps2 - self.achieved_mps2);
        let braking = if wanted_mps2 > MIN_BRAKE_MPS2 {
            1.0
        } else {
            0.0
        };
        self.braking_share += share * (braking - self.braking_share);
        self.braking_sum_mps2 += share * (braking * actual_mps2 - self.braking_sum_mps2);
        if wanted_mps2 > MIN_BRAKE_MPS2 && observation.speed_mps > MIN_SPEED_MPS {
            let noise_mps2 = DEVIATIONS * self.jitter.acceleration_variance().sqrt();
            if self.shortfall_mps2 > LAGGING_SHARE * wanted_mps2 + noise_mps2 {
                // The average shortfall belongs to the present command only if this is not below earlier ones. The road
                // allows at least the average of the deceleration while braking, over the same time.
                let achieved_mps2 = self.braking_sum_mps2 / self.braking_share;
                let found_mps2 = (wanted_mps2 - self.shortfall_mps2).max(achieved_mps2);
                self.usable_mps2 = self
                    .usable_mps2
                    .min(found_mps2.max(MIN_FRICTION * self.max_brake_mps2));
            } else {
                self.usable_mps2 = self
                    .usable_mps2
                    .max(self.achieved_mps2)
                    .min(self.max_brake_mps2);
            }
        }
        self.usable_mps2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::tests::EGO;

    /// Returns the estimates of every step for commands on a road that allows `road_mps2`.
    fn estimates(commands_mps2: &[f64], road_mps2: f64) -> Vec<f64> {
        let mut friction = Friction::new(&EGO);
        let mut acceleration_mps2 = 0.0;
        let step = |&command_mps2: &f64| {
            let observation = Observation {
                speed_mps: 20.0,
                acceleration_mps2,
                ahead: None,
                behind: None,
            };
            let usable_mps2 = friction.usable_brake_mps2(&observation);
            friction.record(command_mps2);
            acceleration_mps2 = command_mps2.max(-road_mps2);
            usable_mps2
        };
        commands_mps2.iter().map(step).collect()
    }

    /// 3.75 m/s² are available. The average deceleration of a period is 3.125 m/s².
    #[test]
    fn the_friction_estimate_survives_jumping_commands() {
        for half_period in [5, 20, 50] {
            let jumping: Vec<f64> = (0..1000)
                .map(|step| {
                    if step / half_period % 2 == 0 {
                        -7.5
                    } else {
                        -2.5
                    }
                })
                .collect();
            let estimated = estimates(&jumping, 3.75);
            let lowest_mps2 = estimated.iter().copied().fold(f64::INFINITY, f64::min);
            assert!(
                (2.5..=4.0).contains(&lowest_mps2),
                "{half_period}: {lowest_mps2}"
            );
        }
    }

    #[test]
    fn a_constant_command_finds_the_friction_and_a_dry_road_keeps_its_own() {
        let on_ice = estimates(&[-6.0; 300], 1.5);
        assert!((on_ice[299] - 1.5).abs() < 0.02, "{}", on_ice[299]);
        let jumping: Vec<f64> = (0..1000)
            .map(|step| if step / 20 % 2 == 0 { -7.0 } else { -2.5 })
            .collect();
        assert!(
            estimates(&jumping, 7.5)
                .iter()
                .all(|&usable_mps2| usable_mps2 == 7.5)
        );
    }
}
