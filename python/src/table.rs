//! Traces as Arrow tables.

use std::sync::Arc;

use arrow_array::builder::Float64Builder;
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::{ArrayRef, Float64Array, RecordBatch, RecordBatchIterator, UInt32Array};
use arrow_schema::{ArrowError, DataType, Field, Schema};
use crumple_sim::engine::{Trace, Track};

/// Returns the table of `crumple simulate --trace`: by sample, then vehicle. The first one has no gap.
pub(crate) fn arrow_stream(trace: &Trace) -> Result<FFI_ArrowArrayStream, ArrowError> {
    let (samples, vehicles) = (trace.len(), trace.vehicles.len());
    let rows =
        || (0..samples).flat_map(|sample| (0..vehicles).map(move |vehicle| (sample, vehicle)));
    let at = |values: &[f64], sample: usize| values.get(sample).copied().unwrap_or(f64::NAN);
    let column = |of: fn(&Track) -> &[f64]| -> ArrayRef {
        let value = |(sample, vehicle): (usize, usize)| {
            trace
                .vehicles
                .get(vehicle)
                .map(|track| at(of(track), sample))
        };
        Arc::new(Float64Array::from_iter_values(
            rows().map(|row| value(row).unwrap_or(f64::NAN)),
        ))
    };
    let gaps_m: Vec<Vec<Option<f64>>> = (0..vehicles).map(|rear| trace.gaps_m(rear)).collect();
    let mut gap_m = Float64Builder::with_capacity(samples * vehicles);
    for (sample, vehicle) in rows() {
        gap_m.append_option(
            gaps_m
                .get(vehicle)
                .and_then(|gaps_m| gaps_m.get(sample).copied().flatten()),
        );
    }
    let columns: [(&str, ArrayRef); 6] = [
        (
            "time_s",
            Arc::new(Float64Array::from_iter_values(
                rows().map(|(sample, _)| at(&trace.time_s, sample)),
            )),
        ),
        (
            "vehicle",
            Arc::new(UInt32Array::from_iter_values(
                rows().map(|(_, vehicle)| vehicle as u32),
            )),
        ),
        ("position_m", column(|track| &track.position_m)),
        ("speed_mps", column(|track| &track.speed_mps)),
        (
            "acceleration_mps2",
            column(|track| &track.acceleration_mps2),
        ),
        ("gap_m", Arc::new(gap_m.finish())),
    ];
    let field = |(name, values): &(&str, ArrayRef)| {
        let kind: &DataType = values.data_type();
        Field::new(*name, kind.clone(), *name == "gap_m")
    };
    let schema = Arc::new(Schema::new(columns.iter().map(field).collect::<Vec<_>>()));
    let batch = RecordBatch::try_new(
        Arc::clone(&schema),
        columns.map(|(_, values)| values).to_vec(),
    )?;
    Ok(FFI_ArrowArrayStream::new(Box::new(
        RecordBatchIterator::new([Ok(batch)], schema),
    )))
}
