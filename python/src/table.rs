//! Traces as Arrow tables.

use std::sync::Arc;

use arrow_array::builder::Float64Builder;
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::{ArrayRef, Float64Array, RecordBatch, RecordBatchIterator, UInt32Array};
use arrow_schema::{ArrowError, Field, Schema};
use crumple_sim::engine::{Trace, Track};

/// Returns the table of `crumple simulate --trace`: by sample, then vehicle. The first one has no gap.
pub(crate) fn arrow_stream(trace: &Trace) -> Result<FFI_ArrowArrayStream, ArrowError> {
    let columns: [(&str, ArrayRef); 6] = [
        (
            "time_s",
            Arc::new(Float64Array::from_iter_values(
                rows(trace).map(|[sample, _]| value_at(&trace.time_s, sample)),
            )),
        ),
        (
            "vehicle",
            Arc::new(UInt32Array::from_iter_values(
                rows(trace).map(|[_, vehicle]| vehicle as u32),
            )),
        ),
        ("position_m", column(trace, |track| &track.position_m)),
        ("speed_mps", column(trace, |track| &track.speed_mps)),
        (
            "acceleration_mps2",
            column(trace, |track| &track.acceleration_mps2),
        ),
        ("gap_m", gap_column(trace)),
    ];
    let fields: Vec<Field> = columns
        .iter()
        .map(|(name, values)| Field::new(*name, values.data_type().clone(), *name == "gap_m"))
        .collect();
    let schema = Arc::new(Schema::new(fields));
    let batch = RecordBatch::try_new(
        Arc::clone(&schema),
        columns.map(|(_, values)| values).to_vec(),
    )?;
    Ok(FFI_ArrowArrayStream::new(Box::new(
        RecordBatchIterator::new([Ok(batch)], schema),
    )))
}

/// Yields sample and vehicle of each row.
fn rows(trace: &Trace) -> impl Iterator<Item = [usize; 2]> {
    let vehicles = trace.vehicles.len();
    (0..trace.len()).flat_map(move |sample| (0..vehicles).map(move |vehicle| [sample, vehicle]))
}

fn value_at(values: &[f64], sample: usize) -> f64 {
    values.get(sample).copied().unwrap_or(f64::NAN)
}

fn column(trace: &Trace, values: fn(&Track) -> &[f64]) -> ArrayRef {
    let column = rows(trace).map(|[sample, vehicle]| {
        trace
            .vehicles
            .get(vehicle)
            .map_or(f64::NAN, |track| value_at(values(track), sample))
    });
    Arc::new(Float64Array::from_iter_values(column))
}

fn gap_column(trace: &Trace) -> ArrayRef {
    let vehicles = trace.vehicles.len();
    let gaps_m: Vec<Vec<Option<f64>>> = (0..vehicles).map(|rear| trace.gaps_m(rear)).collect();
    let mut gap_m = Float64Builder::with_capacity(trace.len() * vehicles);
    for [sample, vehicle] in rows(trace) {
        gap_m.append_option(
            gaps_m
                .get(vehicle)
                .and_then(|gaps_m| gaps_m.get(sample).copied().flatten()),
        );
    }
    Arc::new(gap_m.finish())
}
