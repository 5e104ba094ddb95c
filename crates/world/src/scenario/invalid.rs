//! What can make a scenario invalid.

use std::fmt;

use super::SCENARIO_VERSION;
use crate::control::StartRefusal;

/// A field that makes a scenario invalid: where it is and what is wrong with it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct InvalidField {
    /// Path of the field in the file, such as `vehicles[1].position_m`.
    pub field: String,
    /// What is wrong.
    pub problem: FieldProblem,
}

/// What can be wrong with a field.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FieldProblem {
    /// The file is of another format version.
    #[error("version {found} is not supported: this release reads version {SCENARIO_VERSION}")]
    Version {
        /// What the file says.
        found: u32,
    },
    /// Not a number, or infinite.
    #[error("must be a finite number, found {}", format_compact(*found))]
    NotFinite {
        /// What the file says.
        found: f64,
    },
    /// Outside its range.
    #[error("must be {range}, found {}", format_compact(*found))]
    OutOfRange {
        /// The range it must be in.
        range: AllowedRange,
        /// What the file says.
        found: f64,
    },
    /// An empty text or list, or one too long.
    #[error("must have {min} to {max} {what}, found {found}")]
    Length {
        /// Fewest allowed.
        min: usize,
        /// Most allowed.
        max: usize,
        /// What is counted.
        what: &'static str,
        /// How many there are.
        found: usize,
    },
    /// A name that would garble a terminal.
    #[error("must not hold control characters")]
    ControlCharacter,
    /// Times of a profile that do not increase.
    #[error("must increase, but {found} follows {before}")]
    NotIncreasing {
        /// The earlier entry.
        before: f64,
        /// The entry that is not later.
        found: f64,
    },
    /// Two lists that must be of one length are not.
    #[error("must have as many entries as {other} ({expected}), found {found}")]
    LengthMismatch {
        /// The other list.
        other: &'static str,
        /// Its length.
        expected: usize,
        /// The length found.
        found: usize,
    },
    /// A vehicle that starts inside or ahead of the one before it.
    #[error("overlaps vehicle {ahead}: its rear bumper is at {rear_bumper_m} m, and this front bumper at {found} m")]
    Overlap {
        /// Index of the vehicle ahead.
        ahead: usize,
        /// Where its rear bumper is, in metres.
        rear_bumper_m: f64,
        /// Where the front bumper is, in metres.
        found: f64,
    },
    /// A profile that asks for more braking than the vehicle has.
    #[error("asks for {found} m/s² from a vehicle that can brake at {limit} m/s² at most: raise its max_brake_mps2")]
    BrakeBeyondLimit {
        /// The limit of the vehicle, in m/s².
        limit: f64,
        /// What the profile asks for, in m/s².
        found: f64,
    },
    /// A profile that asks for more acceleration than the vehicle has.
    #[error(
        "asks for {found} m/s² from a vehicle that can accelerate at {limit} m/s² at most: raise its max_accel_mps2"
    )]
    AccelBeyondLimit {
        /// The limit of the vehicle, in m/s².
        limit: f64,
        /// What the profile asks for, in m/s².
        found: f64,
    },
    /// A delay, lag or jerk limit on a vehicle that follows a script.
    #[error("has no place on a vehicle that follows a script: put the delay into the script")]
    DelayedScript,
    /// A vehicle that decides for itself and is to change lanes.
    #[error("has no place on a vehicle that is driven by `{driver}`: only one that follows a script may change lanes")]
    LaneChangeNotScripted {
        /// Who drives it.
        driver: &'static str,
    },
    /// A vehicle that leaves no later than it enters.
    #[error("must be later than it enters, at {enters_s} s, found {found} s")]
    LeavesBeforeEntering {
        /// When it enters, in seconds.
        enters_s: f64,
        /// When it leaves, in seconds.
        found: f64,
    },
    /// A duration that is not a whole number of steps.
    #[error("must be a whole number of steps of {step_s} s, found {found} s")]
    NotWholeSteps {
        /// The step, in seconds.
        step_s: f64,
        /// The duration found, in seconds.
        found: f64,
    },
    /// More steps than can be simulated in memory.
    #[error("asks for {found} vehicle-steps, and at most {limit} are allowed")]
    TooLong {
        /// The limit.
        limit: usize,
        /// Steps times vehicles.
        found: usize,
    },
    /// A driver from a file that cannot be read, or was not.
    #[error("{reason}")]
    DriverFile {
        /// Why not.
        reason: String,
    },
    /// A driver that is a program.
    #[error(transparent)]
    StartRefused(#[from] StartRefusal),
    /// A seed that a TOML file cannot hold, since its integers are signed.
    #[error("must be at most {limit}, found {found}", limit = i64::MAX)]
    Seed {
        /// What the file says.
        found: u64,
    },
}

/// A number as somebody would write it: with an exponent where its digits would fill a line.
pub fn format_compact(number: f64) -> String {
    let size = number.abs();
    if size != 0.0 && size.is_finite() && !(1e-9..1e16).contains(&size) {
        format!("{number:e}")
    } else {
        number.to_string()
    }
}

/// A closed interval, or one open at its lower end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AllowedRange {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
    /// Whether the lower end itself is excluded.
    pub excludes_min: bool,
}

impl fmt::Display for AllowedRange {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { min, max, excludes_min: above_min } = self;
        if *above_min { write!(out, "above {min} and at most {max}") } else { write!(out, "from {min} to {max}") }
    }
}
