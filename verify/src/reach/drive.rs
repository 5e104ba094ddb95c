//! Where everybody can be: the vehicles of a box, driven by an actor, step by step.
//!
//! Leader and follower brake to standstill at some time: see [`braking`](super::braking).
//!
//! # The ego
//! The actor decides every D steps; its answer u is held. It is affine in the symbols plus a rest, which becomes a new symbol. After
//! s seconds w = v + u s, the speed is max(0, w), and the distance v s + u s²/2 + max(0, -w)²/(2|u|), the last of which is at most
//! max(-w) s/2, since -w ≤ |u| s as v ≥ 0. If all members stop they cover at most v s/2. What this adds becomes new symbols too.
//! So nothing that is uncertain is counted twice, and no symbol is ever merged with another.
//!
//! Where some members stand at the beginning of the last step before the next decision and others move, the set is split in those
//! two: who moves observes u as its acceleration and has stopped, if at all, within one step; who stands observes 0. Either set
//! keeps what would belong to the other (a free speed below zero, for instance): too many members do no harm.
//!
//! # The follower's emergency brake
//! It fires at the first instant at which guard = gap - θ (v_r - v_e) < 0. `travel` drives the members *whose follower has not
//! fired*. In a decision interval in which some guard may be negative, first at instant j1, a second set is split off: those whose
//! follower fires between j1 and j2, with τ a symbol of its own; j2 is the first instant at which all guards are negative, if there
//! is one. Then nobody is left who has not fired. As all members of the set have the same τ-window within one decision interval,
//! every observed acceleration of the follower is known. Nothing uses that the guard of the members that fire was not negative
//! before: they are a subset of what is driven.
//!
//! # Contact
//! Gaps are compared at decisions. In between g'' ≤ m, the most the vehicle ahead accelerates (at least 0) less the least the one
//! behind does (at most 0), so g ≥ min(g at begin, g at end) - m (D h)²/8 throughout; see [`avoidable`](crate::avoidable).

use super::actor::{Actor, OBSERVED};
use super::braking::{Braking, Seen};
use super::form::Form;
use super::relax::rectified;
use super::{Dimension, Doubt, Ranges, Reached};
use crate::interval::Interval;

/// Most sets that are split off.
const MOST_SETS: usize = 300;
/// Bounds wider than this are given up, in m/s.
const WIDEST_MPS: f64 = 40.0;

/// What is driven.
#[derive(Debug, Clone)]
pub struct Scene<'a> {
    /// Who decides.
    pub actor: &'a Actor,
    /// Where everybody starts.
    pub ranges: Ranges,
    /// θ of the follower in seconds; none if nobody is behind.
    pub follower_ttc_s: Option<f64>,
    /// Largest error of each observed number.
    pub observation_error: [f64; OBSERVED],
    /// h, in seconds.
    pub step_s: f64,
    /// N, a multiple of `decision_steps`.
    pub steps: u32,
    /// D.
    pub decision_steps: u32,
    /// Whether to stop as soon as contact cannot be excluded.
    pub stop_at_doubt: bool,
}

/// A set of egos at an instant that is a decision's.
#[derive(Debug, Clone)]
struct Members {
    k: u32,
    ego: Seen,
    /// The first symbol that is not in use.
    symbols: usize,
}

/// A set on its way: who leads, who follows, and what is known of its gaps.
struct Drive<'a> {
    scene: &'a Scene<'a>,
    step: Interval,
    leader: Braking,
    gaps: [Form; 2],
    reached: Reached,
    sets: usize,
    tube: Tube,
    /// Whether no part of the tube is missing because all members of a set had touched.
    tube_is_whole: bool,
}

/// For each decision, bounds of the eight numbers that are observed.
pub type Tube = Vec<[Interval; OBSERVED]>;

/// Bounds of what becomes of all members of a box.
#[must_use]
pub fn reach(scene: &Scene<'_>) -> Reached {
    reach_with_tube(scene).0
}

