//! Lane membership of vehicles, and planned lane changes.

use super::motion::{Motion, first_zero, gap_and_rates};
use super::trace::Track;
use crate::scenario::{LaneChange, VehicleSpec};

/// Tolerance around the end of a step, in seconds: sums of steps are rounded.
pub const TIME_TOLERANCE_S: f64 = 1e-9;

#[derive(Debug, Clone)]
pub(super) struct LaneState {
    vehicles: usize,
    /// `None` if no vehicle ever enters or leaves, as in most runs.
    changes: Option<Box<LaneChangeState>>,
}

#[derive(Debug, Clone)]
struct LaneChangeState {
    is_inside: Vec<bool>,
    /// Times of entry and exit of each vehicle, in seconds; infinite before its entry.
    in_lane_s: Vec<[f64; 2]>,
    planned: Vec<PlannedLaneChange>,
}

#[derive(Debug, Clone, Copy)]
struct PlannedLaneChange {
    vehicle: usize,
    is_entry: bool,
    trigger: LaneChange,
    /// True if the gap exceeded the trigger when it was first evaluated.
    was_gap_larger: Option<bool>,
}

/// Motion and length of vehicles, front to rear.
#[derive(Clone, Copy)]
pub(super) struct Bodies<'a> {
    pub(super) motion: &'a [Motion],
    pub(super) length_m: &'a [f64],
}

impl Bodies<'_> {
    /// True if two vehicles do not overlap, `in_s` seconds from now.
    fn are_apart(&self, front: usize, rear: usize, in_s: f64) -> bool {
        self.motion[front].after(in_s).position_m - self.length_m[front]
            > self.motion[rear].after(in_s).position_m
    }
}

/// A part of a step without lane changes.
pub(super) struct LaneInterval {
    /// Start, in seconds since the start of the step.
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) lane: LaneState,
}

impl LaneState {
    pub(super) fn with_all(vehicles: usize) -> Self {
        Self {
            vehicles,
            changes: None,
        }
    }

    pub(super) fn new(vehicles: &[VehicleSpec], bodies: Bodies<'_>) -> Self {
        if vehicles.iter().all(VehicleSpec::keeps_lane) {
            return Self::with_all(vehicles.len());
        }
        let inside = vehicles.iter().map(|spec| spec.enters.is_none());
        let planned_changes = vehicles.iter().enumerate().flat_map(|(vehicle, spec)| {
            [(false, spec.leaves), (true, spec.enters)]
                .into_iter()
                .filter_map(move |(is_entry, trigger)| {
                    Some(PlannedLaneChange {
                        vehicle,
                        is_entry,
                        trigger: trigger?,
                        was_gap_larger: None,
                    })
                })
        });
        let mut planned: Vec<PlannedLaneChange> = planned_changes.collect();
        // Exits come before simultaneous entries, for which they make room. Otherwise the order is front to rear.
        planned.sort_by_key(|planned| planned.is_entry);
        let changes = LaneChangeState {
            is_inside: inside.clone().collect(),
            in_lane_s: inside
                .map(|is_inside| match is_inside {
                    true => Track::THROUGHOUT_S,
                    false => [f64::INFINITY; 2],
                })
                .collect(),
            planned,
        };
        Self {
            vehicles: vehicles.len(),
            changes: Some(Box::new(changes)),
        }
        .after(bodies, 0.0, 0.0)
    }

    #[inline]
    pub(super) fn is_constant(&self) -> bool {
        self.changes.is_none()
    }

    #[inline]
    pub(super) fn has_no_pending_changes(&self) -> bool {
        self.changes
            .as_ref()
            .is_none_or(|changes| changes.planned.is_empty())
    }

    #[inline]
    pub(super) fn contains(&self, vehicle: usize) -> bool {
        match &self.changes {
            None => vehicle < self.vehicles,
            Some(changes) => changes.is_inside.get(vehicle).is_some_and(|&inside| inside),
        }
    }

    /// Returns the leader of a vehicle; `None` for the first, and for a vehicle outside the lane.
    pub(super) fn ahead(&self, vehicle: usize) -> Option<usize> {
        self.nearest_ahead(vehicle)
            .filter(|_| self.contains(vehicle))
    }

    /// Returns the follower of a vehicle; `None` for the last, and for a vehicle outside the lane.
    pub(super) fn behind(&self, vehicle: usize) -> Option<usize> {
        self.nearest_behind(vehicle)
            .filter(|_| self.contains(vehicle))
    }

    fn nearest_ahead(&self, vehicle: usize) -> Option<usize> {
        (0..vehicle).rev().find(|&front| self.contains(front))
    }

    fn nearest_behind(&self, vehicle: usize) -> Option<usize> {
        (vehicle + 1..self.vehicles).find(|&rear| self.contains(rear))
    }

