//! Check of a plan, step by step.
//!
//! Times t_k = k h. All positions are relative to the own front bumper at the start; gaps have the lengths taken out.
//! `x` is the own position. Bounds of the other vehicles:
//!
//! ```text
//! leader      at least U(t) = g + d(w, -c, t)                         (kernel, fact 2)
//! follower    before its brake fires: at most F(t) = -r + d(u, e, t), at least S(t) = -r' + d(u', -e, t)
//!             from a position p and speed v on, at which the brake fires, after a time s: at most
//!             L(s) = p + d(v, e, min(s, ρ)) + d(v + e ρ, -bF, s - ρ)
//! ```
//!
//! with the distance d of [`motion`](crate::motion), the lowest g, w, r, u' and the highest u, r' that the observation
//! allows.
//!
//! **Between steps.** The distance of two vehicles has a second derivative within R, the sum of the largest
//! accelerations. So within a step it is at least its smaller end less R h²/8: gaps at steps must exceed this.
//!
//! **Firing at step k**: x - y < T (u - v) for the follower's position y and speed u, and not at step k - 1. Hence
//!
//! ```text
//! S + q(u - S') <= y <= F - q(F' - u)    and    y <= Y(u) = x_{k-1} - T (u - e h - v_{k-1}) + (u + e h/2) h,
//! low <= u <= high,  low = max(S', v_k + (x_k - F)/T).
//! ```
//!
//! The follower at u = F' - D has not accelerated all the time: its speed at s is at most the smaller one of u_0 + e s
//! and u + e (t - s). This integrates to F - q(D) with q(D) = D²/4e for D <= 2 e t, and D t - e t² otherwise; the
//! latter is never larger. In the same way it is at least at S + q(u - S'). `high` is the largest speed with
//! S + q(u - S') <= Y(u). Y falls with u at the rate T - h.
//!
//! L increases with p and v. Along Y it is convex in u. So for any number k* <= high two followers cover all: that at
//! Y(high) with speed `high`, and that at max(F - q(F' - k*), Y(k*)) with speed k*; at Y(k*) alone if k* <= low.
//!
//! **Waiting at step k**: T (u - v) <= x - y =: r, and so r' >= -r/T at first. Until the next step the gap is at least
//! r (1 - h/T) - (e + d) h²/2 if the own vehicle brakes by at most d.
//!
//! **Standstill from step k on.** A follower that fires later was not slower than the creep speed a step before. Its
//! speed is at most √(F'² + 2 e (x - S)), and it is at or behind Y(u). The leader is not nearer later. So one test with
//! two speeds covers all later steps.

use super::{
    CREEP_SPEED_MPS, CoveredFollowers, FollowerCue, KnownPhase, MAX_QUANTITY, NOTICED_BRAKE_MPS2,
    TwoSidedClaim, TwoSidedStart,
};
use crate::claim::ConstantPiece;
use crate::interval::Interval;
use crate::motion::{distance_and_speed_after, expand_pieces};
use crate::rejection::Rejection;
use crate::work::{OPS_PER_INTERVAL_OP, OpBudget};

/// Maximum number of steps of a course.
const MAX_STEPS: usize = 20_000;

/// Operations for each step of a course that is compared with a neighbour.
const OPS_PER_STEP: u64 = 40 * OPS_PER_INTERVAL_OP;

/// Bounds of position and speed at a step.
#[derive(Debug, Clone, Copy)]
struct StepBounds {
    position_m: Interval,
    speed_mps: Interval,
}

/// Own motion at all steps until standstill.
struct Course(Vec<StepBounds>);

impl Course {
    fn at(&self, step: usize) -> StepBounds {
        // A course begins with its first state.
        self.0
            .get(step)
            .or(self.0.last())
            .copied()
            .unwrap_or(StepBounds {
                position_m: Interval::ENTIRE,
                speed_mps: Interval::ENTIRE,
            })
    }

    /// Returns the last step, from which on the vehicle stands.
    fn end(&self) -> usize {
        self.0.len().saturating_sub(1)
    }
}

