//! Why a recording could not be used at all.

use std::io;
use std::path::PathBuf;

use crate::scenario::{file::FileError, format_compact};

/// Why a recording could not be read. What could be read in part is no error: see [`super::Dropped`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file could not be opened or read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The file holds nothing.
    #[error("{}: the recording is empty", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The first line is of neither format.
    #[error(
        "{}:{line}: `{found}`: neither an OpenACC recording (which starts with `Date`) nor car-following events \
         (which start with `event,time_s,gap_m,...`), both without quotation marks; of any other, a map says what is in it", path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The first field found.
        found: String,
    },
    /// A line that is not text, or is far too long to be a row of numbers.
    #[error("{}:{line}: {message}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// What is wrong.
        message: String,
    },
    /// The file ends before its first sample.
    #[error("{}:{line}: the recording ends here, before {expected}", path.display())]
    CutShort {
        /// The file.
        path: PathBuf,
        /// Last line found, from 1.
        line: u64,
        /// What should have followed.
        expected: &'static str,
    },
    /// The line that names the columns is wrong.
    #[error("{}:{line}: {column}: {problem}", path.display())]
    Column {
        /// The file.
        path: PathBuf,
        /// Line of the column names, from 1.
        line: u64,
        /// The column.
        column: String,
        /// What is wrong with it.
        problem: ColumnProblem,
    },
    /// A row with fewer or more fields than there are columns.
    #[error("{}:{line}: {column}: {found} fields in a row of {expected}", path.display())]
    FieldCount {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The first column that has no field, or the last column if there are too many fields.
        column: String,
        /// Number of columns.
        expected: usize,
        /// Number of fields.
        found: usize,
    },
    /// A field that cannot be used.
    #[error("{}:{line}: {column}: {problem}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The column.
        column: String,
        /// What is wrong with the field.
        problem: ValueProblem,
    },
    /// More than this release is willing to hold in memory.
    #[error("{}:{line}: more than {limit} {what}: split the recording", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Line at which the limit was passed, from 1.
        line: u64,
        /// The limit.
        limit: usize,
        /// What is counted.
        what: &'static str,
    },
    /// A map that is not valid.
    #[error(transparent)]
    Map(Box<FileError>),
    /// A threshold no episode could be found with.
    #[error("min_brake_mps2: must be above 0 and at most {limit}, found {found}", limit = super::MAX_PLAUSIBLE_ACCEL_MPS2)]
    MinBrake {
        /// The threshold asked for, in m/s².
        found: f64,
    },
    /// A scenario that could not be written as text.
    #[error("{}: {name}: {source}", path.display())]
    Render {
        /// The recording.
        path: PathBuf,
        /// The scenario.
        name: String,
        /// What the serializer says.
        source: toml::ser::Error,
    },
}

/// What can be wrong with a column's name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ColumnProblem {
    /// There is no such column.
    #[error("there is no such column among `{known}`")]
    Missing {
        /// The names that there are, cut after 40 letters.
        known: String,
    },
    /// Two columns of one name.
    #[error("named twice")]
    Repeated,
    /// No vehicle has a spacing to a vehicle next to it.
    #[error("no such column lies between two `Speed` columns of successive numbers, so nobody follows anybody")]
    NoFollower,
}

/// What can be wrong with a field.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ValueProblem {
    /// Not a finite number.
    #[error("must be a finite number or empty, found `{found}`")]
    NotANumber {
        /// The text found.
        found: String,
    },
    /// No number of a vehicle.
    #[error("must be a whole number from 0 to 4294967295, found `{found}`")]
    NotWhole {
        /// The text found.
        found: String,
    },
    /// Empty, where a row is nothing without it.
    #[error("must not be empty")]
    Missing,
    /// A row that goes on with an event after rows of other events.
    #[error(
        "event `{event}`, whose last row was line {last_line}, goes on here after rows of other events: sort the rows by event and then by \
         time, or give different events different names"
    )]
    Interleaved {
        /// The event.
        event: String,
        /// Line of its row before, from 1.
        last_line: u64,
    },
    /// A time beyond any clock.
    #[error("must be from -{limit} to {limit}, found {}", format_compact(*found))]
    OutOfRange {
        /// Largest magnitude allowed.
        limit: f64,
        /// The number found.
        found: f64,
    },
}