/// The same, and bounds of all that is observed on the way, the last instant included, unless it was given up or surely
/// ended in contact.
#[must_use]
pub fn reach_with_tube(scene: &Scene<'_>) -> (Reached, Option<Tube>) {
    let step = Interval::point(scene.step_s);
    let symbol = |dimension: Dimension| Form::symbol(dimension as usize, scene.ranges.get(dimension));
    let onset_range = scene.ranges.onset_steps;
    let leader = [Dimension::LeaderSpeedMps, Dimension::LeaderBrakeMps2, Dimension::OnsetSteps].map(symbol);
    let [speed, rate, onset] = leader;
    let mut drive = Drive {
        scene,
        step,
        leader: Braking::new(speed, rate, onset, onset_range, step),
        gaps: [Dimension::GapAheadM, Dimension::GapBehindM].map(symbol),
        reached: Reached::NOTHING_YET,
        sets: 0,
        tube: Vec::new(),
        tube_is_whole: true,
    };
    let ego = Seen { distance: Form::default(), speed: symbol(Dimension::EgoSpeedMps), acceleration: Form::default() };
    let members = Members { k: 0, ego, symbols: Dimension::ALL.len() };
    let never = f64::from(scene.steps);
    let follower = scene.follower_ttc_s.map(|_| drive.follower([never, never], &mut 0));
    let touches = drive.travel(members, follower.as_ref(), true);
    drive.reached.touches = touches == Some(true);
    (drive.reached, touches.filter(|_| drive.tube_is_whole).map(|_| drive.tube))
}

