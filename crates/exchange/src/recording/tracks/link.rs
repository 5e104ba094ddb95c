//! Links of leaders and followers.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::iter::{Enumerate, Peekable};
use std::vec;

use super::super::dropped::Omission;
use super::super::series::{ColumnQuantity, round_to_milli};
use super::TrackPoint;

/// Maximum number of absent vehicles at one instant; with more, no vehicle is linked, which bounds the time of linking.
const MAX_ABSENT: usize = 256;
/// Hardest braking and acceleration of an absent vehicle, in m/s².
const BRAKE_MPS2: f64 = 8.0;
const ACCEL_MPS2: f64 = 4.0;

/// Place of vehicles that may follow each other: one instant, lane and direction.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct RowKey {
    time_ms: i64,
    lane: u32,
    position_decreases: bool,
}

impl RowKey {
    fn new(point: &TrackPoint) -> Self {
        Self {
            time_ms: point.time_ms,
            lane: point.lane,
            position_decreases: point.position_decreases,
        }
    }
}

/// A point by its row and its index.
#[derive(Clone, Copy)]
struct RowEntry {
    row: RowKey,
    index: u32,
}

/// Reason why a vehicle follows no vehicle.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum LinkProblem {
    UnknownPosition,
    Absence,
    Overlap,
}

/// Prints the problem as the end of a sentence that begins with the number of its occurrences.
impl fmt::Display for LinkProblem {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::UnknownPosition => {
                " times the position or the length of a vehicle is not known, the first time here: no vehicle follows \
                it, or a vehicle beyond it, then"
            }
            Self::Absence => {
                " times a vehicle that has rows before and after may be between two others, the first time here: they \
                do not follow each other then"
            }
            Self::Overlap => {
                " times a vehicle overlaps the one ahead of it in its lane, the first time here: it follows no vehicle \
                then"
            }
        })
    }
}

/// Line of the first occurrence of each problem, and their number.
type LinkProblems = BTreeMap<LinkProblem, (u64, usize)>;

