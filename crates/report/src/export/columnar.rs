//! Traces as Parquet files (a feature).

use std::sync::Arc;

use parquet::data_type::{DoubleType, Int32Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;

use super::{ExportError, TraceRow, trace_rows};
use crumple_sim::engine::Trace;

const SCHEMA: &str = "message trace {
    REQUIRED DOUBLE time_s;
    REQUIRED INT32 vehicle;
    REQUIRED DOUBLE position_m;
    REQUIRED DOUBLE speed_mps;
    REQUIRED DOUBLE acceleration_mps2;
    OPTIONAL DOUBLE gap_m;
}";

/// Encodes the trace as a Parquet file.
///
/// # Errors
/// [`ExportError::Parquet`] if the encoder fails, which does not happen in memory.
pub fn to_parquet(trace: &Trace) -> Result<Vec<u8>, ExportError> {
    let rows = trace_rows(trace);
    let doubles: [fn(&TraceRow) -> f64; 3] = [
        |row| row.position_m,
        |row| row.speed_mps,
        |row| row.acceleration_mps2,
    ];
    let schema = Arc::new(parse_message_type(SCHEMA)?);
    let properties = WriterProperties::builder()
        .set_compression(parquet::basic::Compression::SNAPPY)
        .build();
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties))?;
    let mut group = writer.next_row_group()?;
    let mut index = 0;
    while let Some(mut column) = group.next_column()? {
        match index {
            0 => {
                let times: Vec<_> = rows.iter().map(|row| row.time_s).collect();
                column
                    .typed::<DoubleType>()
                    .write_batch(&times, None, None)?;
            }
            1 => {
                let vehicles: Vec<_> = rows.iter().map(|row| row.vehicle).collect();
                column
                    .typed::<Int32Type>()
                    .write_batch(&vehicles, None, None)?;
            }
            5 => {
                let gaps: Vec<_> = rows.iter().filter_map(|row| row.gap_m).collect();
                let present: Vec<_> = rows
                    .iter()
                    .map(|row| i16::from(row.gap_m.is_some()))
                    .collect();
                column
                    .typed::<DoubleType>()
                    .write_batch(&gaps, Some(&present), None)?;
            }
            other => {
                let values: Vec<_> = doubles
                    .get(other - 2)
                    .map_or_else(Vec::new, |of| rows.iter().map(of).collect());
                column
                    .typed::<DoubleType>()
                    .write_batch(&values, None, None)?;
            }
        }
        column.close()?;
        index += 1;
    }
    group.close()?;
    Ok(writer.into_inner()?)
}
