//! Test of one plan: conditions A (ahead) and B (behind).

mod waiting;

use super::params::{FollowerClass, FollowerTrigger, NOTICED_BRAKE_MPS2, TwoSidedParams};
use super::path::{Path, PathPoint, min_distance_m};
use super::state::{FollowerPhase, FollowerState, Plan, PlanShape, TwoSidedState};
use crate::control::{ViabilityKernel, distance_and_speed_after, max_closing_m};
use waiting::WaitingTrial;

/// Maximum number of steps that a plan looks ahead: a minute at 10 ms.
const MAX_SAMPLES: usize = 6000;

/// Work of the test of a firing, relative to that of a step without one.
pub(super) const FIRING_WORK: usize = 8;

/// Maximum number of steps of acceleration in a plan.
const MAX_COAST_STEPS: usize = 5000;

/// Relative rounding error of a condition. A condition adds up at most 100 terms, each with less than 16 operations, so
/// that the error is below 1600 u of the largest term; this is more than 8000 u.
const ROUNDING_SHARE: f64 = 1.0 / (1u64 << 40) as f64;

/// Motions that a test computes; kept between tests to save allocations.
#[derive(Debug, Default)]
pub(super) struct Paths {
    /// Own motion until the follower's brake has fired: farthest and least far.
    up: Path,
    low: Path,
    leader: Path,
    /// Own motion afterwards, least far.
    tail: Path,
    follower: Path,
    /// Tested firings of the plan: step, and steps of acceleration after it.
    pub(super) firings: Vec<(usize, usize)>,
}

/// Test of one plan.
pub(super) struct Trial<'p> {
    params: &'p TwoSidedParams,
    paths: &'p mut Paths,
    /// Work that may still be done.
    budget: &'p mut usize,
    state: TwoSidedState,
    shape: PlanShape,
    kernel: ViabilityKernel,
    /// Gap that must remain, with rounding.
    margin_m: f64,
    /// End of the commands that are given before the plan.
    prefix_s: f64,
    /// Response at that time.
    response_mps2: f64,
    /// Time from which phase 1 holds the speed.
    hold_from_s: f64,
    /// First time within the prefix, or infinity, from which the ego vehicle brakes noticeably until its end.
    braking_from_s: f64,
}

