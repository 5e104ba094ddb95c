//! Rows of a text by RFC 4180, with any separator and line end.

use std::io::{self, BufRead, Read};

pub(super) use csv::StringRecord as Fields;
use csv::{ErrorKind, Reader, ReaderBuilder, Terminator};

use super::text::{TextFormat, Utf8Reader};

/// Maximum length of a line, in bytes. 200 vehicles with all columns of OpenACC take about 30 kB.
const MAX_LINE_BYTES: u64 = 1 << 20;
/// Maximum length of a row with line ends in its fields, and the comments before it, in bytes.
const MAX_ROW_BYTES: u64 = 16 << 20;
const BUFFER_BYTES: usize = 64 << 10;

pub(super) struct TextRows<'a> {
    rows: Reader<LineSource<'a>>,
    format: TextFormat,
    /// True until a first line such as `sep=;` was skipped.
    skips_line: bool,
    /// True if the last row has no line end.
    pub(super) is_cut: bool,
}

impl<'a> TextRows<'a> {
    /// Detects the format of a text with a function of its beginning, whose error is in words.
    pub(super) fn new(
        from: impl Read + 'a,
        detect: impl FnOnce(&str) -> Result<TextFormat, String>,
    ) -> Result<Self, io::Error> {
        let mut text = Utf8Reader::new(Box::new(from) as Box<dyn Read + 'a>);
        let sample = String::from_utf8_lossy(text.fill_buf()?);
        let has_only_carriage_returns = sample.contains('\r') && !sample.contains('\n');
        let format = if has_only_carriage_returns {
            detect(&sample.replace('\r', "\n"))
        } else {
            detect(&sample)
        }
        .map_err(|problem| io::Error::new(io::ErrorKind::InvalidData, problem))?;
        let source = LineSource::new(text, has_only_carriage_returns, &format);
        let rows = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .buffer_capacity(BUFFER_BYTES)
            .delimiter(format.delimiter.byte())
            .terminator(Terminator::Any(b'\n'))
            .comment(format.comment.and_then(|letter| u8::try_from(letter).ok()))
            .from_reader(source);
        Ok(Self {
            rows,
            skips_line: format.has_separator_line,
            format,
            is_cut: false,
        })
    }

    /// Returns the format, with the encoding of what was read so far.
    pub(super) fn format(&self) -> TextFormat {
        TextFormat {
            encoding: self.rows.get_ref().text.encoding(),
            ..self.format.clone()
        }
    }

    /// Reads the next row that is neither blank nor a comment. Returns its first line; `None` at the end. An error has
    /// the line at which the row begins.
    pub(super) fn next_row(
        &mut self,
        fields: &mut Fields,
    ) -> Result<Option<u64>, (u64, io::Error)> {
        loop {
            let before = self.rows.position().line();
            let is_row = self
                .rows
                .read_record(fields)
                .map_err(|error| (before, into_io_error(error)))?;
            if !is_row {
                return Ok(None);
            }
            let line = self.rows.position().line();
            let byte = self.rows.position().byte();
            let source = self.rows.get_mut();
            source.row_at = byte;
            if source.end == SourceEnd::Read {
                let first = line - count_line_ends(fields);
                let problem = "a quotation mark in this row is not closed";
                return Err((first, io::Error::new(io::ErrorKind::InvalidData, problem)));
            }
            self.is_cut = source.end == SourceEnd::LineEndAdded
                && source.last != b'\n'
                && byte == source.passed;
            let is_blank = fields.len() <= 1 && fields.iter().all(|only| only.trim().is_empty());
            if std::mem::take(&mut self.skips_line) || is_blank {
                continue;
            }
            // Blank lines and comments before the row, and line ends in its fields, count as lines, too.
            let first = if line == before + 1 {
                before
            } else {
                line - 1 - count_line_ends(fields)
            };
            return Ok(Some(first));
        }
    }
}

fn count_line_ends(fields: &Fields) -> u64 {
    fields
        .iter()
        .map(|field| field.bytes().filter(|byte| *byte == b'\n').count() as u64)
        .sum()
}

fn into_io_error(error: csv::Error) -> io::Error {
    match error.into_kind() {
        ErrorKind::Io(error) => error,
        _ => io::Error::new(io::ErrorKind::InvalidData, "is not text in UTF-8"),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SourceEnd {
    NotReached,
    /// A last line end follows the text. It ends every row, except within quotation marks.
    LineEndAdded,
    Read,
}

/// A text in UTF-8 whose lines end with a line feed.
struct LineSource<'a> {
    text: Utf8Reader<Box<dyn Read + 'a>>,
    has_only_carriage_returns: bool,
    blanks: Option<BlankFilter>,
    /// Number of bytes that were passed on.
    passed: u64,
    /// Number of these bytes before the current row, and before the last line.
    row_at: u64,
    line_at: u64,
    /// Last byte of the text.
    last: u8,
    end: SourceEnd,
}

impl Read for LineSource<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.check_limits()?;
        loop {
            let read = self.text.read(into)?;
            let Some(bytes) = into.get_mut(..read).filter(|bytes| !bytes.is_empty()) else {
                return Ok(self.read_end(into));
            };
            if self.has_only_carriage_returns {
                bytes
                    .iter_mut()
                    .filter(|byte| **byte == b'\r')
                    .for_each(|byte| *byte = b'\n');
            }
            self.last = bytes.last().copied().unwrap_or(self.last);
            let count = self
                .blanks
                .as_mut()
                .map_or(read, |filter| filter.apply(bytes));
            let line_end = bytes
                .get(..count)
                .and_then(|bytes| bytes.iter().rposition(|byte| *byte == b'\n'));
            self.line_at = line_end.map_or(self.line_at, |at| self.passed + at as u64);
            self.passed += count as u64;
            if count > 0 {
                return Ok(count);
            }
        }
    }
}