impl Drive<'_> {
    /// The follower whose brake fires at an instant of a window.
    fn follower(&self, [first, last]: [f64; 2], symbols: &mut usize) -> Braking {
        let get = |dimension: Dimension| Form::symbol(dimension as usize, self.scene.ranges.get(dimension));
        let window = Interval::new(first, last).unwrap_or(Interval::LINE);
        let onset = Form::symbol(*symbols, window);
        *symbols += 1;
        let mut follower =
            Braking::new(get(Dimension::FollowerSpeedMps), get(Dimension::FollowerBrakeMps2), onset, window, self.step);
        // It fires at instants only.
        follower.mean_held_m = Interval::ZERO;
        follower
    }

    /// Drives to the end. Whether all members surely touch; none once it was given up.
    fn travel(&mut self, mut members: Members, follower: Option<&Braking>, has_not_fired: bool) -> Option<bool> {
        self.sets += 1;
        if self.sets > MOST_SETS {
            self.doubt(Doubt::TooManySets { step: members.k }, &members.ego.distance);
            return None;
        }
        let mut all_touch = true;
        let (mut seen, mut gaps) = self.look(&members, follower);
        while members.k < self.scene.steps {
            self.record(members.k, &seen);
            let wanted = self.scene.actor.decide(&seen, &self.scene.observation_error).settled(members.symbols);
            if !(members.ego.speed.radius() < WIDEST_MPS && wanted.radius() < WIDEST_MPS) {
                self.doubt(Doubt::TooWide { step: members.k }, &members.ego.speed);
                return None;
            }
            if let (Some(follower), true) = (&follower, has_not_fired)
                && let Some((window, is_last)) = self.firing(&members, &wanted, follower)
            {
                let mut fired = members.clone();
                let follower = self.follower(window, &mut fired.symbols);
                all_touch &= self.travel(fired, Some(&follower), false)?;
                if is_last {
                    return Some(all_touch);
                }
            }
            let acts_mps2 = wanted.range();
            let [moving, stopped] = members.after_decision(&wanted, self.step, self.scene.decision_steps);
            let mut goes_on = None;
            for members in [stopped, moving].into_iter().flatten() {
                let (now_seen, now) = self.look(&members, follower);
                if self.compare(&members, &gaps, &now, acts_mps2, follower) {
                    self.tube_is_whole = false;
                } else if self.scene.stop_at_doubt && self.reached.doubt.is_some() {
                    return None;
                } else if let Some((members, ..)) = goes_on.replace((members, now_seen, now)) {
                    all_touch &= self.travel(members, follower, has_not_fired)?;
                }
            }
            match goes_on {
                Some(next) => (members, seen, gaps) = next,
                None => return Some(all_touch),
            }
        }
        self.record(members.k, &seen);
        Some(false)
    }

    fn record(&mut self, k: u32, seen: &[Form; OBSERVED]) {
        let (decision, ranges) = ((k / self.scene.decision_steps) as usize, seen.each_ref().map(Form::range));
        match self.tube.get_mut(decision) {
            Some(known) => *known = std::array::from_fn(|i| known[i].hull(ranges[i])),
            None => self.tube.push(ranges),
        }
    }

    /// What is observed, and the gaps ahead and behind.
    fn look(&self, members: &Members, follower: Option<&Braking>) -> ([Form; OBSERVED], [Form; 2]) {
        let Members { k, ego, .. } = members;
        let leader = self.leader.at(*k, self.step);
        let [ahead, behind] = &self.gaps;
        let ahead = ahead.clone().plus(&leader.distance).minus(&ego.distance);
        let (behind, follower) = match follower {
            Some(follower) => {
                let follower = follower.at(*k, self.step);
                (behind.clone().plus(&ego.distance).minus(&follower.distance), follower)
            }
            None => {
                let nobody = Seen { acceleration: Form::default(), ..ego.clone() };
                (Form::constant(Interval::point(self.scene.actor.empty_gap_m)), nobody)
            }
        };
        let gaps = [ahead.clone(), behind.clone()];
        let ego = ego.clone();
        let speeds = [leader.speed, ego.speed, follower.speed];
        let [v_l, v_e, v_r] = speeds;
        ([ahead, behind, v_l, v_e, v_r, leader.acceleration, ego.acceleration, follower.acceleration], gaps)
    }

    /// The instants of a decision interval at which the brake of a follower that has not fired may fire, if there are any, and
    /// whether it surely does.
    fn firing(&self, members: &Members, wanted: &Form, follower: &Braking) -> Option<([f64; 2], bool)> {
        let theta = Interval::point(self.scene.follower_ttc_s?);
        let mut first = None;
        for j in 0..self.scene.decision_steps {
            let instant = members.k + j;
            let ego = members.moved(wanted, self.step, j);
            let mut guard = self.gaps[1].clone().plus(&ego.distance);
            guard.add(&ego.speed, theta);
            guard.add(&follower.speed, -(theta + Interval::point(f64::from(instant)) * self.step));
            let guard = guard.range();
            let instant = f64::from(instant);
            if guard.low() < 0.0 {
                let first = *first.get_or_insert(instant);
                if guard.high() < 0.0 {
                    return Some(([first, instant], true));
                }
            }
        }
        let last = f64::from(members.k + self.scene.decision_steps - 1);
        first.map(|first| ([first, last], false))
    }

    /// Takes note of the gaps over a decision interval; whether all members surely touch.
    fn compare(
        &mut self,
        members: &Members,
        before: &[Form; 2],
        now: &[Form; 2],
        acts_mps2: Interval,
        follower: Option<&Braking>,
    ) -> bool {
        let interval = Interval::point(f64::from(self.scene.decision_steps)) * self.step;
        let eighth = interval.sqr() * Interval::point(0.125);
        let braking = (-acts_mps2).max(Interval::ZERO);
        let mut closing = vec![braking];
        // Nobody is behind the ego, or somebody who brakes at most as hard as stated.
        closing.extend(follower.map(|follower| acts_mps2.max(Interval::ZERO) + follower.rate.range()));
        let mut touches = false;
        for (pair, m) in closing.into_iter().enumerate() {
            let least = before[pair].range().min(now[pair].range());
            let gap_m = (least - m * eighth).low();
            self.reached.gaps_m[pair] = self.reached.gaps_m[pair].min(gap_m);
            if gap_m <= 0.0 {
                self.doubt(Doubt::MayTouch { pair, step: members.k, gap_m }, &now[pair]);
            }
            touches |= now[pair].range().high() < 0.0;
        }
        touches
    }

    /// Takes note of the first doubt, and of how much each dimension has to do with it.
    fn doubt(&mut self, doubt: Doubt, about: &Form) {
        if self.reached.doubt.is_none() {
            self.reached.doubt = Some(doubt);
            let terms = about.terms();
            self.reached.sensitivity = std::array::from_fn(|i| terms.get(i).copied().unwrap_or(0.0).abs());
        }
    }
}