/// The own motion before and after the follower's brake fires: `before` until `switch`, then `after`.
struct OwnMotion<'c> {
    before: &'c Course,
    switch: usize,
    after: Option<&'c Course>,
}

impl OwnMotion<'_> {
    fn at(&self, step: usize) -> StepBounds {
        match (self.after, step.checked_sub(self.switch)) {
            (Some(after), Some(since)) => after.at(since),
            _ => self.before.at(step),
        }
    }

    fn end(&self) -> usize {
        self.after
            .map_or(self.before.end(), |after| self.switch + after.end())
    }
}

struct PlanCheck<'c> {
    claim: &'c TwoSidedClaim,
    start: &'c TwoSidedStart,
    work: &'c OpBudget,
    step: Interval,
    /// Own motion until the follower's brake fires.
    course: Course,
}

/// Checks that the plan avoids a collision on both sides.
pub(super) fn check(
    claim: &TwoSidedClaim,
    start: &TwoSidedStart,
    work: &OpBudget,
) -> Result<(), Rejection> {
    check_form(claim, start)?;
    let speed_mps = around(start.ego_speed_mps, claim.observation_error.ego_speed_mps);
    let mut check = PlanCheck {
        claim,
        start,
        work,
        step: Interval::point(claim.ego.step_s),
        course: Course(Vec::new()),
    };
    let first = StepBounds {
        position_m: Interval::ZERO,
        speed_mps,
    };
    check.course = check.course_from(first, expand_pieces(&start.plan.commands))?;
    match (claim.follower, start.plan.after_firing.is_some()) {
        (Some(class), true) => check.check_waiting(class),
        (None, true) => Err(Rejection::invalid(
            "after_firing",
            "must be absent without a follower",
        )),
        (follower, false) => {
            let whole = check.whole_course();
            check.check_ahead(&whole)?;
            follower.map_or(Ok(()), |class| check.check_fixed(class))
        }
    }
}

/// Checks ranges, and that the parts of the start and the plan belong together.
fn check_form(claim: &TwoSidedClaim, start: &TwoSidedStart) -> Result<(), Rejection> {
    let is_bounded = |value: f64| (0.0..=MAX_QUANTITY).contains(&value);
    let mut observed = vec![start.ego_speed_mps];
    observed.extend(
        [start.leader, start.follower]
            .iter()
            .flatten()
            .flat_map(|seen| [seen.gap_m, seen.speed_mps]),
    );
    let left_s = match start.phase {
        KnownPhase::BrakesWithinS(left_s) => left_s,
        _ => 0.0,
    };
    if !observed.into_iter().chain([left_s]).all(is_bounded) {
        return Err(Rejection::invalid("start", "is out of range"));
    }
    if start.follower.is_some() != claim.follower.is_some() {
        return Err(Rejection::invalid(
            "start.follower",
            "must be present exactly with a class",
        ));
    }
    let ego = &claim.ego;
    if u64::from(ego.delay_steps) > MAX_STEPS as u64 {
        return Err(Rejection::invalid("ego.delay_steps", "is out of range"));
    }
    let within = |command: &f64| (-ego.brake_mps2..=ego.accel_mps2).contains(command);
    let after = start.plan.after_firing.as_ref();
    let commands = start.plan.commands.iter().map(|piece| &piece.1);
    if !commands
        .chain(after.map(|after| &after.accel_mps2))
        .all(within)
    {
        return Err(Rejection::invalid(
            "start.plan",
            "exceeds the limits of the vehicle",
        ));
    }
    let steps =
        |pieces: &[ConstantPiece<f64>]| pieces.iter().map(|piece| u64::from(piece.0)).sum::<u64>();
    let most = after.and_then(|after| after.steps.iter().map(|piece| piece.1).max());
    if steps(&start.plan.commands) > MAX_STEPS as u64
        || u64::from(most.unwrap_or(0)) > MAX_STEPS as u64
    {
        return Err(Rejection::invalid("start.plan", "has too many steps"));
    }
    let observes = claim.observation_error.shows_firing() && start.phase == KnownPhase::Waiting;
    match after {
        Some(after) if after.steps.is_empty() => {
            Err(Rejection::invalid("after_firing.steps", "is empty"))
        }
        Some(_) if !observes => Err(Rejection::invalid(
            "after_firing",
            "must be absent if errors hide the firing, or it has occurred",
        )),
        _ => Ok(()),
    }
}

