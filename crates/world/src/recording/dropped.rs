//! Parts of a recording that an import drops, with reasons.

use std::fmt;
use std::path::PathBuf;

use super::consistency::ColumnContradiction;
use super::error::format_place;
use crate::scenario::{InvalidField, format_compact};

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
        write!(out, "{}: {}", format_place(&self.path, self.line), self.omission)
    }
}

/// A dropped part and its reason.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Omission {
    /// Vehicles of the platoon without a speed column.
    #[error("{} speed column: {consequence}", have_no(.first, .last))]
    VehiclesMissing {
        /// First missing vehicle.
        first: usize,
        /// Last missing vehicle.
        last: usize,
        /// Effect on the platoon, as a clause.
        consequence: &'static str,
    },
    /// Two neighbours without a spacing column.
    #[error("{column}: no such column, so the platoon is split between vehicles {ahead} and {behind}")]
    SpacingColumnMissing {
        /// Name of the column.
        column: String,
        /// Number of the vehicle ahead.
        ahead: usize,
        /// Number of the vehicle behind.
        behind: usize,
    },
    /// A spacing column of a vehicle that is not recorded.
    #[error("{column}: ignored, because one of its two vehicles has no speed column")]
    SpacingWithoutVehicle {
        /// Name of the column.
        column: String,
    },
    /// A vehicle without a recorded neighbour.
    #[error("vehicle {number}: left out, because no spacing to a vehicle ahead of it or behind it is recorded")]
    LoneVehicle {
        /// Number in the recording.
        number: usize,
    },
    /// Empty fields.
    #[error("{column}: {count} of {rows} values are missing, the first one here")]
    MissingValues {
        /// Name of the column.
        column: String,
        /// Number of missing values.
        count: usize,
        /// Number of rows.
        rows: usize,
    },
    /// Spacings of 0 or less or beyond any view, lengths below 0.1 m or above 100 m, and speeds above 100 m/s, or
    /// negative where the sign has no meaning.
    #[error(
        "{column}: {count} impossible {what}, the first one here, the last one on line {last_line}, the worst {} \
         {unit}{}",
        format_compact(*worst),
        if *is_all { ", and no possible one: its sign or unit is probably wrong" } else { "" }
    )]
    ImpossibleValues {
        /// Name of the column.
        column: String,
        /// Quantity, in the plural.
        what: &'static str,
        /// Unit of the quantity.
        unit: &'static str,
        /// Number of values.
        count: usize,
        /// Line of the last one.
        last_line: u64,
        /// Value furthest out of range.
        worst: f64,
        /// True if no value is possible.
        is_all: bool,
    },
    /// Rows less than a millisecond later than the row before.
    #[error(
        "{column}: {count} rows are not later than the row before and were left out, the first one here \
         ({found_s} s after {before_s} s)"
    )]
    NonIncreasingTime {
        /// Name of the time column.
        column: String,
        /// Number of rows.
        count: usize,
        /// Time of the last valid row before them, in seconds.
        before_s: f64,
        /// Time of the first of them, in seconds.
        found_s: f64,
    },
    /// Rows much earlier than the row before.
    #[error(
        "{column}: the time starts anew here ({found_s} s after {before_s} s); of {count} such places each begins \
        another recording"
    )]
    ClockRestarts {
        /// Name of the time column.
        column: String,
        /// Number of places.
        count: usize,
        /// Time of the row before the first place, in seconds.
        before_s: f64,
        /// Time at the first place, in seconds.
        found_s: f64,
    },
    /// Several rows of one vehicle at one time.
    #[error("vehicle {vehicle} is in two places at once here; of {count} such rows each first one is kept")]
    DuplicateRows {
        /// Id of the vehicle.
        vehicle: String,
        /// Number of dropped rows.
        count: usize,
    },
    /// Positions that start anew, and ids that are used again.
    #[error(
        "the position of vehicle {vehicle} starts anew here, or another vehicle has its id; of {count} such places \
        each begins another track"
    )]
    TracksSplit {
        /// Id of the vehicle at the first place.
        vehicle: String,
        /// Number of places.
        count: usize,
    },
    /// Lane ids that hold only briefly.
    #[error(
        "vehicle {vehicle} has another lane for less than {limit_s} s here; {count} such blips, in which vehicles keep \
        their lane"
    )]
    LaneBlips {
        /// Id of the vehicle with the first blip.
        vehicle: String,
        /// Number of blips.
        count: usize,
        /// Limit of the map, in seconds.
        limit_s: f64,
    },
    /// Neighbours that are not linked, because a vehicle without a row may be between them.
    #[error(
        "{count} times a vehicle that has rows before and after may be between two others, the first time here: they \
        do not follow each other then"
    )]
    AbsentVehicles {
        /// Number of occurrences.
        count: usize,
    },
    /// Gaps whose change contradicts the closing speed.
    #[error(
        "the gap changes by {} m within {} s here, but the speeds by {} m: the sensor switched to another target; of \
         {count} such places each begins another pair",
        format_fixed(*change_m, 1),
        format_fixed(*seconds, 2),
        format_fixed(*driven_m, 1)
    )]
    TargetSwitches {
        /// Change of the gap at the first place, in metres.
        change_m: f64,
        /// Change by the relative speed, in metres.
        driven_m: f64,
        /// Time between the two rows, in seconds.
        seconds: f64,
        /// Number of places.
        count: usize,
    },
    /// Values that are possible, but not usual in traffic.
    #[error("{subject} reaches {} {unit}, more than is usual in traffic: check the unit in the map", format_fixed(*found, 1))]
    Unusual {
        /// Column or braking.
        subject: String,
        /// Largest value.
        found: f64,
        /// Unit of the value.
        unit: &'static str,
    },
    /// Columns that contradict each other.
    #[error("{0}")]
    ColumnsContradict(ColumnContradiction),
    /// Overlapping vehicles of one lane, which are not linked.
    #[error(
        "{count} times a vehicle overlaps the one ahead of it in its lane, the first time here: it follows no vehicle \
        then"
    )]
    Overlapping {
        /// Number of occurrences.
        count: usize,
    },
    /// Vehicles with unknown position or length.
    #[error(
        "{count} times the position or the length of a vehicle is not known, the first time here: no vehicle follows \
        it, or a vehicle beyond it, then"
    )]
    UnknownPosition {
        /// Number of occurrences.
        count: usize,
    },
    /// Missing values that were interpolated, as the map demands.
    #[error("{column}: {count} missing values were filled by straight lines, the first one here")]
    Interpolated {
        /// Name of the column.
        column: String,
        /// Number of values.
        count: usize,
    },
    /// Rows of car-following events with contradictory speeds.
    #[error(
        "{column}: differs from {difference} in {count} rows, the first one here \
         (by {} m/s); their speeds were left out",
        format_fixed(*first_error_mps, 3)
    )]
    SpeedsContradict {
        /// Name of the column of relative speeds.
        column: String,
        /// Expected difference, by names of columns.
        difference: String,
        /// Number of rows.
        count: usize,
        /// Error of the first row, in m/s.
        first_error_mps: f64,
    },
    /// A last row without line end, whose last number is shorter than the one above it.
    #[error("the file ends within this line, so it was left out")]
    CutRow,
    /// A braking episode without a scenario.
    #[error("vehicle {number} brakes at {onset_s} s, but the episode was left out: {reason}")]
    Episode {
        /// Number of the braking vehicle in the recording.
        number: usize,
        /// Onset of braking, in seconds of the recording.
        onset_s: f64,
        /// Reason.
        reason: EpisodeProblem,
    },
}

