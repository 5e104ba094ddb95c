//! Leaders of episodes and the vehicles around them.

use std::ops::Range;

use super::episode::EpisodeVehicle;
use super::motion::{SpeedSample, platoon_samples, split_at_holes};
use super::series::round_to_milli;
use super::{RecordedPlatoon, RecordedTraffic, Recording};

/// Vehicle ahead of a braking vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VehicleAhead {
    /// No recorded vehicle.
    None,
    /// Vehicle number, with known speed and gap.
    Recorded(usize),
    /// Vehicle number, with unknown speed or gap.
    NotRecorded(usize),
}

/// A recorded vehicle as a leader.
pub(super) trait LeadVehicle {
    /// Returns the segments of its motion without holes.
    fn segments(&self) -> Vec<Vec<SpeedSample>>;
    /// Returns the number of the vehicle.
    fn number(&self) -> usize;
    /// Returns the vehicle itself at a sample.
    fn episode_vehicle(&self, sample: &SpeedSample) -> EpisodeVehicle;
    /// Returns the consecutive followers with known speeds and gaps at a sample, front to rear.
    fn followers_at(&self, sample: &SpeedSample) -> Vec<EpisodeVehicle>;
    /// Returns the speed of the next follower, if at least `followers` followers have known speeds and gaps.
    fn follower_speed_at_mps(&self, sample: &SpeedSample, followers: usize) -> Option<f64>;
    /// Returns the speeds of a follower, counted from 1, from a sample on, until a time or a hole of half a second.
    fn speeds_of_follower(
        &self,
        start: &SpeedSample,
        follower: usize,
        until_ms: i64,
    ) -> Vec<SpeedSample>;
    /// Returns the number of the vehicle behind the first `followers` followers, if recorded.
    fn next_behind(&self, followers: usize) -> Option<usize>;
    fn vehicle_ahead_at(&self, sample: &SpeedSample) -> VehicleAhead;
    fn line_of(&self, sample: &SpeedSample) -> u64;
    fn event(&self) -> Option<&str>;
    /// Returns the times at which braking belongs to this part of the recording.
    fn core_ms(&self) -> Range<i64>;
}

impl Recording {
    /// Returns all vehicles with a follower, front to rear.
    pub(super) fn lead_vehicles(&self) -> Vec<Box<dyn LeadVehicle + '_>> {
        let in_platoons = self.platoons.iter().flat_map(|platoon| {
            let leads = 0..platoon.lead_count;
            leads.map(move |index| Box::new(PlatoonLead { platoon, index }) as Box<dyn LeadVehicle>)
        });
        in_platoons
            .chain(self.traffic.iter().flat_map(RecordedTraffic::lead_vehicles))
            .collect()
    }
}

/// A vehicle of a platoon, whose order never changes.
pub(super) struct PlatoonLead<'a> {
    pub(super) platoon: &'a RecordedPlatoon,
    pub(super) index: usize,
}

impl PlatoonLead<'_> {
    fn number_of(&self, index: usize) -> Option<usize> {
        self.platoon
            .vehicles
            .get(index)
            .map(|vehicle| vehicle.number)
    }

    fn episode_vehicle_at(&self, index: usize, gap_ahead_m: f64, speed_mps: f64) -> EpisodeVehicle {
        let name = self
            .platoon
            .vehicles
            .get(index)
            .and_then(|vehicle| vehicle.name.clone());
        EpisodeVehicle {
            number: self.number_of(index).unwrap_or(0),
            name,
            gap_ahead_m,
            speed_mps,
            length_m: None,
        }
    }
}

impl LeadVehicle for PlatoonLead<'_> {
    fn segments(&self) -> Vec<Vec<SpeedSample>> {
        split_at_holes(platoon_samples(self.platoon, self.index, 0))
    }

    fn number(&self) -> usize {
        self.number_of(self.index).unwrap_or(0)
    }

    fn episode_vehicle(&self, sample: &SpeedSample) -> EpisodeVehicle {
        self.episode_vehicle_at(self.index, 0.0, sample.speed_mps)
    }

    fn followers_at(&self, sample: &SpeedSample) -> Vec<EpisodeVehicle> {
        let behind = self.index + 1..self.platoon.vehicles.len();
        let followers = behind.map_while(|index| {
            let gap_and_speed = self.platoon.gap_and_speed(index, sample.index);
            gap_and_speed.map(|(gap_m, speed_mps)| {
                self.episode_vehicle_at(index, round_to_milli(gap_m), round_to_milli(speed_mps))
            })
        });
        followers.collect()
    }

    fn follower_speed_at_mps(&self, sample: &SpeedSample, followers: usize) -> Option<f64> {
        let mut behind = self.index + 1..=self.index + followers;
        let are_known = behind
            .clone()
            .all(|index| self.platoon.gap_and_speed(index, sample.index).is_some());
        behind
            .next()
            .filter(|_| are_known)
            .and_then(|next| Some(self.platoon.gap_and_speed(next, sample.index)?.1))
    }

    fn speeds_of_follower(
        &self,
        start: &SpeedSample,
        follower: usize,
        until_ms: i64,
    ) -> Vec<SpeedSample> {
        let samples = platoon_samples(self.platoon, self.index + follower, start.index)
            .take_while(|sample| sample.time_ms <= until_ms);
        split_at_holes(samples)
            .into_iter()
            .next()
            .unwrap_or_default()
    }

    fn next_behind(&self, followers: usize) -> Option<usize> {
        self.number_of(self.index + followers + 1)
    }

    fn vehicle_ahead_at(&self, sample: &SpeedSample) -> VehicleAhead {
        let Some(index) = self.index.checked_sub(1) else {
            return VehicleAhead::None;
        };
        let number = self.number_of(index).unwrap_or(0);
        let drives = self
            .platoon
            .vehicles
            .get(index)
            .is_some_and(|ahead| ahead.speed_at_mps(sample.index).is_some());
        let is_known = drives
            && self
                .platoon
                .gap_and_speed(self.index, sample.index)
                .is_some();
        if is_known {
            VehicleAhead::Recorded(number)
        } else {
            VehicleAhead::NotRecorded(number)
        }
    }

    fn line_of(&self, sample: &SpeedSample) -> u64 {
        self.platoon.line.get(sample.index).copied().unwrap_or(0)
    }

    fn event(&self) -> Option<&str> {
        self.platoon.event.as_deref()
    }

    fn core_ms(&self) -> Range<i64> {
        self.platoon.core_ms.clone()
    }
}
