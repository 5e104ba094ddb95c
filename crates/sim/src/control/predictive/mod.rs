//! A law that predicts where the leader and the follower stop, and places the ego vehicle between them.
//!
//! Priorities, each in its own function:
//! 1. **Follow** by the Intelligent Driver Model.
//! 2. **Wake the follower** (`wake`) if it is near and the leader brakes hard. A follower with nothing but
//!    an emergency brake holds its speed until TTC < 1.4 s. Firing that brake early leaves it room to stop.
//! 3. **Give way** (`give_way`) to a follower that brakes: do not brake harder than it tolerates, unless the
//!    room ahead is as short as the room behind. A follower may be attentive before its emergency brake
//!    fires (`spare_attentive`).
//! 4. **Limit unnecessary braking** (`limited`): brake little harder than the leader's motion justifies.
//! 5. **Brake just in time** for the leader in every case.
//!
//! The law uses only present and past observations and its own commands. Its state is a few recursive averages.

mod follower;
mod friction;
mod jitter;
mod leader;

use self::follower::Follower;
use self::friction::Friction;
use self::leader::Leader;
use super::baseline::FIRING_TTC_S;
use super::{BuiltIn, Controller, ControllerFailure, Ego, clamp_command};
use crate::idm::{Idm, IdmSettings, MIN_GAP_M, STANDSTILL_GAP_M};
use crate::observation::{Neighbour, Observation};
use crate::required_brake::required_brake_mps2;
use crate::settings::settings;

settings! {
    /// Settings of the predictive two-sided controller. It multiplies `ahead_brake_mps2` and `behind_brake_mps2`,
    /// which hold on a dry road, by the friction that it estimates.
    PredictiveSettings {
        /// Desired time headway while following, in seconds (the Intelligent Driver Model's).
        time_headway_s: 1.6, 0.0..=10.0, 0.5..=3.0;
        /// Acceleration per m/s of speed difference to a leader at the desired gap, in addition to the Intelligent
        /// Driver Model's, in 1/s. From 0.2 on, a line of such vehicles does not amplify oscillations of its
        /// leader.
        speed_gain_per_s: 0.2, 0.0..=10.0, 0.0..=1.0;
        /// Distance to the leader that every plan keeps free, in metres. It covers errors of the gap and of predicted
        /// stopping places.
        margin_m: 0.65, 0.0..=100.0, 0.0..=5.0;
        /// Minimum deceleration of the leader in predictions, in m/s². Predictions assume it even if the leader
        /// brakes less at present, because it may brake harder later.
        ahead_brake_mps2: 4.2, 0.0..=30.0, 0.0..=9.0;
        /// Deceleration of the follower before it is observed, in m/s². A laden lorry has 5 to 6; the default is
        /// lower, because the follower may brake late or weakly.
        behind_brake_mps2: 3.4, 0.1..=30.0, 3.0..=9.0;
        /// Probability, before any observation, that the follower has nothing but an emergency brake.
        unaware_share: 0.1, 0.0..=1.0, 0.01..=0.5;
        /// Expected time from one's own brake lights to the braking of an attentive follower, in seconds (Green 2000:
        /// 1.25 s).
        reaction_s: 1.25, 0.0..=10.0, 0.3..=2.5;
        /// Largest time gap of a follower that is woken, in seconds: a follower that is farther away has time to
        /// react.
        near_time_gap_s: 4.0, 0.0..=100.0, 1.0..=8.0;
        /// Slack between the predicted stopping places of leader and follower below which to wake the follower, in
        /// metres.
        wake_slack_m: 21.0, 0.0..=1000.0, 0.0..=40.0;
        /// Deceleration of the leader, averaged over 0.2 s, from which waking begins, in m/s². It is complete at
        /// `everyday_brake_mps2`.
        wake_from_mps2: 1.4, 0.0..=30.0, 0.0..=4.0;
        /// Deceleration per metre of missing slack, in 1/s².
        wake_gain_per_s2: 5.0, 0.0..=100.0, 0.5..=5.0;
        /// Deceleration with which the ego vehicle wakes the follower in predictions, in m/s².
        wake_brake_mps2: 6.7, 0.1..=30.0, 1.5..=9.0;
        /// Speed difference to the follower at which waking ends, in m/s, on a dry road; it is multiplied by √µ. At
        /// a larger one, a collision with the follower can no longer be avoided.
        wake_closing_mps: 17.3, 0.1..=100.0, 10.0..=30.0;
        /// Time constant of waking in everyday traffic, in seconds: comfort.
        wake_lag_s: 0.6, 0.01..=10.0, 0.05..=1.2;
        /// Smallest predicted gap to a braking follower that needs no giving way, in metres.
        room_behind_m: 0.35, 0.0..=100.0, 0.0..=12.0;
        /// Acceleration per metre of missing room behind, in 1/s².
        room_gain_per_s2: 5.0, 0.0..=100.0, 0.5..=6.0;
        /// Deceleration beyond the justified one, in m/s², unless the leader brakes harder than in everyday traffic.
        excess_brake_mps2: 1.2, 0.0..=30.0, 0.0..=4.0;
        /// Deceleration of the leader, averaged over 0.2 s, that exceeds everyday traffic, in m/s²; the space
        /// `everyday` has at most 4.
        everyday_brake_mps2: 4.2, 0.0..=30.0, 2.0..=6.0;
    }
}

