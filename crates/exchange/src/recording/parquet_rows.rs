//! Rows of Parquet files.

use std::sync::Arc;

use parquet::basic::Repetition;
use parquet::errors::ParquetError;
use parquet::file::reader::{ChunkReader, FileReader, SerializedFileReader};
use parquet::record::{Field, reader::RowIter};
use parquet::schema::types::Type;

use super::binary::check_columns;
use super::error::BinaryProblem;
use super::map::RecordingMapSpec;
use super::table::BinaryRows;
use super::text_rows::Fields;

pub(super) struct ParquetRows(RowIter<'static>);

/// Returns rows and names of the columns that the map names, or of all columns.
pub(super) fn open(
    file: impl ChunkReader + 'static,
    map: Option<&RecordingMapSpec>,
) -> Result<(ParquetRows, Fields), BinaryProblem> {
    let reader = SerializedFileReader::new(file)?;
    let schema = reader.metadata().file_metadata().schema();
    let is_wanted = |column: &&Arc<Type>| {
        column.is_primitive()
            && column.get_basic_info().repetition() != Repetition::REPEATED
            && map.is_none_or(|map| map.column_role(column.name()).is_some())
    };
    let columns: Vec<Arc<Type>> = schema.get_fields().iter().filter(is_wanted).cloned().collect();
    let names = columns.iter().map(|column| column.name()).collect();
    if let Some(map) = map {
        let known: Vec<_> = schema.get_fields().iter().map(|column| column.name().to_owned()).collect();
        check_columns(map, &names, &known)?;
    }
    let projection = Type::group_type_builder(schema.name()).with_fields(columns).build()?;
    Ok((ParquetRows(RowIter::from_file_into(Box::new(reader)).project(Some(projection))?), names))
}

impl BinaryRows for ParquetRows {
    fn next_row(&mut self, texts: &mut Fields, numbers: &mut Vec<f64>) -> Result<bool, BinaryProblem> {
        let Some(row) = self.0.next().transpose()? else { return Ok(false) };
        for (_, field) in row.get_column_iter() {
            let (text, number) = match field {
                Field::Double(value) => (String::new(), *value),
                Field::Float(value) => (String::new(), f64::from(*value)),
                Field::TimestampMillis(value) | Field::TimestampMicros(value) => (value.to_string(), *value as f64),
                Field::Null => (String::new(), f64::NAN),
                Field::Str(text) => (text.clone(), f64::NAN),
                // Whole numbers are also ids.
                other => {
                    let text = other.to_string();
                    let number = text.parse().unwrap_or(f64::NAN);
                    (text, number)
                }
            };
            texts.push(&text);
            numbers.push(number);
        }
        Ok(true)
    }
}

impl From<ParquetError> for BinaryProblem {
    fn from(error: ParquetError) -> Self {
        Self::Parquet(error.to_string())
    }
}
