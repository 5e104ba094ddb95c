//! Text of recordings: its encoding, and how it writes columns and numbers.

use std::fmt;
use std::io::{self, BufRead, Read};
use std::ops::Range;

use encoding_rs::{Decoder, DecoderResult, UTF_16BE, UTF_16LE, WINDOWS_1252};

use super::map::{DecimalMark, Delimiter, RecordingMapSpec};
use super::number::NumberMarks;
use super::table::excerpt;

const CHUNK_BYTES: usize = 64 << 10;
/// Number of rows whose numbers show the decimal mark.
const MAX_SAMPLE_ROWS: usize = 200;

/// Encoding of a recording, and how it writes columns, numbers and times.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TextFormat {
    /// Name of the encoding by the Encoding Standard.
    pub encoding: &'static str,
    /// Separator of columns.
    pub delimiter: Delimiter,
    /// Mark of decimals. Numbers may have thousands separators: the other mark, `'` or a blank.
    pub decimal: DecimalMark,
    /// True if fields may be in quotation marks, which may contain separators.
    pub has_quotes: bool,
    /// First letter of comment lines.
    pub comment: Option<char>,
    /// Format of the time, if the map does not state its unit.
    pub time: Option<&'static str>,
    /// True if the map states the separator, and the mark.
    pub(super) stated: [bool; 2],
    /// True if the first line only states the separator, such as `sep=;`, as spreadsheets write it.
    pub(super) has_separator_line: bool,
    /// True if blanks precede quotation marks at the start of fields.
    pub(super) has_blanks_before_quotes: bool,
}

/// Writes what crumple detected, unless it is the default.
impl fmt::Display for TextFormat {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let delimiter = match self.delimiter {
            Delimiter::Semicolon => Some("semicolons"),
            Delimiter::Tab => Some("tabs"),
            Delimiter::Comma => None,
        };
        let parts = [
            Some(self.encoding)
                .filter(|encoding| *encoding != "UTF-8")
                .map(str::to_owned),
            delimiter
                .filter(|_| !self.stated[0])
                .map(|name| format!("columns separated by {name}")),
            (self.decimal == DecimalMark::Comma && !self.stated[1])
                .then(|| "decimal commas".to_owned()),
            self.has_quotes.then(|| "quotation marks".to_owned()),
            self.comment
                .map(|first| format!("comment lines with {first}")),
            self.time
                .filter(|time| *time != "s")
                .map(|time| format!("time in {time}")),
        ];
        out.write_str(&parts.into_iter().flatten().collect::<Vec<_>>().join(", "))
    }
}

impl TextFormat {
    /// Detects the format from the first lines of a text. `map` takes precedence.
    ///
    /// # Errors
    /// A first line that states a separator which crumple does not read, in words.
    pub(super) fn detect(sample: &str, map: Option<&RecordingMapSpec>) -> Result<Self, String> {
        if let Some(separator) = unknown_separator(sample) {
            let separator = excerpt(separator);
            return Err(format!(
                "the first line states the separator `{separator}`, but crumple reads only comma, semicolon and tab"
            ));
        }
        Ok(Self::detect_known(sample, map))
    }

    fn detect_known(sample: &str, map: Option<&RecordingMapSpec>) -> Self {
        let before_names = map.map_or(0, |map| map.lines_before_names);
        let sample = sample.trim_start_matches('\u{feff}');
        let in_file = stated_separator(sample);
        let lines: Vec<&str> = sample
            .lines()
            .filter(|line| !line.trim().is_empty())
            .skip(usize::from(in_file.is_some()))
            .collect();
        let comment = ['#', '%']
            .into_iter()
            .find(|letter| begins_comments(*letter, &lines, before_names));
        let rows: Vec<&str> = lines
            .into_iter()
            .filter(|line| comment.is_none_or(|letter| !line.starts_with(letter)))
            .skip(before_names)
            .collect();
        let in_map = map.and_then(|map| map.delimiter);
        let delimiter = in_map
            .or(in_file)
            .or_else(|| detect_delimiter(&rows))
            .unwrap_or_default();
        let mut quoted = rows
            .iter()
            .flat_map(|row| fields(row, delimiter))
            .filter(|field| field.trim_start().starts_with('"'))
            .peekable();
        let has_quotes = quoted.peek().is_some();
        let has_blanks_before_quotes = quoted.any(|field| field.starts_with(' '));
        let decimal = map.and_then(|map| map.decimal);
        Self {
            encoding: "UTF-8",
            delimiter,
            decimal: decimal.unwrap_or_else(|| detect_decimal_mark(&rows, delimiter)),
            has_quotes,
            comment,
            time: None,
            stated: [in_map.is_some() && in_file.is_none(), decimal.is_some()],
            has_separator_line: in_file.is_some(),
            has_blanks_before_quotes,
        }
    }
}

