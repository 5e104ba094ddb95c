//! Tracks as leaders of episodes.

use std::ops::Range;

use super::super::episode::EpisodeVehicle;
use super::super::lead_vehicles::{LeadVehicle, VehicleAhead};
use super::super::motion::{SpeedSample, split_at_holes};
use super::super::series::round_to_milli;
use super::{RecordedTraffic, TrackPoint, VehicleId};

/// Maximum number of followers in a scenario. A braking wave reaches vehicles further behind only after the end of the
/// episode.
const MAX_FOLLOWERS: usize = 9;

impl RecordedTraffic {
    pub(super) fn point(&self, index: usize) -> Option<&TrackPoint> {
        self.points.get(index)
    }

    fn id(&self, point: &TrackPoint) -> VehicleId {
        self.vehicles
            .get(point.vehicle as usize)
            .cloned()
            .unwrap_or(VehicleId {
                number: 0,
                name: None,
            })
    }

    /// Returns a vehicle with its length at that time.
    fn episode_vehicle(
        &self,
        point: &TrackPoint,
        gap_ahead_m: f64,
        speed_mps: f64,
    ) -> EpisodeVehicle {
        let VehicleId { number, name } = self.id(point);
        EpisodeVehicle {
            number,
            name,
            gap_ahead_m,
            speed_mps,
            length_m: point.length_m.map(round_to_milli),
        }
    }

    /// Returns every track: each may have a follower at some time.
    pub(in super::super) fn lead_vehicles(
        &self,
    ) -> impl Iterator<Item = Box<dyn LeadVehicle + '_>> {
        let mut from = 0;
        self.points
            .chunk_by(|a, b| a.track == b.track)
            .map(move |track| {
                let first = from;
                from += track.len();
                Box::new(TrafficLead {
                    traffic: self,
                    first,
                    track,
                }) as Box<dyn LeadVehicle>
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
        let samples = self.track.iter().enumerate();
        split_at_holes(samples.filter_map(|(index, point)| {
            Some(SpeedSample {
                index: self.first + index,
                time_ms: point.time_ms,
                speed_mps: round_to_milli(point.speed_mps?),
            })
        }))
    }

    fn number(&self) -> usize {
        self.track
            .first()
            .map_or(0, |point| self.traffic.id(point).number)
    }

    fn episode_vehicle(&self, sample: &SpeedSample) -> EpisodeVehicle {
        let point = self
            .traffic
            .point(sample.index)
            .copied()
            .unwrap_or_default();
        self.traffic.episode_vehicle(&point, 0.0, sample.speed_mps)
    }

    fn followers_at(&self, sample: &SpeedSample) -> Vec<EpisodeVehicle> {
        let mut ahead = self.traffic.point(sample.index);
        let followers = std::iter::from_fn(|| {
            let behind = self.traffic.point(ahead?.behind? as usize)?;
            ahead = Some(behind);
            Some(self.traffic.episode_vehicle(
                behind,
                round_to_milli(behind.ahead?.0),
                round_to_milli(behind.speed_mps?),
            ))
        });
        followers.take(MAX_FOLLOWERS).collect()
    }

    fn follower_speed_at_mps(&self, sample: &SpeedSample, followers: usize) -> Option<f64> {
        let behind = self.followers_at(sample);
        behind
            .first()
            .filter(|_| behind.len() >= followers)
            .map(|next| next.speed_mps)
    }

    fn speeds_of_follower(
        &self,
        start: &SpeedSample,
        follower: usize,
        until_ms: i64,
    ) -> Vec<SpeedSample> {
        let mut index = start.index;
        for _ in 0..follower {
            match self.traffic.point(index).and_then(|point| point.behind) {
                Some(behind) => index = behind as usize,
                None => return Vec::new(),
            }
        }
        let points = self.traffic.points.get(index..).unwrap_or_default();
        let Some(first) = points.first() else {
            return Vec::new();
        };
        let track = points
            .iter()
            .take_while(|point| point.track == first.track && point.time_ms <= until_ms);
        let samples = track.enumerate().filter_map(|(offset, point)| {
            Some(SpeedSample {
                index: index + offset,
                time_ms: point.time_ms,
                speed_mps: round_to_milli(point.speed_mps?),
            })
        });
        split_at_holes(samples)
            .into_iter()
            .next()
            .unwrap_or_default()
    }

    fn next_behind(&self, _: usize) -> Option<usize> {
        None
    }

    fn vehicle_ahead_at(&self, sample: &SpeedSample) -> VehicleAhead {
        let ahead = self
            .traffic
            .point(sample.index)
            .and_then(|point| self.traffic.point(point.ahead?.1 as usize));
        match ahead {
            None => VehicleAhead::None,
            Some(ahead) if ahead.speed_mps.is_some() => {
                VehicleAhead::Recorded(self.traffic.id(ahead).number)
            }
            Some(ahead) => VehicleAhead::NotRecorded(self.traffic.id(ahead).number),
        }
    }

    fn line_of(&self, sample: &SpeedSample) -> u64 {
        self.traffic
            .point(sample.index)
            .map_or(0, |point| point.line)
    }

    fn event(&self) -> Option<&str> {
        None
    }

    fn core_ms(&self) -> Range<i64> {
        self.traffic.core_ms.clone()
    }
}
