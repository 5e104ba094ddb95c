//! Tracks: the stage between the rows of a recording of traffic and its episodes.
//!
//! 1. [`split`] divides the rows of each vehicle id into tracks, where a position starts anew or an id is used again,
//!    and determines the direction of travel of each from the movement between rows.
//! 2. [`lanes`] replaces lane ids that hold only briefly, and gives standing vehicles the direction of their lane.
//! 3. [`fill`] interpolates short holes, as the map demands.
//! 4. [`link`] links leaders and followers at each instant, except across vehicles whose place is unknown.

mod fill;
mod lanes;
mod lead;
mod link;
mod split;
#[cfg(test)]
mod tests;

use std::ops::Range;
use std::sync::Arc;

use super::dropped::Omission;
use super::map::ReferencePoint;
use super::series::STANDING_NOISE_MPS;
use crumple_core::digits::format_number;

/// Vehicles with changing neighbours.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedTraffic {
    /// Points sorted by track, then by time. The tracks of one vehicle are in order of time.
    points: Vec<TrackPoint>,
    vehicles: Arc<[VehicleId]>,
    /// Times at which braking belongs to this part of the recording.
    core_ms: Range<i64>,
}

/// Identity of a vehicle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct VehicleId {
    /// Id in the file; order of the first row, from 1, if ids are text.
    pub(super) number: usize,
    /// Id in the file, if it is text.
    pub(super) name: Option<String>,
}

/// State of a vehicle at one time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct TrackPoint {
    /// Index of the vehicle's id.
    pub(super) vehicle: u32,
    pub(super) track: u32,
    pub(super) lane: u32,
    pub(super) time_ms: i64,
    pub(super) line: u64,
    /// Position along the road, as recorded, in metres.
    pub(super) position_m: Option<f64>,
    /// Speed as recorded, of either sign, in m/s; without sign after orientation.
    pub(super) speed_mps: Option<f64>,
    pub(super) length_m: Option<f64>,
    pub(super) acceleration_mps2: Option<f32>,
    /// Front bumper in the direction of driving, in metres; meaningless if position or length is unknown.
    pub(super) front_m: f64,
    /// True if positions decrease as the vehicle drives.
    pub(super) position_decreases: bool,
    /// True in the margins of a part of a recording, where another part counts omissions.
    pub(super) is_margin: bool,
    /// Gap ahead, in metres, and index of the leader's point.
    pub(super) ahead: Option<(f64, u32)>,
    /// Index of the follower's point.
    pub(super) behind: Option<u32>,
}

/// Settings of the map for tracks.
#[derive(Debug, Clone, Copy)]
pub(super) struct TrackRules {
    pub(super) reference: ReferencePoint,
    /// Longest hole that is interpolated, in seconds.
    pub(super) interpolate_s: f64,
    /// Lane ids that hold for fewer seconds are blips.
    pub(super) lane_blip_s: f64,
    /// False if speeds contradict positions, so that speeds cannot show where a position starts anew.
    pub(super) speeds_agree: bool,
}

/// Occurrences of one kind: line of the first, and number.
type Occurrences = Option<(u64, usize)>;

fn to_ms(seconds: f64) -> i64 {
    (seconds * 1000.0).round() as i64
}

/// Returns an unsigned number in the order of `time_ms`.
fn sortable(time_ms: i64) -> u64 {
    time_ms as u64 ^ 1 << 63
}

