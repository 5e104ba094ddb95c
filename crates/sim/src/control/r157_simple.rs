//! The simple driver model of UN Regulation No. 157: a delay, then braking at a constant rate.

use super::reaction::{ReactionTimer, whole_steps};
use super::{BuiltIn, Controller, ControllerFailure, Ego, Role};
use crate::observation::Observation;
use crate::settings::settings;

settings! {
    /// Settings of the simple driver model (UN R157: 0.35 s and 6 m/s² after a cut-in; other triggers are crumple's
    /// own).
    R157SimpleSettings {
        /// Time from noticing a danger to braking, in seconds.
        reaction_s: 0.35, 0.0..=10.0, 0.0..=1.0;
        /// Deceleration that is held to standstill, in m/s², positive.
        brake_mps2: 6.0, 0.1..=30.0, 1.0..=9.0;
        /// Deceleration of the leader above which it is a danger, in m/s², positive.
        seen_brake_mps2: 1.5, 0.0..=30.0, 0.0..=4.0;
        /// Gap that delayed braking must leave to a leader that holds its speed, in metres; otherwise it is a danger.
        margin_m: 1.0, 0.0..=100.0, 0.0..=5.0;
    }
}

/// A driver that holds its speed and, a fixed delay after it notices a danger, brakes at a constant rate to standstill.
#[derive(Debug, Clone, PartialEq)]
pub struct R157Simple {
    settings: R157SimpleSettings,
    delay_steps: u32,
    reaction_timer: ReactionTimer,
}

impl BuiltIn for R157Simple {
    const NAME: &'static str = "r157-simple";
    const SUMMARY: &'static str =
        "reference driver of UN R157: 6 m/s² from 0.35 s after the leader brakes or is too near";
    const ROLE: Role = Role::Reference;
    type Settings = R157SimpleSettings;
    type Driver = Self;

    fn start(settings: &R157SimpleSettings, ego: &Ego, _seed: u64) -> Self {
        let delay_steps = whole_steps(settings.reaction_s, ego.step_s);
        Self {
            settings: settings.clone(),
            delay_steps,
            reaction_timer: ReactionTimer::default(),
        }
    }
}

impl R157Simple {
    /// True if the leader brakes, or is too near for delayed braking: gap - margin < Δv τ + Δv²/(2 b).
    #[inline]
    fn is_in_danger(&self, observation: &Observation) -> bool {
        let R157SimpleSettings {
            reaction_s,
            brake_mps2,
            seen_brake_mps2,
            margin_m,
        } = self.settings;
        observation.ahead.is_some_and(|ahead| {
            let closing_mps = (observation.speed_mps - ahead.speed_mps).max(0.0);
            let needed_m =
                closing_mps * reaction_s + closing_mps * closing_mps / (2.0 * brake_mps2);
            ahead.acceleration_mps2 < -seen_brake_mps2
                || (closing_mps > 0.0 && ahead.gap_m - margin_m < needed_m)
        })
    }
}

impl Controller for R157Simple {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let is_in_danger = self.is_in_danger(observation);
        let brakes = self.reaction_timer.tick(is_in_danger) >= Some(self.delay_steps);
        Ok(if brakes {
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
            let driver = R157Simple::start(&R157SimpleSettings::default(), &EGO, 0);
            let found_m = stopping_distance_m(driver, v, |speed_mps| {
                leader_observation(speed_mps, 90.0, 10.0, -2.0)
            });
            let expected_m = v * 0.35 + v * v / 12.0;
            assert!(
                (found_m - expected_m).abs() < 1e-9,
                "{v} m/s: {found_m} against {expected_m}"
            );
        }
    }

    /// Behind a standing vehicle it stops at its margin, less at most the distance of a step.
    #[test]
    fn stops_at_its_margin_before_a_vehicle_that_stands() {
        let settings = R157SimpleSettings::default();
        for v in [3.0_f64, 14.0, 36.1] {
            let (mut gap_m, mut speed_mps) = (300.0, v);
            let mut driver = R157Simple::start(&settings, &EGO, 0);
            while speed_mps > 0.0 {
                let a = command_behind(&mut driver, speed_mps, gap_m, 0.0, 0.0);
                let next_mps = speed_mps + a * EGO.step_s;
                gap_m -= if next_mps > 0.0 {
                    0.5 * (speed_mps + next_mps) * EGO.step_s
                } else {
                    speed_mps * speed_mps / -2.0 / a
                };
                speed_mps = next_mps;
            }
            assert!(
                (settings.margin_m - v * EGO.step_s..=settings.margin_m).contains(&gap_m),
                "{v} m/s: {gap_m}"
            );
        }
    }
}
