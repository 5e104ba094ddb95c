//! Validation errors of scenarios.

use std::fmt;

use crate::control::StartRefusal;
use crumple_core::digits::format_compact;
use crumple_core::field_error::FieldError;
use crumple_core::format_version::UnsupportedVersion;

/// An invalid field of a scenario, with its path and its problem.
pub type InvalidField = FieldError<FieldProblem>;

/// A problem of a scenario field.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FieldProblem {
    /// Unsupported format version.
    #[error(transparent)]
    Version(#[from] UnsupportedVersion),
    /// A number that is infinite or NaN.
    #[error("must be a finite number, found {}", format_compact(*found))]
    NotFinite {
        /// Value of the file.
        found: f64,
    },
    /// A value outside its range.
    #[error("must be {range}, found {}", format_compact(*found))]
    OutOfRange {
        /// Allowed range.
        range: AllowedRange,
        /// Value of the file.
        found: f64,
    },
    /// A text or list that is empty or too long.
    #[error("must have {min} to {max} {what}, found {found}")]
    Length {
        /// Minimum length.
        min: usize,
        /// Maximum length.
        max: usize,
        /// Unit of the length.
        what: &'static str,
        /// Length of the text or list.
        found: usize,
    },
    /// Outages with a rate and without a length.
    #[error("must be more than 0, because outage_rate_per_s is")]
    OutageWithoutLength,
    /// Control characters in a name, which would garble a terminal.
    #[error("must not hold control characters")]
    ControlCharacter,
    /// Times of a profile that do not increase.
    #[error("must increase, but {found} follows {before}")]
    NotIncreasing {
        /// Earlier entry.
        before: f64,
        /// Entry that is not later.
        found: f64,
    },
    /// Two lists with different lengths.
    #[error("must have as many entries as {other} ({expected}), found {found}")]
    LengthMismatch {
        /// Name of the other list.
        other: &'static str,
        /// Length of the other list.
        expected: usize,
        /// Length of this list.
        found: usize,
    },
    /// A vehicle that starts inside or ahead of its predecessor in the list.
    #[error(
        "overlaps vehicle {ahead}: its rear bumper is at {rear_bumper_m} m, and this front bumper at {found} m"
    )]
    Overlap {
        /// Index of the vehicle ahead.
        ahead: usize,
        /// Position of its rear bumper, in metres.
        rear_bumper_m: f64,
        /// Position of the front bumper, in metres.
        found: f64,
    },
    /// A profile that brakes harder than the vehicle can.
    #[error(
        "asks for {found} m/s² from a vehicle that can brake at {limit} m/s² at most: raise its max_brake_mps2"
    )]
    BrakeBeyondLimit {
        /// Limit of the vehicle, in m/s².
        limit: f64,
        /// Braking of the profile, in m/s².
        found: f64,
    },
    /// A profile that accelerates harder than the vehicle can.
    #[error(
        "asks for {found} m/s² from a vehicle that can accelerate at {limit} m/s² at most: raise its max_accel_mps2"
    )]
    AccelBeyondLimit {
        /// Limit of the vehicle, in m/s².
        limit: f64,
        /// Acceleration of the profile, in m/s².
        found: f64,
    },
    /// A delay, lag, jerk limit or plant of a scripted vehicle.
    #[error("is not allowed on a vehicle that follows a script: put the delay into the script")]
    DelayedScript,
    /// Parameters of a multi-body vehicle on a point mass.
    #[error("is only allowed with plant = \"multi-body\"")]
    BodyOfPointMass,
    /// A lane change of a vehicle that is not scripted.
    #[error(
        "is not allowed on a vehicle that is driven by `{driver}`: only a vehicle that follows a script may change \
        lanes"
    )]
    LaneChangeNotScripted {
        /// Name of the driver.
        driver: &'static str,
    },
    /// A vehicle that leaves no later than it enters.
    #[error("must be later than it enters, at {enters_s} s, found {found} s")]
    LeavesBeforeEntering {
        /// Time of entering, in seconds.
        enters_s: f64,
        /// Time of leaving, in seconds.
        found: f64,
    },
    /// A duration that is not a whole number of steps.
    #[error("must be a whole number of steps of {step_s} s, found {found} s")]
    NotWholeSteps {
        /// Step, in seconds.
        step_s: f64,
        /// Duration, in seconds.
        found: f64,
    },
    /// More vehicle-steps than memory allows.
    #[error("asks for {found} vehicle-steps, and at most {limit} are allowed")]
    TooLong {
        /// Maximum number of vehicle-steps.
        limit: usize,
        /// Number of steps times number of vehicles.
        found: usize,
    },
    /// A driver from a file that could not be read, or was not read.
    #[error("{reason}")]
    DriverFile {
        /// Reason.
        reason: String,
    },
    /// A driver that starts a program.
    #[error(transparent)]
    StartRefused(#[from] StartRefusal),
    /// A seed above the signed integers of TOML.
    #[error("must be at most {limit}, found {found}", limit = i64::MAX)]
    Seed {
        /// Seed of the file.
        found: u64,
    },
}

/// A closed interval, or one open at its lower end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AllowedRange {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
    /// True if the lower end is excluded.
    pub excludes_min: bool,
}

impl fmt::Display for AllowedRange {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            min,
            max,
            excludes_min: above_min,
        } = self;
        if *above_min {
            write!(out, "above {min} and at most {max}")
        } else {
            write!(out, "from {min} to {max}")
        }
    }
}
