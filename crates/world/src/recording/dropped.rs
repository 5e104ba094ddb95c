//! What an import leaves out of a recording, and why: nothing is dropped in silence.

use std::fmt;
use std::path::PathBuf;

use crate::scenario::{InvalidField, format_compact};

/// Something in a recording that is not in the scenarios made from it.
#[derive(Debug, Clone, PartialEq)]
pub struct DroppedItem {
    /// The recording.
    pub path: PathBuf,
    /// Line it was first seen on, from 1.
    pub line: u64,
    /// What was dropped.
    pub omission: Omission,
}

impl fmt::Display for DroppedItem {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}:{}: {}", self.path.display(), self.line, self.omission)
    }
}

/// What was dropped.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Omission {
    /// Vehicles of the platoon that have no speed column: before the first, between two, or behind the last.
    #[error("{} speed column: {}", have_no(.first, .last), consequence(.place))]
    VehiclesMissing {
        /// First vehicle missing.
        first: usize,
        /// Last vehicle missing.
        last: usize,
        /// Where in the platoon they were.
        place: PlatoonPosition,
    },
    /// Two neighbours without a spacing column between them.
    #[error("{column}: no such column, so the platoon is split between vehicles {ahead} and {behind}")]
    SpacingColumnMissing {
        /// Name of the column.
        column: String,
        /// The vehicle ahead.
        ahead: usize,
        /// The vehicle behind.
        behind: usize,
    },
    /// A spacing column between vehicles that are not both recorded.
    #[error("{column}: ignored, for one of the two vehicles it lies between has no speed column")]
    SpacingWithoutVehicle {
        /// Name of the column.
        column: String,
    },
    /// A vehicle without a recorded neighbour.
    #[error("vehicle {number}: left out, for no spacing to a vehicle ahead of it or behind it is recorded")]
    LoneVehicle {
        /// Its number in the recording.
        number: usize,
    },
    /// Empty fields.
    #[error("{column}: {count} of {rows} values are missing, the first one here")]
    MissingValues {
        /// Name of the column.
        column: String,
        /// How many are missing.
        count: usize,
        /// Rows read.
        rows: usize,
    },
    /// Spacings that no two vehicles can have: not positive, or beyond any view.
    #[error(
        "{column}: {count} impossible spacings, the first one here, the last one on line {last_line}, \
         the worst {} m",
        format_compact(*worst_m)
    )]
    ImpossibleSpacings {
        /// Name of the column.
        column: String,
        /// How many.
        count: usize,
        /// Line of the last one.
        last_line: u64,
        /// The one furthest out of range, in metres.
        worst_m: f64,
    },
    /// Lengths that no vehicle can have: below 0.1 m, or beyond 100 m.
    #[error(
        "{column}: {count} impossible lengths, the first one here, the last one on line {last_line}, \
         the worst {} m",
        format_compact(*worst_m)
    )]
    ImpossibleLengths {
        /// Name of the column.
        column: String,
        /// How many.
        count: usize,
        /// Line of the last one.
        last_line: u64,
        /// The one furthest out of range, in metres.
        worst_m: f64,
    },
    /// Speeds that no vehicle can have: beyond 100 m/s, or negative where a sign means nothing.
    #[error(
        "{column}: {count} impossible speeds, the first one here, the last one on line {last_line}, \
         the worst {} m/s",
        format_compact(*worst_mps)
    )]
    ImpossibleSpeeds {
        /// Name of the column.
        column: String,
        /// How many.
        count: usize,
        /// Line of the last one.
        last_line: u64,
        /// The one furthest out of range, in m/s.
        worst_mps: f64,
    },
    /// Rows that are not at least a millisecond later than the one before.
    #[error(
        "{column}: {count} rows are not later than the row before and were left out, the first one here \
         ({found_s} s after {before_s} s)"
    )]
    NonIncreasingTime {
        /// Name of the time column.
        column: String,
        /// How many rows.
        count: usize,
        /// Time of the last row kept before the first of them, in seconds.
        before_s: f64,
        /// Time of the first of them, in seconds.
        found_s: f64,
    },
    /// Rows of one vehicle at one time.
    #[error("vehicle {vehicle} is in two places at once here; of {count} such rows each first one is kept")]
    DuplicateRows {
        /// The vehicle.
        vehicle: u32,
        /// How many rows were left out.
        count: usize,
    },
    /// Vehicles of one lane that overlap, so that neither follows the other.
    #[error(
        "{count} times a vehicle overlaps the one ahead of it in its lane, the first time here: it follows nobody then"
    )]
    Overlapping {
        /// How often.
        count: usize,
    },
    /// Vehicles of which it is not known where they begin or end.
    #[error(
        "{count} times the position or the length of a vehicle is not known, the first time here: nobody follows it, or anybody beyond it, then"
    )]
    UnknownPosition {
        /// How often.
        count: usize,
    },
    /// Missing values that were filled by straight lines, as a map says.
    #[error("{column}: {count} missing values were filled by straight lines, the first one here")]
    Interpolated {
        /// Name of the column.
        column: String,
        /// How many.
        count: usize,
    },
    /// Rows of car-following events whose three speeds contradict one another.
    #[error(
        "{column}: differs from {difference} in {count} rows, the first one here \
         (by {} m/s); their speeds were left out",
        format_fixed(*first_error_mps, 3)
    )]
    SpeedsContradict {
        /// Name of the column of relative speeds.
        column: String,
        /// What it should be, by the names of columns.
        difference: String,
        /// How many rows.
        count: usize,
        /// By how much in the first one, in m/s.
        first_error_mps: f64,
    },
    /// A braking episode that makes no scenario.
    #[error("vehicle {number} brakes at {onset_s} s, but the episode was left out: {reason}")]
    Episode {
        /// Number of the braking vehicle in the recording.
        number: usize,
        /// When it starts to brake, in seconds of the recording.
        onset_s: f64,
        /// Why there is no scenario.
        reason: EpisodeProblem,
    },
}

