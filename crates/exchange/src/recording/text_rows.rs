//! Rows of a text: lines divided at separators outside of quotation marks.

use std::io::{self, BufRead, Read};

use super::text::{TextFormat, Utf8Reader};

/// Maximum length of a row, in bytes. 200 vehicles with all columns of OpenACC take about 30 kB.
const MAX_ROW_BYTES: u64 = 1 << 20;

/// Fields of a row.
#[derive(Debug, Clone, Default)]
pub(super) struct Fields {
    text: String,
    /// Start and end of each field.
    places: Vec<(usize, usize)>,
}

impl Fields {
    pub(super) fn len(&self) -> usize {
        self.places.len()
    }

    pub(super) fn get(&self, index: usize) -> Option<&str> {
        let &(from, to) = self.places.get(index)?;
        self.text.get(from..to)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &str> + Clone {
        self.places.iter().map(|&(from, to)| self.text.get(from..to).unwrap_or_default())
    }

    pub(super) fn push(&mut self, field: &str) {
        self.places.push((self.text.len(), self.text.len() + field.len()));
        self.text += field;
    }

    pub(super) fn clear(&mut self) {
        self.text.clear();
        self.places.clear();
    }

    /// Returns the fields without blanks around them.
    pub(super) fn trimmed(&self) -> Self {
        self.iter().map(str::trim).collect()
    }

    fn split(&mut self, delimiter: u8) {
        self.places.clear();
        let mut from = 0;
        for (at, _) in self.text.bytes().enumerate().filter(|(_, byte)| *byte == delimiter) {
            self.places.push((from, at));
            from = at + 1;
        }
        self.places.push((from, self.text.len()));
    }

    /// Splits at separators outside of quotation marks. Returns false if one is open at the end.
    fn split_quoted(&mut self, delimiter: u8) -> bool {
        self.places.clear();
        let mut from = 0;
        let mut doubled = Vec::new();
        loop {
            let rest = self.text.get(from..).unwrap_or_default();
            let start = from + rest.len() - rest.trim_start_matches(' ').len();
            let bytes = self.text.as_bytes();
            let find =
                |from: usize, byte: u8| bytes.get(from..)?.iter().position(|other| *other == byte).map(|at| from + at);
            let end = if bytes.get(start) == Some(&b'"') {
                let mut close = start + 1;
                loop {
                    let Some(mark) = find(close, b'"') else { return false };
                    if bytes.get(mark + 1) != Some(&b'"') {
                        close = mark;
                        break;
                    }
                    doubled.push(self.places.len());
                    close = mark + 2;
                }
                self.places.push((start + 1, close));
                find(close, delimiter)
            } else {
                let end = find(from, delimiter);
                self.places.push((from, end.unwrap_or(bytes.len())));
                end
            };
            let Some(end) = end else { break };
            from = end + 1;
        }
        for index in doubled {
            let plain = self.get(index).unwrap_or_default().replace("\"\"", "\"");
            if let Some(place) = self.places.get_mut(index) {
                *place = (self.text.len(), self.text.len() + plain.len());
            }
            self.text += &plain;
        }
        true
    }
}

impl<'t> FromIterator<&'t str> for Fields {
    fn from_iter<T: IntoIterator<Item = &'t str>>(texts: T) -> Self {
        let mut fields = Self::default();
        texts.into_iter().for_each(|text| fields.push(text));
        fields
    }
}

pub(super) struct TextRows<'a> {
    text: Utf8Reader<Box<dyn Read + 'a>>,
    format: TextFormat,
    /// Byte that ends a line.
    line_end: u8,
    /// Number of lines before the next row.
    lines: u64,
    /// True if the last line has no end.
    pub(super) is_cut: bool,
}

impl<'a> TextRows<'a> {
    /// Detects the format of a text with a function of its beginning.
    pub(super) fn new(from: impl Read + 'a, detect: impl FnOnce(&str) -> TextFormat) -> Result<Self, io::Error> {
        let mut text = Utf8Reader::new(Box::new(from) as Box<dyn Read + 'a>);
        let sample = String::from_utf8_lossy(text.fill_buf()?);
        let line_end = if sample.contains('\r') && !sample.contains('\n') { b'\r' } else { b'\n' };
        let format = match line_end {
            b'\r' => detect(&sample.replace('\r', "\n")),
            _ => detect(&sample),
        };
        Ok(Self { text, format, line_end, lines: 0, is_cut: false })
    }

    /// Returns the format, with the encoding of what was read so far.
    pub(super) fn format(&self) -> TextFormat {
        TextFormat { encoding: self.text.encoding(), ..self.format.clone() }
    }

    /// Reads the next row that is neither blank nor a comment. Returns its first line; `None` at the end. An error has
    /// the line at which the row begins.
    pub(super) fn next_row(&mut self, fields: &mut Fields) -> Result<Option<u64>, (u64, io::Error)> {
        let delimiter = self.format.delimiter.byte();
        loop {
            fields.clear();
            let line = self.lines + 1;
            let error = |error| (line, error);
            if !self.read_line(&mut fields.text).map_err(error)? {
                return Ok(None);
            }
            if self.format.comment.is_some_and(|letter| fields.text.starts_with(letter)) {
                continue;
            }
            if self.format.has_quotes {
                while !fields.split_quoted(delimiter) {
                    // Only a line with a quotation mark can close the field.
                    let mut next = String::new();
                    while !next.contains('"') {
                        next.clear();
                        if fields.text.len() as u64 > MAX_ROW_BYTES || !self.read_line(&mut next).map_err(error)? {
                            let problem = "a quotation mark in this row is not closed";
                            return Err(error(io::Error::new(io::ErrorKind::InvalidData, problem)));
                        }
                        fields.text.push('\n');
                        fields.text += &next;
                    }
                }
            } else {
                fields.split(delimiter);
            }
            if fields.len() > 1 || fields.iter().any(|only| !only.trim().is_empty()) {
                return Ok(Some(line));
            }
        }
    }

    /// Appends the next line without its end. Returns false at the end of the text.
    fn read_line(&mut self, into: &mut String) -> io::Result<bool> {
        let mut bytes = std::mem::take(into).into_bytes();
        let count = (&mut self.text).take(MAX_ROW_BYTES + 1).read_until(self.line_end, &mut bytes)?;
        let invalid = |message: String| io::Error::new(io::ErrorKind::InvalidData, message);
        if count as u64 > MAX_ROW_BYTES {
            return Err(invalid(format!("a line of more than {MAX_ROW_BYTES} bytes is not a row of numbers")));
        }
        self.is_cut = count > 0 && bytes.pop_if(|last| *last == self.line_end).is_none();
        if self.lines == 0 && bytes.starts_with("\u{feff}".as_bytes()) {
            bytes.drain(..'\u{feff}'.len_utf8());
        }
        *into = String::from_utf8(bytes).map_err(|error| invalid(error.to_string()))?;
        self.lines += 1;
        Ok(count > 0)
    }
}
