//! Lane membership of vehicles, and planned lane changes.

use super::motion::{Motion, first_zero};
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
        let in_lane_s = |inside: bool| {
            if inside {
                Track::THROUGHOUT_S
            } else {
                [f64::INFINITY; 2]
            }
        };
        let planned = vehicles.iter().enumerate().flat_map(|(vehicle, spec)| {
            let of = |enters: bool, when: Option<LaneChange>| {
                when.map(|when| PlannedLaneChange {
                    vehicle,
                    is_entry: enters,
                    trigger: when,
                    was_gap_larger: None,
                })
            };
            [of(false, spec.leaves), of(true, spec.enters)]
                .into_iter()
                .flatten()
        });
        let mut planned: Vec<PlannedLaneChange> = planned.collect();
        // Exits come before simultaneous entries, for which they make room. Otherwise the order is front to rear.
        planned.sort_by_key(|planned| planned.is_entry);
        let changes = LaneChangeState {
            is_inside: inside.clone().collect(),
            in_lane_s: inside.map(in_lane_s).collect(),
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
        let (mut lane, mut from_s, mut stints) = (self.clone(), 0.0, Vec::new());
        while let Some((to_s, places)) = lane.next_changes(bodies, now_s, from_s, within_s) {
            stints.push(LaneInterval {
                from_s,
                to_s,
                lane: lane.clone(),
            });
            lane.apply_changes(&places, bodies, now_s, to_s);
            from_s = to_s;
        }
        stints.push(LaneInterval {
            from_s,
            to_s: within_s,
            lane,
        });
        stints
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
        for place in 0..self
            .changes
            .as_ref()
            .map_or(0, |changes| changes.planned.len())
        {
            let when = self.changes.as_ref()?.planned.get(place)?.trigger;
            if matches!(when, LaneChange::At(_)) != by_clock {
                continue;
            }
            let Some(in_s) = self.change_time_s(place, bodies, now_s, span_s) else {
                continue;
            };
            match &mut first {
                Some((first_s, places)) if in_s == *first_s => places.push(place),
                Some((first_s, _)) if in_s > *first_s => {}
                _ => first = Some((in_s, vec![place])),
            }
        }
        first
    }

    /// Returns the time of a planned change, between `from_s` and `to_s` seconds from now.
    fn change_time_s(
        &mut self,
        place: usize,
        bodies: Bodies<'_>,
        now_s: f64,
        span_s: [f64; 2],
    ) -> Option<f64> {
        let [from_s, to_s] = span_s;
        let PlannedLaneChange {
            vehicle,
            is_entry: enters,
            trigger: when,
            was_gap_larger: was_larger,
        } = *self.changes.as_ref()?.planned.get(place)?;
        if enters == self.contains(vehicle) {
            return None;
        }
        if let LaneChange::At(time_s) = when {
            let in_s = time_s - now_s;
            return (in_s <= to_s + TIME_TOLERANCE_S).then(|| in_s.clamp(from_s, to_s));
        }
        let (front, rear) = match enters {
            true => (vehicle, self.nearest_behind(vehicle)?),
            false => (self.nearest_ahead(vehicle)?, vehicle),
        };
        let (ahead, behind) = (
            bodies.motion[front].after(from_s),
            bodies.motion[rear].after(from_s),
        );
        let length_m = bodies.length_m[front];
        let gap = |front: Motion, rear: Motion| {
            let gap_m = front.position_m - length_m - rear.position_m;
            [
                gap_m,
                front.speed_mps - rear.speed_mps,
                front.acceleration_mps2 - rear.acceleration_mps2,
            ]
        };
        let found_s = match when {
            LaneChange::At(_) => None,
            LaneChange::Gap(waited_m) => {
                let beyond_m = gap(ahead, behind)[0] - waited_m;
                let larger = was_larger.unwrap_or(beyond_m > 0.0);
                self.changes
                    .as_mut()?
                    .planned
                    .get_mut(place)?
                    .was_gap_larger = Some(larger);
                let sign = if larger { 1.0 } else { -1.0 };
                let size = |front, rear| {
                    let [gap_m, rate_mps, rate_mps2] = gap(front, rear);
                    [sign * (gap_m - waited_m), sign * rate_mps, sign * rate_mps2]
                };
                first_zero(ahead, behind, size, to_s - from_s)
            }
            LaneChange::TimeToCollision(waited_s) if gap(ahead, behind)[0] > 0.0 => {
                let size = |front, rear| {
                    let [gap_m, rate_mps, rate_mps2] = gap(front, rear);
                    [
                        gap_m + waited_s * rate_mps,
                        rate_mps + waited_s * rate_mps2,
                        rate_mps2,
                    ]
                };
                first_zero(ahead, behind, size, to_s - from_s)
            }
            LaneChange::TimeToCollision(_) => None,
        };
        found_s.map(|in_s| (from_s + in_s).min(to_s))
    }

    /// Applies planned changes at increasing indices. A vehicle without room to enter stays outside.
    fn apply_changes(&mut self, places: &[usize], bodies: Bodies<'_>, now_s: f64, in_s: f64) {
        let Some(changes) = &mut self.changes else {
            return;
        };
        let due: Vec<PlannedLaneChange> = places
            .iter()
            .filter_map(|&place| changes.planned.get(place).copied())
            .collect();
        for place in places.iter().rev() {
            changes.planned.remove(*place);
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
        let position_m = |vehicle: usize| bodies.motion[vehicle].after(in_s).position_m;
        let is_clear = |front: usize, rear: usize| {
            position_m(front) - bodies.length_m[front] > position_m(rear)
        };
        self.nearest_ahead(vehicle)
            .is_none_or(|front| is_clear(front, vehicle))
            && self
                .nearest_behind(vehicle)
                .is_none_or(|rear| is_clear(vehicle, rear))
    }
}

#[cfg(test)]
mod tests;