impl Omission {
    /// Adds an omission of another part of the recording, if it is of the same kind and column.
    pub(super) fn absorb(&mut self, other: &mut Self) -> bool {
        let is_alike = match (&*self, &*other) {
            (Self::Interpolated { column: a, .. }, Self::Interpolated { column: b, .. }) => a == b,
            (Self::ColumnsContradict(a), Self::ColumnsContradict(b)) => return a.columns == b.columns,
            (a, b) => std::mem::discriminant(a) == std::mem::discriminant(b),
        };
        match (self.count(), other.count()) {
            (Some(count), Some(more)) if is_alike => *count += *more,
            _ => return false,
        }
        true
    }

    pub(super) fn count(&mut self) -> Option<&mut usize> {
        match self {
            Self::NonIncreasingTime { count, .. }
            | Self::ClockRestarts { count, .. }
            | Self::SpeedsContradict { count, .. }
            | Self::DuplicateRows { count, .. }
            | Self::TracksSplit { count, .. }
            | Self::LaneBlips { count, .. }
            | Self::AbsentVehicles { count }
            | Self::TargetSwitches { count, .. }
            | Self::Overlapping { count }
            | Self::UnknownPosition { count }
            | Self::Interpolated { count, .. } => Some(count),
            _ => None,
        }
    }
}

pub(super) fn format_fixed(number: f64, decimals: usize) -> String {
    if number.abs() < 1e9 { format!("{number:.decimals$}") } else { format_compact(number) }
}

fn have_no(first: &usize, last: &usize) -> String {
    if first == last { format!("vehicle {first} has no") } else { format!("vehicles {first} to {last} have no") }
}

/// A reason why a braking episode has no scenario.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EpisodeProblem {
    /// No time shortly before braking with known speed and gap of the follower.
    #[error("speed of and gap to vehicle {follower} are never both recorded in the {within_s} s before")]
    NoFollower {
        /// Number of the follower.
        follower: usize,
        /// Time searched, in seconds.
        within_s: f64,
    },
    /// No vehicle recorded behind shortly before braking.
    #[error("no vehicle is recorded behind it in the {within_s} s before")]
    NoVehicleBehind {
        /// Time searched, in seconds.
        within_s: f64,
    },
    /// A recorded speed that changes faster than any road vehicle's.
    #[error("its speed changes by {} m/s² at {at_s} s, which no road vehicle can do", format_fixed(*found_mps2, 1))]
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
