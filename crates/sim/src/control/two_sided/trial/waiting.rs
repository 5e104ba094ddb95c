//! Test of a plan for a follower whose brake fires below a time to collision, and has not fired yet.
//!
//! The follower may fire at any step, with any state that the class allows there. Two states at each step cover all
//! ([`WaitingTrial::firing_states`]).
//!
//! One test covers a *block* of steps, from i to k. The follower of the test has not fired before step i, drifts until
//! step k and reacts from then on, so it is farther than each follower that fires in the block, or waits. The ego
//! vehicle of the test accelerates from step k until the time n(i) steps after step i, where n(i) is the longest
//! acceleration after a firing at step i. After a firing at step j of the block, n(i) - (j - i) steps of acceleration
//! end at the same time: the ego vehicle is then not nearer to the leader than after a firing at i (condition A), and
//! not nearer to the follower than in the test (condition B), because its commands are as large at each time.

use super::super::params::{CREEP_SPEED_MPS, FollowerClass};
use super::super::path::{PathPoint, min_distance_m};
use super::super::state::{FollowerPhase, FollowerState, Plan};
use super::{FIRING_WORK, MAX_SAMPLES, Paths, Trial};
use crate::control::{FiringRule, distance_and_speed_after};

/// Steps between two tests of whether all later firings can be covered at once.
const REST_TEST_INTERVAL: usize = 10;

/// Share of the margin that a follower keeps whose brake does not fire.
const WAITING_MARGIN_SHARE: f64 = 0.9;

/// Maximum time that is skipped because no follower can fire, in seconds.
const MAX_SKIP_S: f64 = 1.0;

/// Steps of the largest block.
const MAX_BLOCK: usize = 64;

pub(super) struct WaitingTrial<'p> {
    trial: Trial<'p>,
    class: FollowerClass,
    rule: FiringRule,
    state: FollowerState,
    /// Acceleration steps of the last firing.
    steps: usize,
    blocks: BlockSizes,
}

/// Sizes of the blocks to try. A block that fails costs a test and saves none, so that ever more single steps follow
/// failures without a success in between.
struct BlockSizes {
    /// Steps of the next block.
    next: usize,
    /// Single steps before the next larger block.
    singles_left: usize,
    /// Single steps after the next failure.
    singles: usize,
}

impl BlockSizes {
    fn new() -> Self {
        Self {
            next: 1,
            singles_left: 0,
            singles: 1,
        }
    }

    fn record_success(&mut self, size: usize) {
        if size == 1 && self.singles_left > 0 {
            self.singles_left -= 1;
            self.next = 1;
            return;
        }
        if size > 1 {
            self.singles = 1;
        }
        self.next = (2 * size).min(MAX_BLOCK);
    }

    fn record_failure(&mut self) {
        self.singles_left = self.singles;
        self.singles = (2 * self.singles).min(MAX_BLOCK);
    }
}

/// Own motion and bounds of an unfired follower at a step.
#[derive(Clone, Copy)]
struct Moment {
    /// Own motion, least far and farthest, and the farthest at the step before.
    low: PathPoint,
    up: PathPoint,
    up_before: PathPoint,
    /// Farthest and least far motion of any follower of the class.
    fastest: PathPoint,
    slowest: PathPoint,
}

impl<'p> WaitingTrial<'p> {
    pub(super) fn new(
        trial: Trial<'p>,
        class: FollowerClass,
        ttc_s: f64,
        state: FollowerState,
    ) -> Self {
        let step_s = trial.params.step_s;
        Self {
            trial,
            class,
            rule: FiringRule {
                step_s,
                ttc_s,
                drift_mps2: class.drift_mps2,
            },
            state,
            steps: 0,
            blocks: BlockSizes::new(),
        }
    }

    /// Returns the plan if it satisfies both conditions.
    pub(super) fn plan(self, phase: FollowerPhase) -> Option<Plan> {
        self.trial.paths.firings.clear();
        if self.rule.ttc_s < 2.0 * self.trial.params.step_s {
            return None;
        }
        if phase == FollowerPhase::Waiting && self.trial.params.observes_firing() {
            self.after_observed_firing()
        } else {
            self.after_fixed_time(phase)
        }
    }

