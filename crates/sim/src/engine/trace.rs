//! Recorded motion, sample by sample.

use std::ops::Range;

use super::lane::TIME_TOLERANCE_S;
use super::motion::Motion;

/// Recorded motion of all vehicles of one run.
///
/// Samples are at the start, after every integration step, and at a first collision that ends the run. A run that
/// continues has no samples at collisions; its impacts describe them. All tracks have the same length.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// Time of each sample in seconds, increasing.
    pub time_s: Vec<f64>,
    /// Tracks, one per vehicle, front to rear.
    pub vehicles: Vec<Track>,
}

/// Motion of one vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// Length from bumper to bumper, in metres.
    pub length_m: f64,
    /// Mass in kilograms.
    pub mass_kg: f64,
    /// Position of the front bumper at each sample, in metres.
    pub position_m: Vec<f64>,
    /// Speed at each sample in m/s, never negative.
    pub speed_mps: Vec<f64>,
    /// Acceleration from each sample to the next, in m/s². The last entry repeats the one before, or is the
    /// acceleration after an impact.
    ///
    /// If the vehicle stops within a step, the entry is the acceleration before the stop. It is 0 while the vehicle
    /// stands. Changes of speed by impacts are not included.
    pub acceleration_mps2: Vec<f64>,
    /// Times of entry and exit, in seconds: [`THROUGHOUT_S`](Self::THROUGHOUT_S) without lane changes, infinite if the
    /// vehicle never entered. Outside the lane a vehicle has no neighbours.
    pub in_lane_s: [f64; 2],
}

impl Track {
    /// In the lane from before the start until after the end.
    pub const THROUGHOUT_S: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

    /// True if the vehicle is in the lane at a time in seconds, after any change at that instant.
    #[must_use]
    pub fn is_in_lane(&self, time_s: f64) -> bool {
        let [from_s, to_s] = self.in_lane_s;
        from_s - TIME_TOLERANCE_S <= time_s && time_s < to_s - TIME_TOLERANCE_S
    }

    /// Returns the motion at a sample; `None` beyond the last one.
    #[must_use]
    pub fn motion(&self, sample: usize) -> Option<Motion> {
        Some(Motion {
            position_m: *self.position_m.get(sample)?,
            speed_mps: *self.speed_mps.get(sample)?,
            acceleration_mps2: *self.acceleration_mps2.get(sample)?,
        })
    }

    fn is_in_lane_throughout(&self, [from_s, to_s]: [f64; 2]) -> bool {
        self.in_lane_s[0] <= from_s && to_s <= self.in_lane_s[1]
    }

    /// Returns the motion at a time in seconds, computed from the last sample at or before it; `None` before the first
    /// sample.
    fn motion_at(&self, times_s: &[f64], time_s: f64) -> Option<Motion> {
        let sample = times_s
            .partition_point(|&sampled_s| sampled_s <= time_s)
            .checked_sub(1)?;
        Some(self.motion(sample)?.after(time_s - times_s.get(sample)?))
    }
}

