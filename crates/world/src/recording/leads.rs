//! Who may lead an episode: any recorded vehicle, and what is known of those around it.

use super::Platoon;
use super::episode::Placed;
use super::motion::{Sample, runs};
use super::series::rounded;

/// The vehicle ahead of one that brakes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ahead {
    /// Nobody that the recording knows of.
    Nobody,
    /// A vehicle, by its number, whose speed and gap are known.
    Recorded(usize),
    /// A vehicle, by its number, of which they are not.
    NotRecorded(usize),
}

/// A recorded vehicle as the leader of those behind it.
pub(super) trait Lead {
    /// Unbroken stretches of its motion.
    fn runs(&self) -> Vec<Vec<Sample>>;
    /// The vehicle itself, with a speed.
    fn placed(&self, speed_mps: f64) -> Placed;
    /// Who is behind it at a sample with known speeds and gaps, front to rear, without a break.
    fn followers_at(&self, sample: &Sample) -> Vec<Placed>;
    /// Speed of the next behind it, if at least so many `followers` are behind it with known speeds and gaps.
    fn follower_speed_at_mps(&self, sample: &Sample, followers: usize) -> Option<f64>;
    /// Number of the vehicle behind the first so many followers, if the recording has one.
    fn next_behind(&self, followers: usize) -> Option<usize>;
    fn ahead_at(&self, sample: &Sample) -> Ahead;
    fn line_of(&self, sample: &Sample) -> u64;
    fn event(&self) -> Option<&str>;
}

/// A vehicle of a platoon, whose order never changes.
pub(super) struct InPlatoon<'a> {
    pub(super) platoon: &'a Platoon,
    pub(super) index: usize,
}

impl InPlatoon<'_> {
    fn number_of(&self, index: usize) -> Option<usize> {
        self.platoon.vehicles.get(index).map(|vehicle| vehicle.number)
    }

    fn at(&self, index: usize, gap_ahead_m: f64, speed_mps: f64) -> Placed {
        let name = self.platoon.vehicles.get(index).and_then(|vehicle| vehicle.name.clone());
        Placed { number: self.number_of(index).unwrap_or(0), name, gap_ahead_m, speed_mps, length_m: None }
    }
}

impl Lead for InPlatoon<'_> {
    fn runs(&self) -> Vec<Vec<Sample>> {
        runs(self.platoon, self.index)
    }

    fn placed(&self, speed_mps: f64) -> Placed {
        self.at(self.index, 0.0, speed_mps)
    }

    fn followers_at(&self, sample: &Sample) -> Vec<Placed> {
        let behind = self.index + 1..self.platoon.vehicles.len();
        let known = behind.map_while(|index| Some((index, self.platoon.following(index, sample.index)?)));
        known.map(|(index, (gap_m, speed_mps))| self.at(index, rounded(gap_m), rounded(speed_mps))).collect()
    }

    fn follower_speed_at_mps(&self, sample: &Sample, followers: usize) -> Option<f64> {
        let mut behind = self.index + 1..=self.index + followers;
        let are_known = behind.clone().all(|index| self.platoon.following(index, sample.index).is_some());
        behind.next().filter(|_| are_known).and_then(|next| Some(self.platoon.following(next, sample.index)?.1))
    }

    fn next_behind(&self, followers: usize) -> Option<usize> {
        self.number_of(self.index + followers + 1)
    }

    fn ahead_at(&self, sample: &Sample) -> Ahead {
        let Some(index) = self.index.checked_sub(1) else { return Ahead::Nobody };
        let number = self.number_of(index).unwrap_or(0);
        let drives = self.platoon.vehicles.get(index).is_some_and(|ahead| ahead.speed_at_mps(sample.index).is_some());
        let is_known = drives && self.platoon.following(self.index, sample.index).is_some();
        if is_known { Ahead::Recorded(number) } else { Ahead::NotRecorded(number) }
    }

    fn line_of(&self, sample: &Sample) -> u64 {
        self.platoon.line.get(sample.index).copied().unwrap_or(0)
    }

    fn event(&self) -> Option<&str> {
        self.platoon.event()
    }
}
