//! Errors of recordings.

use std::io;
use std::path::{Path, PathBuf};

use super::consistency::ColumnContradiction;
use crumple_core::digits::format_number;
use crumple_core::text_file::FileError;

/// An error of a recording. Parts that are merely dropped are [`super::DroppedItem`]s.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file could not be opened or read.
    #[error("{}: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// A temporary file of a long recording that could not be written or read.
    #[error("{}: a temporary file of the recording: {source}", path.display())]
    Spill {
        /// Path of the recording.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// Two recordings with the same content.
    #[error("{}: this recording is given twice: {} is equal", path.display(), other.display())]
    Repeated {
        /// Path of the recording.
        path: PathBuf,
        /// Path of the earlier recording.
        other: PathBuf,
    },
    /// An empty file.
    #[error("{}: the recording is empty", path.display())]
    Empty {
        /// Path of the file.
        path: PathBuf,
    },
    /// A recording of several parts, where only one is possible.
    #[error("{}: the recording is too long for this use: split it", path.display())]
    TooLong {
        /// Path of the recording.
        path: PathBuf,
    },
    /// An invalid line.
    #[error("{}: {problem}", format_place(path, *line))]
    Line {
        /// Path of the file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Problem of the line.
        problem: LineProblem,
    },
    /// A file that is no text and cannot be read.
    #[error("{}: {problem}", path.display())]
    Binary {
        /// Path of the file.
        path: PathBuf,
        /// Problem of the file.
        problem: BinaryProblem,
    },
    /// An invalid map.
    #[error(transparent)]
    Map(Box<FileError>),
    /// A threshold outside its range.
    #[error(
        "the deceleration of braking must be above 0 and at most {limit} m/s², found {}",
        format_number(*found),
        limit = super::MAX_PLAUSIBLE_ACCEL_MPS2
    )]
    MinBrake {
        /// Threshold, in m/s².
        found: f64,
    },
    /// A scenario that could not be serialized.
    #[error("{}: {name}: {source}", path.display())]
    Render {
        /// Path of the recording.
        path: PathBuf,
        /// Name of the scenario.
        name: String,
        /// Error of the serializer.
        source: toml::ser::Error,
    },
}

/// Returns a path with a line, which is 0 for the names of the columns of a file that is no text.
pub(super) fn format_place(path: &Path, line: u64) -> String {
    if line == 0 {
        path.display().to_string()
    } else {
        format!("{}:{line}", path.display())
    }
}

/// A problem of a file that is no text.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BinaryProblem {
    /// A format that this build does not read.
    #[error(
        "this is {format}, and this build of crumple lacks the feature `{feature}`: install it with `cargo install \
        --locked --path . --features {feature}` in a clone"
    )]
    NeedsFeature {
        /// Name of the format, with its article.
        format: &'static str,
        /// Feature that reads it.
        feature: &'static str,
    },
    /// A file of a format that no build reads.
    #[error("this is {format}: export the recording as CSV, Parquet or MDF 4")]
    UnknownFormat {
        /// Name of the format, with its article.
        format: &'static str,
    },
    /// A DBC file beside a file of text.
    #[error(
        "the map names a DBC file, which applies only to MDF files: remove `dbc`, or give an MDF file"
    )]
    NeedsMdf,
    /// An MDF file without map.
    #[error(
        "an MDF file needs a map that names its signals (--map); `crumple import --guess` drafts one"
    )]
    NeedsMap,
    /// No column or signal of a name.
    #[error("{column}: there is no such column or signal; the file has {known}")]
    MissingColumn {
        /// Wanted name.
        column: String,
        /// Names in the file, truncated.
        known: String,
    },
    /// A damaged or unsupported MDF file, or a wrong DBC file.
    #[cfg(feature = "mdf")]
    #[error(transparent)]
    Mdf(#[from] super::mdf::MdfError),
    /// A damaged or unsupported Parquet file.
    #[cfg(feature = "parquet")]
    #[error("the Parquet file cannot be read: {0}")]
    Parquet(#[from] super::parquet::ParquetError),
}

/// A problem of a line.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LineProblem {
    /// A first line of neither built-in format.
    #[error(
        "`{found}`: neither an OpenACC recording (which starts with `Date`) nor car-following events (which start with \
        `event,time_s,gap_m,...`); any other format needs a map that describes its columns (`crumple \
        import --guess` drafts one)"
    )]
    UnknownFormat {
        /// First field of the line.
        found: String,
    },
    /// Columns of a format whose map the caller must name.
    #[error("these are the columns of the built-in map `{map}`: name it (--map {map})")]
    NeedsMap {
        /// Name of the map.
        map: &'static str,
    },
    /// A line that is not UTF-8, or far longer than any row of numbers.
    #[error("{0}")]
    Malformed(String),
    /// The last line of a file that ends before its first sample.
    #[error("the recording ends here, before {expected}")]
    CutShort {
        /// Expected content.
        expected: &'static str,
    },
    /// An invalid name or field of a column.
    #[error("{column}: {problem}")]
    Column {
        /// Name of the column.
        column: String,
        /// Problem of the column.
        problem: ColumnProblem,
    },
    /// The first line beyond what this release holds in memory.
    #[error("more than {limit} {what}: split the recording")]
    TooLarge {
        /// Limit.
        limit: usize,
        /// Unit of the limit.
        what: &'static str,
    },
}

