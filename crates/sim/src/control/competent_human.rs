//! The competent and careful human driver of UN Regulation No. 157.
//!
//! The driver holds its speed until it perceives a risk. It then coasts for 0.75 s, builds braking up at 12.65 m/s³ and
//! holds 0.774 g to standstill. The equations are those of `CC_react` in the JRC's published implementation (repository
//! ec-jrc/JRC-FSM, commit 01b05c2, `utility/models.py`; `CC_rt`, `CC_release_deceleration`, `CC_min_jerk`,
//! `CC_max_deceleration` in `utility/vehicle.py`). Times and braking are those of UN R157, original version and 01
//! series, performance models, table 1.
//!
//! The risks:
//! - **The leader brakes.** The JRC's car following reacts from the first instant of braking, however soft.
//! - **The leader is slower**, at a time to collision of at most 2 s, for example after a cut-in (`CC_critical_ttc`).
//! - **The leader cuts out**, followed within a time gap of 2 s (`CC_distance`), and reveals a slower vehicle.
//!
//! The simulator has no lateral motion: a vehicle is beside the lane or in it. In table 1, the 0.4 s of risk evaluation
//! begin when a vehicle is 0.375 m off the centre of its lane. At a lateral speed of 1.8 m/s they end after 0.375 +
//! 0.72 m = 1.1 m. A vehicle 1.9 m wide in the middle of a lane 3.5 m wide is then 0.3 m inside the next lane, where UN
//! R157, 5.2.5.2, begins to count. The driver therefore reacts as soon as a vehicle is in the lane.

use super::reaction::{BrakeRamp, ReactionTimer, whole_steps};
use super::{BuiltIn, Controller, ControllerFailure, Ego, Role, STANDARD_GRAVITY_MPS2};
use crate::observation::{Neighbour, Observation};
use crate::settings::settings;

/// Jump of the gap above which the leader is another vehicle, in metres; less than a vehicle's length.
const NEW_LEADER_GAP_JUMP_M: f64 = 1.0;

settings! {
    /// Settings of the competent and careful human driver of UN R157.
    CompetentHumanSettings {
        /// Leader's deceleration that is a risk at once, in m/s², positive (UN R157, deceleration scenario: 5 m/s²).
        risk_brake_mps2: 5.0, 0.0..=30.0, 0.0..=9.0;
        /// Speed that the leader loses beyond coasting, or by which a revealed vehicle is slower, until that is a risk,
        /// in m/s. The JRC's code has none; 0.5 is seven standard deviations of an estimated speed.
        risk_speed_mps: 0.5, 0.0..=100.0, 0.1..=2.0;
        /// Time to perceive that the leader brakes, in seconds. UN R157, table 1, has 0.4, the JRC's code 0.
        risk_perception_s: 0.0, 0.0..=10.0, 0.0..=1.0;
        /// Time to collision up to which a slower leader is a risk, in seconds (UN R157, cut-in scenario: 2 s).
        risk_ttc_s: 2.0, 0.0..=100.0, 0.5..=4.0;
        /// Time gap up to which a cut-out of the leader is a risk, in seconds (UN R157, cut-out scenario: 2 s).
        risk_time_gap_s: 2.0, 0.0..=100.0, 0.5..=4.0;
        /// Time from perceiving the risk to the beginning of braking, in seconds (UN R157, table 1).
        reaction_s: 0.75, 0.0..=10.0, 0.0..=2.0;
        /// Deceleration between perceiving the risk and braking, in m/s², positive: pedal released (JRC code).
        coasting_mps2: 0.4, 0.0..=30.0, 0.0..=1.0;
        /// Jerk at which braking builds up, in m/s³ (UN R157, table 1: 0.774 g within 0.6 s).
        jerk_mps3: 12.65, 0.1..=10_000.0, 1.0..=50.0;
        /// Deceleration that is held, in m/s², positive (UN R157, table 1: 0.774 g).
        brake_mps2: 0.774 * STANDARD_GRAVITY_MPS2, 0.0..=30.0, 0.0..=9.0;
    }
}

/// A driver that holds its speed until it perceives a risk, then coasts, and brakes to standstill at a limited jerk.
#[derive(Debug, Clone, PartialEq)]
pub struct CompetentHuman {
    settings: CompetentHumanSettings,
    step_s: f64,
    perception_steps: u32,
    reaction_steps: u32,
    leader: Option<LeaderPrediction>,
    steps_to_release: Option<u32>,
    release_timer: ReactionTimer,
    brake_ramp: BrakeRamp,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct LeaderPrediction {
    gap_m: f64,
    /// Gap at the next step if no vehicle changes the lane, in metres.
    next_gap_m: f64,
    /// Speed if the leader only coasted, in m/s.
    coasting_mps: f64,
}

impl BuiltIn for CompetentHuman {
    const NAME: &'static str = "competent-human";
    const SUMMARY: &'static str = "reference driver of UN R157: brakes at 0.774 g, beginning 0.75 s after the leader \
    brakes, is at a time to collision of at most 2 s, or cuts out and reveals a slower vehicle";
    const ROLE: Role = Role::Reference;
    type Settings = CompetentHumanSettings;
    type Driver = Self;

