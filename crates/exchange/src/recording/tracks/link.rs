//! Links of leaders and followers.

use std::collections::{BTreeMap, BTreeSet};

use super::super::dropped::Omission;
use super::super::series::{ColumnQuantity, round_to_milli};
use super::{Occurrences, TrackPoint, count, sortable};

/// Maximum number of absent vehicles at one instant; with more, no vehicle is linked, which bounds the time of linking.
const MAX_ABSENT: usize = 256;
/// Hardest braking and acceleration of an absent vehicle, in m/s².
const BRAKE_MPS2: f64 = 8.0;
const ACCEL_MPS2: f64 = 4.0;

const UNKNOWN_POSITION: &str = " times the position or the length of a vehicle is not known, the first time here: no \
    vehicle follows it, or a vehicle beyond it, then";
const ABSENT: &str = " times a vehicle that has rows before and after may be between two others, the first time here: \
    they do not follow each other then";
const OVERLAPPING: &str = " times a vehicle overlaps the one ahead of it in its lane, the first time here: it follows \
    no vehicle then";

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
                [
                    (a.min(b) - BRAKE_MPS2 * seconds).max(0.0),
                    a.max(b) + ACCEL_MPS2 * seconds,
                ]
            }),
        }
    }

    /// Returns whether the vehicle may be between a leader's rear and a follower's front bumper.
    fn may_be_between(&self, ahead: &TrackPoint, rear_m: f64, behind_front_m: f64) -> bool {
        let [after_s, before_s] =
            [ahead.time_ms - self.from_ms, self.to_ms - ahead.time_ms].map(|ms| ms as f64 / 1000.0);
        let ([from_m, to_m], [slow_mps, fast_mps]) = (self.front_m, self.speed_mps);
        let low_m = (from_m + slow_mps * after_s)
            .max(to_m - fast_mps * before_s)
            .min(to_m);
        let high_m = (from_m + fast_mps * after_s)
            .min(to_m - slow_mps * before_s)
            .max(from_m);
        self.lanes.contains(&ahead.lane)
            && self.decreases == ahead.position_decreases
            && low_m.min(high_m) - self.length_m < rear_m
            && low_m.max(high_m) > behind_front_m
    }
}

/// Links each point with its leader and follower. A vehicle with unknown position may be anywhere in its lane, so no
/// point of that lane at that time is linked. A vehicle with unknown length is not linked. No points are linked if a
/// vehicle that has rows before and after may be between them. Appends omissions, with the line of the first one.
pub(super) fn link(points: &mut [TrackPoint], blip_ms: i64, dropped: &mut Vec<(u64, Omission)>) {
    let row = |point: &TrackPoint| (point.time_ms, point.lane, point.position_decreases);
    let (mut unknown_position, mut unlinkable): (Occurrences, _) = (None, BTreeSet::new());
    for point in points
        .iter()
        .filter(|point| point.position_m.is_none() || point.length_m.is_none())
    {
        if !point.is_margin {
            let (first, count) = unknown_position.unwrap_or((point.line, 0));
            unknown_position = Some((first.min(point.line), count + 1));
        }
        if point.position_m.is_none() {
            unlinkable.insert(row(point));
        }
    }
    let order = order_rows(points);
    let mut to_come = absences(points, &order, blip_ms)
        .into_iter()
        .enumerate()
        .peekable();
    // Keyed by the absence's end.
    let mut absent_now: BTreeMap<(i64, usize), Absence> = BTreeMap::new();
    let (mut overlapping, mut absent) = (None, None);
    for pair in order.windows(2) {
        let &[front, rear] = pair else { continue };
        // Keys of different rows differ above the index.
        if (front ^ rear) >> 32 != 0 {
            continue;
        }
        let [front, rear] = [front, rear].map(|key| key as u32);
        let [ahead, behind] = [front, rear].map(|index| &points[index as usize]);
        if unlinkable.contains(&row(ahead)) {
            continue;
        }
        let (Some(length_m), Some(_)) = (ahead.length_m, behind.length_m) else {
            continue;
        };
        let gap_m = ahead.front_m - length_m - behind.front_m;
        while let Some((index, absence)) =
            to_come.next_if(|(_, absence)| absence.from_ms < ahead.time_ms)
        {
            absent_now.insert((absence.to_ms, index), absence);
        }
        while absent_now
            .first_entry()
            .is_some_and(|first| first.key().0 <= ahead.time_ms)
        {
            absent_now.pop_first();
        }
        let rear_m = ahead.front_m - length_m;
        let hides_vehicle =
            |absence: &Absence| absence.may_be_between(ahead, rear_m, behind.front_m);
        if !ColumnQuantity::Gap.allows(gap_m) {
            if round_to_milli(gap_m) <= 0.0 {
                count(&mut overlapping, behind);
            }
        } else if absent_now.len() > MAX_ABSENT || absent_now.values().any(hides_vehicle) {
            count(&mut absent, behind);
        } else {
            points[rear as usize].ahead = Some((gap_m, front));
            points[front as usize].behind = Some(rear);
        }
    }
    for (found, after) in [
        (unknown_position, UNKNOWN_POSITION),
        (absent, ABSENT),
        (overlapping, OVERLAPPING),
    ] {
        dropped.extend(
            found.map(|(line, count): (u64, usize)| (line, Omission::counted("", count, after))),
        );
    }
}