    /// Returns the time at which a command of the step at `time_s` takes effect, in seconds.
    fn switch_s(&self, time_s: f64) -> f64 {
        let params = self.trial.params;
        ((time_s / params.step_s).round() + params.delay_steps as f64) * params.step_s
    }

    fn moment(&self, sample: usize) -> Moment {
        let step_s = self.trial.params.step_s;
        let time_s = sample as f64 * step_s;
        let FollowerState {
            gap_m: [near_m, far_m],
            speed_mps: [slow_mps, fast_mps],
            ..
        } = self.state;
        let drift_mps2 = self.class.drift_mps2;
        let bound = |gap_m: f64, speed_mps: f64, drift_mps2: f64| {
            let [covered_m, end_mps] = distance_and_speed_after(speed_mps, drift_mps2, time_s);
            PathPoint {
                time_s,
                position_m: covered_m - gap_m,
                speed_mps: end_mps,
            }
        };
        let Paths { up, low, .. } = &*self.trial.paths;
        Moment {
            low: low.at(time_s),
            up: up.at(time_s),
            up_before: up.at((time_s - step_s).max(0.0)),
            fastest: bound(near_m, fast_mps, drift_mps2),
            slowest: bound(far_m, slow_mps, -drift_mps2),
        }
    }

    /// Tests a plan that changes to phase 2 when the follower's brake fires.
    fn after_observed_firing(mut self) -> Option<Plan> {
        let mut ahead_until_s = 0.0;
        let mut is_first_firing = true;
        let mut tests = 0;
        let mut sample = 1;
        while sample <= MAX_SAMPLES {
            self.trial.spend(1)?;
            let now = self.moment(sample);
            let can_rest = self.stands_from(now.up.time_s) && tests % REST_TEST_INTERVAL == 0;
            tests += 1;
            let spare_m = self.fastest_spare_m(&now);
            if spare_m < 0.0 || can_rest {
                if is_first_firing && !self.stays_behind_until(now.low.time_s) {
                    return None;
                }
                is_first_firing = false;
            }
            let mut covered = 1;
            if spare_m < 0.0 {
                let switch_s = self.switch_s(now.up.time_s);
                if !self.trial.keeps_ahead([ahead_until_s, switch_s]) {
                    return None;
                }
                ahead_until_s = switch_s;
                covered = self.covers_firings(&now, sample)?;
                let last = sample + covered - 1;
                if self.slowest_spare_m(&self.moment(last)) < 0.0 {
                    return Some(self.result(Some(last), None));
                }
            }
            if !is_first_firing && covered == 1 && !self.keeps_waiting_gap(&now) {
                return None;
            }
            if can_rest && self.covers_later_firings(&now, true) {
                let kept = self.trial.keeps_ahead([ahead_until_s, now.up.time_s]);
                self.trial.paths.firings.push((sample, self.steps));
                return kept.then(|| self.result(None, None));
            }
            sample += if is_first_firing {
                self.steps_without_firing(spare_m, &now)
            } else {
                covered
            };
        }
        None
    }

    /// Tests a plan that changes to phase 2 at a fixed step, at which every follower of the class has fired.
    fn after_fixed_time(mut self, phase: FollowerPhase) -> Option<Plan> {
        let first = usize::from(phase == FollowerPhase::Waiting);
        let latest = self.latest_firing()?;
        let switch_s = latest.map_or(f64::INFINITY, |sample| {
            self.switch_s(sample as f64 * self.trial.params.step_s)
        });
        let rest_s = self.trial.paths.up.end().time_s;
        let ahead_until_s = if latest.is_some() { switch_s } else { rest_s };
        if !self.trial.keeps_ahead([0.0, ahead_until_s]) {
            return None;
        }
        if latest.is_some() {
            self.begin_phase_two(switch_s)?;
        }
        self.covers_all_firings(first, latest, switch_s)
            .then(|| self.result(latest, Some(self.steps)))
    }

