//! Recordings of tracks, as in highD and NGSIM: each row holds one vehicle among many at one instant.
//!
//! Neighbours follow from the rows: at each instant, the vehicles of a lane and direction are sorted by front bumper.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;

use super::dropped::{DroppedItem, Omission};
use super::episode::EpisodeVehicle;
use super::error::{ColumnProblem, LineProblem, RecordingError};
use super::lead_vehicles::{LeadVehicle, VehicleAhead};
use super::map::{LengthSpec, RecordingMapSpec, ReferencePoint, TracksSpec};
use super::motion::{SpeedSample, split_at_holes};
use super::series::{Clock, ColumnQuantity, Series, interpolate_holes, round_to_milli};
use super::table::{CsvColumn, CsvRow, MAX_ROWS, RowLimiter, RowReader, excerpt};
use super::{Recording, RecordingFormat};

/// Maximum number of followers in a scenario. A braking wave reaches vehicles further behind only after the end of the
/// episode.
const MAX_FOLLOWERS: usize = 9;
const MAX_LANES: usize = 10_000;

/// Vehicles with changing neighbours.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RecordedTraffic {
    /// Points sorted by vehicle, then by time.
    points: Vec<TrackPoint>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct TrackPoint {
    vehicle: u32,
    lane: u32,
    time_ms: i64,
    line: u64,
    /// Position along the road, as recorded, in metres.
    position_m: Option<f64>,
    /// Speed as recorded, of either sign, in m/s.
    speed_mps: Option<f64>,
    length_m: Option<f64>,
    /// Front bumper in the direction of driving, in metres; meaningless if position or length is unknown.
    front_m: f64,
    /// True if positions decrease as the vehicle drives.
    position_decreases: bool,
    /// Gap ahead, in metres, and index of the leader's point.
    ahead: Option<(f64, u32)>,
    /// Index of the follower's point.
    behind: Option<u32>,
}

/// Reads the rows after the column names.
pub(super) fn read<R: Read>(
    table: &mut RowReader<'_, R>,
    (map, tracks): (&RecordingMapSpec, &TracksSpec),
    names: &CsvRow<'_>,
) -> Result<Recording, RecordingError> {
    let clock = Clock::new(CsvColumn::find_time(names, &map.time)?);
    let vehicle = CsvColumn::find(names, &tracks.vehicle, 1.0)?;
    let lane = tracks.lane.as_ref().map(|name| CsvColumn::find(names, name, 1.0)).transpose()?;
    let series = |name: &str, factor, quantity| Ok(Series::new(CsvColumn::find(names, name, factor)?, quantity));
    let mut position = series(&tracks.position.column, tracks.position.unit.factor(), ColumnQuantity::Signed)?;
    let mut speed = series(&tracks.speed.column, tracks.speed.unit.factor(), ColumnQuantity::SignedSpeed)?;
    let (mut length, constant_m) = match &tracks.length {
        LengthSpec::Column(column) => (Some(series(&column.name, column.unit.factor(), ColumnQuantity::Length)?), 0.0),
        LengthSpec::Metres(metres) => (None, *metres),
    };
    let mut lanes = BTreeMap::new();
    let mut limiter = RowLimiter::new(&names.fields, 2);
    let mut points = Vec::new();
    while let Some(row) = table.next_row()? {
        limiter.check_row(row)?;
        let time_s = clock.read(row)?;
        let vehicle = read_whole_number(row, &vehicle)?;
        let lane = match &lane {
            // A vehicle without a lane could be in any lane.
            Some(column) if row.text(column.index).is_empty() => {
                return row.reject(&column.name, ColumnProblem::Empty);
            }
            Some(column) => {
                let next = lanes.len();
                let known = *lanes.entry(row.text(column.index).to_owned()).or_insert(next);
                if lanes.len() > MAX_LANES {
                    return row.reject_too_large(MAX_LANES, "lanes");
                }
                known as u32
            }
            None => 0,
        };
        let (position_m, speed_mps) = (position.read(row)?, speed.read(row)?);
        let length_m = length.as_mut().map_or(Ok(Some(constant_m)), |series| series.read(row))?;
        // Points with unknown values stay in the list; without them, the next vehicle would seem to follow the wrong
        // leader.
        points.push(TrackPoint {
            vehicle,
            lane,
            time_ms: (time_s * 1000.0).round() as i64,
            line: row.line,
            position_m,
            speed_mps,
            length_m,
            front_m: 0.0,
            position_decreases: false,
            ahead: None,
            behind: None,
        });
    }
    if limiter.rows == 0 {
        return table.reject_cut_short("its first sample");
    }
    let path = table.path();
    let mut dropped = Vec::new();
    for series in [Some(&position), Some(&speed), length.as_ref()].into_iter().flatten() {
        series.report(path, limiter.rows, &mut dropped);
    }
    points.sort_unstable_by_key(|point: &TrackPoint| (point.vehicle, point.time_ms, point.line));
    let item = |omission, line| DroppedItem { path: path.to_owned(), line, omission };
    if let Some((duplicate, count)) = remove_duplicates(&mut points) {
        dropped.push(item(Omission::DuplicateRows { vehicle: duplicate.vehicle, count }, duplicate.line));
    }
    let filled = fill_holes(&mut points, map.interpolate_s).map_err(|line| {
        let problem = LineProblem::TooLarge { limit: MAX_ROWS, what: "rows, with those that are filled" };
        RecordingError::Line { path: path.to_owned(), line, problem }
    })?;
    if let Some((line, count)) = filled {
        dropped.push(item(Omission::Interpolated { column: excerpt(&tracks.vehicle), count }, line));
    }
    orient(&mut points, tracks.position.of);
    let LinkProblems { overlapping, unknown_position: unplaced } = link(&mut points);
    dropped.extend(unplaced.map(|(line, count)| item(Omission::UnknownPosition { count }, line)));
    dropped.extend(overlapping.map(|(line, count)| item(Omission::Overlapping { count }, line)));
    let traffic = Some(RecordedTraffic { points });
    Ok(Recording {
        path: path.to_owned(),
        format: RecordingFormat::from_map(map),
        platoons: Vec::new(),
        traffic,
        dropped,
    })
}

