//! Responsibility-Sensitive Safety in one lane (Shalev-Shwartz, Shammah and Shashua, *On a Formal Model of Safe and
//! Scalable Self-driving Cars*, arXiv:1708.06374, 2017).

use super::reaction::whole_steps;
use super::{BuiltIn, Controller, ControllerFailure, Ego, Role};
use crate::observation::Observation;
use crate::settings::settings;

settings! {
    /// Settings of Responsibility-Sensitive Safety. The paper leaves the values to regulators; these are crumple's own.
    RssSettings {
        /// Response time ρ, in seconds.
        response_s: 0.75, 0.0..=10.0, 0.0..=2.0;
        /// Maximum acceleration during the response time, in m/s².
        accel_mps2: 2.0, 0.0..=30.0, 0.0..=3.0;
        /// Deceleration of the response, in m/s², positive.
        brake_mps2: 6.0, 0.1..=30.0, 1.0..=9.0;
        /// Maximum deceleration that is expected of the leader, in m/s², positive.
        ahead_brake_mps2: 7.5, 0.1..=30.0, 1.0..=9.0;
    }
}

impl RssSettings {
    /// Returns the safe distance behind a leader at `ahead_mps`, in metres (the paper's safe longitudinal distance, one
    /// direction): [v ρ + a ρ²/2 + (v + a ρ)²/(2 b) - v_f²/(2 b_f)]₊.
    pub(crate) fn safe_distance_m(&self, speed_mps: f64, ahead_mps: f64) -> f64 {
        let Self {
            response_s,
            accel_mps2,
            brake_mps2,
            ahead_brake_mps2,
        } = *self;
        let fastest_mps = speed_mps + accel_mps2 * response_s;
        let before_m = (speed_mps + 0.5 * accel_mps2 * response_s) * response_s;
        let braking_m = fastest_mps * fastest_mps / (2.0 * brake_mps2);
        (before_m + braking_m - ahead_mps * ahead_mps / (2.0 * ahead_brake_mps2)).max(0.0)
    }
}

/// A driver that brakes from a response time after the distance becomes unsafe until it is safe again.
#[derive(Debug, Clone, PartialEq)]
pub struct Rss {
    settings: RssSettings,
    response_steps: u32,
    unsafe_for_steps: u32,
}

impl BuiltIn for Rss {
    const NAME: &'static str = "rss";
    const SUMMARY: &'static str = "Responsibility-Sensitive Safety (Shalev-Shwartz et al. 2017): \
        brakes while nearer than the safe distance";
    const ROLE: Role = Role::Reference;
    type Settings = RssSettings;
    type Driver = Self;

    fn start(settings: &RssSettings, ego: &Ego, _seed: u64) -> Self {
        let response_steps = whole_steps(settings.response_s, ego.step_s);
        Self {
            settings: settings.clone(),
            response_steps,
            unsafe_for_steps: 0,
        }
    }
}

impl Controller for Rss {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let settings = &self.settings;
        if observation.ahead.is_none_or(|ahead| {
            ahead.gap_m >= settings.safe_distance_m(observation.speed_mps, ahead.speed_mps)
        }) {
            self.unsafe_for_steps = 0;
            return Ok(0.0);
        }
        let responds = self.unsafe_for_steps >= self.response_steps;
        self.unsafe_for_steps = self.unsafe_for_steps.saturating_add(1);
        Ok(if responds {
            -self.settings.brake_mps2
        } else {
            0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind, leader_observation, stopping_distance_m};
    use super::*;

    #[test]
    fn stops_within_the_distance_of_its_closed_form() {
        for v in [3.0_f64, 14.0, 36.1] {
            let driver = Rss::start(&RssSettings::default(), &EGO, 0);
            let found_m = stopping_distance_m(driver, v, |speed_mps| {
                leader_observation(speed_mps, -1.0, 0.0, 0.0)
            });
            let expected_m = v * 0.75 + v * v / 12.0;
            assert!(
                (found_m - expected_m).abs() < 1e-9,
                "{v} m/s: {found_m} against {expected_m}"
            );
        }
    }

    /// The safe distance is the difference of the two stopping distances, or 0 if the leader needs more.
    #[test]
    fn the_safe_distance_is_the_difference_of_two_stopping_distances() {
        let settings = RssSettings::default();
        for (v, ahead) in [(14.0_f64, 14.0_f64), (36.1, 20.0), (5.0, 0.0), (10.0, 40.0)] {
            let fastest = v + 2.0 * 0.75;
            // Distance at the mean of both speeds, then v²/2b.
            let own_m = 0.5 * (v + fastest) * 0.75 + fastest * fastest / 12.0;
            let expected_m = (own_m - ahead * ahead / 15.0).max(0.0);
            assert!((settings.safe_distance_m(v, ahead) - expected_m).abs() < 1e-9);
        }
        assert_eq!(settings.safe_distance_m(10.0, 40.0), 0.0);
    }

    /// From the safe distance it does not collide with a leader that brakes within the assumed limit.
    #[test]
    fn avoids_a_collision_from_the_safe_distance() {
        let settings = RssSettings::default();
        for (v, ahead) in [(14.0_f64, 14.0_f64), (36.1, 20.0), (8.0, 12.0)] {
            let (mut gap_m, mut own, mut front) = (settings.safe_distance_m(v, ahead), v, ahead);
            let mut driver = Rss::start(&settings, &EGO, 0);
            for _ in 0..3000 {
                let a = command_behind(&mut driver, own, gap_m, front, -7.5);
                let (next_own, next_front) = ((own + a * 0.01).max(0.0), (front - 0.075).max(0.0));
                gap_m += 0.5 * (front + next_front - own - next_own) * 0.01;
                (own, front) = (next_own, next_front);
                assert!(gap_m > 0.0, "{v} behind {ahead} m/s");
            }
        }
    }
}
