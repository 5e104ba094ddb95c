//! A lane of vehicles as bodies: joint motion through a step, and impacts.

use super::lane::{Bodies, LaneInterval, LaneState};
use super::motion::{Motion, closest_gap_given_ends_m, first_collision, needs_collision_check};
use super::{AfterCollision, Collision, Impact};

const MAX_SHORT_LINE_VEHICLES: usize = 8;

/// The bodies of one run.
///
/// Impacts are perfectly inelastic: vehicles stay locked together and move as one body under their summed forces.
#[derive(Debug, Clone)]
pub(super) struct PlatoonState {
    pub(super) motion: Vec<Motion>,
    pub(super) length_m: Vec<f64>,
    pub(super) mass_kg: Vec<f64>,
    /// Lane membership; a vehicle outside the lane does not collide.
    pub(super) lane: LaneState,
    /// True for each vehicle that is locked to its leader.
    pub(super) locked_to_front: Vec<bool>,
    /// Minimum gap ahead of each vehicle so far, in metres; infinite without a leader.
    pub(super) min_gap_m: Vec<f64>,
}

impl PlatoonState {
    /// Returns the gap ahead of a vehicle, in metres; `None` without a leader.
    pub(super) fn gap_m(&self, rear: usize) -> Option<f64> {
        self.lane
            .ahead(rear)
            .map(|front| self.gap_between_m(front, rear))
    }

    pub(super) fn gap_between_m(&self, front: usize, rear: usize) -> f64 {
        self.motion[front].position_m - self.length_m[front] - self.motion[rear].position_m
    }

    pub(super) fn is_locked(&self, index: usize) -> bool {
        self.locked_to_front
            .get(index)
            .is_some_and(|&sticks| sticks)
            || self.is_hit_from_behind(index)
    }

    pub(super) fn is_hit_from_behind(&self, index: usize) -> bool {
        self.lane
            .behind(index)
            .is_some_and(|rear| self.locked_to_front[rear])
    }

    pub(super) fn track_gaps(&mut self) {
        for rear in 0..self.motion.len() {
            if let Some(gap_m) = self.gap_m(rear) {
                self.min_gap_m[rear] = self.min_gap_m[rear].min(gap_m);
            }
        }
    }

    /// Advances all vehicles by `dt_s`, through any collisions, and appends these to `impacts`.
    ///
    /// Requires that locked vehicles share their acceleration. Returns the completed part of the step, in seconds.
    pub(super) fn advance(
        &mut self,
        from_s: f64,
        dt_s: f64,
        after_collision: AfterCollision,
        impacts: &mut Vec<Impact>,
    ) -> f64 {
        if self.advance_collision_free(dt_s) {
            return dt_s;
        }
        let mut done_s = 0.0;
        let mut intervals = self.lane_intervals(from_s, dt_s);
        while let Some((in_s, [front, rear])) =
            self.next_collision(intervals.as_deref(), dt_s - done_s)
        {
            let before_impact = self.lane_intervals(from_s + done_s, in_s);
            self.advance_and_track_gaps(before_impact, in_s);
            done_s += in_s;
            let impact = self.impact(from_s + done_s, front, rear);
            self.min_gap_m[rear] = 0.0;
            let common_mps = impact.common_speed_mps;
            let involved: Vec<usize> = (0..self.motion.len())
                .filter(|&vehicle| impact.involves(vehicle))
                .collect();
            impacts.push(impact);
            if after_collision == AfterCollision::Stop {
                return done_s;
            }
            self.locked_to_front[rear] = true;
            for vehicle in involved {
                self.motion[vehicle].speed_mps = common_mps;
                self.lane.cancel_changes(vehicle);
            }
            self.share_acceleration();
            intervals = self.lane_intervals(from_s + done_s, dt_s - done_s);
        }
        self.advance_and_track_gaps(intervals, dt_s - done_s);
        dt_s
    }

    /// Advances all vehicles by `dt_s`, bit-identical to [`Self::advance_and_track_gaps`], but faster. Returns false
    /// and changes nothing if there are lane changes or locked vehicles, or if a collision or the minimum gap may be
    /// inside the step.
    #[inline]
    fn advance_collision_free(&mut self, dt_s: f64) -> bool {
        let mut ends = [Motion {
            position_m: 0.0,
            speed_mps: 0.0,
            acceleration_mps2: 0.0,
        }; MAX_SHORT_LINE_VEHICLES];
        let Some(ends) = ends
            .get_mut(..self.motion.len())
            .filter(|_| self.lane.is_constant())
        else {
            return false;
        };
        for (end, motion) in ends.iter_mut().zip(&self.motion) {
            *end = motion.after(dt_s);
        }
        let mut gaps_m = [f64::INFINITY; MAX_SHORT_LINE_VEHICLES];
        let pairs = self
            .motion
            .windows(2)
            .zip(ends.windows(2))
            .zip(&self.length_m);
        for ((gap_m, &is_locked), ((now, end), length_m)) in gaps_m
            .iter_mut()
            .zip(&self.locked_to_front)
            .skip(1)
            .zip(pairs)
        {
            let [front, rear] = now else { continue };
            let [front_end, rear_end] = end else { continue };
            match collision_free_end_gap_m([front, rear], [front_end, rear_end], *length_m, dt_s) {
                Some(end_m) if !is_locked => *gap_m = end_m,
                _ => return false,
            }
        }
        for (min_gap_m, gap_m) in self.min_gap_m.iter_mut().zip(gaps_m) {
            // Plain comparison: `f64::min` also handles NaN, which cannot occur here.
            if gap_m < *min_gap_m {
                *min_gap_m = gap_m;
            }
        }
        self.motion.copy_from_slice(ends);
        true
    }