/// Where in a platoon vehicles are missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlatoonPosition {
    /// Ahead of the first recorded vehicle.
    Front,
    /// Between two recorded vehicles.
    Middle,
    /// Behind the last recorded vehicle.
    Rear,
}

/// A number of ordinary size to so many decimals.
fn format_fixed(number: f64, decimals: usize) -> String {
    if number.abs() < 1e9 { format!("{number:.decimals$}") } else { format_compact(number) }
}

fn have_no(first: &usize, last: &usize) -> String {
    if first == last { format!("vehicle {first} has no") } else { format!("vehicles {first} to {last} have no") }
}

fn consequence(place: &PlatoonPosition) -> &'static str {
    match place {
        PlatoonPosition::Front => "the platoon starts behind",
        PlatoonPosition::Middle => "the platoon is split there, for the spacing across is unknown",
        PlatoonPosition::Rear => "the platoon ends before",
    }
}

/// Why a braking episode makes no scenario.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EpisodeProblem {
    /// At no time shortly before braking are speed and gap of the next vehicle known.
    #[error("speed of and gap to vehicle {follower} are never both recorded in the {within_s} s before")]
    NoFollower {
        /// Number of the vehicle behind.
        follower: usize,
        /// The time searched, in seconds.
        within_s: f64,
    },
    /// At no time shortly before braking is anybody known behind.
    #[error("nobody is recorded behind it in the {within_s} s before")]
    NoVehicleBehind {
        /// The time searched, in seconds.
        within_s: f64,
    },
    /// The recorded speed changes faster than any road vehicle can.
    #[error("its speed changes by {} m/s² at {at_s} s, which no road vehicle does", format_fixed(*found_mps2, 1))]
    SpeedJump {
        /// When, in seconds of the recording.
        at_s: f64,
        /// The change, in m/s², negative when slowing.
        found_mps2: f64,
    },
    /// The numbers are outside what a scenario may hold.
    #[error("{0}")]
    Invalid(InvalidField),
}