    /// True if the computed own motion is safe with any follower of the class that fires from step `first` on.
    fn covers_all_firings(&mut self, first: usize, latest: Option<usize>, switch_s: f64) -> bool {
        let mut is_first_firing = true;
        let mut sample = first;
        while sample <= latest.unwrap_or(MAX_SAMPLES) {
            if self.trial.spend(1).is_none() {
                return false;
            }
            let now = self.moment(sample);
            let spare_m = self.fastest_spare_m(&now);
            let rests = latest.is_none()
                && self.stands_from(now.up.time_s)
                && self.covers_later_firings(&now, false);
            if spare_m < 0.0 || rests {
                if is_first_firing && !self.stays_behind_until(now.low.time_s) {
                    return false;
                }
                is_first_firing = false;
            }
            let mut covered = 1;
            if spare_m < 0.0 {
                match self.covers_firings_of_course(&now, sample, latest, switch_s) {
                    Some(steps) => covered = steps,
                    None => return false,
                }
            }
            if rests {
                return true;
            }
            if is_first_firing {
                sample += self.steps_without_firing(spare_m, &now);
                continue;
            }
            let last = sample + covered - 1;
            if covered == 1 && Some(last) != latest && !self.keeps_waiting_gap(&now) {
                return false;
            }
            sample += covered;
        }
        latest.is_some() && !is_first_firing
    }

    /// Returns the step at which every follower of the class has fired: `Some(None)` if the ego vehicle stands before,
    /// `None` if it cannot wait so long.
    fn latest_firing(&mut self) -> Option<Option<usize>> {
        let mut sample = 1;
        while sample <= MAX_SAMPLES {
            self.trial.spend(1)?;
            let now = self.moment(sample);
            let late_m = self.slowest_spare_m(&now);
            if late_m < 0.0 {
                return Some(Some(sample));
            }
            if now.slowest.speed_mps == 0.0 {
                return self.stands_from(now.up.time_s).then_some(None);
            }
            sample += self.steps_until_zero(late_m, now.slowest.speed_mps, now.up.speed_mps);
        }
        None
    }

    fn stands_from(&self, time_s: f64) -> bool {
        let Paths { up, low, .. } = &*self.trial.paths;
        up.stands_from(time_s) && low.stands_from(time_s)
    }

    fn result(&self, latest: Option<usize>, fixed_steps: Option<usize>) -> Plan {
        let params = self.trial.params;
        let commands = self.trial.prefix_steps().saturating_sub(params.delay_steps);
        Plan::Waiting {
            shape: self.trial.shape,
            latest_steps: latest.map(|sample| sample.saturating_sub(commands)),
            fixed_steps,
        }
    }

    /// Returns the distance by which the most dangerous follower misses its threshold, in metres; no follower of the
    /// class fires unless it is negative.
    fn fastest_spare_m(&self, now: &Moment) -> f64 {
        self.rule.spare_m(now.low.into(), now.fastest.into())
    }

    /// Returns the distance by which the least dangerous follower misses its threshold, in metres, and a margin; every
    /// follower of the class has fired at this step or before if it is negative.
    fn slowest_spare_m(&self, now: &Moment) -> f64 {
        self.rule.spare_m(now.up.into(), now.slowest.into()) + self.trial.margin_m
    }

    /// Returns a number of steps until a follower can fire, at least 1.
    fn steps_without_firing(&self, spare_m: f64, now: &Moment) -> usize {
        let drift_mps = self.class.drift_mps2 * MAX_SKIP_S;
        // With lag, the least far motion jumps to lower speeds.
        let jumps_mps = self.trial.params.lag_s()
            * (self.trial.params.brake_mps2 + self.trial.params.accel_mps2);
        self.steps_until_zero(
            spare_m - self.rule.ttc_s * jumps_mps,
            now.fastest.speed_mps + drift_mps,
            now.low.speed_mps - jumps_mps,
        )
    }

    /// Returns a number of steps, at least 1, in which a distance to a threshold stays positive: the ego vehicle brakes
    /// at most fully, and the follower is at most so fast.
    fn steps_until_zero(&self, distance_m: f64, follower_mps: f64, own_mps: f64) -> usize {
        let params = self.trial.params;
        let brake_mps2 = params.brake_mps2 + params.noise_mps2;
        let slowest_mps = (own_mps - brake_mps2 * MAX_SKIP_S).max(0.0);
        let rate_mps = (follower_mps - slowest_mps).max(0.0)
            + self.rule.ttc_s * (self.class.drift_mps2 + brake_mps2);
        let skip_s = (distance_m / rate_mps).min(MAX_SKIP_S);
        ((skip_s / params.step_s) as usize).max(1)
    }

