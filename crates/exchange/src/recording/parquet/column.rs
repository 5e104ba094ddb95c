//! Values of a column, row by row.

use std::fmt::Write;

use super::footer::ColumnChunk;
use super::pages::{Page, PageKind, next_page};
use super::values::{Hybrid, Value, ValueReader};
use super::{FileBytes, ParquetError};
use crate::recording::table::excerpt;

/// Encoding of levels.
const RLE: i64 = 3;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PhysicalType {
    Boolean,
    Int32,
    Int64,
    /// Nanoseconds of a day, and its Julian number.
    Int96,
    Float,
    Double,
    Bytes,
    FixedBytes(usize),
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ColumnMeaning {
    Plain,
    Unsigned,
    Decimal {
        scale: u32,
    },
    /// A time since midnight.
    TimeOfDay {
        per_second: u32,
    },
    Float16,
}

/// A column that is neither nested nor repeated.
#[derive(Debug, Clone)]
pub(super) struct FlatColumn {
    pub(super) name: String,
    /// Index among the columns with values.
    pub(super) leaf: usize,
    pub(super) physical: PhysicalType,
    pub(super) meaning: ColumnMeaning,
    /// True if values may be missing.
    pub(super) is_optional: bool,
}

impl FlatColumn {
    pub(super) fn shown_name(&self) -> String {
        excerpt(&self.name)
    }
}

/// Reader of a column.
pub(super) struct Column {
    column: FlatColumn,
    chunk: Option<ColumnChunk>,
    dictionary: Option<Dictionary>,
    page: Vec<u8>,
    /// Number of rows left in the page.
    rows_left: u64,
    /// Number of rows of the group that no page had so far.
    group_rows_left: u64,
    /// 1 for each row with a value, if values may be missing.
    levels: Option<Hybrid>,
    values: ValueReader,
}

/// Values that pages name by their index.
struct Dictionary {
    bytes: Vec<u8>,
    /// Place of each text.
    texts: Vec<(u32, u32)>,
}

impl Column {
    pub(super) fn new(column: FlatColumn) -> Self {
        Self {
            column,
            chunk: None,
            dictionary: None,
            page: Vec::new(),
            rows_left: 0,
            group_rows_left: 0,
            levels: None,
            values: ValueReader::Plain { at: 0 },
        }
    }

    pub(super) fn name(&self) -> &str {
        &self.column.name
    }

    /// Begins with the rows of the next group.
    pub(super) fn begin(&mut self, chunk: ColumnChunk, rows: u64, file: &mut FileBytes) {
        self.release_page(file);
        if let Some(dictionary) = self.dictionary.take() {
            file.bytes_in_memory -= dictionary.bytes.len() as u64;
        }
        self.chunk = Some(chunk);
        self.rows_left = 0;
        self.group_rows_left = rows;
    }

    fn release_page(&mut self, file: &mut FileBytes) {
        file.bytes_in_memory -= std::mem::take(&mut self.page).len() as u64;
    }

    /// Returns the number of the next row, NaN if missing or no number, and writes its text.
    pub(super) fn next(
        &mut self,
        file: &mut FileBytes,
        text: &mut String,
    ) -> Result<f64, ParquetError> {
        while self.rows_left == 0 {
            self.read_page(file)?;
        }
        self.rows_left -= 1;
        if let Some(levels) = &mut self.levels {
            match levels.next(&self.page) {
                Some(0) => return Ok(f64::NAN),
                Some(1) => {}
                _ => return Err(ParquetError::Damaged("the levels of a page are wrong")),
            }
        }
        let value = match &mut self.values {
            ValueReader::Dictionary(indices) => {
                let index = indices
                    .next(&self.page)
                    .ok_or(ParquetError::Damaged("a page ends before its values"))?;
                let dictionary = self
                    .dictionary
                    .as_ref()
                    .ok_or(ParquetError::Damaged("a column lacks its dictionary"))?;
                let lacks = ParquetError::Damaged("a page names a value that its dictionary lacks");
                dictionary
                    .get(self.column.physical, index as usize)
                    .ok_or(lacks)?
            }
            values => values.next(self.column.physical, &self.page)?,
        };
        Ok(self.column.show(value, text))
    }

    /// Reads the next page of the current group.
    fn read_page(&mut self, file: &mut FileBytes) -> Result<(), ParquetError> {
        self.release_page(file);
        let chunk = self
            .chunk
            .as_mut()
            .ok_or(ParquetError::Damaged("a column has no pages"))?;
        let page =
            next_page(file, chunk)?.ok_or(ParquetError::Damaged("a column has too few values"))?;
        self.open_page(page)
    }

    fn open_page(&mut self, page: Page) -> Result<(), ParquetError> {
        let Page { bytes, header } = page;
        if header.kind == PageKind::Dictionary {
            if self.dictionary.is_some() {
                return Err(ParquetError::Damaged("a column has two dictionaries"));
            }
            self.dictionary = Some(Dictionary::new(bytes, self.column.physical)?);
            return Ok(());
        }
        let too_many = ParquetError::Damaged("a column has more values than rows");
        self.group_rows_left = self
            .group_rows_left
            .checked_sub(header.values)
            .ok_or(too_many)?;
        let [levels_start, levels_end] = match header.kind {
            _ if !self.column.is_optional => [0, 0],
            PageKind::DataV2 { definition_bytes } => [0, definition_bytes],
            _ if header.level_encoding != RLE => {
                return Err(ParquetError::Unsupported(
                    "levels that are packed without runs".to_owned(),
                ));
            }
            _ => [4, end_of_levels(&bytes)?],
        };
        self.levels = self
            .column
            .is_optional
            .then(|| Hybrid::new(levels_start, levels_end, 1));
        self.values = ValueReader::new(
            &self.column,
            header.encoding,
            &bytes,
            levels_end,
            header.values,
        )?;
        self.page = bytes;
        self.rows_left = header.values;
        Ok(())
    }
}

/// Returns the end of levels whose length precedes them.
fn end_of_levels(bytes: &[u8]) -> Result<usize, ParquetError> {
    let length = bytes
        .first_chunk()
        .map(|length| u32::from_le_bytes(*length) as usize);
    let end = length
        .and_then(|length| length.checked_add(4))
        .filter(|end| *end <= bytes.len());
    end.ok_or(ParquetError::Damaged(
        "the levels of a page are longer than the page",
    ))
}

impl Dictionary {
    fn new(bytes: Vec<u8>, physical: PhysicalType) -> Result<Self, ParquetError> {
        let mut texts = Vec::new();
        let mut at = 0;
        while physical == PhysicalType::Bytes && at < bytes.len() {
            let length = bytes
                .get(at..)
                .and_then(<[u8]>::first_chunk)
                .map(|length| u32::from_le_bytes(*length) as usize);
            let end = length
                .and_then(|length| (at + 4).checked_add(length))
                .filter(|end| *end <= bytes.len());
            let end = end.ok_or(ParquetError::Damaged("a dictionary ends within a text"))?;
            // Pages have at most 64 MiB.
            texts.push((at as u32 + 4, end as u32));
            at = end;
        }
        Ok(Self { bytes, texts })
    }

    /// Returns the value with an index, if there is one.
    fn get(&self, physical: PhysicalType, index: usize) -> Option<Value<'_>> {
        if physical == PhysicalType::Bytes {
            let &(from, to) = self.texts.get(index)?;
            return self.bytes.get(from as usize..to as usize).map(Value::Bytes);
        }
        Value::from_dictionary(physical, &self.bytes, index)
    }
}

