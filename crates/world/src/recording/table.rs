//! Rows of numbers from a text file of any size: bounded memory, and errors with file, line and column.

use std::io::{self, Chain, Cursor, Read};
use std::path::Path;

use csv::StringRecord;

use super::dropped::{DroppedItem, Omission};
use super::error::{BinaryProblem, ColumnProblem, LineProblem, RecordingError};
use super::map::{DecimalMark, RecordingMapSpec};
use super::number::parse_number;
use super::text::{TextFormat, Utf8Reader};

/// Maximum line length, in bytes. 200 vehicles with all columns of OpenACC take about 30 kB.
const MAX_LINE_BYTES: usize = 1 << 20;
pub(super) const MAX_ROWS: usize = 5_000_000;
/// Maximum number of speeds and gaps of a file: 320 MB.
pub(super) const MAX_VALUES: usize = 20_000_000;

/// Adds a line feed to the last line, and rejects overlong lines before they fill the memory.
struct LineLimitReader<R> {
    inner: R,
    since_line_feed: usize,
    /// True if line feeds in quotation marks do not end a line.
    has_quotes: bool,
    is_quoted: bool,
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
            self.is_quoted ^= self.has_quotes && byte == b'"';
            self.since_line_feed = if byte == b'\n' && !self.is_quoted { 0 } else { self.since_line_feed + 1 };
            if self.since_line_feed > MAX_LINE_BYTES {
                let message = format!("a line of more than {MAX_LINE_BYTES} bytes is not a row of numbers");
                return Err(io::Error::new(io::ErrorKind::InvalidData, message));
            }
        }
        Ok(count)
    }
}

/// A text whose sample was read before.
type SampledText<'a> = Chain<Cursor<Vec<u8>>, Utf8Reader<Box<dyn Read + 'a>>>;

pub(super) struct RowReader<'a> {
    path: &'a Path,
    rows: RowSource<'a>,
    format: TextFormat,
    row: CsvRow<'a>,
}