/// Reads a vehicle number, which some tools write with a decimal point.
fn read_whole_number(row: &CsvRow<'_>, column: &CsvColumn) -> Result<u32, RecordingError> {
    match row.number(column)? {
        Some(number) if number >= 0.0 && number <= f64::from(u32::MAX) && number.fract() == 0.0 => Ok(number as u32),
        Some(_) => row.reject(&column.name, ColumnProblem::NotWhole { found: excerpt(row.text(column.index)) }),
        None => row.reject(&column.name, ColumnProblem::Empty),
    }
}

/// Keeps the first of several points of a vehicle at one time. Returns the first duplicate and the number of
/// duplicates.
fn remove_duplicates(points: &mut Vec<TrackPoint>) -> Option<(TrackPoint, usize)> {
    let mut duplicate: Option<(TrackPoint, usize)> = None;
    points.dedup_by(|later, first| {
        let is_twice = (later.vehicle, later.time_ms) == (first.vehicle, first.time_ms);
        if is_twice {
            duplicate.get_or_insert((*later, 0)).1 += 1;
        }
        is_twice
    });
    duplicate
}

const OPTIONAL_FIELDS: [fn(&mut TrackPoint) -> &mut Option<f64>; 3] =
    [|point| &mut point.position_m, |point| &mut point.speed_mps, |point| &mut point.length_m];