    pub(super) fn in_lane_s(&self, vehicle: usize) -> [f64; 2] {
        let changed = self
            .changes
            .as_ref()
            .and_then(|changes| changes.in_lane_s.get(vehicle));
        changed.copied().unwrap_or(Track::THROUGHOUT_S)
    }

    pub(super) fn cancel_changes(&mut self, vehicle: usize) {
        if let Some(changes) = &mut self.changes {
            changes.planned.retain(|planned| planned.vehicle != vehicle);
        }
    }

    /// Splits the `within_s` seconds after `now_s` at lane changes. Requires that no collision occurs in them.
    pub(super) fn intervals(
        &self,
        bodies: Bodies<'_>,
        now_s: f64,
        within_s: f64,
    ) -> Vec<LaneInterval> {
        let mut lane = self.clone();
        let mut from_s = 0.0;
        let mut intervals = Vec::new();
        while let Some((to_s, changes)) = lane.next_changes(bodies, now_s, from_s, within_s) {
            intervals.push(LaneInterval {
                from_s,
                to_s,
                lane: lane.clone(),
            });
            lane.apply_changes(&changes, bodies, now_s, to_s);
            from_s = to_s;
        }
        intervals.push(LaneInterval {
            from_s,
            to_s: within_s,
            lane,
        });
        intervals
    }

    pub(super) fn after(&self, bodies: Bodies<'_>, now_s: f64, within_s: f64) -> Self {
        self.intervals(bodies, now_s, within_s)
            .pop()
            .map_or_else(|| self.clone(), |last| last.lane)
    }

    /// Returns time and indices of the next simultaneous changes between `from_s` and `within_s` seconds from now.
    ///
    /// Time-triggered changes are applied before neighbours are looked up: a vehicle that is in the lane for zero time
    /// is no neighbour. Simultaneous changes are applied together, so that their order has no effect.
    fn next_changes(
        &mut self,
        bodies: Bodies<'_>,
        now_s: f64,
        from_s: f64,
        within_s: f64,
    ) -> Option<(f64, Vec<usize>)> {
        let span_s = [from_s, within_s];
        let by_clock = self.earliest_changes(true, bodies, now_s, span_s);
        if by_clock.as_ref().is_some_and(|(in_s, _)| *in_s <= from_s) {
            return by_clock;
        }
        let by_distance = self.earliest_changes(false, bodies, now_s, span_s);
        match (by_clock, by_distance) {
            (Some(clock), Some(distance)) if distance.0 < clock.0 => Some(distance),
            (clock, distance) => clock.or(distance),
        }
    }

    /// Returns the earliest planned changes, either time-triggered or distance-triggered, and their time.
    fn earliest_changes(
        &mut self,
        by_clock: bool,
        bodies: Bodies<'_>,
        now_s: f64,
        span_s: [f64; 2],
    ) -> Option<(f64, Vec<usize>)> {
        let mut first: Option<(f64, Vec<usize>)> = None;
        for index in 0..self
            .changes
            .as_ref()
            .map_or(0, |changes| changes.planned.len())
        {
            let trigger = self.changes.as_ref()?.planned.get(index)?.trigger;
            if matches!(trigger, LaneChange::At(_)) != by_clock {
                continue;
            }
            let Some(in_s) = self.change_time_s(index, bodies, now_s, span_s) else {
                continue;
            };
            match &mut first {
                Some((first_s, indices)) if in_s == *first_s => indices.push(index),
                Some((first_s, _)) if in_s > *first_s => {}
                _ => first = Some((in_s, vec![index])),
            }
        }
        first
    }

    /// Returns the time of planned change `index`, between `from_s` and `to_s` seconds from now.
    fn change_time_s(
        &mut self,
        index: usize,
        bodies: Bodies<'_>,
        now_s: f64,
        span_s: [f64; 2],
    ) -> Option<f64> {
        let [from_s, to_s] = span_s;
        let change = *self.changes.as_ref()?.planned.get(index)?;
        if change.is_entry == self.contains(change.vehicle) {
            return None;
        }
        let trigger_m = match change.trigger {
            LaneChange::At(time_s) => {
                let in_s = time_s - now_s;
                return (in_s <= to_s + TIME_TOLERANCE_S).then(|| in_s.clamp(from_s, to_s));
            }
            LaneChange::Gap(trigger_m) => Some(trigger_m),
            LaneChange::TimeToCollision(_) => None,
        };
        let pair = self.pair_at(change, bodies, from_s)?;
        let mut was_gap_larger = change.was_gap_larger;
        if let Some(trigger_m) = trigger_m {
            let is_larger = was_gap_larger.unwrap_or(pair.gap_m() - trigger_m > 0.0);
            was_gap_larger = Some(is_larger);
            let planned = &mut self.changes.as_mut()?.planned;
            planned.get_mut(index)?.was_gap_larger = was_gap_larger;
        }
        let found_s = pair.trigger_time_s(change.trigger, was_gap_larger, to_s - from_s);
        found_s.map(|in_s| (from_s + in_s).min(to_s))
    }