/// Share of the available braking. If avoiding the leader requires more than that, the ego vehicle brakes as
/// required; before that it may brake less.
const LATEST_BRAKE_SHARE: f64 = 0.97;
/// Braking harder than this counts as hard (`crumple_measure`: 4 m/s², less errors of the estimate), in m/s².
const HARD_BRAKE_MPS2: f64 = 3.8;
/// Justified deceleration below which hard braking counts as unnecessary, in m/s² (3 m/s², plus errors of the
/// estimate).
const HARD_BRAKE_CAUSE_MPS2: f64 = 3.5;
/// Time from the firing of the follower's emergency brake to its deceleration, in seconds.
const FIRING_DELAY_S: f64 = 0.1;
/// Smallest deceleration in a prediction, in m/s²: makes stopping distances finite.
const MIN_BRAKE_MPS2: f64 = 0.05;
/// Waking deceleration that is too small to brake for, in m/s².
const MIN_WAKE_MPS2: f64 = 1e-3;
/// Longest time before the firing of the follower's emergency brake for which the ego vehicle holds its speed, in
/// seconds.
const HOLDING_S: f64 = 2.0;
/// Time constant of waking while the leader brakes hard, in seconds.
const EMERGENCY_LAG_S: f64 = 0.05;

/// A controller that predicts the stopping places of leader and follower.
#[derive(Debug, Clone, PartialEq)]
pub struct Predictive(Box<State>);

/// State of the controller; boxed, because it is larger than that of any other controller.
#[derive(Debug, Clone, PartialEq)]
struct State {
    settings: PredictiveSettings,
    idm: Idm,
    /// The model by which `crumple_measure::UnnecessaryBraking` justifies braking.
    reference: Idm,
    max_brake_mps2: f64,
    max_accel_mps2: f64,
    friction: Friction,
    leader: Leader,
    follower: Follower,
    step_s: f64,
    /// Smoothed deceleration that wakes the follower, in m/s².
    wake_mps2: f64,
}

impl BuiltIn for Predictive {
    const NAME: &'static str = "predictive";
    const SUMMARY: &'static str = "follows like idm, brakes early to wake (alert) an inattentive follower, and stops \
        so that room remains ahead and behind";
    const OBSERVES_FOLLOWER: bool = true;
    type Settings = PredictiveSettings;
    type Driver = Self;

    fn start(settings: &PredictiveSettings, ego: &Ego, _seed: u64) -> Self {
        let idm = IdmSettings {
            time_headway_s: settings.time_headway_s,
            ..Default::default()
        };
        Self(Box::new(State {
            settings: settings.clone(),
            idm: (&idm).into(),
            reference: (&IdmSettings::default()).into(),
            max_brake_mps2: ego.max_brake_mps2,
            max_accel_mps2: ego.max_accel_mps2,
            friction: Friction::new(ego),
            leader: Leader::new(
                [settings.wake_from_mps2, settings.everyday_brake_mps2],
                ego.step_s,
            ),
            follower: Follower::new(settings.unaware_share, ego),
            step_s: ego.step_s,
            wake_mps2: 0.0,
        }))
    }
}

impl Controller for Predictive {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let state = &mut *self.0;
        let answer_mps2 = clamp_command(
            state.command_mps2(observation),
            state.max_brake_mps2,
            state.max_accel_mps2,
        );
        state.friction.record(answer_mps2);
        Ok(answer_mps2)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.0.friction.replace_last(command_mps2);
    }
}