impl Trace {
    /// Returns the number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True if there are no samples.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Returns the pairs of a vehicle and its successive leaders, in order of time.
    #[must_use]
    pub fn pairs(&self, rear: usize) -> Vec<VehiclePair<'_>> {
        let Some((rear, ahead)) = self.vehicles.get(rear).zip(self.vehicles.get(..rear)) else {
            return Vec::new();
        };
        let nearest = last_permanent(ahead);
        let near = &ahead[nearest..];
        let changes_s = lane_change_times_s(near.iter().chain([rear]));
        // A vehicle that leaves at the start was never in the lane.
        let before_s = self
            .time_s
            .first()
            .map_or(f64::NEG_INFINITY, |first_s| first_s + TIME_TOLERANCE_S);
        let mut pairs: Vec<VehiclePair<'_>> = Vec::new();
        for (&from_s, &to_s) in changes_s
            .iter()
            .zip(changes_s.iter().skip(1))
            .filter(|(_, to_s)| **to_s > before_s)
        {
            let span_s = [from_s, to_s];
            let Some(front_vehicle) = near
                .iter()
                .rposition(|track| track.is_in_lane_throughout(span_s))
                .map(|index| nearest + index)
                .filter(|_| rear.is_in_lane_throughout(span_s))
            else {
                continue;
            };
            match pairs.last_mut() {
                Some(last) if last.front_vehicle == front_vehicle && last.span_s[1] == from_s => {
                    last.span_s[1] = to_s;
                }
                _ => pairs.push(VehiclePair {
                    time_s: &self.time_s,
                    front_vehicle,
                    front: &ahead[front_vehicle],
                    rear,
                    span_s,
                }),
            }
        }
        pairs
    }

    /// Returns the gap ahead of a vehicle in metres at each sample; `None` without a leader.
    #[must_use]
    pub fn gaps_m(&self, rear: usize) -> Vec<Option<f64>> {
        let mut gaps_m = vec![None; self.len()];
        for (sample, gap_m) in self.pairs(rear).iter().flat_map(VehiclePair::gaps_m) {
            if let Some(at_sample) = gaps_m.get_mut(sample) {
                *at_sample = Some(gap_m);
            }
        }
        gaps_m
    }

    /// Returns the leader of a vehicle at each sample.
    pub fn leaders(&self, rear: usize) -> impl Iterator<Item = Option<&Track>> {
        let own = self.vehicles.get(rear);
        self.time_s.iter().map(move |&time_s| {
            own.filter(|own| own.is_in_lane(time_s))?;
            self.vehicles
                .get(..rear)?
                .iter()
                .rev()
                .find(|front| front.is_in_lane(time_s))
        })
    }
}

/// Returns the index of the last vehicle that never leaves the lane, otherwise 0: no vehicle ahead of it can lead those
/// behind.
fn last_permanent(ahead: &[Track]) -> usize {
    let mut tracks = ahead.iter();
    tracks
        .rposition(|track| track.is_in_lane_throughout(Track::THROUGHOUT_S))
        .unwrap_or(0)
}

/// Returns the distinct times of entries and exits, in order; the first and the last are infinite.
fn lane_change_times_s<'t>(tracks: impl Iterator<Item = &'t Track>) -> Vec<f64> {
    let mut changes_s: Vec<f64> = tracks.flat_map(|track| track.in_lane_s).collect();
    changes_s.extend(Track::THROUGHOUT_S);
    changes_s.sort_by(f64::total_cmp);
    changes_s.dedup();
    changes_s
}

/// Two successive vehicles of a trace, while no vehicle is between them.
#[derive(Debug, Clone, Copy)]
pub struct VehiclePair<'a> {
    /// Time of each sample in seconds.
    pub time_s: &'a [f64],
    /// Index of the leader.
    pub front_vehicle: usize,
    /// The leader.
    pub front: &'a Track,
    /// The follower.
    pub rear: &'a Track,
    /// Start and end of the time for which no vehicle is between the two, in seconds; infinite without lane changes.
    pub span_s: [f64; 2],
}

impl<'a> VehiclePair<'a> {
    /// Returns the gap in metres at each sample within `span_s`, with the index of the sample.
    pub fn gaps_m(&self) -> impl DoubleEndedIterator<Item = (usize, f64)> + use<'a> {
        let Self { front, rear, .. } = *self;
        self.samples().filter_map(move |sample| {
            let [front_m, rear_m] = [front.position_m.get(sample)?, rear.position_m.get(sample)?];
            Some((sample, front_m - front.length_m - rear_m))
        })
    }

    /// Returns the samples within `span_s`, including both ends.
    #[must_use]
    pub fn samples(&self) -> Range<usize> {
        let [from_s, to_s] = self.span_s;
        let first = self
            .time_s
            .partition_point(|&time_s| time_s < from_s - TIME_TOLERANCE_S);
        let end = self
            .time_s
            .partition_point(|&time_s| time_s <= to_s + TIME_TOLERANCE_S);
        first..end
    }

    /// Returns the motions of front and rear vehicle at a time in seconds.
    #[must_use]
    pub fn motion_at(&self, time_s: f64) -> Option<[Motion; 2]> {
        Some([
            self.front.motion_at(self.time_s, time_s)?,
            self.rear.motion_at(self.time_s, time_s)?,
        ])
    }
}
