//! Vehicles that enter the lane or leave it.

use serde::{Deserialize, Serialize};

/// When a vehicle changes over between the lane and the one beside it: at once, at an instant that may lie inside a step.
///
/// Distances are those along the road to its neighbour: for a vehicle that enters, the next one behind it in the list that is in
/// the lane; for one that leaves, the next one ahead of it. Where there is none, the moment does not come.
///
/// Of several at one instant those come first that come by the clock. Then everybody looks at the lane as it is, and all whose moment
/// it is change together: those who leave first, then those who enter, front to rear. Who finds no room stays beside.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum LaneChange {
    /// At a time, in seconds.
    #[serde(rename = "at_s")]
    At(#[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 1e5)))] f64),
    /// Once the bumper gap to its neighbour passes through this, in metres, from whichever side.
    #[serde(rename = "gap_m")]
    Gap(#[cfg_attr(feature = "schema", schemars(range(min = 0.01, max = 1e5)))] f64),
    /// Once the bumper gap to its neighbour, at the speed at which it closes, lasts no longer than this, in seconds.
    #[serde(rename = "ttc_s")]
    TimeToCollision(#[cfg_attr(feature = "schema", schemars(range(min = 0.01, max = 1e3)))] f64),
}

impl LaneChange {
    /// Its field in files.
    #[must_use]
    pub fn field(self) -> &'static str {
        match self {
            Self::At(_) => "at_s",
            Self::Gap(_) => "gap_m",
            Self::TimeToCollision(_) => "ttc_s",
        }
    }

    /// Its number: a time in seconds or a gap in metres.
    #[must_use]
    pub(crate) fn value(self) -> f64 {
        match self {
            Self::At(value) | Self::Gap(value) | Self::TimeToCollision(value) => value,
        }
    }

    /// The same number, to be changed.
    pub(crate) fn value_mut(&mut self) -> &mut f64 {
        match self {
            Self::At(value) | Self::Gap(value) | Self::TimeToCollision(value) => value,
        }
    }
}