/// Predictions for one decision.
struct Outlook {
    own_mps: f64,
    ahead: Neighbour,
    /// Deceleration of the leader that predictions use, in m/s², positive.
    ahead_brake_mps2: f64,
    /// Way of the ego vehicle to the stopping place of the leader, less the margin, in metres.
    way_m: f64,
    /// Deceleration of the ego vehicle that plans use, in m/s², positive.
    own_brake_mps2: f64,
    /// Share of dry-road braking that the road allows.
    friction: f64,
}

/// Predicted braking of the follower.
struct FollowerBraking {
    /// Time until it begins, in seconds.
    delay_s: f64,
    /// Deceleration, in m/s², positive.
    brake_mps2: f64,
}

impl State {
    fn command_mps2(&mut self, observation: &Observation) -> f64 {
        let own_brake_mps2 = self.friction.usable_brake_mps2(observation);
        let follow_mps2 = self.follow(observation);
        let Some(ahead) = observation.ahead else {
            return follow_mps2;
        };
        self.leader.observe(&ahead, observation.speed_mps);
        let outlook = self.predict(observation.speed_mps, ahead, own_brake_mps2);
        let wanted_mps2 = match &observation.behind {
            Some(behind) => self.heed_follower(&outlook, observation, behind, follow_mps2),
            None => follow_mps2,
        };
        // Without a gap no deceleration is enough.
        let required_mps2 = required_brake_mps2(
            ahead.gap_m - self.settings.margin_m,
            ahead.speed_mps,
            -ahead.acceleration_mps2,
            observation.speed_mps,
        )
        .unwrap_or(f64::INFINITY);
        let limited_mps2 = self.limited(wanted_mps2, required_mps2, &outlook);
        if required_mps2 > LATEST_BRAKE_SHARE * own_brake_mps2 {
            limited_mps2.min(-required_mps2)
        } else {
            limited_mps2
        }
    }

    /// Returns the acceleration that is best for the follower: wakes or spares it before its emergency brake fires,
    /// and gives way afterwards.
    fn heed_follower(
        &mut self,
        outlook: &Outlook,
        observation: &Observation,
        behind: &Neighbour,
        follow_mps2: f64,
    ) -> f64 {
        let expected_mps2 = self.settings.behind_brake_mps2 * outlook.friction;
        let has_fired = self.follower.observe(behind, observation, expected_mps2);
        if !has_fired {
            let woken_mps2 = self.wake(outlook, behind, follow_mps2);
            return self.spare_attentive(outlook, behind, woken_mps2);
        }
        self.wake_mps2 = 0.0;
        let braking = FollowerBraking {
            delay_s: (FIRING_DELAY_S - self.follower.fired_for_s()).max(0.0),
            brake_mps2: self.follower.brake_mps2(),
        };
        follow_mps2.max(self.give_way(outlook, behind, &braking))
    }

    /// Returns the acceleration of the Intelligent Driver Model, and a share of the speed difference that falls
    /// with the square of the gap beyond the desired one.
    #[inline]
    fn follow(&self, observation: &Observation) -> f64 {
        let model_mps2 = self.idm.desired_acceleration_mps2(observation);
        let Some(ahead) = observation.ahead else {
            return model_mps2;
        };
        let desired_m = STANDSTILL_GAP_M + self.settings.time_headway_s * observation.speed_mps;
        let nearness = (desired_m / ahead.gap_m.max(MIN_GAP_M)).min(1.0);
        let difference_mps = ahead.speed_mps - observation.speed_mps;
        model_mps2 + self.settings.speed_gain_per_s * nearness * nearness * difference_mps
    }

    /// Predicts what leader and ego vehicle can do, if the ego vehicle can brake at `own_brake_mps2`.
    #[inline]
    fn predict(&self, own_mps: f64, ahead: Neighbour, own_brake_mps2: f64) -> Outlook {
        let friction = own_brake_mps2 / self.max_brake_mps2.max(f64::MIN_POSITIVE);
        let gap_m = ahead.gap_m - self.settings.margin_m;
        let ahead_brake_mps2 =
            (self.settings.ahead_brake_mps2 * friction).max(-ahead.acceleration_mps2);
        Outlook {
            own_mps,
            ahead,
            ahead_brake_mps2,
            way_m: gap_m + stopping_distance_m(ahead.speed_mps, ahead_brake_mps2),
            own_brake_mps2,
            friction,
        }
    }