    fn bodies(&self) -> Bodies<'_> {
        Bodies {
            motion: &self.motion,
            length_m: &self.length_m,
        }
    }

    fn lane_intervals(&self, now_s: f64, within_s: f64) -> Option<Vec<LaneInterval>> {
        (!self.lane.has_no_pending_changes())
            .then(|| self.lane.intervals(self.bodies(), now_s, within_s))
    }

    /// Returns the earliest, foremost collision within `within_s` seconds: time, front and rear vehicle.
    fn next_collision(
        &self,
        intervals: Option<&[LaneInterval]>,
        within_s: f64,
    ) -> Option<(f64, [usize; 2])> {
        match intervals {
            None => self.first_collision_between(&self.lane, [0.0, within_s]),
            Some(intervals) => intervals.iter().find_map(|interval| {
                self.first_collision_between(&interval.lane, [interval.from_s, interval.to_s])
            }),
        }
    }

    /// Returns the earliest collision between two instants without lane changes between them.
    fn first_collision_between(
        &self,
        lane: &LaneState,
        [from_s, to_s]: [f64; 2],
    ) -> Option<(f64, [usize; 2])> {
        let within_s = to_s - from_s;
        let mut first: Option<(f64, [usize; 2])> = None;
        let mut before: Option<(usize, Motion, Motion)> = None;
        for rear in 0..self.motion.len() {
            if !lane.contains(rear) {
                continue;
            }
            let behind = self.motion_after(rear, from_s);
            let behind_end = behind.after(within_s);
            if let Some((index, front, front_end)) = before
                && !self.locked_to_front[rear]
            {
                let behind_mps = [behind.speed_mps, behind_end.speed_mps];
                let closing_mps = [
                    behind_mps[0] - front.speed_mps,
                    behind_mps[1] - front_end.speed_mps,
                ];
                let length_m = self.length_m[index];
                let gap_m = front.position_m - length_m - behind.position_m;
                if needs_collision_check(gap_m, behind_mps, closing_mps, within_s)
                    && let Some(in_s) = first_collision(front, behind, length_m, within_s)
                    && first.is_none_or(|(earliest_s, _)| from_s + in_s < earliest_s)
                {
                    first = Some((from_s + in_s, [index, rear]));
                }
            }
            before = Some((rear, behind, behind_end));
        }
        first
    }

    fn motion_after(&self, vehicle: usize, in_s: f64) -> Motion {
        if in_s == 0.0 {
            self.motion[vehicle]
        } else {
            self.motion[vehicle].after(in_s)
        }
    }

    fn advance_and_track_gaps(&mut self, intervals: Option<Vec<LaneInterval>>, dt_s: f64) {
        match intervals {
            None => self.advance_without_lane_changes(dt_s),
            Some(mut intervals) => {
                for (index, interval) in intervals.iter().enumerate() {
                    // A vehicle that enters and leaves at one instant was never in the lane.
                    if interval.from_s < interval.to_s || index + 1 == intervals.len() {
                        self.track_closest_gaps(&interval.lane, [interval.from_s, interval.to_s]);
                    }
                }
                self.motion
                    .iter_mut()
                    .for_each(|motion| *motion = motion.after(dt_s));
                if let Some(last) = intervals.pop() {
                    self.lane = last.lane;
                }
            }
        }
        self.snap_locked_vehicles();
    }

    /// Sets the gap between locked vehicles to exactly zero.
    fn snap_locked_vehicles(&mut self) {
        // An emergency brake that tests the sign of the gap must not depend on rounding.
        for rear in 1..self.motion.len() {
            if self.locked_to_front[rear]
                && let Some(front) = self.lane.ahead(rear)
            {
                self.motion[rear].position_m = self.motion[front].position_m - self.length_m[front];
            }
        }
    }

    fn advance_without_lane_changes(&mut self, dt_s: f64) {
        let mut before: Option<(usize, Motion, Motion)> = None;
        for rear in 0..self.motion.len() {
            let behind = self.motion[rear];
            let behind_end = behind.after(dt_s);
            self.motion[rear] = behind_end;
            if !self.lane.contains(rear) {
                continue;
            }
            if let Some((index, front, front_end)) = before
                && !self.locked_to_front[rear]
            {
                let closest_m = closest_gap_given_ends_m(
                    [front, behind],
                    [front_end, behind_end],
                    self.length_m[index],
                    dt_s,
                );
                self.min_gap_m[rear] = self.min_gap_m[rear].min(closest_m);
            }
            before = Some((rear, behind, behind_end));
        }
    }

    fn track_closest_gaps(&mut self, lane: &LaneState, [from_s, to_s]: [f64; 2]) {
        for rear in 0..self.motion.len() {
            let Some(front) = lane.ahead(rear).filter(|_| !self.locked_to_front[rear]) else {
                continue;
            };
            let ahead = self.motion_after(front, from_s);
            let behind = self.motion_after(rear, from_s);
            let length_m = self.length_m[front];
            let within_s = to_s - from_s;
            let ends = [ahead.after(within_s), behind.after(within_s)];
            let at_first_m = ahead.position_m - length_m - behind.position_m;
            let closest_m =
                closest_gap_given_ends_m([ahead, behind], ends, length_m, within_s).min(at_first_m);
            self.min_gap_m[rear] = self.min_gap_m[rear].min(closest_m);
        }
    }

    /// Returns the first and the last vehicle that move together with two colliding ones.
    fn locked_group(&self, front: usize, rear: usize) -> [usize; 2] {
        let mut first_involved = front;
        while let Some(ahead) = self
            .lane
            .ahead(first_involved)
            .filter(|_| self.locked_to_front[first_involved])
        {
            first_involved = ahead;
        }
        let mut last_involved = rear;
        while let Some(behind) = self
            .lane
            .behind(last_involved)
            .filter(|&behind| self.locked_to_front[behind])
        {
            last_involved = behind;
        }
        [first_involved, last_involved]
    }

    fn impact(&self, time_s: f64, front: usize, rear: usize) -> Impact {
        let [first_involved, last_involved] = self.locked_group(front, rear);
        let beside = (first_involved..=last_involved)
            .filter(|&vehicle| !self.lane.contains(vehicle))
            .collect();
        let involved =
            || (first_involved..=last_involved).filter(|&vehicle| self.lane.contains(vehicle));
        let mass_kg: f64 = involved().map(|i| self.mass_kg[i]).sum();
        let momentum: f64 = involved()
            .map(|i| self.mass_kg[i] * self.motion[i].speed_mps)
            .sum();
        let front_speed_mps = self.motion[front].speed_mps;
        let rear_speed_mps = self.motion[rear].speed_mps;
        let collision = Collision {
            time_s,
            front_vehicle: front,
            rear_vehicle: rear,
            front_speed_mps,
            rear_speed_mps,
            impact_speed_mps: rear_speed_mps - front_speed_mps,
        };
        Impact {
            collision,
            common_speed_mps: momentum / mass_kg,
            first_involved,
            last_involved,
            beside,
        }
    }

    /// Gives each locked group the acceleration of its summed forces.
    pub(super) fn share_acceleration(&mut self) {
        for first in (0..self.motion.len())
            .filter(|&vehicle| !self.locked_to_front[vehicle])
            .collect::<Vec<_>>()
        {
            let mut members = vec![first];
            while let Some(next) = self
                .lane
                .behind(members[members.len() - 1])
                .filter(|&behind| self.locked_to_front[behind])
            {
                members.push(next);
            }
            if members.len() > 1 {
                let mass_kg: f64 = members.iter().map(|&i| self.mass_kg[i]).sum();
                let force: f64 = members
                    .iter()
                    .map(|&i| self.mass_kg[i] * self.motion[i].acceleration_mps2)
                    .sum();
                let shared = force / mass_kg;
                let at_rest = self.motion[first].speed_mps == 0.0 && shared <= 0.0;
                for member in members {
                    self.motion[member].acceleration_mps2 = if at_rest { 0.0 } else { shared };
                }
            }
        }
    }
}

/// Returns the gap after `dt_s` seconds, in metres; `None` if the vehicles could collide or be closest inside the step.
#[inline]
fn collision_free_end_gap_m(
    now: [&Motion; 2],
    end: [&Motion; 2],
    length_m: f64,
    dt_s: f64,
) -> Option<f64> {
    let gap_m = |[front, rear]: [&Motion; 2]| front.position_m - length_m - rear.position_m;
    let closing_mps = [now, end].map(|[front, rear]| rear.speed_mps - front.speed_mps);
    let rear_mps = [now[1].speed_mps, end[1].speed_mps];
    (!needs_collision_check(gap_m(now), rear_mps, closing_mps, dt_s)).then(|| gap_m(end))
}

#[cfg(test)]
mod tests;
