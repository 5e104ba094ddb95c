//! Parts of a recording that an import drops, with reasons.

use std::fmt;
use std::path::PathBuf;

use super::consistency::ColumnContradiction;
use super::error::format_place;
use crumple_core::digits::{format_fixed, format_number};
use crumple_sim::scenario::InvalidField;

/// Advice about values that are possible, but not usual in traffic.
pub(super) const CHECK_UNIT: &str = "more than is usual in traffic, so check the unit in the map";
/// End of the sentence about rows whose three speeds contradict each other.
pub(super) const SPEEDS_LEFT_OUT: &str = "; their speeds were left out";

/// A part of a recording that is in no scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct DroppedItem {
    /// Path of the recording.
    pub path: PathBuf,
    /// Line of the first occurrence, from 1.
    pub line: u64,
    /// Dropped part.
    pub omission: Omission,
}

impl fmt::Display for DroppedItem {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "{}: {}",
            format_place(&self.path, self.line),
            self.omission
        )
    }
}

/// A dropped part and its reason.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Omission {
    /// A sentence.
    #[error("{0}")]
    Note(String),
    /// A sentence with a number of occurrences.
    #[error("{}", format_counted(before, *count, after))]
    Counted {
        /// Text before the number.
        before: String,
        /// Number of occurrences.
        count: usize,
        /// Text after the number, which is the same for all omissions of one kind.
        after: String,
    },
    /// Columns that contradict each other.
    #[error("{0}")]
    ColumnsContradict(ColumnContradiction),
    /// A braking episode without a scenario.
    #[error("vehicle {number} brakes at {} s, but the episode was left out: {reason}", format_number(*onset_s))]
    Episode {
        /// Number of the braking vehicle in the recording.
        number: usize,
        /// Onset of braking, in seconds of the recording.
        onset_s: f64,
        /// Reason.
        reason: EpisodeProblem,
    },
    /// A whole drive without a scenario.
    #[error("vehicle {number} leads a drive from {} s on, which was left out: {reason}", format_number(*start_s))]
    Drive {
        /// Number of the leader in the recording.
        number: usize,
        /// Start of the drive, in seconds of the recording.
        start_s: f64,
        /// Field that a scenario may not hold.
        reason: InvalidField,
    },
}

impl Omission {
    pub(super) fn counted(
        before: impl Into<String>,
        count: usize,
        after: impl Into<String>,
    ) -> Self {
        Self::Counted {
            before: before.into(),
            count,
            after: after.into(),
        }
    }

    /// Returns the omission of missing values that were interpolated, as the map demands.
    pub(super) fn interpolated(column: &str, count: usize) -> Self {
        Self::counted(
            "",
            count,
            format!(
                " missing values of {column} were filled by straight lines, the first one here"
            ),
        )
    }

    /// Adds occurrences to their number.
    pub(super) fn add(&mut self, more: usize) {
        if let Self::Counted { count, .. } = self {
            *count += more;
        }
    }

    /// Adds an omission of another part of the recording, if it is of the same kind.
    pub(super) fn absorb(&mut self, other: &Self) -> bool {
        match (&*self, other) {
            (Self::ColumnsContradict(a), Self::ColumnsContradict(b)) => a.columns == b.columns,
            (
                Self::Counted { after: a, .. },
                Self::Counted {
                    count, after: b, ..
                },
            ) if a == b => {
                self.add(*count);
                true
            }
            _ => false,
        }
    }
}

fn format_counted(before: &str, count: usize, after: &str) -> String {
    match after.strip_prefix(" times") {
        Some(after) if count == 1 => format!("{before}once{after}"),
        _ => format!("{before}{count}{after}"),
    }
}

/// A reason why a braking episode has no scenario.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EpisodeProblem {
    /// No time shortly before braking with known speed and gap of the follower.
    #[error(
        "speed of and gap to vehicle {follower} are never both recorded in the {} s before", format_number(*within_s)
    )]
    NoFollower {
        /// Number of the follower.
        follower: usize,
        /// Time searched, in seconds.
        within_s: f64,
    },
    /// No vehicle recorded behind shortly before braking.
    #[error("no vehicle is recorded behind it in the {} s before", format_number(*within_s))]
    NoVehicleBehind {
        /// Time searched, in seconds.
        within_s: f64,
    },
    /// A recorded speed that changes faster than any road vehicle's.
    #[error(
        "its speed changes by {} m/s² at {} s, which no road vehicle can do",
        format_fixed(*found_mps2, 1),
        format_number(*at_s)
    )]
    SpeedJump {
        /// Time of the change, in seconds of the recording.
        at_s: f64,
        /// Acceleration, in m/s².
        found_mps2: f64,
    },
    /// Numbers that a scenario may not hold.
    #[error("{0}")]
    Invalid(InvalidField),
}