enum RowSource<'a> {
    Text(Box<csv::Reader<LineLimitReader<SampledText<'a>>>>),
    Binary { rows: Box<dyn BinaryRows + 'a>, names: Option<StringRecord> },
}

/// Rows of a file that is no text.
pub(super) trait BinaryRows {
    /// Reads the next row: texts of ids and whole numbers, and numbers, NaN if missing. Returns false at the end.
    fn next_row(&mut self, texts: &mut StringRecord, numbers: &mut Vec<f64>) -> Result<bool, BinaryProblem>;
}

impl<'a> RowReader<'a> {
    /// Reads rows with named columns.
    pub(super) fn from_binary(rows: Box<dyn BinaryRows + 'a>, names: StringRecord, path: &'a Path) -> Self {
        let row =
            CsvRow { path, line: 0, fields: StringRecord::new(), numbers: Vec::new(), decimal: DecimalMark::Point };
        Self { path, rows: RowSource::Binary { rows, names: Some(names) }, format: TextFormat::default(), row }
    }

    /// Detects the text format, as far as `map` does not state it.
    pub(super) fn new(
        from: impl Read + 'a,
        path: &'a Path,
        map: Option<&RecordingMapSpec>,
    ) -> Result<Self, RecordingError> {
        let mut text = Utf8Reader::new(Box::new(from) as Box<dyn Read + 'a>);
        let (fields, numbers) = (StringRecord::new(), Vec::new());
        let start = CsvRow { path, line: 1, fields, numbers, decimal: DecimalMark::Point };
        let sample = text.sample().map_err(|error| start.io_error(error))?;
        let format = TextFormat::detect(&String::from_utf8_lossy(&sample), map);
        let reader = csv::ReaderBuilder::new()
            .delimiter(format.delimiter.byte())
            .has_headers(false)
            .flexible(true)
            .quoting(format.has_quotes)
            .comment(format.comment.map(|letter| letter as u8))
            // Fields are trimmed, which removes carriage returns. Rows that end at both would miscount lines.
            .terminator(csv::Terminator::Any(b'\n'))
            .from_reader(LineLimitReader {
                inner: Cursor::new(sample).chain(text),
                since_line_feed: 0,
                has_quotes: format.has_quotes,
                is_quoted: false,
            });
        let decimal = format.decimal;
        let rows = RowSource::Text(Box::new(reader));
        Ok(Self { path, rows, format, row: CsvRow { line: 0, decimal, ..start } })
    }

    /// Returns the text format, with the encoding of what was read so far.
    pub(super) fn format(&self) -> TextFormat {
        match &self.rows {
            RowSource::Text(reader) => {
                TextFormat { encoding: reader.get_ref().inner.get_ref().1.encoding(), ..self.format.clone() }
            }
            RowSource::Binary { .. } => TextFormat { encoding: "UTF-8", ..self.format.clone() },
        }
    }

    /// Returns the next row with trimmed fields, such as column names.
    pub(super) fn next_header(&mut self) -> Result<Option<CsvRow<'a>>, RecordingError> {
        let mut row = self.next_row()?.cloned();
        row.iter_mut().for_each(|row| row.fields.trim());
        Ok(row)
    }

    pub(super) fn path(&self) -> &'a Path {
        self.path
    }

    /// Returns the next row that is not blank; `None` at the end of the file.
    pub(super) fn next_row(&mut self) -> Result<Option<&CsvRow<'a>>, RecordingError> {
        let Self { rows, row, path, .. } = self;
        match rows {
            RowSource::Text(reader) => loop {
                match reader.read_record(&mut row.fields) {
                    Ok(true) => {
                        // `row.position` precedes blank lines; the reader's position follows the row.
                        row.line = reader.position().line().saturating_sub(1);
                        if row.fields.len() > 1 || !row.text(0).is_empty() {
                            return Ok(Some(row));
                        }
                    }
                    Ok(false) => return Ok(None),
                    Err(error) => {
                        // Errors occur inside the next row.
                        row.line = reader.position().line();
                        return Err(match error.into_kind() {
                            csv::ErrorKind::Io(source) => row.io_error(source),
                            other => row.io_error(io::Error::new(io::ErrorKind::InvalidData, format!("{other:?}"))),
                        });
                    }
                }
            },
            RowSource::Binary { names, .. } if names.is_some() => {
                row.fields = names.take().unwrap_or_default();
                Ok(Some(row))
            }
            RowSource::Binary { rows, .. } => {
                row.line += 1;
                row.fields.clear();
                row.numbers.clear();
                let is_row = rows.next_row(&mut row.fields, &mut row.numbers);
                let problem = |problem| RecordingError::Binary { path: path.to_path_buf(), problem };
                Ok(is_row.map_err(problem)?.then_some(row))
            }
        }
    }

    pub(super) fn reject_cut_short<T>(&self, expected: &'static str) -> Result<T, RecordingError> {
        self.row.reject_line(LineProblem::CutShort { expected })
    }
}

#[derive(Clone)]
pub(super) struct CsvRow<'a> {
    path: &'a Path,
    decimal: DecimalMark,
    /// Line of a text; row of any other file.
    pub(super) line: u64,
    pub(super) fields: StringRecord,
    /// Numbers of a row that is no text.
    numbers: Vec<f64>,
}

impl CsvRow<'_> {
    pub(super) fn text(&self, index: usize) -> &str {
        self.fields.get(index).unwrap_or_default().trim()
    }

    /// Returns an error of reading the line, or of its text.
    fn io_error(&self, source: io::Error) -> RecordingError {
        let path = self.path.to_owned();
        if source.kind() != io::ErrorKind::InvalidData {
            return RecordingError::Read { path, source };
        }
        RecordingError::Line { path, line: self.line, problem: LineProblem::Malformed(source.to_string()) }
    }

    /// Returns the number of a field; `None` for an empty field or NaN, which many tools write for missing values.
    pub(super) fn number(&self, column: &CsvColumn) -> Result<Option<f64>, RecordingError> {
        let text = self.text(column.index);
        let number = self.numbers.get(column.index).map(|number| number * column.factor);
        if let Some(number) = number.filter(|number| number.is_finite()) {
            return Ok(Some(number));
        }
        if text.is_empty() && number.is_none_or(f64::is_nan) {
            return Ok(None);
        }
        match parse_number(text, self.decimal) {
            Some(number) if (number * column.factor).is_finite() => Ok(Some(number * column.factor)),
            Some(number) if number.is_nan() => Ok(None),
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
