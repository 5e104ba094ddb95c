//! What happened, sample by sample.

use std::ops::Range;

use super::lane::TIME_TOLERANCE_S;
use super::motion::Motion;

/// The recorded motion of all vehicles of one run.
///
/// Samples are taken at the start, after every integration step, and at the instant of first contact where the run
/// ends there. A run that goes on after contact has no samples at the contacts themselves: those are in its impacts. All
/// tracks have one length.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// Time of each sample in seconds, increasing.
    pub time_s: Vec<f64>,
    /// One track a vehicle, front to rear.
    pub vehicles: Vec<Track>,
}

/// The motion of one vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// Bumper to bumper, in metres.
    pub length_m: f64,
    /// Mass in kilograms.
    pub mass_kg: f64,
    /// Front bumper at each sample, in metres.
    pub position_m: Vec<f64>,
    /// Speed at each sample in m/s, never negative.
    pub speed_mps: Vec<f64>,
    /// Acceleration held from each sample to the next, in m/s²; the last entry repeats the one before, or is
    /// what an impact in between made of it.
    ///
    /// In a step in which the vehicle stops it is the acceleration until it stops; it is 0 from the next step on while the
    /// vehicle stands, whatever is commanded. Changes of speed in impacts are not part of it.
    pub acceleration_mps2: Vec<f64>,
    /// From when until when it was in the lane, in seconds: [`THROUGHOUT_S`](Self::THROUGHOUT_S), unless it entered or left. From
    /// infinity on where it never was. Beside the lane it has no neighbours.
    pub in_lane_s: [f64; 2],
}

impl Track {
    /// In the lane from before the start until after the end.
    pub const THROUGHOUT_S: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

    /// Whether it was in the lane at a time in seconds; at the instant of a change it is where it then is.
    #[must_use]
    pub fn is_in_lane(&self, time_s: f64) -> bool {
        let [from_s, to_s] = self.in_lane_s;
        from_s - TIME_TOLERANCE_S <= time_s && time_s < to_s - TIME_TOLERANCE_S
    }

    /// How it moved at a sample, and from there on.
    pub(crate) fn motion(&self, sample: usize) -> Option<Motion> {
        Some(Motion {
            position_m: *self.position_m.get(sample)?,
            speed_mps: *self.speed_mps.get(sample)?,
            acceleration_mps2: *self.acceleration_mps2.get(sample)?,
        })
    }

    /// How it moved at a time in seconds, by the last of `times_s` that is not later; none before the first.
    fn motion_at(&self, times_s: &[f64], time_s: f64) -> Option<Motion> {
        let sample = times_s.partition_point(|&sampled_s| sampled_s <= time_s).checked_sub(1)?;
        Some(self.motion(sample)?.after(time_s - times_s.get(sample)?))
    }
}

impl Trace {
    /// The number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether there are no samples.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// The pairs of a vehicle and whoever was ahead of it in the lane, in order of time: none for the leader, one where nobody
    /// enters or leaves.
    #[must_use]
    pub fn pairs(&self, rear: usize) -> Vec<VehiclePair<'_>> {
        let Some((rear, ahead)) = self.vehicles.get(rear).zip(self.vehicles.get(..rear)) else { return Vec::new() };
        let mut changes_s: Vec<f64> = ahead.iter().chain([rear]).flat_map(|track| track.in_lane_s).collect();
        changes_s.extend(Track::THROUGHOUT_S);
        changes_s.sort_by(f64::total_cmp);
        changes_s.dedup();
        // Who leaves at the start was never there.
        let before_s = self.time_s.first().map_or(f64::NEG_INFINITY, |first_s| first_s + TIME_TOLERANCE_S);
        let mut pairs: Vec<VehiclePair<'_>> = Vec::new();
        for (&from_s, &to_s) in changes_s.iter().zip(changes_s.iter().skip(1)).filter(|(_, to_s)| **to_s > before_s) {
            let is_there = |track: &&Track| track.in_lane_s[0] <= from_s && to_s <= track.in_lane_s[1];
            let Some(front_vehicle) = ahead.iter().rposition(|track| is_there(&track)).filter(|_| is_there(&rear))
            else {
                continue;
            };
            let goes_on = |last: &&mut VehiclePair<'_>| last.front_vehicle == front_vehicle && last.span_s[1] == from_s;
            match pairs.last_mut().filter(goes_on) {
                Some(last) => last.span_s[1] = to_s,
                None => {
                    let front = &ahead[front_vehicle];
                    pairs.push(VehiclePair {
                        time_s: &self.time_s,
                        front_vehicle,
                        front,
                        rear,
                        span_s: [from_s, to_s],
                    });
                }
            }
        }
        pairs
    }

    /// Bumper gap ahead of a vehicle in metres at each sample; none where nobody is ahead of it in the lane.
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

    /// Who is ahead of a vehicle in the lane at each sample.
    pub fn leaders(&self, rear: usize) -> impl Iterator<Item = Option<&Track>> {
        let own = self.vehicles.get(rear);
        self.time_s.iter().map(move |&time_s| {
            own.filter(|own| own.is_in_lane(time_s))?;
            self.vehicles.get(..rear)?.iter().rev().find(|front| front.is_in_lane(time_s))
        })
    }
}

/// Two successive vehicles of a trace, as long as nobody was between them.
#[derive(Debug, Clone, Copy)]
pub struct VehiclePair<'a> {
    /// Time of each sample in seconds.
    pub time_s: &'a [f64],
    /// Index of the vehicle ahead.
    pub front_vehicle: usize,
    /// The vehicle ahead.
    pub front: &'a Track,
    /// The vehicle behind.
    pub rear: &'a Track,
    /// From when until when, in seconds; without end where neither entered or left.
    pub span_s: [f64; 2],
}

impl<'a> VehiclePair<'a> {
    /// Bumper gap in metres at each sample of that time, with the sample's number.
    pub fn gaps_m(&self) -> impl Iterator<Item = (usize, f64)> + use<'a> {
        let Self { front, rear, .. } = *self;
        self.samples().filter_map(move |sample| {
            let [front_m, rear_m] = [front.position_m.get(sample)?, rear.position_m.get(sample)?];
            Some((sample, front_m - front.length_m - rear_m))
        })
    }

    /// The samples of that time, both ends included.
    pub(crate) fn samples(&self) -> Range<usize> {
        let [from_s, to_s] = self.span_s;
        let first = self.time_s.partition_point(|&time_s| time_s < from_s - TIME_TOLERANCE_S);
        let end = self.time_s.partition_point(|&time_s| time_s <= to_s + TIME_TOLERANCE_S);
        first..end
    }

    /// How the two, front and rear, moved at a time in seconds.
    pub(crate) fn motion_at(&self, time_s: f64) -> Option<[Motion; 2]> {
        Some([self.front.motion_at(self.time_s, time_s)?, self.rear.motion_at(self.time_s, time_s)?])
    }
}