    fn start(settings: &CompetentHumanSettings, ego: &Ego, _seed: u64) -> Self {
        Self {
            settings: settings.clone(),
            step_s: ego.step_s,
            perception_steps: whole_steps(settings.risk_perception_s, ego.step_s),
            reaction_steps: whole_steps(settings.reaction_s, ego.step_s),
            leader: None,
            steps_to_release: None,
            release_timer: ReactionTimer::default(),
            brake_ramp: BrakeRamp::new(settings.coasting_mps2, settings.jerk_mps3, ego.step_s),
        }
    }
}

impl CompetentHuman {
    /// Returns the steps until the foot leaves the pedal because of the current leader; `None` without a risk.
    #[inline]
    fn steps_until_release(&mut self, speed_mps: f64, ahead: &Neighbour) -> Option<u32> {
        let CompetentHumanSettings {
            risk_brake_mps2,
            risk_speed_mps,
            risk_ttc_s,
            risk_time_gap_s,
            ..
        } = self.settings;
        let coasted_mps = self.settings.coasting_mps2 * self.step_s;
        let before = self.leader;
        let appeared_m = before.map(|before| ahead.gap_m - before.next_gap_m);
        let same = before.filter(|_| {
            appeared_m.is_some_and(|appeared_m| appeared_m.abs() <= NEW_LEADER_GAP_JUMP_M)
        });
        let closing_mps = speed_mps - ahead.speed_mps;
        let coasting_mps = same.map_or(ahead.speed_mps, |same| {
            ahead.speed_mps.max(same.coasting_mps - coasted_mps)
        });
        self.leader = Some(LeaderPrediction {
            gap_m: ahead.gap_m,
            next_gap_m: ahead.gap_m - closing_mps * self.step_s,
            coasting_mps,
        });

        let cuts_out = before.is_some_and(|before| {
            before.gap_m <= risk_time_gap_s * speed_mps + NEW_LEADER_GAP_JUMP_M
        }) && appeared_m
            .is_some_and(|appeared_m| appeared_m > NEW_LEADER_GAP_JUMP_M)
            && closing_mps > risk_speed_mps;
        let is_near = closing_mps > 0.0 && ahead.gap_m <= risk_ttc_s * closing_mps;
        let brakes = ahead.acceleration_mps2 < -risk_brake_mps2
            || coasting_mps - ahead.speed_mps > risk_speed_mps;
        if cuts_out || is_near {
            Some(0)
        } else {
            brakes.then_some(self.perception_steps)
        }
    }
}

impl Controller for CompetentHuman {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let risk = match &observation.ahead {
            Some(ahead) => self.steps_until_release(observation.speed_mps, ahead),
            None => {
                self.leader = None;
                None
            }
        };
        let left = self.steps_to_release.map(|steps| steps.saturating_sub(1));
        self.steps_to_release = left.into_iter().chain(risk).min();
        Ok(
            match self.release_timer.tick(self.steps_to_release == Some(0)) {
                Some(steps) if steps >= self.reaction_steps => {
                    -self.brake_ramp.step_towards(self.settings.brake_mps2)
                }
                Some(_) => -self.settings.coasting_mps2,
                None => 0.0,
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind, leader_observation, stopping_distance_m};
    use super::*;

    fn start(settings: &CompetentHumanSettings) -> CompetentHuman {
        CompetentHuman::start(settings, &EGO, 0)
    }

    /// Closed form: v τ + v₁ T - c T²/2 with coasting c over T, then a ramp of jerk j from c to b, then v₂²/(2 b).
    /// Braking is held at its mean over each step: speeds are exact, and each step of the ramp is j dt³/12 longer.
    #[test]
    fn stops_within_the_distance_of_its_closed_form() {
        for risk_perception_s in [0.0, 0.4] {
            let settings = CompetentHumanSettings {
                risk_perception_s,
                brake_mps2: 0.4 + 12.65 * 0.57,
                ..Default::default()
            };
            let CompetentHumanSettings {
                risk_perception_s: tau,
                reaction_s: t,
                coasting_mps2: c,
                jerk_mps3: j,
                ..
            } = settings;
            for v in [14.0_f64, 22.0, 36.1] {
                let v1 = v - c * t;
                let rise_s = (settings.brake_mps2 - c) / j;
                let v2 = v1 - c * rise_s - j * rise_s * rise_s / 2.0;
                let ramp_m = v1 * rise_s - c * rise_s * rise_s / 2.0 - j * rise_s.powi(3) / 6.0;
                let held_m = rise_s / EGO.step_s * j * EGO.step_s.powi(3) / 12.0;
                let expected_m = v * (tau + t) - c * t * t / 2.0 + ramp_m - held_m
                    + v2 * v2 / (2.0 * settings.brake_mps2);
                let found_m = stopping_distance_m(start(&settings), v, |speed_mps| {
                    leader_observation(speed_mps, 90.0, 10.0, -5.01)
                });
                assert!(
                    (found_m - expected_m).abs() < 1e-9,
                    "{v} m/s: {found_m} against {expected_m}"
                );
            }
        }
    }

    #[test]
    fn reaches_its_full_braking_exactly_and_perceives_no_risk_in_steady_traffic() {
        let settings = CompetentHumanSettings::default();
        let mut driver = start(&settings);
        for _ in 0..1000 {
            assert_eq!(
                command_behind(&mut driver, 20.0, 25.0, 20.0, -5.0),
                0.0,
                "not harder than 5 m/s²"
            );
        }
        let commands = [0; 200].map(|_| command_behind(&mut driver, 20.0, 25.0, 20.0, -5.1));
        assert_eq!(commands[..75], [-0.4; 75]);
        assert_eq!(commands[199], -settings.brake_mps2);
        assert!(
            commands
                .windows(2)
                .all(|pair| pair[1] <= pair[0] && pair[0] - pair[1] < 0.401)
        );
    }

    /// A cut-in is a risk at a time to collision of 2 s. A cut-out within 2 s is one if it reveals a slower vehicle.
    #[test]
    fn a_new_leader_is_a_risk_as_the_regulation_defines() {
        let reacts = |observations: &[Observation]| {
            let mut driver = start(&CompetentHumanSettings::default());
            observations
                .iter()
                .map(|observation| driver.decide(observation).unwrap())
                .any(|command| command < 0.0)
        };
        let steady = |gap_m: f64| leader_observation(20.0, gap_m, 20.0, 0.0);
        let far = |ahead_mps: f64| leader_observation(20.0, 200.0, ahead_mps, 0.0);
        assert!(
            !reacts(&[steady(300.0), leader_observation(20.0, 20.01, 10.0, 0.0)]),
            "cuts in at 2.001 s"
        );
        assert!(
            reacts(&[steady(300.0), leader_observation(20.0, 20.0, 10.0, 0.0)]),
            "cuts in at 2 s"
        );
        assert!(
            reacts(&[steady(40.0), far(0.0)]),
            "cuts out before a vehicle that stands"
        );
        assert!(
            !reacts(&[steady(45.0), far(0.0)]),
            "was followed at more than 2 s"
        );
        assert!(
            !reacts(&[steady(40.0), far(19.8)]),
            "reveals a vehicle about as fast"
        );
        assert!(!reacts(&[far(0.0)]), "no vehicle has cut out");
    }

    /// A leader that brakes softly is a risk once it has lost 0.5 m/s beyond coasting; one that only coasts is none.
    #[test]
    fn soft_braking_is_a_risk_and_coasting_is_none() {
        for (mps2, reacts) in [(-0.39, false), (-0.5, true), (-1.0, true)] {
            let mut driver = start(&CompetentHumanSettings::default());
            let mut has_reacted = false;
            for step in 0..600 {
                let front_mps = 20.0 + mps2 * 0.01 * f64::from(step);
                has_reacted |= command_behind(&mut driver, 20.0, 40.0, front_mps, mps2) < 0.0;
            }
            assert_eq!(has_reacted, reacts, "{mps2} m/s²");
        }
    }

    /// No vehicle collides on the JRC's grid of car following (0.05 to 0.95 g, 12 to 128 km/h, time gap 2 s). The JRC's
    /// code has the same result (`comparison_car_following.py`, 1121 runs).
    #[test]
    fn collides_nowhere_on_the_published_grid_of_car_following() {
        for (kmph, hundredths_g) in (12..130)
            .step_by(2)
            .flat_map(|v| (5..100).step_by(5).map(move |g| (v, g)))
        {
            let (v, brake_mps2) = (
                f64::from(kmph) / 3.6,
                f64::from(hundredths_g) / 100.0 * 9.81,
            );
            let (mut own, mut front, mut gap_m) = (v, v, 2.0 * v);
            let mut driver = start(&CompetentHumanSettings::default());
            while own > 0.0 {
                let front_mps2 = if front > 0.0 { -brake_mps2 } else { 0.0 };
                let command = command_behind(&mut driver, own, gap_m, front, front_mps2)
                    .max(-EGO.max_brake_mps2);
                let (next_own, next_front) = (
                    (own + command * 0.01).max(0.0),
                    (front - brake_mps2 * 0.01).max(0.0),
                );
                gap_m += 0.5 * (front + next_front - own - next_own) * 0.01;
                (own, front) = (next_own, next_front);
                assert!(gap_m > 0.0, "{kmph} km/h behind {brake_mps2} m/s²: {gap_m}");
            }
        }
    }
}
