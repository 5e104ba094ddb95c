//! Vehicles that enter the lane or leave it.

use serde::{Deserialize, Serialize};

/// The trigger of a lane change of a vehicle between the lane and the adjacent lane.
///
/// The change is instantaneous and may occur within a step. Gaps are measured along the road: a vehicle that enters, to
/// the next vehicle in the lane behind it in the list; one that leaves, to the next one ahead. Without such a vehicle
/// the trigger never fires.
///
/// Of several triggers at one instant, times come first. The others are evaluated together on the resulting lane:
/// leaving vehicles change first, then entering ones, front to rear. A vehicle without room stays in the adjacent lane.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum LaneChange {
    /// Time, in seconds.
    #[serde(rename = "at_s")]
    At(#[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 1e5)))] f64),
    /// Bumper gap to the neighbour, in metres, that triggers when crossed in either direction.
    #[serde(rename = "gap_m")]
    Gap(#[cfg_attr(feature = "schema", schemars(range(min = 0.01, max = 1e5)))] f64),
    /// Time to collision with the neighbour, in seconds, that triggers at or below this value.
    #[serde(rename = "ttc_s")]
    TimeToCollision(#[cfg_attr(feature = "schema", schemars(range(min = 0.01, max = 1e3)))] f64),
}

impl LaneChange {
    /// Returns the field in files.
    #[must_use]
    pub fn field(self) -> &'static str {
        match self {
            Self::At(_) => "at_s",
            Self::Gap(_) => "gap_m",
            Self::TimeToCollision(_) => "ttc_s",
        }
    }

    /// Returns the value: a time in seconds or a gap in metres.
    pub(crate) fn value(self) -> f64 {
        match self {
            Self::At(value) | Self::Gap(value) | Self::TimeToCollision(value) => value,
        }
    }

    /// Returns the value, for a change.
    pub fn value_mut(&mut self) -> &mut f64 {
        match self {
            Self::At(value) | Self::Gap(value) | Self::TimeToCollision(value) => value,
        }
    }
}