    /// Returns the acceleration that wakes the follower, or `follow_mps2` if that is not needed.
    ///
    /// The deceleration is that of [`Self::wake_demand_mps2`], smoothed. Waking ends at the speed difference
    /// `wake_closing_mps`.
    fn wake(&mut self, outlook: &Outlook, behind: &Neighbour, follow_mps2: f64) -> f64 {
        let all = &self.settings;
        let closing_mps = behind.speed_mps - outlook.own_mps;
        let max_closing_mps = all.wake_closing_mps * outlook.friction.sqrt();
        if closing_mps >= max_closing_mps || behind.gap_m <= FIRING_TTC_S * closing_mps {
            return self.hold_before_firing(behind, closing_mps, follow_mps2);
        }
        let near_share = all.near_time_gap_s - behind.gap_m / behind.speed_mps.max(1.0);
        let share = self.leader.severity() * near_share.clamp(0.0, 1.0);
        let demand_mps2 = if share > 0.0 {
            self.wake_demand_mps2(outlook, behind, share)
        } else {
            0.0
        };
        let lag_s = match self.leader.brakes_hard() {
            true => EMERGENCY_LAG_S,
            false => all.wake_lag_s,
        };
        self.wake_mps2 += (self.step_s / lag_s).min(1.0) * (demand_mps2 - self.wake_mps2);
        if self.wake_mps2 > MIN_WAKE_MPS2 {
            follow_mps2.min(-self.wake_mps2)
        } else {
            follow_mps2
        }
    }

    /// Returns the deceleration that wakes the follower, in m/s², before it is smoothed: the gain times the missing
    /// slack, times the `share` of it that the leader and the follower's distance justify, times the probability that
    /// the follower has nothing but an emergency brake.
    ///
    /// The slack is the distance from the predicted stopping place of the follower, if the ego vehicle starts to wake
    /// it now, to that of the leader: s = g_a + v_a²/(2 b_a) + g_b - v_b (t + τ) - v_b²/(2 b_b), where t is the time
    /// until its emergency brake fires.
    fn wake_demand_mps2(&self, outlook: &Outlook, behind: &Neighbour, share: f64) -> f64 {
        let all = &self.settings;
        let closing_mps = behind.speed_mps - outlook.own_mps;
        let max_closing_mps = all.wake_closing_mps * outlook.friction.sqrt();
        let brake_mps2 = all.wake_brake_mps2.min(outlook.own_brake_mps2);
        let waking_s = waking_time_s(behind.gap_m, closing_mps, brake_mps2, max_closing_mps);
        let behind_m = behind.speed_mps * (waking_s + FIRING_DELAY_S)
            + stopping_distance_m(behind.speed_mps, all.behind_brake_mps2 * outlook.friction);
        let slack_m = outlook.way_m + behind.gap_m - behind_m;
        let missing_m = all.wake_slack_m - slack_m;
        if missing_m <= 0.0 {
            return 0.0;
        }
        all.wake_gain_per_s2 * missing_m * share * self.follower.unaware_probability()
    }

    /// Returns the acceleration while the closing speed is as high as an unaware follower can bear: the ego vehicle
    /// holds its speed if the emergency brake of the follower is about to fire, by the probability that it has no
    /// other.
    fn hold_before_firing(&self, behind: &Neighbour, closing_mps: f64, follow_mps2: f64) -> f64 {
        if behind.gap_m > (FIRING_TTC_S + HOLDING_S) * closing_mps {
            return follow_mps2;
        }
        let released_mps2 = follow_mps2.max(0.0) - follow_mps2;
        follow_mps2 + self.follower.unaware_probability() * released_mps2
    }

    /// Returns the acceleration before the follower's emergency brake fires: between `wanted_mps2` and the one that
    /// leaves an attentive follower enough room, by the probability that it is attentive.
    fn spare_attentive(&self, outlook: &Outlook, behind: &Neighbour, wanted_mps2: f64) -> f64 {
        let expected_mps2 = self.settings.behind_brake_mps2 * outlook.friction;
        let reaction_s = self.settings.reaction_s - self.follower.warned_for_s();
        let braking = FollowerBraking {
            delay_s: reaction_s.max(FIRING_DELAY_S),
            brake_mps2: expected_mps2.max(-behind.acceleration_mps2),
        };
        let spared_mps2 = self.give_way(outlook, behind, &braking).min(0.0) - wanted_mps2;
        if spared_mps2 <= 0.0 {
            return wanted_mps2;
        }
        wanted_mps2 + (1.0 - self.follower.unaware_probability()) * spared_mps2
    }

