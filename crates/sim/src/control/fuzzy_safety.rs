//! The fuzzy safety model of UN Regulation No. 157: a driver that brakes early and gently.
//!
//! Source: K. Mattas et al., *Fuzzy Surrogate Safety Metrics for real-time assessment of rear-end collision risk*,
//! Accident Analysis and Prevention 148 (2020) 105794. Formulas and numbers are those of the authors' code.

use super::reaction::{BrakeRamp, ReactionTimer, whole_steps};
use super::{BuiltIn, Controller, ControllerFailure, Ego, Role, STANDARD_GRAVITY_MPS2};
use crate::observation::{Neighbour, Observation};
use crate::settings::settings;

settings! {
    /// Settings of the fuzzy safety model (UN R157). `graze_m` is crumple's addition: without it, braking after the
    /// critical metric ends with a gap of exactly 0, and rounding decides about a collision.
    FuzzySafetySettings {
        /// Time from noticing a danger to braking, in seconds.
        reaction_s: 0.75, 0.0..=10.0, 0.0..=2.0;
        /// Comfortable deceleration, in m/s², positive.
        comfortable_brake_mps2: 4.0, 0.1..=30.0, 1.0..=6.0;
        /// Maximum deceleration that the driver expects of itself, in m/s², positive.
        hardest_brake_mps2: 6.0, 0.1..=30.0, 1.0..=9.0;
        /// Maximum deceleration that the driver expects of its leader, in m/s², positive.
        ahead_brake_mps2: 7.0, 0.1..=30.0, 1.0..=9.0;
        /// Gap at standstill, in metres.
        standstill_m: 2.0, 0.0..=100.0, 0.0..=5.0;
        /// Additional gap of the safe distance, in metres.
        margin_m: 2.0, 0.0..=100.0, 0.0..=5.0;
        /// Gap that braking after the critical metric leaves, in metres.
        graze_m: 0.1, 0.0..=100.0, 0.0..=1.0;
        /// Jerk at which braking builds up, in m/s³.
        jerk_mps3: 12.65, 0.1..=10_000.0, 1.0..=50.0;
        /// Upper limit of the deceleration, in m/s², positive (0.774 g).
        limit_mps2: 0.774 * STANDARD_GRAVITY_MPS2, 0.0..=30.0, 0.0..=9.0;
    }
}

/// Returns the degree to which a gap is unsafe: 0 (safe) to 1, linear between the two distances.
fn membership(gap_m: f64, safe_m: f64, unsafe_m: f64) -> f64 {
    if gap_m >= safe_m {
        0.0
    } else if gap_m <= unsafe_m {
        1.0
    } else {
        (safe_m - gap_m) / (safe_m - unsafe_m)
    }
}

impl FuzzySafetySettings {
    /// Returns the proactive metric, 0 to 1: the danger from a leader that brakes at `ahead_brake_mps2`.
    pub(crate) fn proactive(&self, speed_mps: f64, ahead: &Neighbour) -> f64 {
        let Self {
            reaction_s,
            comfortable_brake_mps2,
            hardest_brake_mps2,
            ahead_brake_mps2,
            ..
        } = *self;
        let [comfortable_m, hardest_m] =
            [comfortable_brake_mps2, hardest_brake_mps2].map(|brake_mps2| {
                speed_mps * reaction_s + speed_mps * speed_mps / (2.0 * brake_mps2)
                    - ahead.speed_mps * ahead.speed_mps / (2.0 * ahead_brake_mps2)
            });
        membership(
            ahead.gap_m - self.standstill_m,
            comfortable_m + self.margin_m,
            hardest_m,
        )
    }