    /// True if no follower of the class comes too near until `time_s` without firing.
    fn stays_behind_until(&mut self, time_s: f64) -> bool {
        let FollowerState {
            gap_m, speed_mps, ..
        } = self.state;
        if time_s == 0.0 {
            return gap_m[0] >= self.trial.margin_m;
        }
        let path = &mut self.trial.paths.follower;
        path.restart(PathPoint {
            time_s: 0.0,
            position_m: -gap_m[0],
            speed_mps: speed_mps[1],
        });
        path.finish(self.class.drift_mps2);
        let Paths { low, follower, .. } = &*self.trial.paths;
        min_distance_m(low, follower, [0.0, time_s]) >= self.trial.margin_m
    }

    /// Computes phase 2 from an instant on; `None` if the plan then does not keep the gap ahead.
    fn begin_phase_two(&mut self, switch_s: f64) -> Option<()> {
        self.set_longest_steps(switch_s)?;
        self.extend_low_after(switch_s, self.steps);
        Some(())
    }

    /// Sets the steps of acceleration in phase 2 from an instant on: as many as keep the gap ahead.
    fn set_longest_steps(&mut self, switch_s: f64) -> Option<()> {
        let trial = &mut self.trial;
        let accel_mps2 = trial.shape.accel_mps2;
        let braked_mps2 = trial.shape.brake_mps2.max(-trial.response_mps2);
        let from = trial.paths.up.at(switch_s);
        self.steps = trial.longest_steps(from, accel_mps2, braked_mps2, self.steps)?;
        Some(())
    }

    /// Returns a number of steps, from this one on, at which any follower of the class may fire; `None` if the plan is
    /// not safe with a firing at this step.
    fn covers_firings(&mut self, now: &Moment, sample: usize) -> Option<usize> {
        self.set_longest_steps(self.switch_s(now.up.time_s))?;
        let first_steps = self.steps;
        let size = match self.computes_exactly() {
            true => self.blocks.next,
            false => 1,
        };
        let covered = self.covered_steps(size, |waiting, size| {
            waiting.covers_waiting_block(now, size, first_steps)
        })?;
        let firings = (0..covered).map(|step| (sample + step, first_steps.saturating_sub(step)));
        self.trial.paths.firings.extend(firings);
        Some(covered)
    }

    /// True if the plan is safe with any follower of the class that fires in a block of steps, with so many steps of
    /// acceleration after a firing at the first.
    fn covers_waiting_block(&mut self, now: &Moment, size: usize, first_steps: usize) -> bool {
        let last_s = now.up.time_s + (size - 1) as f64 * self.trial.params.step_s;
        let last_switch_s = self.switch_s(last_s);
        let fits =
            size == 1 || first_steps >= size - 1 || self.trial.brakes_fully_until(last_switch_s);
        if !fits {
            return false;
        }
        self.extend_low_after(last_switch_s, first_steps.saturating_sub(size - 1));
        self.covers_block(now, size, last_switch_s)
    }

    /// Tries a block of steps, and then a single one. Returns the first number of steps that the condition covers.
    fn covered_steps(
        &mut self,
        mut size: usize,
        mut covers: impl FnMut(&mut Self, usize) -> bool,
    ) -> Option<usize> {
        loop {
            self.trial.spend(FIRING_WORK)?;
            if covers(self, size) {
                self.blocks.record_success(size);
                return Some(size);
            }
            if size == 1 {
                return None;
            }
            self.blocks.record_failure();
            size = 1;
        }
    }

    /// Returns a number of steps, from this one on, at which any follower of the class may fire; `None` if the computed
    /// own motion is not safe with a firing at this step.
    fn covers_firings_of_course(
        &mut self,
        now: &Moment,
        sample: usize,
        latest: Option<usize>,
        switch_s: f64,
    ) -> Option<usize> {
        let most = latest.map_or(usize::MAX, |latest| latest - sample + 1);
        if sample == 0 {
            return self.covered_steps(1, |waiting, _| waiting.covers_start(now, switch_s));
        }
        self.covered_steps(self.blocks.next.min(most), |waiting, size| {
            waiting.covers_block(now, size, switch_s)
        })
    }

