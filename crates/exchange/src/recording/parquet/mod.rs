//! Rows of Parquet files: columns of numbers, texts and times that are not nested.
//!
//! crumple reads these columns itself: the crate `parquet` trusts the sizes in a file, and panics on damaged pages.

mod codec;
mod column;
mod error;
mod footer;
mod pages;
#[cfg(test)]
mod tests;
mod thrift;
mod values;

use std::io::{Read, Seek, SeekFrom};

use super::binary::check_columns;
use super::error::BinaryProblem;
use super::limits;
use super::map::RecordingMapSpec;
use super::table::BinaryRows;
use super::text_rows::Fields;
use column::Column;
use footer::{Footer, RowGroup};

pub use error::ParquetError;

/// A file, or its bytes.
pub(super) trait ParquetSource: Read + Seek {}

impl<S: Read + Seek> ParquetSource for S {}

/// Bytes of a file, and the work that it may still cause.
pub(super) struct FileBytes {
    source: Box<dyn ParquetSource>,
    length: u64,
    /// Bytes of pages that may still be read; no two pages share bytes.
    unread: u64,
    /// Bytes that pages may still have after decompression.
    decompressed_left: u64,
    /// Bytes of the pages and dictionaries in memory.
    bytes_in_memory: u64,
}

impl FileBytes {
    fn new(mut source: Box<dyn ParquetSource>) -> Result<Self, ParquetError> {
        let length = source.seek(SeekFrom::End(0))?;
        let decompressed_left = limits::max_decompressed_bytes(length);
        Ok(Self {
            source,
            length,
            unread: length,
            decompressed_left,
            bytes_in_memory: 0,
        })
    }

    fn read(&mut self, at: u64, count: u64) -> Result<Vec<u8>, ParquetError> {
        if at.checked_add(count).is_none_or(|end| end > self.length) {
            return Err(ParquetError::Damaged(
                "a part lies behind the end of the file",
            ));
        }
        let mut bytes = vec![0; count as usize];
        self.source.seek(SeekFrom::Start(at))?;
        self.source.read_exact(&mut bytes)?;
        Ok(bytes)
    }
}

pub(super) struct ParquetRows {
    file: FileBytes,
    groups: std::vec::IntoIter<RowGroup>,
    /// Number of rows left in the current group.
    rows_left: u64,
    columns: Vec<Column>,
    /// Text of the current value.
    text: String,
}

/// Returns the rows of the columns that the map names, or of all columns.
pub(super) fn open(
    source: impl ParquetSource + 'static,
    map: Option<&RecordingMapSpec>,
) -> Result<ParquetRows, BinaryProblem> {
    let mut file = FileBytes::new(Box::new(source))?;
    let wanted = |name: &str| map.is_none_or(|map| map.has_column(name));
    let Footer {
        columns,
        groups,
        all_names,
    } = Footer::read(&mut file, &wanted)?;
    let names = columns.iter().map(|column| column.name.as_str()).collect();
    if let Some(map) = map {
        check_columns(map, &names, &all_names)?;
    }
    let limit = limits::max_rows(file.length);
    let rows: u64 = groups
        .iter()
        .fold(0, |sum, group| sum.saturating_add(group.rows));
    if rows > limit {
        return Err(ParquetError::TooLarge {
            limit,
            what: "rows",
        }
        .into());
    }
    Ok(ParquetRows {
        file,
        groups: groups.into_iter(),
        rows_left: 0,
        columns: columns.into_iter().map(Column::new).collect(),
        text: String::new(),
    })
}

impl ParquetRows {
    /// Returns the names of the columns.
    pub(super) fn names(&self) -> Fields {
        self.columns.iter().map(Column::name).collect()
    }
}

impl BinaryRows for ParquetRows {
    fn next_row(
        &mut self,
        texts: &mut Fields,
        numbers: &mut Vec<f64>,
    ) -> Result<bool, BinaryProblem> {
        let Self {
            file,
            groups,
            rows_left,
            columns,
            text,
        } = self;
        while *rows_left == 0 {
            let Some(group) = groups.next() else {
                return Ok(false);
            };
            *rows_left = group.rows;
            for (column, chunk) in columns.iter_mut().zip(group.chunks) {
                column.begin(chunk, group.rows, file);
            }
        }
        *rows_left -= 1;
        for column in columns {
            text.clear();
            numbers.push(column.next(file, text)?);
            texts.push_field(text);
        }
        Ok(true)
    }
}