fn count(problems: &mut LinkProblems, problem: LinkProblem, point: &TrackPoint) {
    if !point.is_margin {
        problems.entry(problem).or_insert((point.line, 0)).1 += 1;
    }
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
    /// Returns the absence between two rows of a vehicle.
    fn new(before: &TrackPoint, after: &TrackPoint) -> Self {
        let duration_s = (after.time_ms - before.time_ms) as f64 / 1000.0;
        let [length_m, other_length_m] = [before, after].map(|point| point.length_m.unwrap_or(0.0));
        Self {
            lanes: [before.lane, after.lane],
            decreases: before.position_decreases,
            from_ms: before.time_ms,
            to_ms: after.time_ms,
            front_m: [before.front_m, after.front_m],
            length_m: length_m.max(other_length_m),
            speed_mps: match (before.speed_mps, after.speed_mps) {
                (Some(first_mps), Some(last_mps)) => [
                    (first_mps.min(last_mps) - BRAKE_MPS2 * duration_s).max(0.0),
                    first_mps.max(last_mps) + ACCEL_MPS2 * duration_s,
                ],
                _ => [0.0, f64::INFINITY],
            },
        }
    }

    /// Returns whether the vehicle may be between a leader's rear and a follower's front bumper.
    fn may_be_between(&self, ahead: &TrackPoint, rear_m: f64, behind_front_m: f64) -> bool {
        let [after_s, before_s] =
            [ahead.time_ms - self.from_ms, self.to_ms - ahead.time_ms].map(|ms| ms as f64 / 1000.0);
        let [from_m, to_m] = self.front_m;
        let [slow_mps, fast_mps] = self.speed_mps;
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

/// The absences that are under way while time advances.
struct CurrentAbsences {
    to_come: Peekable<Enumerate<vec::IntoIter<Absence>>>,
    /// By their ends.
    current: BTreeMap<(i64, usize), Absence>,
}

impl CurrentAbsences {
    /// Creates them before the first absence. `absences` are in order of their starts.
    fn new(absences: Vec<Absence>) -> Self {
        Self {
            to_come: absences.into_iter().enumerate().peekable(),
            current: BTreeMap::new(),
        }
    }

    fn advance(&mut self, time_ms: i64) {
        while let Some((index, absence)) = self
            .to_come
            .next_if(|(_, absence)| absence.from_ms < time_ms)
        {
            self.current.insert((absence.to_ms, index), absence);
        }
        while let Some(first) = self.current.first_entry()
            && first.key().0 <= time_ms
        {
            first.remove();
        }
    }

    /// Returns whether a vehicle may be between two others.
    fn may_be_between(&self, ahead: &TrackPoint, rear_m: f64, behind_front_m: f64) -> bool {
        let mut absences = self.current.values();
        self.current.len() > MAX_ABSENT
            || absences.any(|absence| absence.may_be_between(ahead, rear_m, behind_front_m))
    }
}

/// Links each point with its leader and follower. A vehicle with unknown position may be anywhere in its lane, so no
/// point of that lane at that time is linked. A vehicle with unknown length is not linked. No points are linked if a
/// vehicle that has rows before and after may be between them. Appends omissions, with the line of the first one.
pub(super) fn link(points: &mut [TrackPoint], blip_ms: i64, dropped: &mut Vec<(u64, Omission)>) {
    let mut problems = count_unknown_positions(points);
    let unlinkable: BTreeSet<RowKey> = points
        .iter()
        .filter(|point| point.position_m.is_none())
        .map(RowKey::new)
        .collect();
    let order = order_rows(points);
    let mut absent = CurrentAbsences::new(absences(points, &order, blip_ms));
    for pair in order.windows(2) {
        let &[front, rear] = pair else { continue };
        if front.row != rear.row || unlinkable.contains(&front.row) {
            continue;
        }
        absent.advance(front.row.time_ms);
        let [ahead, behind] = [front, rear].map(|entry| &points[entry.index as usize]);
        match gap_between(ahead, behind, &absent) {
            Ok(Some(gap_m)) => {
                points[rear.index as usize].ahead = Some((gap_m, front.index));
                points[front.index as usize].behind = Some(rear.index);
            }
            Ok(None) => {}
            Err(problem) => count(&mut problems, problem, behind),
        }
    }
    dropped.extend(problems.into_iter().map(|(problem, (line, number))| {
        (line, Omission::counted("", number, problem.to_string()))
    }));
}

/// Counts points with unknown positions or lengths. Points are not in order of their lines.
fn count_unknown_positions(points: &[TrackPoint]) -> LinkProblems {
    let unknown = points.iter().filter(|point| {
        !point.is_margin && (point.position_m.is_none() || point.length_m.is_none())
    });
    let count = unknown.clone().count();
    let first_line = unknown.map(|point| point.line).min();
    first_line
        .map(|line| (LinkProblem::UnknownPosition, (line, count)))
        .into_iter()
        .collect()
}

/// Returns the gap of a vehicle to the next point of its row; `None` if it is unknown or too large.
fn gap_between(
    ahead: &TrackPoint,
    behind: &TrackPoint,
    absent: &CurrentAbsences,
) -> Result<Option<f64>, LinkProblem> {
    let Some((length_m, _)) = ahead.length_m.zip(behind.length_m) else {
        return Ok(None);
    };
    let rear_m = ahead.front_m - length_m;
    let gap_m = rear_m - behind.front_m;
    if ColumnQuantity::Gap.allows(gap_m) {
        match absent.may_be_between(ahead, rear_m, behind.front_m) {
            true => Err(LinkProblem::Absence),
            false => Ok(Some(gap_m)),
        }
    } else if round_to_milli(gap_m) <= 0.0 {
        Err(LinkProblem::Overlap)
    } else {
        Ok(None)
    }
}

/// Returns the points by row, and then front to rear.
fn order_rows(points: &[TrackPoint]) -> Vec<RowEntry> {
    let mut order: Vec<RowEntry> = points
        .iter()
        .zip(0..)
        .map(|(point, index)| RowEntry {
            row: RowKey::new(point),
            index,
        })
        .collect();
    // The stable sort is as fast as one of packed keys: points of a vehicle are in order already.
    order.sort_by_key(|entry| entry.row);
    for row in order.chunk_by_mut(|a, b| a.row == b.row) {
        row.sort_by(|a, b| {
            let [a, b] = [a, b].map(|entry| points[entry.index as usize].front_m);
            b.total_cmp(&a)
        });
    }
    order
}

/// Returns the index of the first instant after a time. Mostly it is one of the first, so the search doubles its steps:
/// a walk would visit all instants for each vehicle that is long absent.
fn later_instants(instants: &[i64], time_ms: i64) -> usize {
    let mut end = 1;
    while instants.get(end).is_some_and(|&instant| instant <= time_ms) {
        end *= 2;
    }
    instants
        .get(..end.min(instants.len()))
        .unwrap_or_default()
        .partition_point(|&instant| instant <= time_ms)
}

/// Returns the absences during which other vehicles have rows, in order of their starts. A vehicle is also absent from
/// a lane that it leaves for at most `blip_ms`.
fn absences(points: &[TrackPoint], order: &[RowEntry], blip_ms: i64) -> Vec<Absence> {
    let mut instants: Vec<i64> = order.iter().map(|entry| entry.row.time_ms).collect();
    instants.dedup();
    let mut absences = Vec::new();
    for track in points.chunk_by(|a, b| a.track == b.track) {
        let mut located = track.iter().filter(|point| point.position_m.is_some());
        let Some(mut before) = located.next() else {
            continue;
        };
        // Index of the first instant after `before`, and the last row in each lane that the vehicle left.
        let mut next = instants.partition_point(|&instant| instant <= before.time_ms);
        let mut last_in_lane: BTreeMap<u32, &TrackPoint> = BTreeMap::new();
        for after in located {
            if before.lane != after.lane {
                last_in_lane.insert(before.lane, before);
                let last = last_in_lane
                    .get(&after.lane)
                    .filter(|last| after.time_ms - last.time_ms <= blip_ms);
                absences.extend(last.map(|last| Absence::new(last, after)));
            }
            if instants
                .get(next)
                .is_some_and(|&instant| instant < after.time_ms)
            {
                absences.push(Absence::new(before, after));
            }
            before = after;
            next += later_instants(instants.get(next..).unwrap_or_default(), before.time_ms);
        }
    }
    absences.sort_by_key(|absence| absence.from_ms);
    absences
}