/// A problem of a column: of its name, or of its field in a row.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ColumnProblem {
    /// No such column.
    #[error("there is no such column among `{known}`")]
    Missing {
        /// Existing names, truncated to 40 characters.
        known: String,
    },
    /// A unit in the file that is none of the quantity, or that crumple does not know.
    #[error("the file states the unit `{unit}`, which is {advice}")]
    UnknownUnit {
        /// Name of the unit.
        unit: String,
        /// Known units of the quantity, and a change of the map or of the file.
        advice: Box<str>,
    },
    /// A unit in the name of a column that differs from that of the map.
    #[error("its name states the unit `{in_name}`, but the map states `{in_map}`: {remedy}")]
    OtherUnit {
        /// Unit in the name.
        in_name: Box<str>,
        /// Unit in the map.
        in_map: &'static str,
        /// Change of the map or of the file.
        remedy: Box<str>,
    },
    /// Two columns of one name.
    #[error("named twice")]
    Repeated,
    /// No spacing between successive vehicles.
    #[error(
        "no such column is between two `Speed` columns of successive numbers, so no vehicle follows another"
    )]
    NoFollower,
    /// A row whose number of fields differs from the number of columns: no field of this column, or more than the last.
    #[error("{found} fields in a row of {expected}")]
    FieldCount {
        /// Number of columns.
        expected: usize,
        /// Number of fields.
        found: usize,
    },
    /// A field that is not a finite number.
    #[error("must be a finite number or empty, found `{found}`{hint}")]
    NotANumber {
        /// Text of the field.
        found: String,
        /// Setting of the map that would make it a number.
        hint: &'static str,
    },
    /// A field that is not a time stamp, in a column of them.
    #[error("must be an ISO 8601 time stamp, as in the first row, found `{found}`")]
    NotATime {
        /// Text of the field.
        found: String,
    },
    /// A vehicle id that is too long.
    #[error("must have at most {limit} bytes, found `{found}`")]
    LongId {
        /// Largest length, in bytes.
        limit: usize,
        /// Beginning of the field.
        found: String,
    },
    /// A column that contradicts others, for which the map has probably a wrong unit or sign.
    #[error("{0}; correct the map")]
    Contradiction(Box<ColumnContradiction>),
    /// A column of the vehicle behind without a possible value.
    #[error("{0}; correct the map, or leave the vehicle behind out of it")]
    OnlyImpossible(String),
    /// An empty field that the row requires.
    #[error("must not be empty")]
    Empty,
    /// A row that continues an event after rows of other events.
    #[error(
        "event `{event}`, whose last row was line {last_line}, continues here after rows of other events: sort the \
        rows by event and then by time, or give different events different names"
    )]
    Interleaved {
        /// Name of the event.
        event: String,
        /// Line of its previous row, from 1.
        last_line: u64,
    },
    /// A time beyond any clock.
    #[error("must be from -{0} to {0}, found {1}", format_number(*limit), format_number(*found))]
    OutOfRange {
        /// Largest allowed magnitude.
        limit: f64,
        /// Value of the field.
        found: f64,
    },
}