/// Returns the points by time, lane and direction, and then front to rear. The low 32 bits of each key are the index of
/// the point.
fn order_rows(points: &[TrackPoint]) -> Vec<u128> {
    let key = |(point, index): (&TrackPoint, u32)| {
        let row = u64::from(point.lane) << 33 | u64::from(point.position_decreases) << 32;
        u128::from(sortable(point.time_ms)) << 64 | u128::from(row | u64::from(index))
    };
    let mut order: Vec<u128> = points.iter().zip(0..).map(key).collect();
    order.sort_unstable();
    let front_m = |key: u128| points[key as u32 as usize].front_m;
    for row in order.chunk_by_mut(|a, b| (a ^ b) >> 32 == 0) {
        row.sort_by(|&a, &b| front_m(b).total_cmp(&front_m(a)));
    }
    order
}

/// Returns the index of the first instant after a time. Mostly it is one of the first, so the search doubles its steps:
/// a walk would visit all instants for each vehicle that is long absent.
fn later_instants(instants: &[u64], time: u64) -> usize {
    let mut end = 1;
    while instants.get(end).is_some_and(|&instant| instant <= time) {
        end *= 2;
    }
    instants
        .get(..end.min(instants.len()))
        .unwrap_or_default()
        .partition_point(|&instant| instant <= time)
}

/// Returns the absences during which other vehicles have rows, in order of their starts. A vehicle is also absent from
/// a lane that it leaves for at most `blip_ms`.
fn absences(points: &[TrackPoint], order: &[u128], blip_ms: i64) -> Vec<Absence> {
    let mut instants: Vec<u64> = order.iter().map(|key| (key >> 64) as u64).collect();
    instants.dedup();
    let mut absences = Vec::new();
    for track in points.chunk_by(|a, b| a.track == b.track) {
        let mut known = track.iter().filter(|point| point.position_m.is_some());
        let Some(mut a) = known.next() else { continue };
        let mut next = instants.partition_point(|&instant| instant <= sortable(a.time_ms));
        let mut left: BTreeMap<u32, &TrackPoint> = BTreeMap::new();
        for b in known {
            if a.lane != b.lane {
                left.insert(a.lane, a);
                let before = left
                    .get(&b.lane)
                    .filter(|before| b.time_ms - before.time_ms <= blip_ms);
                absences.extend(before.map(|before| Absence::new(before, b)));
            }
            if instants
                .get(next)
                .is_some_and(|&instant| instant < sortable(b.time_ms))
            {
                absences.push(Absence::new(a, b));
            }
            a = b;
            next += later_instants(
                instants.get(next..).unwrap_or_default(),
                sortable(a.time_ms),
            );
        }
    }
    absences.sort_by_key(|absence| absence.from_ms);
    absences
}