impl Members {
    /// All egos `steps` steps into a decision interval; what they accelerate at is left open.
    fn moved(&self, wanted: &Form, step: Interval, steps: u32) -> Seen {
        let time = Interval::point(f64::from(steps)) * step;
        let half = Interval::point(0.5);
        let Seen { distance, speed, .. } = &self.ego;
        if steps == 0 || speed.is_zero() && wanted.range().high() <= 0.0 {
            return Seen { acceleration: Form::default(), ..self.ego.clone() };
        }
        let mut free = speed.clone();
        free.add(wanted, time);
        let mut travelled = distance.clone();
        let (least, most) = (free.range().low(), free.range().high());
        if most <= 0.0 {
            let farthest = speed.range().max(Interval::ZERO) * time * half;
            travelled.shift(farthest.hull(Interval::ZERO));
            return Seen { distance: travelled, speed: Form::default(), acceleration: wanted.clone() };
        }
        travelled.add(speed, time);
        travelled.add(wanted, time.sqr() * half);
        if least < 0.0 {
            let reversed = Interval::point(-least) * time * half;
            travelled.shift(reversed.hull(Interval::ZERO));
        }
        Seen { distance: travelled, speed: rectified(&free), acceleration: wanted.clone() }
    }

    /// The egos at the next decision: those that move at the beginning of the last step before it, and those that stand.
    fn after_decision(&self, wanted: &Form, step: Interval, decision_steps: u32) -> [Option<Self>; 2] {
        let Seen { distance, speed, .. } = &self.ego;
        let [until_last, time] =
            [decision_steps - 1, decision_steps].map(|steps| Interval::point(f64::from(steps)) * step);
        let half = Interval::point(0.5);
        let free = |time: Interval| speed.clone().plus(&wanted.scaled(time));
        let (before_last, acts) = (free(until_last).range(), wanted.range());
        let braking = (-acts).max(Interval::ZERO);
        if speed.is_zero() {
            // Who stands accelerates at max(0, u).
            let acceleration = rectified(wanted);
            let travelled = distance.clone().plus(&acceleration.scaled(time.sqr() * half));
            return [Some(self.next(travelled, acceleration.scaled(time), acceleration, decision_steps)), None];
        }
        let moving = || {
            // Who stops in the last step would have reversed at no more than b h.
            let end = free(time);
            let reversing = (-end.range()).max(Interval::ZERO).min(braking * step);
            let reversing = reversing.hull(Interval::ZERO);
            let mut travelled = distance.clone().plus(&speed.scaled(time)).plus(&wanted.scaled(time.sqr() * half));
            travelled.shift((reversing * step * half).hull(Interval::ZERO));
            let mut speed = end;
            speed.shift(reversing);
            self.next(travelled, speed, wanted.clone(), decision_steps)
        };
        let stopped = || {
            // From at most b s within at most s seconds.
            let speed_mps = speed.range().max(Interval::ZERO).min(braking * until_last);
            let mut travelled = distance.clone();
            travelled.shift((speed_mps * until_last * half).hull(Interval::ZERO));
            self.next(travelled, Form::default(), Form::default(), decision_steps)
        };
        let may_move = before_last.high() > 0.0 || acts.high() > 0.0;
        let may_stand = before_last.low() <= 0.0 && acts.low() <= 0.0;
        [may_move.then(moving), may_stand.then(stopped)]
    }

    fn next(&self, distance: Form, speed: Form, acceleration: Form, decision_steps: u32) -> Self {
        let used = acceleration.terms().len().max(speed.terms().len()).max(distance.terms().len());
        let mut symbols = self.symbols.max(used);
        let mut settle = |form: Form| {
            let settled = form.settled(symbols);
            symbols = symbols.max(settled.terms().len());
            settled
        };
        let ego = Seen { distance: settle(distance), speed: settle(speed), acceleration };
        Self { k: self.k + decision_steps, ego, symbols }
    }
}
