//! Lane ids that hold only briefly, and the direction of travel of each lane.

use std::collections::BTreeMap;

use super::split::{DirectionVotes, track_votes};
use super::{ReferencePoint, STANDING_NOISE_MPS, TrackPoint};

/// Mean signed speed that shows the direction of a vehicle in a lane without moving traffic, in m/s.
const MIN_SIGNED_SPEED_MPS: f64 = 0.1;
/// Fastest vehicle that rolls back, in m/s.
pub(super) const MAX_ROLLING_MPS: f64 = 3.0;

/// Replaces lane ids that a track has for less than `shortest_ms` by the lane before; at the start of a track by the
/// lane after. A track that has no lane for that long gets the lane of two thirds of its rows, if there is one. Returns
/// the first replaced point and the number of replaced intervals.
pub(super) fn remove_blips(
    points: &mut [TrackPoint],
    shortest_ms: i64,
) -> Option<(TrackPoint, usize)> {
    let mut blips: Option<(TrackPoint, usize)> = None;
    for track in points.chunk_by_mut(|a, b| a.track == b.track) {
        let is_stable = lane_intervals(track, shortest_ms);
        let first_stable = track
            .iter()
            .zip(&is_stable)
            .find(|(_, stable)| **stable)
            .map(|(point, _)| point.lane);
        let Some(mut lane) = first_stable.or_else(|| most_common_lane(track)) else {
            continue;
        };
        let mut was_blip = false;
        for (point, stable) in track.iter_mut().zip(is_stable) {
            if stable {
                lane = point.lane;
            }
            let is_blip = point.lane != lane;
            if is_blip && !was_blip && !point.is_margin {
                blips.get_or_insert((*point, 0)).1 += 1;
            }
            point.lane = lane;
            was_blip = is_blip;
        }
    }
    blips
}

/// Returns the lane of at least two thirds of the rows.
fn most_common_lane(track: &[TrackPoint]) -> Option<u32> {
    let mut rows: BTreeMap<u32, usize> = BTreeMap::new();
    track
        .iter()
        .for_each(|point| *rows.entry(point.lane).or_default() += 1);
    rows.into_iter()
        .find(|(_, rows)| 3 * rows >= 2 * track.len())
        .map(|(lane, _)| lane)
}

/// Returns for each point whether the track has its lane for at least `shortest_ms` around it.
fn lane_intervals(track: &[TrackPoint], shortest_ms: i64) -> Vec<bool> {
    // The last row of an interval counts for one step: an absence shows no lane.
    let steps = track
        .windows(2)
        .filter_map(|pair| Some(pair.last()?.time_ms - pair.first()?.time_ms));
    let step_ms = steps.min().unwrap_or(0);
    let mut is_stable = Vec::with_capacity(track.len());
    for interval in track.chunk_by(|a, b| a.lane == b.lane) {
        let lasts_ms = interval
            .first()
            .zip(interval.last())
            .map_or(0, |(first, last)| last.time_ms - first.time_ms);
        is_stable.resize(
            is_stable.len() + interval.len(),
            lasts_ms + step_ms >= shortest_ms,
        );
    }
    is_stable
}

/// Determines the direction of travel of each track, and the front bumper of each point. A standing vehicle has the
/// direction of the traffic in its lane. Returns the first speed of a vehicle that rolls back, and their number.
pub(super) fn orient(
    points: &mut [TrackPoint],
    reference: ReferencePoint,
    speeds_agree: bool,
) -> Option<(TrackPoint, usize)> {
    let votes = TrafficVotes::count(points, speeds_agree);
    for (track, direction) in points
        .chunk_by_mut(|a, b| a.track == b.track)
        .zip(&votes.track_directions)
    {
        let by_speed = is_negative(track).filter(|is_negative| *is_negative);
        for point in track {
            point.position_decreases = direction
                .or_else(|| votes.by_lane.get(&point.lane)?.majority_decreases())
                .or(by_speed)
                .or_else(|| votes.all.majority_decreases())
                .unwrap_or(false);
            point.front_m = front_m(point, reference);
        }
    }
    let is_same_interval = |a: &TrackPoint, b: &TrackPoint| (a.track, a.lane) == (b.track, b.lane);
    let mut signs = SpeedSigns::default();
    let own_signs: Vec<_> = points
        .chunk_by(is_same_interval)
        .map(|interval| signs.add(interval, speeds_agree))
        .collect();
    let mut rolling: Option<(TrackPoint, usize)> = None;
    for (interval, own_sign) in points.chunk_by_mut(is_same_interval).zip(own_signs) {
        for point in interval {
            let sign = own_sign.or_else(|| signs.of_direction(point.position_decreases));
            if let Some(speed_mps) = point.speed_mps {
                let forward_mps = forward_mps(speed_mps, sign);
                point.speed_mps = Some(forward_mps.max(0.0));
                if forward_mps < -STANDING_NOISE_MPS && !point.is_margin {
                    rolling.get_or_insert((*point, 0)).1 += 1;
                }
            }
        }
    }
    rolling
}