/// Fills holes of at most `longest_s` by interpolation: missing numbers, and missing points between two points of a
/// vehicle in one lane. Returns the line of the first filled hole and the number of filled values. The error is the
/// line at which there are too many points.
fn fill_holes(points: &mut Vec<TrackPoint>, longest_s: f64) -> Result<Option<(u64, usize)>, u64> {
    let longest_ms = (longest_s * 1000.0).round() as i64;
    let steps = points.windows(2).filter_map(|pair| match pair {
        [a, b] if a.vehicle == b.vehicle && longest_ms > 0 => Some(b.time_ms - a.time_ms),
        _ => None,
    });
    let mut steps: Vec<i64> = steps.collect();
    steps.sort_unstable();
    let Some(&step_ms) = steps.get(steps.len() / 2) else { return Ok(None) };
    let mut found: Option<(u64, usize)> = None;
    for track in points.chunk_by_mut(|a, b| a.vehicle == b.vehicle) {
        let time_s: Vec<f64> = track.iter().map(|point| point.time_ms as f64 / 1000.0).collect();
        for number in OPTIONAL_FIELDS {
            let mut values: Vec<Option<f64>> = track.iter_mut().map(|point| *number(point)).collect();
            if let Some((count, first)) = interpolate_holes(&mut values, &time_s, longest_s) {
                track.iter_mut().zip(values).for_each(|(point, value)| *number(point) = value);
                found.get_or_insert((track.get(first).map_or(0, |point| point.line), 0)).1 += count;
            }
        }
    }
    let mut filled: Vec<TrackPoint> = Vec::new();
    for pair in points.windows(2) {
        let [a, b] = pair else { continue };
        let hole_ms = b.time_ms - a.time_ms;
        if (a.vehicle, a.lane) != (b.vehicle, b.lane) || hole_ms > longest_ms {
            continue;
        }
        // Frame intervals are not whole milliseconds at some rates.
        let parts = (hole_ms + step_ms / 2) / step_ms;
        for part in 1..parts {
            let share = part as f64 / parts as f64;
            let between = |a: f64, b: f64| a + (b - a) * share;
            filled.push(TrackPoint {
                time_ms: between(a.time_ms as f64, b.time_ms as f64).round() as i64,
                position_m: a.position_m.zip(b.position_m).map(|(a, b)| between(a, b)),
                speed_mps: a.speed_mps.zip(b.speed_mps).map(|(a, b)| between(a, b)),
                length_m: a.length_m.zip(b.length_m).map(|(a, b)| between(a, b)),
                ..*a
            });
        }
        if points.len() + filled.len() > MAX_ROWS {
            return Err(a.line);
        }
    }
    if let Some(TrackPoint { line, .. }) = filled.first() {
        found.get_or_insert((*line, 0)).1 += filled.len();
    }
    points.append(&mut filled);
    points.sort_unstable_by_key(|point| (point.vehicle, point.time_ms));
    Ok(found)
}

/// Determines the direction of each vehicle and its front bumper.
fn orient(points: &mut [TrackPoint], reference: ReferencePoint) {
    for track in points.chunk_by_mut(|a, b| a.vehicle == b.vehicle) {
        let mut known_m = track.iter().filter_map(|point| point.position_m);
        let first_m = known_m.next().unwrap_or(0.0);
        let moved_m = known_m.next_back().unwrap_or(first_m) - first_m;
        let decreases = match moved_m.partial_cmp(&0.0) {
            Some(Ordering::Equal) | None => track.iter().filter_map(|point| point.speed_mps).sum::<f64>() < 0.0,
            Some(order) => order == Ordering::Less,
        };
        for point in track {
            // Vehicles do not overlap, so a point without length still sorts correctly in its lane.
            let (position_m, length_m) = (point.position_m.unwrap_or(0.0), point.length_m.unwrap_or(0.0));
            let to_front_m = match reference {
                ReferencePoint::Front => 0.0,
                ReferencePoint::Centre => length_m / 2.0,
                ReferencePoint::Rear => length_m,
                ReferencePoint::LowEnd if decreases => 0.0,
                ReferencePoint::LowEnd => length_m,
            };
            point.position_decreases = decreases;
            point.front_m = to_front_m + if decreases { -position_m } else { position_m };
            point.speed_mps = point.speed_mps.map(f64::abs);
        }
    }
}

/// Points that could not be linked: first line and number.
struct LinkProblems {
    /// Overlapping vehicles.
    overlapping: Option<(u64, usize)>,
    /// Unknown position or length.
    unknown_position: Option<(u64, usize)>,
}