impl<'a> LineSource<'a> {
    fn new(
        text: Utf8Reader<Box<dyn Read + 'a>>,
        has_only_carriage_returns: bool,
        format: &TextFormat,
    ) -> Self {
        Self {
            text,
            has_only_carriage_returns,
            blanks: format
                .has_blanks_before_quotes
                .then(|| BlankFilter::new(format)),
            passed: 0,
            row_at: 0,
            line_at: 0,
            last: b'\n',
            end: SourceEnd::NotReached,
        }
    }

    fn check_limits(&self) -> io::Result<()> {
        let problem = if self.passed - self.line_at > MAX_LINE_BYTES {
            format!("a line of more than {MAX_LINE_BYTES} bytes is not a row of numbers")
        } else if self.passed - self.row_at > MAX_ROW_BYTES {
            format!(
                "a row of more than {MAX_ROW_BYTES} bytes: a quotation mark is probably not closed"
            )
        } else {
            return Ok(());
        };
        Err(io::Error::new(io::ErrorKind::InvalidData, problem))
    }

    /// Passes on the last line end, and then nothing.
    fn read_end(&mut self, into: &mut [u8]) -> usize {
        match (self.end, into.first_mut()) {
            (SourceEnd::NotReached, Some(first)) => {
                *first = b'\n';
                self.end = SourceEnd::LineEndAdded;
                self.passed += 1;
                1
            }
            _ => {
                self.end = SourceEnd::Read;
                0
            }
        }
    }
}

/// Removes blanks between a separator and a quotation mark, which many programs write against RFC 4180.
struct BlankFilter {
    delimiter: u8,
    comment: Option<u8>,
    state: TextState,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum TextState {
    LineStart,
    FieldStart,
    Field,
    Quoted,
    /// After a quotation mark in a quoted field, which ends the field or is doubled.
    QuotedMark,
    Comment,
}

impl BlankFilter {
    fn new(format: &TextFormat) -> Self {
        let comment = format.comment.and_then(|letter| u8::try_from(letter).ok());
        Self {
            delimiter: format.delimiter.byte(),
            comment,
            state: TextState::LineStart,
        }
    }

    /// Removes blanks at the starts of fields, and returns the number of remaining bytes.
    fn apply(&mut self, bytes: &mut [u8]) -> usize {
        let mut count = 0;
        for index in 0..bytes.len() {
            let byte = bytes[index];
            let is_removed = self.advance(byte);
            if !is_removed {
                bytes[count] = byte;
                count += 1;
            }
        }
        count
    }

    /// Moves behind a byte. Returns whether it is removed.
    fn advance(&mut self, byte: u8) -> bool {
        use TextState::{Comment, Field, FieldStart, LineStart, Quoted, QuotedMark};
        let unquoted = match byte {
            b'\n' => LineStart,
            _ if byte == self.delimiter => FieldStart,
            _ => Field,
        };
        let is_start = matches!(self.state, LineStart | FieldStart);
        let is_blank = is_start && byte == b' ';
        self.state = match self.state {
            LineStart if self.comment == Some(byte) => Comment,
            LineStart | FieldStart if byte == b'"' => Quoted,
            LineStart | FieldStart if is_blank => FieldStart,
            LineStart | FieldStart | Field => unquoted,
            Quoted if byte == b'"' => QuotedMark,
            Quoted => Quoted,
            QuotedMark if byte == b'"' => Quoted,
            QuotedMark => unquoted,
            Comment if byte == b'\n' => LineStart,
            Comment => Comment,
        };
        is_blank
    }
}
