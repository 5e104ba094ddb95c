//! Boxes of starts, and how they are cut.

use serde::{Deserialize, Serialize};

use crate::interval::Interval;

/// Where everybody starts, how fast, and how hard and when leader and follower brake. The claim is about each member.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitialRanges {
    /// Bumper to bumper at the start, in metres.
    pub gap_ahead_m: Interval,
    /// Bumper to bumper at the start, in metres; without a meaning if nobody is behind, like all that is the follower's.
    pub gap_behind_m: Interval,
    /// At the start, in m/s.
    pub leader_speed_mps: Interval,
    /// At the start, in m/s.
    pub ego_speed_mps: Interval,
    /// At the start, in m/s.
    pub follower_speed_mps: Interval,
    /// How hard the leader brakes, in m/s².
    pub leader_brake_mps2: Interval,
    /// How hard the follower's emergency brake brakes, and the hardest that one who follows by a law does, in m/s².
    pub follower_brake_mps2: Interval,
    /// When the leader begins to brake, in steps, not necessarily whole ones.
    pub onset_steps: Interval,
}

/// One of the ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(missing_docs, reason = "each is the field of `Ranges` of that name")]
pub enum BoxDimension {
    GapAheadM,
    GapBehindM,
    LeaderSpeedMps,
    EgoSpeedMps,
    FollowerSpeedMps,
    #[serde(rename = "leader_brake_mps2")]
    LeaderBrakeMps2,
    #[serde(rename = "follower_brake_mps2")]
    FollowerBrakeMps2,
    OnsetSteps,
}

impl BoxDimension {
    /// All of them, in the order of the fields of [`InitialRanges`].
    pub const ALL: [Self; 8] = [
        Self::GapAheadM,
        Self::GapBehindM,
        Self::LeaderSpeedMps,
        Self::EgoSpeedMps,
        Self::FollowerSpeedMps,
        Self::LeaderBrakeMps2,
        Self::FollowerBrakeMps2,
        Self::OnsetSteps,
    ];

    /// The field of [`InitialRanges`] that it is.
    #[must_use]
    pub const fn field_name(self) -> &'static str {
        match self {
            Self::GapAheadM => "gap_ahead_m",
            Self::GapBehindM => "gap_behind_m",
            Self::LeaderSpeedMps => "leader_speed_mps",
            Self::EgoSpeedMps => "ego_speed_mps",
            Self::FollowerSpeedMps => "follower_speed_mps",
            Self::LeaderBrakeMps2 => "leader_brake_mps2",
            Self::FollowerBrakeMps2 => "follower_brake_mps2",
            Self::OnsetSteps => "onset_steps",
        }
    }
}

impl InitialRanges {
    /// One range.
    #[must_use]
    pub fn get(&self, dimension: BoxDimension) -> Interval {
        let mut copy = *self;
        *copy.get_mut(dimension)
    }

    /// One range, to be changed.
    pub fn get_mut(&mut self, dimension: BoxDimension) -> &mut Interval {
        match dimension {
            BoxDimension::GapAheadM => &mut self.gap_ahead_m,
            BoxDimension::GapBehindM => &mut self.gap_behind_m,
            BoxDimension::LeaderSpeedMps => &mut self.leader_speed_mps,
            BoxDimension::EgoSpeedMps => &mut self.ego_speed_mps,
            BoxDimension::FollowerSpeedMps => &mut self.follower_speed_mps,
            BoxDimension::LeaderBrakeMps2 => &mut self.leader_brake_mps2,
            BoxDimension::FollowerBrakeMps2 => &mut self.follower_brake_mps2,
            BoxDimension::OnsetSteps => &mut self.onset_steps,
        }
    }

    /// Cut in two in the middle of a dimension; none if there is no number in between.
    #[must_use]
    pub fn bisect(&self, dimension: BoxDimension) -> Option<[Self; 2]> {
        let range = self.get(dimension);
        let middle = 0.5 * range.low() + 0.5 * range.high();
        if !(range.low() < middle && middle < range.high()) {
            return None;
        }
        let mut halves = [*self; 2];
        *halves[0].get_mut(dimension) = Interval::new(range.low(), middle)?;
        *halves[1].get_mut(dimension) = Interval::new(middle, range.high())?;
        Some(halves)
    }

    /// The box that holds one point, in the order of [`BoxDimension::ALL`]; none if the point is not in this box.
    #[must_use]
    pub fn at_point(&self, point: &[f64; 8]) -> Option<Self> {
        let mut at = *self;
        for (dimension, &value) in BoxDimension::ALL.into_iter().zip(point) {
            let range = at.get_mut(dimension);
            *range = range.contains(value).then(|| Interval::new(value, value)).flatten()?;
        }
        Some(at)
    }
}

#[cfg(test)]
mod tests;