/// Returns a speed in the direction of travel, in m/s, if speeds in this direction are negative or positive. It is
/// negative only for a vehicle that stands or rolls back; a faster one has another direction than crumple believes.
fn forward_mps(speed_mps: f64, is_negative: Option<bool>) -> f64 {
    match is_negative {
        Some(is_negative)
            if (speed_mps < 0.0) != is_negative && speed_mps.abs() <= MAX_ROLLING_MPS =>
        {
            -speed_mps.abs()
        }
        _ => speed_mps.abs(),
    }
}

/// Returns whether the speeds of points are negative in the mean; `None` if the vehicle stands.
fn is_negative(points: &[TrackPoint]) -> Option<bool> {
    let speeds_mps = || points.iter().filter_map(|point| point.speed_mps);
    let mean_mps = speeds_mps().sum::<f64>() / speeds_mps().count().max(1) as f64;
    (mean_mps.abs() > MIN_SIGNED_SPEED_MPS).then_some(mean_mps < 0.0)
}

/// Numbers of moving vehicles with positive and negative speeds, for increasing and for decreasing positions.
#[derive(Default)]
struct SpeedSigns([DirectionVotes; 2]);

impl SpeedSigns {
    /// Counts an interval of a track in one lane, if it moves. Returns whether its speeds are negative.
    fn add(&mut self, interval: &[TrackPoint], speeds_agree: bool) -> Option<bool> {
        let decreases = track_votes(interval, speeds_agree).decreases()?;
        let is_negative = is_negative(interval)?;
        self.0[usize::from(decreases)].add(DirectionVotes {
            up: usize::from(!is_negative),
            down: usize::from(is_negative),
        });
        Some(is_negative)
    }

    /// Returns whether most speeds are negative where positions change in a direction.
    fn of_direction(&self, decreases: bool) -> Option<bool> {
        self.0[usize::from(decreases)].majority_decreases()
    }
}

/// Votes for the directions of travel in a recording.
#[derive(Default)]
struct TrafficVotes {
    /// Direction of each track, if its own movement shows it.
    track_directions: Vec<Option<bool>>,
    by_lane: BTreeMap<u32, DirectionVotes>,
    all: DirectionVotes,
}

impl TrafficVotes {
    /// Counts the movements of all tracks.
    fn count(points: &[TrackPoint], speeds_agree: bool) -> Self {
        let mut sum = Self::default();
        for track in points.chunk_by(|a, b| a.track == b.track) {
            let votes = track_votes(track, speeds_agree);
            sum.track_directions.push(votes.decreases());
            for interval in track.chunk_by(|a, b| a.lane == b.lane) {
                // Most tracks have one lane.
                let votes = if interval.len() == track.len() {
                    votes
                } else {
                    track_votes(interval, speeds_agree)
                };
                let lane = interval.first().map_or(0, |point| point.lane);
                sum.by_lane.entry(lane).or_default().add(votes);
                sum.all.add(votes);
            }
        }
        sum
    }
}

/// Returns the position of the front bumper in the direction of driving. Vehicles do not overlap, so a point without
/// length still sorts correctly in its lane.
fn front_m(point: &TrackPoint, reference: ReferencePoint) -> f64 {
    let position_m = point.position_m.unwrap_or(0.0);
    let length_m = point.length_m.unwrap_or(0.0);
    let decreases = point.position_decreases;
    let to_front_m = match reference {
        ReferencePoint::Front => 0.0,
        ReferencePoint::Centre => length_m / 2.0,
        ReferencePoint::Rear => length_m,
        ReferencePoint::LowEnd if decreases => 0.0,
        ReferencePoint::LowEnd => length_m,
    };
    to_front_m + if decreases { -position_m } else { position_m }
}