    /// True if the bounds of the own motion do not depend on the commands before: the steps of acceleration after a
    /// firing then decrease by at most one from step to step.
    fn computes_exactly(&self) -> bool {
        self.trial.params.response_fraction == 1.0
    }

    fn extend_low_after(&mut self, switch_s: f64, steps: usize) {
        let accel_mps2 = self.trial.shape.accel_mps2;
        let response_mps2 = self.trial.highest_response_mps2(switch_s);
        let low = self.trial.paths.low.at(switch_s);
        self.trial.extend_low(low, accel_mps2, steps, response_mps2);
    }

    /// True if the computed own motion is safe with any follower that has fired at the first step.
    fn covers_start(&mut self, now: &Moment, switch_s: f64) -> bool {
        self.keeps_follower_behind(now.fastest, self.class.reaction_s, switch_s)
    }

    /// True if the computed own motion is safe with any follower of the class that fires in a block of steps.
    fn covers_block(&mut self, now: &Moment, size: usize, switch_s: f64) -> bool {
        let step_s = self.trial.params.step_s;
        let last_s = (size - 1) as f64 * step_s;
        // In a block, a follower that waits drifts until the step after it.
        let waits_s = if size == 1 { 0.0 } else { last_s + step_s };
        let left_s = waits_s.max(last_s + self.class.reaction_s);
        self.firing_states(now, size == 1).is_none_or(|states| {
            states
                .into_iter()
                .all(|start| self.keeps_follower_behind(start, left_s, switch_s))
        })
    }

    /// Returns two states that cover all followers which have not fired before this step; with `fires`, all that fire
    /// at it. `None` if there are none.
    ///
    /// A follower with speed u has not accelerated all the time, so its farthest position is that of the fastest one
    /// less a deficit ([`Self::deficit_m`]); it must also satisfy the condition of the step before. Both are equal at
    /// one speed. Up to it, the farthest later position increases with u, and beyond it is convex in u.
    fn firing_states(&self, now: &Moment, fires: bool) -> Option<[PathPoint; 2]> {
        let Moment {
            fastest, slowest, ..
        } = now;
        let unfired_m = |speed_mps: f64| {
            self.rule
                .unfired_position_m(now.up_before.into(), speed_mps)
        };
        let least_excess_m = unfired_m(slowest.speed_mps) - slowest.position_m;
        if least_excess_m < 0.0 {
            return None;
        }
        let time_s = fastest.time_s;
        let own = [now.low.into(), now.up_before.into()];
        let bounds = self
            .rule
            .firing_speeds_mps(own, [now.fastest.into(), now.slowest.into()]);
        let least_mps = if fires {
            bounds.min_mps
        } else {
            slowest.speed_mps
        };
        let change_mps = self.speed_change_mps(least_excess_m, time_s);
        let most_mps = bounds.max_mps.min(slowest.speed_mps + change_mps);
        if most_mps < least_mps {
            return None;
        }
        let excess_m = fastest.position_m - unfired_m(fastest.speed_mps);
        let kink_mps = fastest.speed_mps - self.speed_change_mps(excess_m, time_s);
        Some(
            [kink_mps.max(least_mps).min(most_mps), most_mps].map(|speed_mps| {
                let deficit_m = self.deficit_m(fastest.speed_mps - speed_mps, time_s);
                PathPoint {
                    time_s,
                    position_m: unfired_m(speed_mps).min(fastest.position_m - deficit_m),
                    speed_mps,
                }
            }),
        )
    }

    /// Returns the distance, in metres, that a follower loses on one that accelerates all the time, if it is slower by
    /// `change_mps` at the end.
    fn deficit_m(&self, change_mps: f64, time_s: f64) -> f64 {
        let drift_mps2 = self.class.drift_mps2;
        if change_mps <= 0.0 {
            0.0
        } else if change_mps <= 2.0 * drift_mps2 * time_s {
            0.25 * change_mps * change_mps / drift_mps2
        } else {
            (change_mps - drift_mps2 * time_s) * time_s
        }
    }