    /// Returns the critical metric, 0 to 1: the danger from a leader that holds its speed. Until the driver reacts, its
    /// current acceleration lasts, limited to the comfortable deceleration.
    pub(crate) fn critical(
        &self,
        speed_mps: f64,
        acceleration_mps2: f64,
        ahead: &Neighbour,
    ) -> f64 {
        let Self {
            reaction_s,
            comfortable_brake_mps2,
            hardest_brake_mps2,
            ..
        } = *self;
        let closing_mps = speed_mps - ahead.speed_mps;
        if closing_mps <= 0.0 {
            return 0.0;
        }
        let gap_m = ahead.gap_m - self.graze_m;
        let until_mps2 = acceleration_mps2.max(-comfortable_brake_mps2);
        let then_mps = closing_mps + until_mps2 * reaction_s;
        if then_mps < 0.0 {
            // The current braking ends the closing before the reaction time ends.
            let needed_m = closing_mps * closing_mps / (-2.0 * until_mps2);
            return membership(gap_m, needed_m, needed_m);
        }
        let until_m = 0.5 * (closing_mps + then_mps) * reaction_s;
        let [comfortable_m, hardest_m] = [comfortable_brake_mps2, hardest_brake_mps2]
            .map(|brake_mps2| until_m + then_mps * then_mps / (2.0 * brake_mps2));
        membership(gap_m, comfortable_m, hardest_m)
    }

    /// Returns the deceleration that the metrics demand, in m/s², positive; 0 if both are 0.
    fn demanded_brake_mps2(&self, observation: &Observation) -> f64 {
        let Some(ahead) = observation.ahead else {
            return 0.0;
        };
        let critical = self.critical(observation.speed_mps, observation.acceleration_mps2, &ahead);
        let asked_mps2 = if critical > 0.0 {
            self.comfortable_brake_mps2
                + critical * (self.hardest_brake_mps2 - self.comfortable_brake_mps2)
        } else {
            self.proactive(observation.speed_mps, &ahead) * self.comfortable_brake_mps2
        };
        asked_mps2.min(self.limit_mps2)
    }
}

/// A driver that holds its speed until a reaction time after it first notices a danger. It then brakes in proportion to
/// the danger at a limited jerk, and holds its speed while there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct FuzzySafety {
    settings: FuzzySafetySettings,
    reaction_steps: u32,
    reaction_timer: ReactionTimer,
    brake_ramp: BrakeRamp,
}

impl BuiltIn for FuzzySafety {
    const NAME: &'static str = "fuzzy-safety";
    const SUMMARY: &'static str = "reference driver of UN R157: the fuzzy safety model, which \
        brakes early and in proportion to the danger";
    const ROLE: Role = Role::Reference;
    type Settings = FuzzySafetySettings;
    type Driver = Self;

    fn start(settings: &FuzzySafetySettings, ego: &Ego, _seed: u64) -> Self {
        Self {
            settings: settings.clone(),
            reaction_steps: whole_steps(settings.reaction_s, ego.step_s),
            reaction_timer: ReactionTimer::default(),
            brake_ramp: BrakeRamp::new(0.0, settings.jerk_mps3, ego.step_s),
        }
    }
}