/// Returns the values within an error, without negative ones.
fn around(value: f64, error: f64) -> Interval {
    (Interval::point(value) + Interval::around_zero(error)).max(Interval::ZERO)
}

/// Returns the lower end as a number.
fn low(value: Interval) -> Interval {
    Interval::point(value.low())
}

/// Returns the upper end as a number.
fn high(value: Interval) -> Interval {
    Interval::point(value.high())
}

impl PlanCheck<'_> {
    fn time(&self, steps: usize) -> Interval {
        Interval::point(steps as f64) * self.step
    }

    /// Returns the own motion with these commands and full braking afterwards, until standstill.
    fn course_from(
        &self,
        first: StepBounds,
        commands: impl Iterator<Item = f64>,
    ) -> Result<Course, Rejection> {
        let brake_mps2 = self.claim.ego.brake_mps2;
        let mut commands = commands.fuse();
        let mut at = first;
        let mut course = vec![at];
        loop {
            let command = commands.next();
            let stands = at.speed_mps.high() <= 0.0;
            if stands && command.is_none() {
                return Ok(Course(course));
            }
            self.work.charge_or_reject(OPS_PER_STEP)?;
            at = self.after_step(at, command.unwrap_or(-brake_mps2));
            course.push(at);
            if course.len() > 3 * MAX_STEPS {
                return Err(Rejection::invalid(
                    "start.plan",
                    "does not stop the vehicle in time",
                ));
            }
        }
    }

    fn after_step(&self, at: StepBounds, command: f64) -> StepBounds {
        // A standing vehicle is held until a positive command.
        if at.speed_mps.high() <= 0.0 && command <= 0.0 {
            return at;
        }
        let noise = self.claim.ego.noise_mps2;
        let acceleration = Interval::point(command) + Interval::around_zero(noise);
        let (covered_m, speed_mps) =
            distance_and_speed_after(at.speed_mps, acceleration, self.step);
        StepBounds {
            position_m: at.position_m + covered_m.max(Interval::ZERO),
            speed_mps,
        }
    }

    fn whole_course(&self) -> OwnMotion<'_> {
        OwnMotion {
            before: &self.course,
            switch: usize::MAX,
            after: None,
        }
    }

    /// Returns the gap that must remain at steps, with a neighbour of this largest acceleration.
    fn slack_m(&self, other_mps2: f64) -> f64 {
        let ego = &self.claim.ego;
        let own =
            Interval::point(ego.brake_mps2.max(ego.accel_mps2)) + Interval::point(ego.noise_mps2);
        let relative = own + Interval::point(other_mps2);
        (relative * self.step.sqr() * Interval::point(0.125)).high()
    }

    /// Condition A: the leader is never reached.
    fn check_ahead(&self, own: &OwnMotion<'_>) -> Result<(), Rejection> {
        let Some(leader) = self.start.leader else {
            return Ok(());
        };
        let errors = &self.claim.observation_error;
        let gap_m = low(Interval::point(leader.gap_m) - Interval::point(errors.gap_ahead_m));
        let speed_mps = low(around(leader.speed_mps, errors.leader_speed_mps));
        let limit_mps2 = self.claim.leader_brakes_at_most_mps2;
        let slack_m = self.slack_m(limit_mps2);
        for step in 0..=own.end() {
            self.work.charge_or_reject(OPS_PER_STEP)?;
            let (covered_m, _) =
                distance_and_speed_after(speed_mps, Interval::point(-limit_mps2), self.time(step));
            let left_m = (gap_m + covered_m - own.at(step).position_m).low();
            if left_m <= slack_m {
                return Err(may_collide(0, step, left_m - slack_m));
            }
        }
        Ok(())
    }

    /// Condition B: a follower whose brake fires at step `first` in this state stays behind. It brakes after `left`.
    fn check_behind(
        &self,
        class: CoveredFollowers,
        own: &OwnMotion<'_>,
        first: usize,
        (fires, left): (StepBounds, Interval),
    ) -> Result<(), Rejection> {
        let slack_m = self.slack_m(class.brake_mps2.max(class.drift_mps2));
        let [drift, brake] = [class.drift_mps2, -class.brake_mps2].map(Interval::point);
        let end = own.end().max(first);
        for step in first..=end {
            self.work.charge_or_reject(OPS_PER_STEP)?;
            let since = (self.time(step) - self.time(first)).max(Interval::ZERO);
            // Once the ego vehicle stands, only the follower's last position counts.
            let (coasts, brakes) = if step == end {
                (left, None)
            } else {
                (since.min(left), Some((since - left).max(Interval::ZERO)))
            };
            let (coasted_m, speed_mps) = distance_and_speed_after(fires.speed_mps, drift, coasts);
            let braked_m = match brakes {
                Some(brakes) => distance_and_speed_after(speed_mps, brake, brakes).0,
                None => speed_mps.sqr().over(-(brake + brake)),
            };
            let gap_m = own.at(step).position_m - (fires.position_m + coasted_m + braked_m);
            if gap_m.low() <= slack_m {
                return Err(may_collide(1, step, gap_m.low() - slack_m));
            }
        }
        Ok(())
    }

    /// Returns the farthest and the least far motion of any follower whose brake has not fired.
    fn unfired(&self, class: CoveredFollowers, step: usize) -> [StepBounds; 2] {
        let errors = &self.claim.observation_error;
        let [gap, speed] = self
            .start
            .follower
            .map_or([0.0; 2], |seen| [seen.gap_m, seen.speed_mps]);
        let gap_m = Interval::point(gap) + Interval::around_zero(errors.gap_behind_m);
        let speed_mps = around(speed, errors.follower_speed_mps);
        let bound = |gap_m: Interval, speed_mps: Interval, drift_mps2: f64| {
            let drift = Interval::point(drift_mps2);
            let (covered_m, speed_mps) =
                distance_and_speed_after(speed_mps, drift, self.time(step));
            StepBounds {
                position_m: covered_m - gap_m,
                speed_mps,
            }
        };
        [
            bound(low(gap_m), high(speed_mps), class.drift_mps2),
            bound(high(gap_m), low(speed_mps), -class.drift_mps2),
        ]
    }

    /// Checks a plan that depends on no observation.
    fn check_fixed(&self, class: CoveredFollowers) -> Result<(), Rejection> {
        let [farthest, _] = self.unfired(class, 0);
        let reaction = Interval::point(class.reaction_s);
        let whole = self.whole_course();
        match (class.brakes_when, self.start.phase) {
            (FollowerCue::EgoBrakes, phase) => {
                let noticed = self.noticed_from();
                let left = match phase {
                    KnownPhase::BrakesWithinS(left_s) if noticed == 0 => {
                        Interval::point(left_s).min(reaction)
                    }
                    _ => self.time(noticed) + reaction,
                };
                self.check_behind(class, &whole, 0, (farthest, left))
            }
            (FollowerCue::TtcBelowS(_), KnownPhase::BrakesWithinS(left_s)) => {
                self.check_behind(class, &whole, 0, (farthest, Interval::point(left_s)))
            }
            (FollowerCue::TtcBelowS(_), KnownPhase::Unknown) => {
                self.check_behind(class, &whole, 0, (farthest, reaction))?;
                self.check_waiting(class)
            }
            (FollowerCue::TtcBelowS(_), KnownPhase::Waiting) => self.check_waiting(class),
        }
    }

    /// Returns the step from which on the ego vehicle brakes noticeably or stands. A step in which it comes to a stop
    /// with less braking does not count: it begins to stand at the end.
    fn noticed_from(&self) -> usize {
        let ego = &self.claim.ego;
        let full = std::iter::repeat(-ego.brake_mps2);
        let commands = expand_pieces(&self.start.plan.commands).chain(full);
        let unnoticed = commands
            .take(self.course.end())
            .enumerate()
            .filter(|&(step, command)| {
                let most = Interval::point(command) + Interval::point(ego.noise_mps2);
                let stands = [step, step + 1].map(|at| self.course.at(at).speed_mps.high() <= 0.0);
                most.high() > -NOTICED_BRAKE_MPS2 && stands != [true; 2]
            });
        unnoticed.last().map_or(0, |(step, _)| step + 1)
    }

    /// Checks a plan for a follower whose brake has not fired at the start, for each step at which it may fire.
    fn check_waiting(&self, class: CoveredFollowers) -> Result<(), Rejection> {
        let FollowerCue::TtcBelowS(ttc_s) = class.brakes_when else {
            return Err(Rejection::invalid(
                "after_firing",
                "must be absent for this class",
            ));
        };
        let waiting = WaitingCheck {
            check: self,
            class,
            ttc: Interval::point(ttc_s),
        };
        for step in 0..MAX_STEPS {
            if step > 0 {
                waiting.check_firing(step)?;
            }
            if waiting.all_have_fired(step) {
                return Ok(());
            }
            waiting.check_until_next(step)?;
            if waiting.check_rest(step)? {
                return Ok(());
            }
        }
        Err(Rejection::invalid(
            "start.plan",
            "waits too long for the follower",
        ))
    }
}