    /// Returns the two vehicles whose gap triggers a change, as they are `in_s` seconds from now.
    fn pair_at(
        &self,
        change: PlannedLaneChange,
        bodies: Bodies<'_>,
        in_s: f64,
    ) -> Option<MovingPair> {
        let [front, rear] = match change.is_entry {
            true => [change.vehicle, self.nearest_behind(change.vehicle)?],
            false => [self.nearest_ahead(change.vehicle)?, change.vehicle],
        };
        Some(MovingPair {
            front: bodies.motion[front].after(in_s),
            rear: bodies.motion[rear].after(in_s),
            front_length_m: bodies.length_m[front],
        })
    }

    /// Applies planned changes at increasing indices. A vehicle without room to enter stays outside.
    fn apply_changes(&mut self, indices: &[usize], bodies: Bodies<'_>, now_s: f64, in_s: f64) {
        let Some(changes) = &mut self.changes else {
            return;
        };
        let due: Vec<PlannedLaneChange> = indices
            .iter()
            .filter_map(|&index| changes.planned.get(index).copied())
            .collect();
        for index in indices.iter().rev() {
            changes.planned.remove(*index);
        }
        for PlannedLaneChange {
            vehicle,
            is_entry: enters,
            trigger: when,
            ..
        } in due
        {
            let at_s = match when {
                LaneChange::At(time_s) if (time_s - now_s - in_s).abs() <= TIME_TOLERANCE_S => {
                    time_s
                }
                _ => now_s + in_s,
            };
            if enters && !self.has_room(vehicle, bodies, in_s) {
                self.cancel_changes(vehicle);
            } else if let Some(changes) = &mut self.changes {
                changes.is_inside[vehicle] = enters;
                changes.in_lane_s[vehicle][usize::from(!enters)] = at_s;
            }
        }
    }

    /// True if a vehicle overlaps neither neighbour in the lane, `in_s` seconds from now.
    fn has_room(&self, vehicle: usize, bodies: Bodies<'_>, in_s: f64) -> bool {
        self.nearest_ahead(vehicle)
            .is_none_or(|front| bodies.are_apart(front, vehicle, in_s))
            && self
                .nearest_behind(vehicle)
                .is_none_or(|rear| bodies.are_apart(vehicle, rear, in_s))
    }
}

/// Motion of two vehicles whose gap triggers a lane change.
struct MovingPair {
    front: Motion,
    rear: Motion,
    front_length_m: f64,
}

impl MovingPair {
    fn gap_m(&self) -> f64 {
        gap_and_rates(self.front, self.rear, self.front_length_m)[0]
    }

    /// Returns the time within `dt_s` at which the gap reaches a trigger, or the TTC falls to it, if it does.
    ///
    /// A gap is reached from above if `was_gap_larger`, otherwise from below.
    fn trigger_time_s(
        &self,
        trigger: LaneChange,
        was_gap_larger: Option<bool>,
        dt_s: f64,
    ) -> Option<f64> {
        match trigger {
            LaneChange::Gap(trigger_m) => {
                let sign = match was_gap_larger? {
                    true => 1.0,
                    false => -1.0,
                };
                self.first_zero(dt_s, |[gap_m, rate_mps, rate_mps2]| {
                    [
                        sign * (gap_m - trigger_m),
                        sign * rate_mps,
                        sign * rate_mps2,
                    ]
                })
            }
            LaneChange::TimeToCollision(trigger_s) if self.gap_m() > 0.0 => {
                self.first_zero(dt_s, |[gap_m, rate_mps, rate_mps2]| {
                    [
                        gap_m + trigger_s * rate_mps,
                        rate_mps + trigger_s * rate_mps2,
                        rate_mps2,
                    ]
                })
            }
            LaneChange::At(_) | LaneChange::TimeToCollision(_) => None,
        }
    }

    /// Returns the first time within `dt_s` at which a quantity is zero or less. `quantity` computes it and its two
    /// derivatives from those of the gap.
    fn first_zero(&self, dt_s: f64, quantity: impl Fn([f64; 3]) -> [f64; 3]) -> Option<f64> {
        first_zero(
            self.front,
            self.rear,
            |front, rear| quantity(gap_and_rates(front, rear, self.front_length_m)),
            dt_s,
        )
    }
}

#[cfg(test)]
mod tests;