impl Controller for FuzzySafety {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let asked_mps2 = self.settings.demanded_brake_mps2(observation);
        let reacts = self.reaction_timer.tick(asked_mps2 > 0.0) >= Some(self.reaction_steps);
        // `0.0 -` avoids a command of -0.
        Ok(if reacts {
            0.0 - self.brake_ramp.step_towards(asked_mps2)
        } else {
            0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, leader_observation, stopping_distance_m};
    use super::*;

    fn ahead(gap_m: f64, speed_mps: f64) -> Neighbour {
        Neighbour {
            gap_m,
            speed_mps,
            acceleration_mps2: 0.0,
        }
    }

    /// Closed form: v τ, a ramp of jerk j to b, then v₂²/(2 b). Each step of the ramp is j dt³/12 longer.
    #[test]
    fn stops_within_the_distance_of_its_closed_form() {
        let settings = FuzzySafetySettings {
            hardest_brake_mps2: 12.65 * 0.48,
            ..Default::default()
        };
        let FuzzySafetySettings {
            reaction_s: tau,
            jerk_mps3: j,
            hardest_brake_mps2: b,
            ..
        } = settings;
        for v in [14.0_f64, 22.0, 36.1] {
            let rise_s = b / j;
            let v2 = v - j * rise_s * rise_s / 2.0;
            let ramp_m = v * rise_s - j * rise_s.powi(3) / 6.0;
            let held_m = rise_s / EGO.step_s * j * EGO.step_s.powi(3) / 12.0;
            let expected_m = v * tau + ramp_m - held_m + v2 * v2 / (2.0 * b);
            let driver = FuzzySafety::start(&settings, &EGO, 0);
            let found_m = stopping_distance_m(driver, v, |speed_mps| {
                leader_observation(speed_mps, -1.0, -1.0, 0.0)
            });
            assert!(
                (found_m - expected_m).abs() < 1e-9,
                "{v} m/s: {found_m} against {expected_m}"
            );
        }
    }

    #[test]
    fn each_metric_is_linear_between_its_two_distances() {
        let settings = FuzzySafetySettings::default();
        let (v, front) = (20.0_f64, 12.0_f64);
        let stop_m = |b: f64| v * 0.75 + v * v / (2.0 * b) - front * front / 14.0;
        let (safe_m, unsafe_m) = (stop_m(4.0) + 4.0, stop_m(6.0) + 2.0);
        for (share, metric) in [(0.0, 0.0), (0.5, 0.5), (1.0, 1.0)] {
            let command_mps2 =
                settings.proactive(v, &ahead(safe_m + share * (unsafe_m - safe_m), front));
            assert!(
                (command_mps2 - metric).abs() < 1e-12,
                "{command_mps2} at {share}"
            );
        }
        let closing_m = |b: f64| 0.5 * (8.0 + 7.25) * 0.75 + 7.25 * 7.25 / (2.0 * b);
        for (share, metric) in [(0.0, 0.0), (0.5, 0.5), (1.0, 1.0)] {
            let gap_m =
                settings.graze_m + closing_m(4.0) + share * (closing_m(6.0) - closing_m(4.0));
            let command_mps2 = settings.critical(v, -1.0, &ahead(gap_m, front));
            assert!(
                (command_mps2 - metric).abs() < 1e-12,
                "{command_mps2} at {share}"
            );
        }
    }

    /// If braking ends the closing before the reaction time, only the distance until then counts.
    #[test]
    fn sufficient_braking_avoids_critical_danger() {
        let settings = FuzzySafetySettings::default();
        for own_mps2 in [-4.0, -9.0] {
            assert_eq!(settings.critical(12.0, own_mps2, &ahead(0.61, 10.0)), 0.0);
            assert_eq!(settings.critical(12.0, own_mps2, &ahead(0.59, 10.0)), 1.0);
        }
        assert_eq!(
            settings.critical(10.0, 3.0, &ahead(0.1, 10.0)),
            0.0,
            "no vehicle closes in"
        );
    }

    /// Behind leaders that brake at 0.05 to 0.95 g from 12 to 128 km/h, no run of 1121 collides, as in the authors'
    /// implementation at steps of 0.1 s. Behind gentle braking the driver brakes gently.
    #[test]
    fn no_collision_on_the_grid_of_its_authors() {
        let settings = FuzzySafetySettings::default();
        for (kmph, hundredths_g) in (12..130)
            .step_by(2)
            .flat_map(|v| (5..100).step_by(5).map(move |g| (v, g)))
        {
            let (v, brake_mps2) = (
                f64::from(kmph) / 3.6,
                f64::from(hundredths_g) / 100.0 * 9.81,
            );
            let mut gap_m = v * 0.75 + v * v / 8.0 - v * v / 14.0 + 4.0;
            let (mut own, mut front, mut command, mut hardest) = (v, v, 0.0, 0.0_f64);
            let mut driver = FuzzySafety::start(&settings, &EGO, 0);
            for _ in 0..3500 {
                let mut observation = leader_observation(own, gap_m, front, -brake_mps2);
                observation.acceleration_mps2 = command;
                command = driver.decide(&observation).unwrap();
                hardest = hardest.max(-command);
                let (next_own, next_front) = (
                    (own + command * 0.01).max(0.0),
                    (front - brake_mps2 * 0.01).max(0.0),
                );
                gap_m += 0.5 * (front + next_front - own - next_own) * 0.01;
                (own, front) = (next_own, next_front);
                assert!(
                    gap_m > 0.09,
                    "{kmph} km/h behind {brake_mps2} m/s²: {gap_m}"
                );
            }
            assert!(
                brake_mps2 > 2.0 || hardest <= 4.0,
                "{kmph} km/h behind {brake_mps2}: {hardest} m/s²"
            );
        }
    }
}
