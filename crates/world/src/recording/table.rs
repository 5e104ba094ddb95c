//! Rows of numbers from a text file of any size: bounded memory, and errors with file, line and column.

use std::io::{self, Read};
use std::path::Path;

use csv::StringRecord;

use super::dropped::{DroppedItem, Omission};
use super::error::{ColumnProblem, LineProblem, RecordingError};
use super::map::{Delimiter, TimeSpec};

/// Maximum line length, in bytes. 200 vehicles with all columns of OpenACC take about 30 kB.
const MAX_LINE_BYTES: usize = 1 << 20;
pub(super) const MAX_ROWS: usize = 5_000_000;
/// Maximum number of speeds and gaps of a file: 320 MB.
const MAX_VALUES: usize = 20_000_000;

/// Adds a line feed to the last line, and rejects overlong lines before they fill the memory.
struct LineLimitReader<R> {
    inner: R,
    since_line_feed: usize,
}

impl<R: Read> Read for LineLimitReader<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(into)?;
        if count == 0
            && self.since_line_feed > 0
            && let Some(first) = into.first_mut()
        {
            *first = b'\n';
            self.since_line_feed = 0;
            return Ok(1);
        }
        for &byte in into.iter().take(count) {
            self.since_line_feed = if byte == b'\n' { 0 } else { self.since_line_feed + 1 };
            if self.since_line_feed > MAX_LINE_BYTES {
                let message = format!("a line of more than {MAX_LINE_BYTES} bytes is not a row of numbers");
                return Err(io::Error::new(io::ErrorKind::InvalidData, message));
            }
        }
        Ok(count)
    }
}

pub(super) struct RowReader<'a, R> {
    path: &'a Path,
    reader: csv::Reader<LineLimitReader<R>>,
    row: CsvRow<'a>,
}

impl<'a, R: Read> RowReader<'a, R> {
    pub(super) fn new(from: R, path: &'a Path, delimiter: Delimiter) -> Self {
        let delimiter = match delimiter {
            Delimiter::Comma => b',',
            Delimiter::Semicolon => b';',
            Delimiter::Tab => b'\t',
        };
        let reader = csv::ReaderBuilder::new()
            .delimiter(delimiter)
            .has_headers(false)
            .flexible(true)
            // No format has quotes; without them a row is a line, which bounds its length.
            .quoting(false)
            // Trimming removes carriage returns. Splitting rows at both characters would miscount lines.
            .terminator(csv::Terminator::Any(b'\n'))
            .trim(csv::Trim::All)
            .from_reader(LineLimitReader { inner: from, since_line_feed: 0 });
        Self { path, reader, row: CsvRow { path, line: 0, fields: StringRecord::new() } }
    }

    pub(super) fn path(&self) -> &'a Path {
        self.path
    }

    /// Returns the next row that is not blank; `None` at the end of the file.
    pub(super) fn next_row(&mut self) -> Result<Option<&CsvRow<'a>>, RecordingError> {
        loop {
            match self.reader.read_record(&mut self.row.fields) {
                Ok(true) => {
                    // `row.position` precedes blank lines; the reader's position follows the row.
                    self.row.line = self.reader.position().line().saturating_sub(1);
                    if self.row.fields.len() > 1 || !self.row.text(0).is_empty() {
                        return Ok(Some(&self.row));
                    }
                }
                Ok(false) => return Ok(None),
                Err(error) => return Err(self.read_error(error)),
            }
        }
    }

    fn read_error(&self, error: csv::Error) -> RecordingError {
        // UTF-8 is checked after the row is read; all other errors occur inside the next row.
        let line = match error.kind() {
            csv::ErrorKind::Utf8 { .. } => self.reader.position().line().saturating_sub(1),
            _ => self.reader.position().line(),
        };
        let path = self.path.to_owned();
        let message = match error.into_kind() {
            csv::ErrorKind::Io(source) if source.kind() != io::ErrorKind::InvalidData => {
                return RecordingError::Read { path, source };
            }
            csv::ErrorKind::Io(source) => source.to_string(),
            csv::ErrorKind::Utf8 { .. } => "is not text in UTF-8".to_owned(),
            other => format!("{other:?}"),
        };
        RecordingError::Line { path, line, problem: LineProblem::Malformed(message) }
    }

    pub(super) fn reject_cut_short<T>(&self, expected: &'static str) -> Result<T, RecordingError> {
        self.row.reject_line(LineProblem::CutShort { expected })
    }
}