fn may_collide(front_vehicle: usize, step: usize, gap_m: f64) -> Rejection {
    Rejection::MayCollide {
        front_vehicle,
        step: u32::try_from(step).unwrap_or(u32::MAX),
        gap_m,
    }
}

/// Check for followers whose brake fires below a time to collision, and has not fired yet.
struct WaitingCheck<'c> {
    check: &'c PlanCheck<'c>,
    class: CoveredFollowers,
    ttc: Interval,
}

impl WaitingCheck<'_> {
    fn drift(&self) -> Interval {
        Interval::point(self.class.drift_mps2)
    }

    /// Returns the distance by which a follower misses the threshold; its brake fires if this is negative.
    fn spare_m(&self, step: usize, follower: StepBounds) -> Interval {
        let own = self.check.course.at(step);
        own.position_m - follower.position_m - self.ttc * (follower.speed_mps - own.speed_mps)
    }

    /// True if the brake of each follower of the class has fired, or it cannot be at the first step.
    fn all_have_fired(&self, step: usize) -> bool {
        let [_, slowest] = self.check.unfired(self.class, step);
        let is_known_to_wait = step == 0 && self.check.start.phase == KnownPhase::Waiting;
        !is_known_to_wait && self.spare_m(step, slowest).high() < 0.0
    }

    /// Returns Y(u) for the own motion a step before.
    fn unfired_position_m(&self, before: StepBounds, speed: Interval) -> Interval {
        let h = self.check.step;
        let drift_mps = self.drift() * h;
        before.position_m - self.ttc * (speed - drift_mps - before.speed_mps)
            + (speed + drift_mps * Interval::point(0.5)) * h
    }

    /// Returns the speed for which Y(u) is this position.
    fn unfired_speed_mps(&self, before: StepBounds, position_m: Interval) -> Interval {
        let at_rest_m = self.unfired_position_m(before, Interval::ZERO);
        (at_rest_m - position_m).over(self.ttc - self.check.step)
    }

    /// Returns q(D), or a lower bound.
    fn deficit_m(&self, change: Interval, time: Interval) -> f64 {
        let change = change.max(Interval::ZERO);
        let gained = self.drift() * time;
        let slow_m = ((change - gained) * time).low();
        let quick_m = if change.high() <= (gained + gained).low() {
            (change.sqr() * Interval::point(0.25))
                .over(self.drift())
                .low()
        } else {
            0.0
        };
        slow_m.max(quick_m).max(0.0)
    }

    /// Returns an upper bound of the D >= 0 with (T - h) D + q(D) = `excess`.
    fn speed_change_mps(&self, excess: Interval, time: Interval) -> f64 {
        let excess = excess.max(Interval::ZERO);
        let rate = self.ttc - self.check.step;
        let slow = (excess + self.drift() * time.sqr())
            .over(rate + time)
            .high();
        let root = (rate.sqr() + excess.over(self.drift())).sqrt();
        let quick = (excess + excess).over(rate + root).high();
        let limit = (Interval::point(2.0) * self.drift() * time).low();
        if quick <= limit {
            quick.min(slow)
        } else {
            slow
        }
    }

    /// Returns followers that cover all whose brake fires at a step and not before.
    fn firing_followers(&self, step: usize) -> Vec<StepBounds> {
        let [farthest, slowest] = self.check.unfired(self.class, step);
        if self.spare_m(step, farthest).low() >= 0.0 {
            return Vec::new();
        }
        let time = self.check.time(step);
        let own = self.check.course.at(step);
        let before = self.check.course.at(step.saturating_sub(1));
        let line_m = |speed: Interval| self.unfired_position_m(before, speed);
        let least_excess = line_m(low(slowest.speed_mps)) - low(slowest.position_m);
        let threshold = own.speed_mps + (own.position_m - farthest.position_m).over(self.ttc);
        let least = slowest.speed_mps.max(threshold).low();
        let change = self.speed_change_mps(least_excess, time);
        let most = low(slowest.speed_mps) + Interval::point(change);
        let most = most.min(farthest.speed_mps).high();
        if most < least || least_excess.high() < 0.0 {
            return Vec::new();
        }
        let fastest = high(farthest.speed_mps);
        // Every kink is sound; that of the higher line is the tightest, since the positions on the line are at its
        // upper end.
        let excess = high(farthest.position_m) - high(line_m(fastest));
        let kink = farthest.speed_mps.high() - self.speed_change_mps(excess, time);
        let kink = kink.max(least).min(most);
        let farthest_m = |speed: f64| {
            let deficit = self.deficit_m(fastest - Interval::point(speed), time);
            (high(farthest.position_m) - Interval::point(deficit)).high()
        };
        let at = |speed: f64, position_m: f64| StepBounds {
            position_m: Interval::point(position_m),
            speed_mps: Interval::point(speed),
        };
        if kink >= most {
            // The step before limits no follower.
            return vec![at(most, farthest_m(most))];
        }
        let on_line_m = |speed: f64| line_m(Interval::point(speed)).high();
        let kink_m = if kink > least {
            on_line_m(kink).max(farthest_m(kink))
        } else {
            on_line_m(kink)
        };
        vec![at(kink, kink_m), at(most, on_line_m(most))]
    }

    /// Returns the step at which a plan that observes the firing changes, and the motion afterwards.
    fn switch(&self, step: usize) -> Result<Option<(usize, Course)>, Rejection> {
        let check = self.check;
        let Some(after) = &check.start.plan.after_firing else {
            return Ok(None);
        };
        let switch = step + check.claim.ego.delay_steps as usize;
        let steps = expand_pieces(&after.steps).nth(step.saturating_sub(1));
        let steps = steps
            .or(after.steps.last().map(|piece| piece.1))
            .unwrap_or(0);
        let commands = std::iter::repeat_n(after.accel_mps2, steps as usize);
        let course = check.course_from(check.course.at(switch), commands)?;
        Ok(Some((switch, course)))
    }

    /// Checks the plan with followers whose brake fires at a step.
    fn check_firing(&self, step: usize) -> Result<(), Rejection> {
        let followers = self.firing_followers(step);
        if followers.is_empty() {
            return Ok(());
        }
        self.check_with(step, followers)
    }

    fn check_with(&self, step: usize, followers: Vec<StepBounds>) -> Result<(), Rejection> {
        let check = self.check;
        let changed = self.switch(step)?;
        let branch = changed.as_ref().map_or_else(
            || check.whole_course(),
            |(switch, after)| OwnMotion {
                before: &check.course,
                switch: *switch,
                after: Some(after),
            },
        );
        if changed.is_some() {
            check.check_ahead(&branch)?;
        }
        let reaction = Interval::point(self.class.reaction_s);
        followers
            .into_iter()
            .try_for_each(|fires| check.check_behind(self.class, &branch, step, (fires, reaction)))
    }

    /// Checks that followers whose brake does not fire at a step stay behind until the next.
    fn check_until_next(&self, step: usize) -> Result<(), Rejection> {
        let check = self.check;
        check.work.charge_or_reject(OPS_PER_STEP)?;
        let drift_mps2 = self.class.drift_mps2;
        let gap_m = |step: usize| {
            check.course.at(step).position_m - check.unfired(self.class, step)[0].position_m
        };
        let ends_m = gap_m(step).low().min(gap_m(step + 1).low());
        if ends_m > check.slack_m(drift_mps2) {
            return Ok(());
        }
        let own = check.course.at(step);
        let slowest = low(check.unfired(self.class, step)[1].speed_mps);
        let least_mps = if own.speed_mps.high() <= 0.0 {
            slowest.max(Interval::point(CREEP_SPEED_MPS))
        } else {
            slowest
        };
        let least_m = gap_m(step).max(self.ttc * (least_mps - own.speed_mps));
        let ego = &check.claim.ego;
        let brakes = Interval::point(ego.brake_mps2) + Interval::point(ego.noise_mps2);
        let left_m = self.waiting_gap_m(least_m, brakes);
        if left_m > 0.0 {
            Ok(())
        } else {
            Err(may_collide(1, step, left_m))
        }
    }

    /// Returns a lower bound of the gap to a waiting follower until the next step.
    fn waiting_gap_m(&self, gap_m: Interval, brakes: Interval) -> f64 {
        let h = self.check.step;
        let relative = self.drift() + brakes;
        let kept_m = gap_m * (self.ttc - h).over(self.ttc);
        (kept_m - relative * h.sqr() * Interval::point(0.5)).low()
    }

    /// Returns true if the ego vehicle stands and the plan is safe with all followers whose brake fires later.
    fn check_rest(&self, step: usize) -> Result<bool, Rejection> {
        let check = self.check;
        let after = check.start.plan.after_firing.as_ref();
        let listed = after.map_or(0, |after| {
            let all = after
                .steps
                .iter()
                .map(|piece| piece.0 as usize)
                .sum::<usize>();
            all - after.steps.last().map_or(0, |piece| piece.0 as usize)
        });
        if step < check.course.end() || step <= listed {
            return Ok(false);
        }
        let own = check.course.at(step);
        let [farthest, slowest] = check.unfired(self.class, step);
        let reach_m = (own.position_m - slowest.position_m).max(Interval::ZERO);
        let fastest =
            (farthest.speed_mps.sqr() + Interval::point(2.0) * self.drift() * reach_m).sqrt();
        let most = high(fastest.min(self.unfired_speed_mps(own, slowest.position_m)));
        let creep = Interval::point(CREEP_SPEED_MPS);
        let least = low(creep - self.drift() * check.step);
        let waits_m = self.waiting_gap_m(self.ttc * creep, Interval::ZERO);
        let first_m = self.unfired_position_m(own, least).high();
        if !(waits_m > 0.0 && least.low() >= 0.0 && first_m <= own.position_m.low()) {
            return Ok(false);
        }
        // The follower may also wait for ever.
        let whole = check.whole_course();
        check.check_ahead(&whole)?;
        if most.high() < least.low() {
            return Ok(true);
        }
        let followers = [least, most].map(|speed_mps| StepBounds {
            position_m: high(self.unfired_position_m(own, speed_mps)),
            speed_mps,
        });
        match self.check_with(step, followers.to_vec()) {
            Ok(()) => Ok(true),
            Err(Rejection::MayCollide { .. }) => Ok(false),
            Err(other) => Err(other),
        }
    }
}