impl FlatColumn {
    /// Returns the number of a value, NaN if it is none, and writes its text: ids may be texts or whole numbers.
    fn show(&self, value: Value<'_>, text: &mut String) -> f64 {
        match (value, self.meaning) {
            (Value::Number(number), _) => number,
            (Value::Integer(number), ColumnMeaning::Unsigned)
                if self.physical == PhysicalType::Int32 =>
            {
                show_integer(i128::from(number as u32), text)
            }
            (Value::Integer(number), ColumnMeaning::Unsigned) => {
                show_integer(i128::from(number as u64), text)
            }
            (Value::Integer(number), ColumnMeaning::Decimal { scale }) => {
                show_decimal(number, scale, text)
            }
            (Value::Integer(number), ColumnMeaning::TimeOfDay { per_second }) => {
                show_time_of_day(number * 1_000_000 / i128::from(per_second), text);
                f64::NAN
            }
            (Value::Integer(number), _) => show_integer(number, text),
            (Value::Bytes(bytes), ColumnMeaning::Decimal { scale }) if bytes.len() <= 16 => {
                show_decimal(twos_complement(bytes), scale, text)
            }
            (Value::Bytes(&[low, high]), ColumnMeaning::Float16) => {
                half_precision(u16::from_le_bytes([low, high]))
            }
            (Value::Bytes(bytes), _) => {
                *text += &String::from_utf8_lossy(bytes);
                f64::NAN
            }
        }
    }
}

/// Returns a whole number with sign, whose most significant byte comes first.
fn twos_complement(bytes: &[u8]) -> i128 {
    let is_negative = bytes.first().is_some_and(|first| *first >= 0x80);
    let sign = if is_negative { -1 } else { 0 };
    bytes
        .iter()
        .fold(sign, |number, byte| number << 8 | i128::from(*byte))
}

fn show_integer(number: i128, text: &mut String) -> f64 {
    let _ = write!(text, "{number}");
    number as f64
}

fn show_decimal(number: i128, scale: u32, text: &mut String) -> f64 {
    let number = number as f64 / 10_f64.powi(scale as i32);
    let _ = write!(text, "{number}");
    number
}

fn show_time_of_day(microseconds: i128, text: &mut String) {
    let seconds = microseconds / 1_000_000;
    let _ = write!(
        text,
        "{:02}:{:02}:{:02}.{:06}",
        seconds / 3600,
        seconds / 60 % 60,
        seconds % 60,
        microseconds % 1_000_000
    );
}

/// Returns the value of a floating point number of 16 bits.
fn half_precision(bits: u16) -> f64 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let exponent = i32::from(bits >> 10 & 0x1f);
    let fraction = f64::from(bits & 0x3ff) / 1024.0;
    sign * match exponent {
        0 => fraction * 2_f64.powi(-14),
        0x1f if fraction == 0.0 => f64::INFINITY,
        0x1f => f64::NAN,
        _ => (1.0 + fraction) * 2_f64.powi(exponent - 15),
    }
}