/// Returns whether lines that begin with a letter are comments.
fn begins_comments(letter: char, lines: &[&str], before_names: usize) -> bool {
    let mut header = lines.iter().take(before_names);
    let rows = lines.iter().skip(before_names);
    // Ids may begin with the letter, too.
    !header.any(|line| line.starts_with(letter))
        && rows.clone().any(|line| line.starts_with(letter))
        && !rows.skip(1).all(|line| line.starts_with(letter))
}

/// Returns the separator that splits the names of columns, preferably into as many fields as the first row.
fn detect_delimiter(rows: &[&str]) -> Option<Delimiter> {
    let [names, first] = [0, 1].map(|index| rows.get(index).copied().unwrap_or(""));
    let splitting = KNOWN_DELIMITERS
        .into_iter()
        .filter(|delimiter| fields(names, *delimiter).count() > 1);
    splitting
        .clone()
        .find(|delimiter| fields(names, *delimiter).count() == fields(first, *delimiter).count())
        .or_else(|| splitting.clone().next())
}

/// Returns the decimal mark of the numbers in the first rows after the names.
fn detect_decimal_mark(rows: &[&str], delimiter: Delimiter) -> DecimalMark {
    let mut marks = NumberMarks::default();
    for row in rows.iter().skip(1).take(MAX_SAMPLE_ROWS) {
        for field in fields(row, delimiter) {
            marks.add(field.trim().trim_matches('"'));
        }
    }
    marks.decimal(delimiter)
}

/// Separators that crumple reads.
const KNOWN_DELIMITERS: [Delimiter; 3] = [Delimiter::Tab, Delimiter::Semicolon, Delimiter::Comma];

/// Returns the text behind `sep=` in a first line, which may be in quotation marks.
fn separator_text(sample: &str) -> Option<&str> {
    let line = sample.trim_start_matches('\u{feff}').lines().next()?;
    let line = line.strip_prefix('"').unwrap_or(line);
    let (key, rest) = line.split_at_checked(4)?;
    key.eq_ignore_ascii_case("sep=").then_some(rest)
}

/// Returns the separator of a first line such as `sep=;`. Spreadsheets fill the line with more separators.
fn stated_separator(sample: &str) -> Option<Delimiter> {
    let text = separator_text(sample)?;
    KNOWN_DELIMITERS.into_iter().find(|delimiter| {
        let separator = char::from(delimiter.byte());
        text.starts_with(separator)
            && text
                .chars()
                .all(|letter| letter == separator || letter == '"')
    })
}

/// Returns the separator of a first line such as `sep=|`, if crumple does not read it.
fn unknown_separator(sample: &str) -> Option<&str> {
    let text = separator_text(sample)?;
    let has_known = KNOWN_DELIMITERS
        .iter()
        .any(|delimiter| text.contains(char::from(delimiter.byte())));
    (!has_known).then(|| text.trim_end_matches('"'))
}

/// Splits a line at separators outside of quotation marks.
fn fields(line: &str, delimiter: Delimiter) -> impl Iterator<Item = &str> {
    let mut is_quoted = false;
    line.split(move |letter: char| {
        is_quoted ^= letter == '"';
        !is_quoted && letter == char::from(delimiter.byte())
    })
}

/// Converts a text to UTF-8 while it is read: UTF-16, with or without a byte order mark; UTF-8; and Windows-1252, which
/// includes Latin-1, from the first byte on that is not UTF-8.
pub(super) struct Utf8Reader<R> {
    inner: R,
    encoding: &'static str,
    /// Decoder of texts that are not UTF-8.
    decoder: Option<Decoder>,
    is_started: bool,
    is_finished: bool,
    /// Bytes that were read, of which the first ones begin an incomplete letter.
    input: Vec<u8>,
    /// Number of bytes of the incomplete letter.
    incomplete: usize,
    output: Vec<u8>,
    /// Number of bytes of `output` that were returned.
    returned: usize,
}