    /// Returns the change of speed, in m/s, for which [`Self::deficit_m`] and the change of the unfired position add up
    /// to `excess_m`.
    fn speed_change_mps(&self, excess_m: f64, time_s: f64) -> f64 {
        let drift_mps2 = self.class.drift_mps2;
        let per_mps_s = self.rule.ttc_s - self.rule.step_s;
        if excess_m <= 0.0 {
            return 0.0;
        }
        if drift_mps2 > 0.0 {
            let root_s = (per_mps_s * per_mps_s + excess_m / drift_mps2).sqrt();
            let change_mps = 2.0 * excess_m / (per_mps_s + root_s);
            if change_mps <= 2.0 * drift_mps2 * time_s {
                return change_mps;
            }
        }
        (excess_m + drift_mps2 * time_s * time_s) / (per_mps_s + time_s)
    }

    /// True if a follower that does not fire at this step keeps a gap until the next one.
    fn keeps_waiting_gap(&self, now: &Moment) -> bool {
        let params = self.trial.params;
        let low_mps = if now.up.speed_mps == 0.0 {
            now.slowest.speed_mps.max(CREEP_SPEED_MPS)
        } else {
            now.slowest.speed_mps
        };
        // The least far position and the highest speed make the gap smallest.
        let own = PathPoint {
            speed_mps: now.up.speed_mps,
            ..now.low
        };
        let brake_mps2 = params.brake_mps2 + params.noise_mps2;
        let gap_m =
            self.rule
                .waiting_gap_m(own.into(), brake_mps2, now.fastest.position_m, low_mps);
        gap_m >= WAITING_MARGIN_SHARE * self.trial.margin_m
    }

    /// True if the follower that drifts from `start` on, and brakes after `left_s`, stays behind the computed own
    /// motion.
    fn keeps_follower_behind(&mut self, start: PathPoint, left_s: f64, switch_s: f64) -> bool {
        self.trial.set_follower(start, self.class, left_s);
        if switch_s == f64::INFINITY {
            let Paths { low, follower, .. } = &*self.trial.paths;
            return min_distance_m(low, follower, [start.time_s, f64::INFINITY])
                >= self.trial.margin_m;
        }
        self.trial.keeps_behind([start.time_s, switch_s])
    }

    /// True if the plan is safe with any follower that fires later, while the ego vehicle stands in phase 1. Followers
    /// slower than [`CREEP_SPEED_MPS`] are not covered.
    fn covers_later_firings(&mut self, now: &Moment, observes: bool) -> bool {
        let stand_m = now.up.position_m;
        let reach_m = (stand_m - now.slowest.position_m).max(0.0);
        let fastest_mps = (now.fastest.speed_mps * now.fastest.speed_mps
            + 2.0 * self.class.drift_mps2 * reach_m)
            .sqrt();
        let high_mps = self
            .rule
            .unfired_speed_mps(now.up.into(), now.slowest.position_m)
            .min(fastest_mps);
        // A follower that has waited is not slower than this at the next step.
        let low_mps = CREEP_SPEED_MPS - self.rule.drift_mps2 * self.rule.step_s;
        if high_mps < low_mps {
            return true;
        }
        let switch_s = if observes {
            self.switch_s(now.up.time_s)
        } else {
            f64::INFINITY
        };
        // The leader is never nearer than now, so later firings allow as many steps of acceleration.
        if observes && self.begin_phase_two(switch_s).is_none() {
            return false;
        }
        self.keeps_waiting_gap_at_rest(now)
            && [low_mps, high_mps].iter().all(|&speed_mps| {
                let start = PathPoint {
                    time_s: now.low.time_s,
                    position_m: self.rule.unfired_position_m(now.up.into(), speed_mps),
                    speed_mps,
                };
                self.keeps_follower_behind(start, self.class.reaction_s, switch_s)
            })
    }

    /// True if a follower that waits behind the standing ego vehicle keeps a gap.
    fn keeps_waiting_gap_at_rest(&self, now: &Moment) -> bool {
        let far_m = f64::INFINITY;
        let gap_m = self
            .rule
            .waiting_gap_m(now.up.into(), 0.0, far_m, CREEP_SPEED_MPS);
        gap_m >= WAITING_MARGIN_SHARE * self.trial.margin_m
    }
}
