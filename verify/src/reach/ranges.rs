//! Boxes of initial states, and their bisection.

use serde::{Deserialize, Serialize};

use crate::interval::Interval;

/// Ranges of initial gaps and speeds, and of the braking of leader and follower. The claim is about each member.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitialRanges {
    /// Initial gap ahead of the ego, in metres.
    pub gap_ahead_m: Interval,
    /// Initial gap behind the ego, in metres; meaningless without a follower, like all its ranges.
    pub gap_behind_m: Interval,
    /// Initial speed of the leader, in m/s.
    pub leader_speed_mps: Interval,
    /// Initial speed of the ego, in m/s.
    pub ego_speed_mps: Interval,
    /// Initial speed of the follower, in m/s.
    pub follower_speed_mps: Interval,
    /// Deceleration of the leader, in m/s².
    pub leader_brake_mps2: Interval,
    /// Deceleration of the follower's emergency brake, or the hardest of its law, in m/s².
    pub follower_brake_mps2: Interval,
    /// Begin of the leader's braking, in steps, not necessarily whole ones.
    pub onset_steps: Interval,
}

/// One of the ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(
    missing_docs,
    reason = "each is the field of `InitialRanges` of that name"
)]
pub enum BoxDimension {
    GapAheadM,
    GapBehindM,
    LeaderSpeedMps,
    EgoSpeedMps,
    FollowerSpeedMps,
    LeaderBrakeMps2,
    FollowerBrakeMps2,
    OnsetSteps,
}

impl BoxDimension {
    /// All dimensions, in the order of the fields of [`InitialRanges`].
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

    /// Returns the name of the field in [`InitialRanges`].
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
    /// Returns one range.
    #[must_use]
    pub fn get(&self, dimension: BoxDimension) -> Interval {
        let mut copy = *self;
        *copy.get_mut(dimension)
    }

    /// Returns one range for modification.
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

    /// Bisects the box in the middle of a dimension, or returns `None` if no number lies in between.
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

    /// Returns the box of one point, in the order of [`BoxDimension::ALL`], or `None` if the point is not in this box.
    #[must_use]
    pub fn at_point(&self, point: &[f64; 8]) -> Option<Self> {
        let mut at = *self;
        for (dimension, &value) in BoxDimension::ALL.into_iter().zip(point) {
            let range = at.get_mut(dimension);
            *range = range
                .contains(value)
                .then(|| Interval::new(value, value))
                .flatten()?;
        }
        Some(at)
    }
}

#[cfg(test)]
mod tests;