impl<'p> Trial<'p> {
    /// Prepares the test of a plan of this shape after the commands `prefix_mps2`.
    pub(super) fn new(
        (params, paths, budget): (&'p TwoSidedParams, &'p mut Paths, &'p mut usize),
        state: TwoSidedState,
        prefix_mps2: impl Iterator<Item = f64> + Clone,
        shape: PlanShape,
        level_mps2: f64,
    ) -> Self {
        let kernel = params.kernel(level_mps2);
        let mut trial = Self {
            params,
            paths,
            budget,
            state,
            shape,
            kernel,
            margin_m: params.margin_m,
            prefix_s: 0.0,
            response_mps2: state.response_mps2,
            hold_from_s: f64::INFINITY,
            braking_from_s: f64::INFINITY,
        };
        trial.margin_m += ROUNDING_SHARE * trial.scale_m();
        trial.paths.leader.restart(PathPoint {
            time_s: 0.0,
            position_m: state.gap_m,
            speed_mps: state.ahead_mps,
        });
        trial.paths.leader.finish(-level_mps2);
        trial.begin(prefix_mps2);
        trial
    }

    /// Accounts for work; `None` if too little of the budget is left.
    fn spend(&mut self, work: usize) -> Option<()> {
        *self.budget = self.budget.checked_sub(work)?;
        Some(())
    }

    /// Returns a bound of the magnitude of all terms, in metres.
    fn scale_m(&self) -> f64 {
        let TwoSidedState {
            gap_m,
            ahead_mps,
            speed_mps,
            ..
        } = self.state;
        let stop_m = |speed_mps: f64, brake_mps2: f64| 0.5 * speed_mps * speed_mps / brake_mps2;
        let own_m = stop_m(speed_mps[1] + 10.0, self.kernel.own_brake_mps2) + 1000.0;
        let ahead_m = if gap_m < f64::INFINITY {
            gap_m + stop_m(ahead_mps, self.kernel.ahead_brake_mps2)
        } else {
            0.0
        };
        let behind_m = self.class_and_state().map_or(0.0, |(class, state)| {
            state.gap_m[1] + stop_m(state.speed_mps[1] + 20.0, class.brake_mps2) + 6000.0
        });
        own_m + ahead_m + behind_m
    }

    fn class_and_state(&self) -> Option<(FollowerClass, FollowerState)> {
        self.params.follower.zip(self.state.follower)
    }

    /// Computes the own motion over the commands that are given before the plan.
    fn begin(&mut self, prefix_mps2: impl Iterator<Item = f64> + Clone) {
        let params = self.params;
        let step_s = params.step_s;
        let speeds_mps = self.state.speed_mps;
        for (path, speed_mps) in [
            (&mut self.paths.low, speeds_mps[0]),
            (&mut self.paths.up, speeds_mps[1]),
        ] {
            path.restart(PathPoint {
                time_s: 0.0,
                position_m: 0.0,
                speed_mps,
            });
        }
        let mut response_mps2 = self.state.response_mps2;
        for (index, command_mps2) in prefix_mps2.enumerate() {
            response_mps2 = params.response_mps2(response_mps2, command_mps2);
            let stood = self.paths.up.end().speed_mps <= 0.0;
            for (path, noise_mps2) in [
                (&mut self.paths.low, -params.noise_mps2),
                (&mut self.paths.up, params.noise_mps2),
            ] {
                let is_held = path.end().speed_mps <= 0.0 && response_mps2 <= 0.0;
                let acceleration_mps2 = if is_held {
                    0.0
                } else {
                    response_mps2 + noise_mps2
                };
                // A product, as all times of steps: jumps of the speed lie exactly at steps.
                path.run_until(acceleration_mps2, (index + 1) as f64 * step_s);
            }
            let is_noticed = response_mps2 + params.noise_mps2 <= -NOTICED_BRAKE_MPS2
                || stood && self.paths.up.end().speed_mps <= 0.0;
            if !is_noticed {
                self.braking_from_s = f64::INFINITY;
            } else if self.braking_from_s == f64::INFINITY {
                self.braking_from_s = index as f64 * step_s;
            }
        }
        self.response_mps2 = response_mps2;
        self.prefix_s = self.paths.up.end().time_s;
    }

    /// True if full braking after the prefix avoids the leader; no plan does otherwise.
    pub(super) fn avoids_leader(&self) -> bool {
        let mut from = self.paths.up.end();
        from.speed_mps +=
            self.params.lag_s() * (self.response_mps2 + self.params.brake_mps2).max(0.0);
        let ahead = self.paths.leader.at(from.time_s);
        self.state.gap_m == f64::INFINITY
            || self.keeps_ahead([0.0, self.prefix_s]) && self.keeps_after(0, 0.0, 0.0, from, ahead)
    }

    /// Returns the plan if it satisfies both conditions.
    pub(super) fn plan(mut self) -> Option<Plan> {
        let Some((class, state)) = self.class_and_state() else {
            return self.committed(self.shape.accel_mps2, None);
        };
        match (class.trigger, state.phase) {
            (FollowerTrigger::LeaderBrakes, phase) => self.braking_with_follower(class, phase),
            (FollowerTrigger::TimeToCollision(_), FollowerPhase::Braking(left_s)) => {
                self.committed(self.shape.accel_mps2, Some((class, left_s)))
            }
            (FollowerTrigger::TimeToCollision(ttc_s), phase) => {
                self.begin_waiting();
                WaitingTrial::new(self, class, ttc_s, state).plan(phase)
            }
        }
    }

    /// Tests a plan for a follower that reacts to the ego vehicle's braking.
    fn braking_with_follower(
        &mut self,
        class: FollowerClass,
        phase: FollowerPhase,
    ) -> Option<Plan> {
        let brake_mps2 = self.shape.brake_mps2;
        if brake_mps2 < NOTICED_BRAKE_MPS2 + self.params.noise_mps2 {
            return None;
        }
        let brakes_since_s = if self.braking_from_s < f64::INFINITY {
            self.braking_from_s
        } else {
            self.prefix_s + self.noticed_after_s(brake_mps2)
        };
        let left_s = match phase {
            FollowerPhase::Braking(left_s) if brakes_since_s == 0.0 => left_s,
            _ => brakes_since_s + class.reaction_s,
        };
        self.committed(-brake_mps2, Some((class, left_s)))
    }

    /// Returns the time from the end of the prefix until braking at this rate is noticed, in seconds.
    fn noticed_after_s(&self, brake_mps2: f64) -> f64 {
        let mut response_mps2 = self.response_mps2;
        for steps in 0..MAX_SAMPLES {
            response_mps2 = self.params.response_mps2(response_mps2, -brake_mps2);
            if response_mps2 + self.params.noise_mps2 <= -NOTICED_BRAKE_MPS2 {
                return steps as f64 * self.params.step_s;
            }
        }
        f64::INFINITY
    }

    /// Tests an acceleration from the end of the prefix on, as long as possible, and full braking afterwards, with a
    /// follower that brakes after a time.
    fn committed(
        &mut self,
        accel_mps2: f64,
        follower: Option<(FollowerClass, f64)>,
    ) -> Option<Plan> {
        self.spend(FIRING_WORK)?;
        if !self.keeps_ahead([0.0, self.prefix_s]) {
            return None;
        }
        let mut from = self.paths.up.end();
        from.speed_mps += self.params.lag_s() * (self.response_mps2 - accel_mps2).max(0.0);
        let steps = self.longest_steps(from, accel_mps2, -self.response_mps2, 0)?;
        if let Some((class, left_s)) = follower {
            let state = self.state.follower?;
            self.extend_low(self.paths.low.end(), accel_mps2, steps, self.response_mps2);
            let start = PathPoint {
                time_s: 0.0,
                position_m: -state.gap_m[0],
                speed_mps: state.speed_mps[1],
            };
            self.set_follower(start, class, left_s);
            if !self.keeps_behind([0.0, self.prefix_s]) {
                return None;
            }
        }
        Some(Plan::Committed { accel_mps2, steps })
    }

    /// True if the gap to the worst leader is large enough over an interval of phase 1.
    fn keeps_ahead(&self, interval_s: [f64; 2]) -> bool {
        self.state.gap_m == f64::INFINITY
            || interval_s[1] <= interval_s[0] && self.state.gap_m >= self.margin_m
            || min_distance_m(&self.paths.leader, &self.paths.up, interval_s) >= self.margin_m
    }

    /// True if the gap to the computed follower is large enough: from `from_s` to `switch_s` in phase 1, and later.
    fn keeps_behind(&self, [from_s, switch_s]: [f64; 2]) -> bool {
        let Paths {
            low,
            tail,
            follower,
            ..
        } = &*self.paths;
        min_distance_m(tail, follower, [switch_s, f64::INFINITY]) >= self.margin_m
            && (switch_s <= from_s
                || min_distance_m(low, follower, [from_s, switch_s]) >= self.margin_m)
    }

    /// Sets the follower's motion: at `start`, and braking after `left_s`.
    fn set_follower(&mut self, start: PathPoint, class: FollowerClass, left_s: f64) {
        let path = &mut self.paths.follower;
        path.restart(start);
        path.run(class.drift_mps2, left_s);
        path.finish(-class.brake_mps2);
    }

    /// Returns the speed that braking fully adds to the farthest motion without lag, in m/s, after braking at up to
    /// `braked_mps2`.
    fn brake_jump_mps(&self, braked_mps2: f64) -> f64 {
        self.params.lag_s() * (self.params.brake_mps2 - braked_mps2).max(0.0)
    }

    /// Returns the largest number of steps of an acceleration, from `from` on, after which full braking keeps the gap
    /// ahead; `None` if even 0 is too many. The response before was at least `-braked_mps2`.
    fn longest_steps(
        &self,
        from: PathPoint,
        accel_mps2: f64,
        braked_mps2: f64,
        guess: usize,
    ) -> Option<usize> {
        let jump_mps = self.brake_jump_mps(braked_mps2.max(-accel_mps2));
        let ahead = self.paths.leader.at(from.time_s);
        let keeps = |steps: usize| self.keeps_after(steps, accel_mps2, jump_mps, from, ahead);
        if self.state.gap_m == f64::INFINITY {
            return Some(MAX_COAST_STEPS);
        }
        // Lag cannot be bounded for a vehicle that accelerates again.
        let max_steps = if accel_mps2 > 0.0 && self.params.response_fraction < 1.0 {
            0
        } else {
            MAX_COAST_STEPS
        };
        largest_with(keeps, guess, max_steps)
    }

    /// True if the ego vehicle keeps the gap ahead if it accelerates for so many steps, and then brakes fully.
    fn keeps_after(
        &self,
        steps: usize,
        accel_mps2: f64,
        jump_mps: f64,
        from: PathPoint,
        ahead: PathPoint,
    ) -> bool {
        let dt_s = steps as f64 * self.params.step_s;
        let level_mps2 = self.kernel.ahead_brake_mps2;
        let noisy_mps2 = accel_mps2 + self.params.noise_mps2;
        let [own_m, own_mps] = distance_and_speed_after(from.speed_mps, noisy_mps2, dt_s);
        let [ahead_m, ahead_mps] = distance_and_speed_after(ahead.speed_mps, -level_mps2, dt_s);
        let gap_m = ahead.position_m - from.position_m;
        let end_gap_m = gap_m + ahead_m - own_m;
        // With an acceleration of 0 or more, the gap is smallest at an end of the time.
        let inside_m = if accel_mps2 < 0.0 && steps > 0 {
            gap_m
                - max_closing_m(
                    from.speed_mps,
                    noisy_mps2,
                    ahead.speed_mps,
                    level_mps2,
                    dt_s,
                )
        } else {
            gap_m
        };
        inside_m >= self.margin_m
            && end_gap_m - self.kernel.demanded_gap_m(own_mps + jump_mps, ahead_mps)
                >= self.margin_m
    }

    /// Computes the least far own motion after phase 1. The response at `from` was at most `response_mps2`.
    fn extend_low(&mut self, from: PathPoint, accel_mps2: f64, steps: usize, response_mps2: f64) {
        let noise_mps2 = self.params.noise_mps2;
        let path = &mut self.paths.tail;
        path.restart(from);
        if steps > 0 {
            path.jump(-self.params.lag_s() * (accel_mps2 - response_mps2).max(0.0));
            path.run(accel_mps2 - noise_mps2, steps as f64 * self.params.step_s);
        }
        path.finish(-self.params.brake_mps2 - noise_mps2);
    }

    /// Computes phase 1: the own motion until the follower's brake has fired.
    fn begin_waiting(&mut self) {
        let PlanShape {
            brake_mps2,
            brake_steps,
            ..
        } = self.shape;
        let prefix_steps = self.prefix_steps();
        let held_from_s =
            brake_steps.map(|steps| (prefix_steps + steps) as f64 * self.params.step_s);
        let noise_mps2 = self.params.noise_mps2;
        let lag_s = self.params.lag_s();
        let held_jump_mps = lag_s * self.highest_response_mps2(self.prefix_s).min(0.0);
        let Paths { up, low, .. } = &mut *self.paths;
        up.jump(lag_s * (self.response_mps2 + brake_mps2).max(0.0));
        low.jump(-lag_s * (-brake_mps2 - self.response_mps2).max(0.0));
        match held_from_s {
            None => {
                up.finish(-brake_mps2 + noise_mps2);
                low.finish(-brake_mps2 - noise_mps2);
            }
            Some(held_from_s) => {
                up.run_until(-brake_mps2 + noise_mps2, held_from_s);
                up.finish(noise_mps2);
                low.run_until(-brake_mps2 - noise_mps2, held_from_s);
                low.jump(held_jump_mps);
                low.finish(-noise_mps2);
                self.hold_from_s = held_from_s;
            }
        }
    }

    /// True if phase 1 brakes fully until an instant.
    fn brakes_fully_until(&self, time_s: f64) -> bool {
        self.shape.brake_mps2 >= self.params.brake_mps2 && time_s <= self.hold_from_s
    }

    fn prefix_steps(&self) -> usize {
        (self.prefix_s / self.params.step_s).round() as usize
    }

    /// Returns a bound of the responses in phase 1 until an instant, in m/s².
    fn highest_response_mps2(&self, time_s: f64) -> f64 {
        if time_s >= self.hold_from_s {
            0.0_f64.max(self.response_mps2)
        } else {
            self.response_mps2.max(-self.shape.brake_mps2)
        }
    }
}

/// Returns the largest number up to `max` that satisfies a condition which no larger number satisfies again; `None` if
/// 0 does not. `guess` makes it faster.
pub(super) fn largest_with(
    mut keeps: impl FnMut(usize) -> bool,
    guess: usize,
    max: usize,
) -> Option<usize> {
    if !keeps(0) {
        return None;
    }
    let mut low = 0;
    let mut high = max + 1;
    let mut probe = guess.min(max);
    let mut stride = 1;
    while high - low > 1 {
        probe = probe.clamp(low + 1, high - 1);
        if keeps(probe) {
            low = probe;
            probe += stride;
        } else {
            high = probe;
            probe = probe.saturating_sub(stride);
        }
        stride *= 2;
        if high - low < stride {
            probe = low + (high - low) / 2;
        }
    }
    Some(low)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crumple_cases::with_cases(512))]

        #[test]
        fn the_largest_number_is_found_from_any_guess(
            largest in 0..5000_usize, guess in 0..9000_usize, max in 0..5000_usize,
        ) {
            let mut tests = std::cell::Cell::new(0);
            let result = largest_with(|n| { tests.set(tests.get() + 1); n <= largest }, guess, max);
            prop_assert_eq!(result, Some(largest.min(max)));
            prop_assert!(*tests.get_mut() < 40, "{} tests", tests.get());
        }
    }

    #[test]
    fn nothing_is_found_if_zero_is_too_much() {
        assert_eq!(largest_with(|_| false, 7, 100), None);
    }
}
