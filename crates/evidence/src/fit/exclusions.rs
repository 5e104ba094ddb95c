//! Brakings that a fitted space does not describe.

use serde::Serialize;

use crumple_exchange::recording::{DroppedItem, EpisodeProblem, Omission};

/// Numbers of brakings that the space does not describe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct ExclusionCounts {
    /// Without a known follower; not within the counted hours.
    pub no_follower: usize,
    /// With too few vehicles; not within the counted hours.
    pub too_few_vehicles: usize,
    /// With speeds that no road vehicle can have.
    pub impossible_speeds: usize,
    /// With a feature outside the range of the space.
    pub out_of_range: usize,
}

impl ExclusionCounts {
    /// Returns the number of exclusions within the counted hours.
    #[must_use]
    pub(crate) fn count_in_exposure(&self) -> usize {
        self.impossible_speeds + self.out_of_range
    }

    pub(super) fn add(&mut self, dropped: &DroppedItem) {
        match dropped.omission {
            Omission::Episode {
                reason: EpisodeProblem::NoFollower { .. } | EpisodeProblem::NoVehicleBehind { .. },
                ..
            } => {
                self.no_follower += 1;
            }
            Omission::Episode { .. } => self.impossible_speeds += 1,
            _ => {}
        }
    }

    /// Describes the exclusions in sentences, for episodes of this number of vehicles.
    #[must_use]
    pub fn sentences(&self, vehicles: usize) -> Vec<String> {
        let Self {
            no_follower,
            too_few_vehicles,
            impossible_speeds,
            out_of_range,
        } = self;
        let mut words = Vec::new();
        if no_follower + too_few_vehicles > 0 {
            words.push(format!(
                "Excluded, with their hours: {no_follower} episodes without a known follower, {too_few_vehicles} with \
                 fewer than {vehicles} vehicles"
            ));
        }
        if impossible_speeds + out_of_range > 0 {
            words.push(format!(
                "Excluded, but part of these hours: {impossible_speeds} episodes with impossible speeds, \
                 {out_of_range} with values outside the ranges; rates per hour assume that they fail as often as the \
                 others"
            ));
        }
        words
    }
}
