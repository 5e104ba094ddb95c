//! Traces as Parquet files (a feature).

use std::sync::Arc;

use parquet::data_type::{DoubleType, Int32Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::parser::parse_message_type;

use super::{ExportError, TraceRow, trace_rows};
use crumple_measure::LevelMeasures;
use crumple_sim::engine::Trace;

const SCHEMA: &str = "message trace {
    REQUIRED DOUBLE time_s;
    REQUIRED INT32 vehicle;
    REQUIRED DOUBLE position_m;
    REQUIRED DOUBLE speed_mps;
    REQUIRED DOUBLE acceleration_mps2;
    OPTIONAL DOUBLE gap_m;
";

/// The column of levels, if there are any.
const LEVEL_SCHEMA: &str = "    OPTIONAL DOUBLE level_mps2;
";

/// Encodes the trace as a Parquet file; with a column of levels if there are any.
///
/// # Errors
/// [`ExportError::Parquet`] if the encoder fails, which does not happen in memory.
pub fn to_parquet(trace: &Trace, levels: &[LevelMeasures]) -> Result<Vec<u8>, ExportError> {
    let rows = trace_rows(trace, levels);
    let level = if levels.is_empty() { "" } else { LEVEL_SCHEMA };
    let schema = Arc::new(parse_message_type(&format!("{SCHEMA}{level}}}"))?);
    let properties = WriterProperties::builder()
        .set_compression(parquet::basic::Compression::SNAPPY)
        .build();
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties))?;
    let mut group = writer.next_row_group()?;
    let mut index = 0;
    while let Some(mut column) = group.next_column()? {
        match index {
            0 => write_doubles(&mut column, &rows, |row| row.time_s)?,
            1 => {
                let vehicles: Vec<_> = rows.iter().map(|row| row.vehicle).collect();
                column
                    .typed::<Int32Type>()
                    .write_batch(&vehicles, None, None)?;
            }
            2 => write_doubles(&mut column, &rows, |row| row.position_m)?,
            3 => write_doubles(&mut column, &rows, |row| row.speed_mps)?,
            4 => write_doubles(&mut column, &rows, |row| row.acceleration_mps2)?,
            5 => write_optional(&mut column, &rows, |row| row.gap_m)?,
            _ => write_optional(&mut column, &rows, |row| row.level_mps2)?,
        }
        column.close()?;
        index += 1;
    }
    group.close()?;
    Ok(writer.into_inner()?)
}

fn write_doubles(
    column: &mut SerializedColumnWriter<'_>,
    rows: &[TraceRow],
    value: fn(&TraceRow) -> f64,
) -> Result<(), ExportError> {
    let values: Vec<_> = rows.iter().map(value).collect();
    column
        .typed::<DoubleType>()
        .write_batch(&values, None, None)?;
    Ok(())
}

/// Writes numbers that some rows lack.
fn write_optional(
    column: &mut SerializedColumnWriter<'_>,
    rows: &[TraceRow],
    value: fn(&TraceRow) -> Option<f64>,
) -> Result<(), ExportError> {
    let values: Vec<_> = rows.iter().filter_map(value).collect();
    let present: Vec<_> = rows
        .iter()
        .map(|row| i16::from(value(row).is_some()))
        .collect();
    column
        .typed::<DoubleType>()
        .write_batch(&values, Some(&present), None)?;
    Ok(())
}