#[derive(Clone)]
pub(super) struct CsvRow<'a> {
    path: &'a Path,
    pub(super) line: u64,
    pub(super) fields: StringRecord,
}

impl CsvRow<'_> {
    pub(super) fn text(&self, index: usize) -> &str {
        self.fields.get(index).unwrap_or_default()
    }

    /// Returns the number of a field; `None` for an empty field or NaN, which many tools write for missing values.
    pub(super) fn number(&self, column: &CsvColumn) -> Result<Option<f64>, RecordingError> {
        let text = self.text(column.index);
        if text.is_empty() {
            return Ok(None);
        }
        match text.parse::<f64>() {
            Ok(number) if (number * column.factor).is_finite() => Ok(Some(number * column.factor)),
            Ok(number) if number.is_nan() => Ok(None),
            _ => self.reject(&column.name, ColumnProblem::NotANumber { found: excerpt(text) }),
        }
    }

    pub(super) fn reject<T>(&self, column: &str, problem: ColumnProblem) -> Result<T, RecordingError> {
        self.reject_line(LineProblem::Column { column: column.to_owned(), problem })
    }

    pub(super) fn reject_too_large<T>(&self, limit: usize, what: &'static str) -> Result<T, RecordingError> {
        self.reject_line(LineProblem::TooLarge { limit, what })
    }

    pub(super) fn reject_line<T>(&self, problem: LineProblem) -> Result<T, RecordingError> {
        Err(RecordingError::Line { path: self.path.to_owned(), line: self.line, problem })
    }

    pub(super) fn dropped_item(&self, what: Omission) -> DroppedItem {
        DroppedItem { path: self.path.to_owned(), line: self.line, omission: what }
    }
}

/// Returns the beginning of a text, on one line.
pub(super) fn excerpt(text: &str) -> String {
    const MAX_LENGTH: usize = 40;
    let visible = |letter: char| if letter.is_control() { char::REPLACEMENT_CHARACTER } else { letter };
    let mut excerpt: String = text.chars().take(MAX_LENGTH).map(visible).collect();
    if text.chars().nth(MAX_LENGTH).is_some() {
        excerpt += "...";
    }
    excerpt
}

#[derive(Debug, Clone)]
pub(super) struct CsvColumn {
    pub(super) name: String,
    pub(super) index: usize,
    /// Size of its unit in seconds, metres or metres per second.
    pub(super) factor: f64,
}

impl CsvColumn {
    pub(super) fn find(names: &CsvRow<'_>, name: &str, factor: f64) -> Result<Self, RecordingError> {
        let mut found = names.fields.iter().enumerate().filter(|(_, known)| *known == name);
        match (found.next(), found.next()) {
            (Some((index, _)), None) => Ok(Self { name: excerpt(name), index, factor }),
            (Some(_), Some(_)) => names.reject(&excerpt(name), ColumnProblem::Repeated),
            (None, _) => {
                let known = excerpt(&names.fields.iter().collect::<Vec<_>>().join(", "));
                names.reject(&excerpt(name), ColumnProblem::Missing { known })
            }
        }
    }

    pub(super) fn find_time(names: &CsvRow<'_>, time: &TimeSpec) -> Result<Self, RecordingError> {
        match time {
            TimeSpec::Clock(clock) => Self::find(names, &clock.column, clock.unit.factor()),
            TimeSpec::Frames(frames) => Self::find(names, &frames.column, 1.0 / frames.rate_hz),
        }
    }
}

/// Counts rows and values, and rejects a file before it fills the memory.
pub(super) struct RowLimiter<'h> {
    names: &'h StringRecord,
    values_per_row: usize,
    pub(super) rows: usize,
}

impl<'h> RowLimiter<'h> {
    pub(super) fn new(names: &'h StringRecord, values_per_row: usize) -> Self {
        Self { names, values_per_row, rows: 0 }
    }

    /// Accepts a row with a field for each column within the limits.
    pub(super) fn check_row(&mut self, row: &CsvRow<'_>) -> Result<(), RecordingError> {
        let (expected, found) = (self.names.len(), row.fields.len());
        if found != expected {
            let column = excerpt(self.names.get(found.min(expected.saturating_sub(1))).unwrap_or_default());
            return row.reject(&column, ColumnProblem::FieldCount { expected, found });
        }
        self.rows += 1;
        if self.rows > MAX_ROWS {
            return row.reject_too_large(MAX_ROWS, "rows");
        }
        if self.rows.saturating_mul(self.values_per_row) > MAX_VALUES {
            return row.reject_too_large(MAX_VALUES, "speeds and gaps");
        }
        Ok(())
    }
}