    /// Returns the lowest acceleration that leaves the follower enough room, or a lower one if the room ahead is
    /// short as well.
    ///
    /// Room behind: closest gap if the ego vehicle holds its speed, r_b = g_b - Δv τ - Δv²/(2 b_b). Room ahead:
    /// closest gap if it brakes from now on, at standstill or while both move. a = k min(r_a - r_b, r_min - r_b).
    fn give_way(&self, outlook: &Outlook, behind: &Neighbour, braking: &FollowerBraking) -> f64 {
        let all = &self.settings;
        let closing_mps = (behind.speed_mps - outlook.own_mps).max(0.0);
        let behind_m = behind.gap_m
            - closing_mps * braking.delay_s
            - stopping_distance_m(closing_mps, braking.brake_mps2);
        let at_rest_m =
            outlook.way_m - stopping_distance_m(outlook.own_mps, outlook.own_brake_mps2);
        let gains_mps2 = outlook.own_brake_mps2 - outlook.ahead_brake_mps2;
        let nearing_mps = outlook.own_mps - outlook.ahead.speed_mps;
        let moving_m = if nearing_mps > 0.0 && gains_mps2 > 0.0 {
            outlook.ahead.gap_m - all.margin_m - stopping_distance_m(nearing_mps, gains_mps2)
        } else {
            f64::INFINITY
        };
        let missing_m = at_rest_m.min(moving_m).min(all.room_behind_m) - behind_m;
        all.room_gain_per_s2 * missing_m
    }

    /// Limits braking to a little more than the motion of the leader justifies, by the definition of
    /// `crumple_measure::UnnecessaryBraking`, unless the leader brakes hard.
    fn limited(&self, wanted_mps2: f64, required_mps2: f64, outlook: &Outlook) -> f64 {
        if self.leader.brakes_hard() {
            return wanted_mps2;
        }
        let Neighbour {
            gap_m,
            speed_mps,
            acceleration_mps2,
        } = outlook.ahead;
        let followed_mps2 = self
            .reference
            .interaction_brake_mps2(outlook.own_mps, [gap_m, speed_mps]);
        let matched_mps2 = if gap_m < 3.0 * outlook.own_mps {
            -acceleration_mps2
        } else {
            0.0
        };
        let justified_mps2 = required_mps2.max(followed_mps2).max(matched_mps2);
        let most_mps2 = justified_mps2 + self.settings.excess_brake_mps2;
        wanted_mps2.max(-if justified_mps2 < HARD_BRAKE_CAUSE_MPS2 {
            most_mps2.min(HARD_BRAKE_MPS2)
        } else {
            most_mps2
        })
    }
}

/// Returns v²/(2 b), in metres.
fn stopping_distance_m(speed_mps: f64, brake_mps2: f64) -> f64 {
    speed_mps * speed_mps / (2.0 * brake_mps2.max(MIN_BRAKE_MPS2))
}

/// Returns the time until the gap to a follower of constant speed falls below θ times the closing speed, if the ego
/// vehicle brakes until it is `max_closing_mps` slower and then holds its speed.
fn waking_time_s(gap_m: f64, closing_mps: f64, brake_mps2: f64, max_closing_mps: f64) -> f64 {
    // g - Δv t - b t²/2 = θ (Δv + b t).
    let ttc_s = FIRING_TTC_S;
    let rate_mps = closing_mps + ttc_s * brake_mps2;
    let missing_m = gap_m - ttc_s * closing_mps;
    let waking_s = ((rate_mps * rate_mps + 2.0 * brake_mps2 * missing_m)
        .max(0.0)
        .sqrt()
        - rate_mps)
        / brake_mps2;
    if closing_mps + brake_mps2 * waking_s <= max_closing_mps {
        return waking_s.max(0.0);
    }
    let braking_s = ((max_closing_mps - closing_mps) / brake_mps2).max(0.0);
    let left_m = gap_m - (closing_mps + 0.5 * brake_mps2 * braking_s) * braking_s;
    braking_s + (left_m / max_closing_mps - ttc_s).max(0.0)
}

#[cfg(test)]
mod tests;