/// Sorts points, which are in order of their lines, by vehicle and time. Keeps the first of several points of a vehicle
/// at one time. Returns the first duplicate and the number of duplicates.
pub(super) fn sort(points: &mut Vec<TrackPoint>) -> Option<(TrackPoint, usize)> {
    let mut order: Vec<u128> = points
        .iter()
        .zip(0_u32..)
        .map(|(point, index)| {
            u128::from(point.vehicle) << 96
                | u128::from(sortable(point.time_ms)) << 32
                | u128::from(index)
        })
        .collect();
    order.sort_unstable();
    for to in 0..points.len() {
        let mut from = order[to] as u32 as usize;
        // Earlier swaps moved this point.
        while from < to {
            from = order[from] as u32 as usize;
        }
        order[to] = from as u128;
        points.swap(to, from);
    }
    let mut duplicate: Option<(TrackPoint, usize)> = None;
    points.dedup_by(|later, first| {
        let is_twice = (later.vehicle, later.time_ms) == (first.vehicle, first.time_ms);
        if is_twice && !later.is_margin {
            duplicate.get_or_insert((*later, 0)).1 += 1;
        }
        is_twice
    });
    duplicate
}

impl RecordedTraffic {
    /// Returns whether a vehicle follows another at any time.
    pub(super) fn has_followers(&self) -> bool {
        self.points.iter().any(|point| point.ahead.is_some())
    }

    /// Builds tracks from sorted points, and links leaders and followers. Appends omissions, with the line of their
    /// first occurrence. The error is the line at which interpolation makes too many points.
    pub(super) fn build(
        mut points: Vec<TrackPoint>,
        (vehicles, core_ms): (Arc<[VehicleId]>, Range<i64>),
        rules: TrackRules,
        dropped: &mut Vec<(u64, Omission)>,
    ) -> Result<Self, u64> {
        if let Some((first, count)) = split::split(&mut points, rules.speeds_agree) {
            let vehicle = label(&vehicles, first.vehicle);
            dropped.push((first.line, split_omission(&vehicle, count)));
        }
        if let Some((first, count)) = lanes::remove_blips(&mut points, to_ms(rules.lane_blip_s)) {
            let vehicle = label(&vehicles, first.vehicle);
            dropped.push((
                first.line,
                blip_omission(&vehicle, rules.lane_blip_s, count),
            ));
        }
        if let Some((line, count)) = fill::fill_holes(&mut points, rules.interpolate_s)? {
            let after = " missing rows and values of vehicles were filled by straight lines, the first one here";
            dropped.push((line, Omission::counted("", count, after)));
        }
        if let Some((first, count)) =
            lanes::orient(&mut points, rules.reference, rules.speeds_agree)
        {
            let vehicle = label(&vehicles, first.vehicle);
            dropped.push((first.line, backward_omission(&vehicle, count)));
        }
        link::link(&mut points, to_ms(rules.lane_blip_s), dropped);
        Ok(Self {
            points,
            vehicles,
            core_ms,
        })
    }
}

/// Returns the omission of tracks that begin within the rows of a vehicle, the first one.
fn split_omission(vehicle: &str, count: usize) -> Omission {
    let before = format!(
        "the position of vehicle {vehicle} starts anew here, or another vehicle has its id; of "
    );
    Omission::counted(before, count, " such places each begins another track")
}

/// Returns the omission of speeds against the direction of travel, the first one of a vehicle.
fn backward_omission(vehicle: &str, count: usize) -> Omission {
    let before = format!("vehicle {vehicle} rolls back here; ");
    let after = format!(
        " such speeds, from {STANDING_NOISE_MPS} to {} m/s, count as 0",
        lanes::MAX_ROLLING_MPS
    );
    Omission::counted(before, count, after)
}

/// Returns the omission of lane ids that hold only briefly, the first one of a vehicle.
fn blip_omission(vehicle: &str, limit_s: f64, count: usize) -> Omission {
    let limit_s = format_number(limit_s);
    let before = format!("vehicle {vehicle} has another lane for less than {limit_s} s here; ");
    let after = " such blips, in which vehicles keep their lane";
    Omission::counted(before, count, after)
}

/// Returns the id of a vehicle as recorded.
pub(super) fn label(vehicles: &[VehicleId], vehicle: u32) -> String {
    let id = vehicles.get(vehicle as usize);
    id.map(|id| id.name.clone().unwrap_or_else(|| id.number.to_string()))
        .unwrap_or_default()
}
