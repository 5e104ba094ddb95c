//! Traces as tables in CSV, one row per sample and vehicle; and runs for other simulators
//! ([`openscenario`]).
//!
//! Columns: `time_s`, `vehicle`, `position_m`, `speed_mps`, `acceleration_mps2`, `gap_m` (to the vehicle ahead; empty
//! for the leader). Rows are in order of time, then of vehicle.

pub mod openscenario;

use crumple_world::sim::Trace;

const COLUMNS: [&str; 6] = ["time_s", "vehicle", "position_m", "speed_mps", "acceleration_mps2", "gap_m"];

/// An error of encoding a table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The CSV writer failed.
    #[error("cannot encode the trace as CSV: {0}")]
    Csv(#[from] csv::Error),
}

/// Encodes the trace as CSV with a header line.
///
/// # Errors
/// [`ExportError::Csv`] if the encoder fails, which does not happen in memory.
pub fn to_csv(trace: &Trace) -> Result<Vec<u8>, ExportError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(COLUMNS)?;
    let gaps_m: Vec<Vec<Option<f64>>> = (0..trace.vehicles.len()).map(|rear| trace.gaps_m(rear)).collect();
    for (sample, &time_s) in trace.time_s.iter().enumerate() {
        for (vehicle, (track, gaps_m)) in trace.vehicles.iter().zip(&gaps_m).enumerate() {
            let at = |column: &[f64]| column.get(sample).copied().unwrap_or(f64::NAN).to_string();
            let columns = [&track.position_m, &track.speed_mps, &track.acceleration_mps2];
            let [position, speed, acceleration] = columns.map(|column| at(column));
            let gap = gaps_m.get(sample).copied().flatten().map(|gap_m| gap_m.to_string()).unwrap_or_default();
            writer.write_record([time_s.to_string(), vehicle.to_string(), position, speed, acceleration, gap])?;
        }
    }
    writer.into_inner().map_err(|error| ExportError::Csv(error.into_error().into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_world::control::ControllerSpec;
    use crumple_world::scenario::built_in_scenario;
    use crumple_world::sim::{RecordingLevel, Run, RunOptions, simulate};

    #[test]
    fn a_table_holds_the_numbers_of_the_trace() {
        let scenario = built_in_scenario("paper-1").unwrap();
        let run = Run::new(&scenario, RunOptions::new(ControllerSpec::from_name("baseline").unwrap())).unwrap();
        let trace = simulate(&run, RecordingLevel::Trace).trace.unwrap();
        let csv = to_csv(&trace).unwrap();
        let mut reader = csv::Reader::from_reader(csv.as_slice());
        let mut count = 0;
        for (index, row) in reader.records().enumerate() {
            let row = row.unwrap();
            let track = &trace.vehicles[index % 3];
            let expected = [trace.time_s[index / 3], track.position_m[index / 3], track.speed_mps[index / 3]];
            for (column, expected) in [0, 2, 3].into_iter().zip(expected) {
                assert_eq!(row[column].parse::<f64>().unwrap(), expected);
            }
            let gap_m = trace.vehicles[..index % 3]
                .last()
                .map(|ahead| ahead.position_m[index / 3] - ahead.length_m - track.position_m[index / 3]);
            assert_eq!(row[5].parse::<f64>().ok(), gap_m);
            count += 1;
        }
        assert_eq!(count, trace.len() * 3);
    }
}
