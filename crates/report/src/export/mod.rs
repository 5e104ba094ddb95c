//! Traces as tables in CSV or Parquet, one row per sample and vehicle.
//!
//! Columns: `time_s`, `vehicle`, `position_m`, `speed_mps`, `acceleration_mps2`, `gap_m` (to the vehicle ahead; empty
//! for the leader). If levels were computed, `level_mps2` follows (empty between two levels, and for vehicles that are
//! not under test). Rows are in order of time, then of vehicle.

#[cfg(feature = "parquet")]
mod columnar;

use crumple_measure::LevelMeasures;
use crumple_sim::engine::Trace;

#[cfg(feature = "parquet")]
pub use columnar::to_parquet;

/// True if this build writes Parquet.
pub const WRITES_PARQUET: bool = cfg!(feature = "parquet");

const COLUMNS: [&str; 6] = [
    "time_s",
    "vehicle",
    "position_m",
    "speed_mps",
    "acceleration_mps2",
    "gap_m",
];

/// Column of levels, if there are any.
const LEVEL_COLUMN: &str = "level_mps2";

/// An error of encoding a table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The CSV writer failed.
    #[error("cannot encode the trace as CSV: {0}")]
    Csv(#[from] csv::Error),
    /// The Parquet writer failed.
    #[cfg(feature = "parquet")]
    #[error("cannot encode the trace as Parquet: {0}")]
    Parquet(#[from] ::parquet::errors::ParquetError),
    /// This build writes no Parquet ([`WRITES_PARQUET`]).
    #[error("traces in Parquet need a build with the feature `parquet`")]
    NeedsParquet,
}

struct TraceRow {
    time_s: f64,
    vehicle: i32,
    position_m: f64,
    speed_mps: f64,
    acceleration_mps2: f64,
    gap_m: Option<f64>,
    level_mps2: Option<f64>,
}

/// Returns the levels of each vehicle at each sample that has one.
fn levels_by_sample(trace: &Trace, levels: &[LevelMeasures]) -> Vec<Vec<Option<f64>>> {
    let mut all = vec![vec![None; trace.len()]; trace.vehicles.len()];
    for measured in levels {
        let Some(column) = all.get_mut(measured.vehicle) else {
            continue;
        };
        for (time_s, level_mps2) in measured.time_s.iter().zip(&measured.level_mps2) {
            let sample = trace.time_s.partition_point(|time| time < time_s);
            if let Some(cell) = column.get_mut(sample) {
                *cell = Some(*level_mps2);
            }
        }
    }
    all
}

fn trace_rows(trace: &Trace, levels: &[LevelMeasures]) -> Vec<TraceRow> {
    let levels_mps2 = levels_by_sample(trace, levels);
    let gaps_m: Vec<Vec<Option<f64>>> = (0..trace.vehicles.len())
        .map(|rear| trace.gaps_m(rear))
        .collect();
    let mut rows = Vec::with_capacity(trace.len() * trace.vehicles.len());
    for (sample, &time_s) in trace.time_s.iter().enumerate() {
        for (vehicle, (track, gaps_m)) in trace.vehicles.iter().zip(&gaps_m).enumerate() {
            rows.push(TraceRow {
                time_s,
                vehicle: vehicle as i32,
                position_m: value_at(&track.position_m, sample),
                speed_mps: value_at(&track.speed_mps, sample),
                acceleration_mps2: value_at(&track.acceleration_mps2, sample),
                gap_m: gaps_m.get(sample).copied().flatten(),
                level_mps2: levels_mps2
                    .get(vehicle)
                    .and_then(|levels| levels.get(sample).copied().flatten()),
            });
        }
    }
    rows
}

fn value_at(column: &[f64], sample: usize) -> f64 {
    column.get(sample).copied().unwrap_or(f64::NAN)
}

/// Encodes the trace as CSV with a header line; with a column of levels if there are any.
///
/// # Errors
/// [`ExportError::Csv`] if the encoder fails, which does not happen in memory.
pub fn to_csv(trace: &Trace, levels: &[LevelMeasures]) -> Result<Vec<u8>, ExportError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let has_levels = !levels.is_empty();
    writer.write_record(
        COLUMNS
            .into_iter()
            .chain(has_levels.then_some(LEVEL_COLUMN)),
    )?;
    for row in trace_rows(trace, levels) {
        let numbers =
            [row.position_m, row.speed_mps, row.acceleration_mps2].map(|number| number.to_string());
        let optional =
            |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        let [position, speed, acceleration] = numbers;
        let cells = [
            row.time_s.to_string(),
            row.vehicle.to_string(),
            position,
            speed,
            acceleration,
            optional(row.gap_m),
        ];
        let level = has_levels.then(|| optional(row.level_mps2));
        writer.write_record(cells.into_iter().chain(level))?;
    }
    writer
        .into_inner()
        .map_err(|error| ExportError::Csv(error.into_error().into()))
}

/// Encodes the trace as a Parquet file.
///
/// # Errors
/// [`ExportError::NeedsParquet`], because this build lacks the feature `parquet`.
#[cfg(not(feature = "parquet"))]
pub fn to_parquet(_: &Trace, _: &[LevelMeasures]) -> Result<Vec<u8>, ExportError> {
    Err(ExportError::NeedsParquet)
}

#[cfg(all(test, feature = "parquet"))]
mod tests {
    use super::*;
    use ::parquet::file::reader::{FileReader, SerializedFileReader};
    use ::parquet::record::RowAccessor;
    use crumple_sim::control::BuiltInController;
    use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
    use crumple_sim::scenario::built_in_scenario;

    #[test]
    fn both_formats_hold_the_same_numbers_as_the_trace() {
        let scenario = built_in_scenario("paper-1").unwrap();
        let run = Run::new(
            &scenario,
            RunOptions::new(BuiltInController::from_name("baseline").unwrap()),
        )
        .unwrap();
        let trace = simulate(&run, RecordingLevel::Trace).trace.unwrap();
        let csv = to_csv(&trace, &[]).unwrap();
        let mut reader = csv::Reader::from_reader(csv.as_slice());
        let parquet =
            SerializedFileReader::new(bytes::Bytes::from(to_parquet(&trace, &[]).unwrap()))
                .unwrap();
        let mut count = 0;
        for (index, (from_csv, from_parquet)) in reader
            .records()
            .zip(parquet.get_row_iter(None).unwrap())
            .enumerate()
        {
            let from_csv = from_csv.unwrap();
            let from_parquet = from_parquet.unwrap();
            let track = &trace.vehicles[index % 3];
            let expected = [
                trace.time_s[index / 3],
                track.position_m[index / 3],
                track.speed_mps[index / 3],
            ];
            for (column, expected) in [0, 2, 3].into_iter().zip(expected) {
                assert_eq!(from_csv[column].parse::<f64>().unwrap(), expected);
                assert_eq!(from_parquet.get_double(column).unwrap(), expected);
            }
            let gap_m = trace.vehicles[..index % 3].last().map(|ahead| {
                ahead.position_m[index / 3] - ahead.length_m - track.position_m[index / 3]
            });
            assert_eq!(from_csv[5].parse::<f64>().ok(), gap_m);
            assert_eq!(
                from_parquet.get_double(5).ok(),
                from_csv[5].parse::<f64>().ok()
            );
            count += 1;
        }
        assert_eq!(count, trace.len() * 3);
    }
}