impl<R: Read> Utf8Reader<R> {
    pub(super) fn new(inner: R) -> Self {
        Self {
            inner,
            encoding: "UTF-8",
            decoder: None,
            is_started: false,
            is_finished: false,
            input: vec![0; CHUNK_BYTES],
            incomplete: 0,
            output: Vec::new(),
            returned: 0,
        }
    }

    pub(super) fn encoding(&self) -> &'static str {
        self.encoding
    }

    /// Reads and converts a chunk. Returns false at the end.
    fn refill(&mut self) -> io::Result<bool> {
        if self.is_finished {
            return Ok(false);
        }
        let end = self.read_input()?;
        let is_last = end == self.incomplete;
        self.is_finished = is_last;
        if !std::mem::replace(&mut self.is_started, true)
            && let Some(encoding) = utf_16(&self.input[..end])
        {
            self.encoding = encoding.name();
            self.decoder = Some(encoding.new_decoder_with_bom_removal());
        }
        self.output.clear();
        self.returned = 0;
        self.incomplete = 0;
        let valid = match self.decoder {
            Some(_) => 0,
            None => self.pass_on_utf_8(end, is_last),
        };
        self.decode(valid..end, is_last)?;
        Ok(!is_last || !self.output.is_empty())
    }

    /// Reads a chunk behind the incomplete letter. Returns the end of the input.
    fn read_input(&mut self) -> io::Result<usize> {
        let mut end = self.incomplete;
        loop {
            let count = self.inner.read(&mut self.input[end..])?;
            end += count;
            // The first chunk shows the format.
            if count == 0 || self.is_started || end == self.input.len() {
                return Ok(end);
            }
        }
    }

    /// Passes on the input up to the first byte that is not UTF-8, from which on it is Windows-1252, or up to an
    /// incomplete letter. Returns the number of bytes.
    fn pass_on_utf_8(&mut self, end: usize, is_last: bool) -> usize {
        let bytes = &self.input[..end];
        let valid = match std::str::from_utf8(bytes) {
            Ok(_) => end,
            Err(error) => {
                if error.error_len().is_none() && !is_last {
                    self.incomplete = end - error.valid_up_to();
                } else {
                    self.encoding = WINDOWS_1252.name();
                    self.decoder = Some(WINDOWS_1252.new_decoder_without_bom_handling());
                }
                error.valid_up_to()
            }
        };
        self.output.extend_from_slice(&bytes[..valid]);
        valid
    }

    /// Decodes input that is not UTF-8; otherwise moves the incomplete letter to the start of the input.
    fn decode(&mut self, rest: Range<usize>, is_last: bool) -> io::Result<()> {
        let Some(decoder) = &mut self.decoder else {
            self.input.copy_within(rest, 0);
            return Ok(());
        };
        let rest = &self.input[rest];
        let capacity = decoder
            .max_utf8_buffer_length_without_replacement(rest.len())
            .unwrap_or(4 * CHUNK_BYTES);
        let from = self.output.len();
        self.output.resize(from + capacity, 0);
        let (result, _, written) =
            decoder.decode_to_utf8_without_replacement(rest, &mut self.output[from..], is_last);
        self.output.truncate(from + written);
        if matches!(result, DecoderResult::Malformed(..)) {
            let message = format!("is not text in {}", self.encoding);
            return Err(io::Error::new(io::ErrorKind::InvalidData, message));
        }
        Ok(())
    }
}

impl<R: Read> BufRead for Utf8Reader<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        while self.returned == self.output.len() && self.refill()? {}
        Ok(&self.output[self.returned..])
    }

    fn consume(&mut self, count: usize) {
        self.returned += count;
    }
}

impl<R: Read> Read for Utf8Reader<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(into)?;
        self.consume(count);
        Ok(count)
    }
}

/// Recognises UTF-16 by its byte order mark, or by the zero bytes of Latin letters.
fn utf_16(bytes: &[u8]) -> Option<&'static encoding_rs::Encoding> {
    let [even_zeros, odd_zeros] = [0, 1].map(|from| {
        let every_other = bytes.iter().skip(from).step_by(2);
        every_other.filter(|byte| **byte == 0).count()
    });
    let most = bytes.len() * 3 / 8;
    match bytes {
        [0xff, 0xfe, ..] => Some(UTF_16LE),
        [0xfe, 0xff, ..] => Some(UTF_16BE),
        _ if bytes.len() >= 4 && even_zeros == 0 && odd_zeros > most => Some(UTF_16LE),
        _ if bytes.len() >= 4 && odd_zeros == 0 && even_zeros > most => Some(UTF_16BE),
        _ => None,
    }
}