/// Links each point with its leader and follower. A vehicle with unknown position may be anywhere in its lane, so no
/// point of that lane at that time is linked. A vehicle with unknown length is not linked.
fn link(points: &mut [TrackPoint]) -> LinkProblems {
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    let at = |points: &[TrackPoint], index: u32| points.get(index as usize).copied();
    let row = |point: &TrackPoint| (point.time_ms, point.lane, point.position_decreases);
    let unplaced = || points.iter().filter(|point| point.position_m.is_none() || point.length_m.is_none());
    let unplaced = unplaced().map(|point| point.line).min().map(|first| (first, unplaced().count()));
    let unlinkable: BTreeSet<_> = points.iter().filter(|point| point.position_m.is_none()).map(row).collect();
    order.sort_by(|&a, &b| match (at(points, a), at(points, b)) {
        (Some(a), Some(b)) => row(&a).cmp(&row(&b)).then(b.front_m.total_cmp(&a.front_m)),
        _ => Ordering::Equal,
    });
    let mut overlapping: Option<(u64, usize)> = None;
    for pair in order.windows(2) {
        let &[front, rear] = pair else { continue };
        let (Some(ahead), Some(behind)) = (at(points, front), at(points, rear)) else { continue };
        if row(&ahead) != row(&behind) || unlinkable.contains(&row(&ahead)) {
            continue;
        }
        let (Some(length_m), Some(_)) = (ahead.length_m, behind.length_m) else { continue };
        let gap_m = ahead.front_m - length_m - behind.front_m;
        if ColumnQuantity::Gap.allows(gap_m) {
            if let Some(point) = points.get_mut(rear as usize) {
                point.ahead = Some((gap_m, front));
            }
            if let Some(point) = points.get_mut(front as usize) {
                point.behind = Some(rear);
            }
        } else if round_to_milli(gap_m) <= 0.0 {
            overlapping.get_or_insert((behind.line, 0)).1 += 1;
        }
    }
    LinkProblems { overlapping, unknown_position: unplaced }
}

impl RecordedTraffic {
    fn point(&self, index: usize) -> Option<&TrackPoint> {
        self.points.get(index)
    }

    /// Returns every vehicle: each may have a follower at some time.
    pub(super) fn lead_vehicles(&self) -> impl Iterator<Item = Box<dyn LeadVehicle + '_>> {
        let mut from = 0;
        self.points.chunk_by(|a, b| a.vehicle == b.vehicle).map(move |track| {
            let first = from;
            from += track.len();
            Box::new(TrafficLead { traffic: self, first, track }) as Box<dyn LeadVehicle>
        })
    }
}

struct TrafficLead<'a> {
    traffic: &'a RecordedTraffic,
    /// Index of its first point.
    first: usize,
    track: &'a [TrackPoint],
}

impl LeadVehicle for TrafficLead<'_> {
    fn segments(&self) -> Vec<Vec<SpeedSample>> {
        let sample = |(index, point): (usize, &TrackPoint)| {
            Some(SpeedSample {
                index: self.first + index,
                time_ms: point.time_ms,
                speed_mps: round_to_milli(point.speed_mps?),
            })
        };
        split_at_holes(self.track.iter().enumerate().filter_map(sample))
    }

    fn episode_vehicle(&self, speed_mps: f64) -> EpisodeVehicle {
        let number = self.track.first().map_or(0, |point| point.vehicle as usize);
        let length_m = self.track.iter().find_map(|point| point.length_m).map(round_to_milli);
        EpisodeVehicle { number, name: None, gap_ahead_m: 0.0, speed_mps, length_m }
    }

    fn followers_at(&self, sample: &SpeedSample) -> Vec<EpisodeVehicle> {
        let mut ahead = self.traffic.point(sample.index);
        let next = || {
            let behind = self.traffic.point(ahead?.behind? as usize)?;
            ahead = Some(behind);
            Some(EpisodeVehicle {
                number: behind.vehicle as usize,
                name: None,
                gap_ahead_m: round_to_milli(behind.ahead?.0),
                speed_mps: round_to_milli(behind.speed_mps?),
                length_m: behind.length_m.map(round_to_milli),
            })
        };
        std::iter::from_fn(next).take(MAX_FOLLOWERS).collect()
    }

    fn follower_speed_at_mps(&self, sample: &SpeedSample, followers: usize) -> Option<f64> {
        let behind = self.followers_at(sample);
        behind.first().filter(|_| behind.len() >= followers).map(|next| next.speed_mps)
    }

    fn next_behind(&self, _: usize) -> Option<usize> {
        None
    }

    fn vehicle_ahead_at(&self, sample: &SpeedSample) -> VehicleAhead {
        let ahead = self.traffic.point(sample.index).and_then(|point| self.traffic.point(point.ahead?.1 as usize));
        match ahead {
            None => VehicleAhead::None,
            Some(ahead) if ahead.speed_mps.is_some() => VehicleAhead::Recorded(ahead.vehicle as usize),
            Some(ahead) => VehicleAhead::NotRecorded(ahead.vehicle as usize),
        }
    }

    fn line_of(&self, sample: &SpeedSample) -> u64 {
        self.traffic.point(sample.index).map_or(0, |point| point.line)
    }

    fn event(&self) -> Option<&str> {
        None
    }
}
