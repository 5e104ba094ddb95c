//! Reward of a step: the paper's reward minus driving costs.
//!
//! The paper's reward is constant without a collision, even for unnecessary braking. [`CostConfig`] adds costs.

use super::config::EnvironmentConfig;
use super::costs::CostConfig;
use super::source::EGO;
use crumple_measure::{PairState, justified_brake_mps2};
use crumple_sim::engine::{Motion, StepView, Stepper};

/// Full braking on a dry road, in m/s²: the reference of decelerations.
pub(super) const FULL_BRAKE_MPS2: f64 = 7.5;
/// Jerk with a cost term of 1, in m/s³: full braking within 0.1 s.
const FULL_JERK_MPS3: f64 = 75.0;
const FULL_RELATIVE_SPEED_MPS: f64 = 10.0;
/// Braking beyond the justified one that does not yet count as unnecessary, in m/s².
const UNNECESSARY_BRAKING_MARGIN_MPS2: f64 = 1.0;

impl CostConfig {
    /// Returns the cost as a share of the step's reward. `before_mps2` is the ego vehicle's last acceleration.
    fn step_cost(&self, now: &StepView<'_>, before_mps2: f64, step_s: f64) -> f64 {
        let motion = now.motion;
        let ([Some(front), Some(ego)], Some(gap_m)) =
            ([EGO - 1, EGO].map(|vehicle| motion.get(vehicle)), now.gap_m)
        else {
            return 0.0;
        };
        let wanted_m = self.standstill_m + self.headway_s * ego.speed_mps;
        let off = (gap_m - wanted_m) / wanted_m;
        let brake_mps2 = -ego.acceleration_mps2;
        let state = PairState {
            time_s: 0.0,
            gap_m: gap_m.max(0.0),
            front_speed_mps: front.speed_mps,
            rear_speed_mps: ego.speed_mps,
            front_acceleration_mps2: front.acceleration_mps2,
            rear_acceleration_mps2: ego.acceleration_mps2,
        };
        let imposed_mps2 = motion.get(EGO + 1).map_or(0.0, |behind| {
            -behind.acceleration_mps2 - (-front.acceleration_mps2).max(0.0)
        });
        self.far * off.clamp(0.0, 1.0)
            + self.near * (-off).clamp(0.0, 1.0)
            + self.relative_speed
                * ((front.speed_mps - ego.speed_mps).abs() / FULL_RELATIVE_SPEED_MPS).min(1.0)
            + self.acceleration * (brake_mps2 / FULL_BRAKE_MPS2).powi(2)
            + self.jerk * (ego.acceleration_mps2 - before_mps2).abs() / step_s / FULL_JERK_MPS3
            + self.induced_braking * imposed_mps2.max(0.0) / FULL_BRAKE_MPS2
            + self.unnecessary_braking
                * (brake_mps2 - justified_brake_mps2(&state) - UNNECESSARY_BRAKING_MARGIN_MPS2)
                    .max(0.0)
                / FULL_BRAKE_MPS2
    }
}

pub(super) struct RewardTracker {
    step_s: f64,
    previous_accel_mps2: f64,
    is_free: bool,
}

impl RewardTracker {
    pub(super) fn new(stepper: &Stepper, step_s: f64, costs: &CostConfig) -> Self {
        Self {
            step_s,
            previous_accel_mps2: ego_accel_mps2(stepper.motion()),
            is_free: costs.is_free(),
        }
    }

    #[inline]
    pub(super) fn step_reward(&mut self, now: &StepView<'_>, config: &EnvironmentConfig) -> f64 {
        if now.has_collided {
            return config.collision_reward;
        }
        if self.is_free {
            return config.step_reward;
        }
        let cost = config
            .costs
            .step_cost(now, self.previous_accel_mps2, self.step_s);
        self.previous_accel_mps2 = ego_accel_mps2(now.motion);
        config.step_reward * (1.0 - cost)
    }
}

fn ego_accel_mps2(motion: &[Motion]) -> f64 {
    motion.get(EGO).map_or(0.0, |ego| ego.acceleration_mps2)
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::rl::TrainingConfig;
    use crumple_sim::control::BuiltInController;
    use crumple_sim::engine::{RecordingLevel, Run, RunOptions};
    use crumple_sim::scenario::built_in_scenario;

    /// Simulates one step of paper-1: 25 m/s, braking at 4 m/s², gap 16 m, leader of constant speed.
    fn relative_step_reward(costs: CostConfig) -> f64 {
        let config = EnvironmentConfig {
            costs,
            ..TrainingConfig::preset("fast").unwrap().environment
        };
        let scenario = built_in_scenario("paper-1").unwrap();
        let run = Run::new(
            &scenario,
            RunOptions::new(BuiltInController::MatchLeader(Default::default())),
        )
        .unwrap();
        let mut stepper = Stepper::new(&run, RecordingLevel::Summary);
        let mut reward_tracker = RewardTracker::new(&stepper, 0.01, &config.costs);
        let mut earned = 0.0;
        let after = |now: &StepView<'_>| {
            earned = reward_tracker.step_reward(now, &config);
            ControlFlow::Break(())
        };
        stepper.drive(EGO, 1, |_| -4.0, after);
        earned / config.step_reward
    }

    #[test]
    fn each_reward_term_equals_the_hand_computed_value() {
        let none = CostConfig::default;
        assert_eq!(relative_step_reward(none()), 1.0);
        let costs = |costs, by_hand: f64| {
            let actual = relative_step_reward(costs);
            assert!(
                (actual - (1.0 - by_hand)).abs() < 2e-3,
                "{actual} {by_hand}"
            );
        };
        costs(
            CostConfig {
                near: 1.0,
                ..none()
            },
            (34.5 - 16.0) / 34.5,
        );
        costs(
            CostConfig {
                far: 1.0,
                standstill_m: 1.0,
                headway_s: 0.5,
                ..none()
            },
            (16.0 - 13.5) / 13.5,
        );
        costs(
            CostConfig {
                relative_speed: 10.0,
                ..none()
            },
            0.04,
        );
        costs(
            CostConfig {
                acceleration: 2.0,
                ..none()
            },
            2.0 * (4.0_f64 / 7.5).powi(2),
        );
        costs(
            CostConfig {
                jerk: 0.5,
                ..none()
            },
            0.5 * 400.0 / 75.0,
        );
        // The reference driver wants 42 m, so it brakes at 0.73 (42 / 16)² m/s², which exceeds 4 m/s².
        costs(
            CostConfig {
                unnecessary_braking: 1.0,
                ..none()
            },
            0.0,
        );
        costs(
            CostConfig {
                induced_braking: 1.0,
                ..none()
            },
            0.0,
        );
    }
}
