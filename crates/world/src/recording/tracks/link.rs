//! Links of leaders and followers.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use super::super::series::{ColumnQuantity, round_to_milli};
use super::{Occurrences, TrackPoint, count};

/// Maximum number of absent vehicles at one instant; with more, no vehicle is linked, which bounds the time of linking.
const MAX_ABSENT: usize = 256;
/// Hardest braking and acceleration of an absent vehicle, in m/s².
const BRAKE_MPS2: f64 = 8.0;
const ACCEL_MPS2: f64 = 4.0;

/// Points that could not be linked.
pub(super) struct LinkProblems {
    /// Overlapping vehicles.
    pub(super) overlapping: Occurrences,
    /// Unknown position or length.
    pub(super) unknown_position: Occurrences,
    /// Neighbours that may have a vehicle without a row between them.
    pub(super) absent: Occurrences,
}

/// A vehicle between two of its rows, while other vehicles have rows.
struct Absence {
    lanes: [u32; 2],
    decreases: bool,
    from_ms: i64,
    to_ms: i64,
    front_m: [f64; 2],
    length_m: f64,
    /// Lowest and highest possible speed.
    speed_mps: [f64; 2],
}

impl Absence {
    fn new(a: &TrackPoint, b: &TrackPoint) -> Self {
        let seconds = (b.time_ms - a.time_ms) as f64 / 1000.0;
        let speeds = a.speed_mps.zip(b.speed_mps);
        Self {
            lanes: [a.lane, b.lane],
            decreases: a.position_decreases,
            from_ms: a.time_ms,
            to_ms: b.time_ms,
            front_m: [a.front_m, b.front_m],
            length_m: a.length_m.unwrap_or(0.0).max(b.length_m.unwrap_or(0.0)),
            speed_mps: speeds.map_or([0.0, f64::INFINITY], |(a, b)| {
                [(a.min(b) - BRAKE_MPS2 * seconds).max(0.0), a.max(b) + ACCEL_MPS2 * seconds]
            }),
        }
    }

    /// Returns whether the vehicle may be between a leader's rear and a follower's front bumper.
    fn may_be_between(&self, ahead: &TrackPoint, rear_m: f64, behind_front_m: f64) -> bool {
        let [after_s, before_s] =
            [ahead.time_ms - self.from_ms, self.to_ms - ahead.time_ms].map(|ms| ms as f64 / 1000.0);
        let ([from_m, to_m], [slow_mps, fast_mps]) = (self.front_m, self.speed_mps);
        let low_m = (from_m + slow_mps * after_s).max(to_m - fast_mps * before_s).min(to_m);
        let high_m = (from_m + fast_mps * after_s).min(to_m - slow_mps * before_s).max(from_m);
        self.lanes.contains(&ahead.lane)
            && self.decreases == ahead.position_decreases
            && low_m.min(high_m) - self.length_m < rear_m
            && low_m.max(high_m) > behind_front_m
    }
}

/// Links each point with its leader and follower. A vehicle with unknown position may be anywhere in its lane, so no
/// point of that lane at that time is linked. A vehicle with unknown length is not linked. No points are linked if a
/// vehicle that has rows before and after may be between them.
pub(super) fn link(points: &mut [TrackPoint]) -> LinkProblems {
    let at = |points: &[TrackPoint], index: u32| points.get(index as usize).copied();
    let row = |point: &TrackPoint| (point.time_ms, point.lane, point.position_decreases);
    let unplaced = || points.iter().filter(|point| point.position_m.is_none() || point.length_m.is_none());
    let unplaced = || unplaced().filter(|point| !point.is_margin);
    let unknown_position = unplaced().map(|point| point.line).min().map(|first| (first, unplaced().count()));
    let unlinkable: BTreeSet<_> = points.iter().filter(|point| point.position_m.is_none()).map(row).collect();
    // By row, front to rear.
    let key = |(point, index): (&TrackPoint, u32)| (row(point), Reverse(total_order(point.front_m)), index);
    let mut order: Vec<_> = points.iter().zip(0..).map(key).collect();
    order.sort_unstable();
    let mut to_come = absences(points).into_iter().enumerate().peekable();
    // By the end of the absence.
    let mut absent_now: BTreeMap<(i64, usize), Absence> = BTreeMap::new();
    let (mut overlapping, mut absent) = (None, None);
    for pair in order.windows(2) {
        let &[(_, _, front), (_, _, rear)] = pair else { continue };
        let (Some(ahead), Some(behind)) = (at(points, front), at(points, rear)) else { continue };
        if row(&ahead) != row(&behind) || unlinkable.contains(&row(&ahead)) {
            continue;
        }
        let (Some(length_m), Some(_)) = (ahead.length_m, behind.length_m) else { continue };
        let gap_m = ahead.front_m - length_m - behind.front_m;
        while let Some((index, absence)) = to_come.next_if(|(_, absence)| absence.from_ms < ahead.time_ms) {
            absent_now.insert((absence.to_ms, index), absence);
        }
        while absent_now.first_entry().is_some_and(|first| first.key().0 <= ahead.time_ms) {
            absent_now.pop_first();
        }
        let rear_m = ahead.front_m - length_m;
        let hides_vehicle = |absence: &Absence| absence.may_be_between(&ahead, rear_m, behind.front_m);
        if !ColumnQuantity::Gap.allows(gap_m) {
            if round_to_milli(gap_m) <= 0.0 {
                count(&mut overlapping, &behind);
            }
        } else if absent_now.len() > MAX_ABSENT || absent_now.values().any(hides_vehicle) {
            count(&mut absent, &behind);
        } else {
            if let Some(point) = points.get_mut(rear as usize) {
                point.ahead = Some((gap_m, front));
            }
            if let Some(point) = points.get_mut(front as usize) {
                point.behind = Some(rear);
            }
        }
    }
    LinkProblems { overlapping, unknown_position, absent }
}

/// Returns the absences during which other vehicles have rows, in order of their starts.
fn absences(points: &[TrackPoint]) -> Vec<Absence> {
    let mut instants_ms: Vec<i64> = points.iter().map(|point| point.time_ms).collect();
    instants_ms.sort_unstable();
    instants_ms.dedup();
    let mut absences = Vec::new();
    for track in points.chunk_by(|a, b| a.track == b.track) {
        let known: Vec<_> = track.iter().filter(|point| point.position_m.is_some()).collect();
        absences.extend(known.windows(2).filter_map(|pair| {
            let &[a, b] = pair else { return None };
            let next = instants_ms.partition_point(|&time_ms| time_ms <= a.time_ms);
            (instants_ms.get(next).is_some_and(|&next_ms| next_ms < b.time_ms)).then(|| Absence::new(a, b))
        }));
    }
    absences.sort_by_key(|absence| absence.from_ms);
    absences
}

/// Returns an integer in the order of [`f64::total_cmp`].
fn total_order(number: f64) -> i64 {
    let bits = number.to_bits() as i64;
    bits ^ ((bits >> 63) as u64 >> 1) as i64
}
