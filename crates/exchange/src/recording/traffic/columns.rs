//! Columns of tracks, and the points that rows contain.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use super::super::acceleration::AccelerationCheck;
use super::super::dropped::DroppedItem;
use super::super::error::{ColumnProblem, RecordingError};
use super::super::map::{
    ColumnUnit, LengthSpec, LengthUnit, RecordingMapSpec, SpeedUnit, TracksSpec,
};
use super::super::parts::PART_ROWS;
use super::super::series::{Clock, ColumnQuantity, Series};
use super::super::table::{CsvColumn, CsvRow, excerpt, is_missing};
use super::super::tracks::{TrackPoint, VehicleId};

const MAX_LANES: usize = 10_000;
/// Each takes about 200 bytes.
const MAX_VEHICLES: usize = 2 * PART_ROWS;
/// Longest id of a vehicle, in bytes.
const MAX_ID_BYTES: usize = 200;

/// Columns of tracks, with what was read of them.
pub(super) struct TrackColumns {
    pub(super) clock: Clock,
    vehicle: CsvColumn,
    lane: Option<CsvColumn>,
    pub(super) position: Series,
    pub(super) speed: Series,
    length: LengthColumn,
    pub(super) acceleration: Option<AccelerationCheck>,
    pub(super) vehicles: TextIds,
    lanes: TextIds,
}

/// Lengths of vehicles, in metres.
enum LengthColumn {
    Column(Box<Series>),
    Constant(f64),
}

impl TrackColumns {
    pub(super) fn find(
        names: &CsvRow<'_>,
        map: &RecordingMapSpec,
        spec: &TracksSpec,
    ) -> Result<Self, RecordingError> {
        let clock = Clock::find(names, &map.time)?;
        let vehicle = CsvColumn::find(names, &spec.vehicle, ColumnUnit::None)?;
        let lane = spec.lane.as_ref();
        let lane = lane
            .map(|name| CsvColumn::find(names, name, ColumnUnit::None))
            .transpose()?;
        let position_unit = LengthUnit::column_unit(spec.position.unit);
        let position = CsvColumn::find(names, &spec.position.column, position_unit)?;
        let speed_unit = SpeedUnit::column_unit(spec.speed.unit);
        let speed = CsvColumn::find(names, &spec.speed.column, speed_unit)?;
        let length = match &spec.length {
            LengthSpec::Column(column) => {
                let unit = LengthUnit::column_unit(column.unit);
                let column = CsvColumn::find(names, &column.name, unit)?;
                LengthColumn::Column(Box::new(Series::new(column, ColumnQuantity::Length)))
            }
            LengthSpec::Metres(metres) => LengthColumn::Constant(*metres),
        };
        Ok(Self {
            clock,
            vehicle,
            lane,
            position: Series::new(position, ColumnQuantity::Signed),
            speed: Series::new(speed, ColumnQuantity::SignedSpeed),
            length,
            acceleration: AccelerationCheck::find(names, &spec.speed)?,
            vehicles: TextIds::default(),
            lanes: TextIds::default(),
        })
    }

    /// Returns the point of a row; `None` if it has no vehicle. Points with unknown values stay: without them, the next
    /// vehicle would seem to follow the wrong leader.
    pub(super) fn read(&mut self, row: &CsvRow<'_>) -> Result<Option<TrackPoint>, RecordingError> {
        let time_s = self.clock.read(row)?;
        // SUMO writes a row without values for a time without vehicles.
        let values = [&self.vehicle, &self.position.column, &self.speed.column];
        if values
            .iter()
            .all(|column| is_missing(row.text(column.index)))
        {
            return Ok(None);
        }
        let vehicle = self.vehicles.index(row, &self.vehicle)?;
        let lane = match &self.lane {
            Some(column) => self.lanes.index(row, column)?,
            None => 0,
        };
        self.check_counts(row)?;
        Ok(Some(TrackPoint {
            vehicle,
            lane,
            time_ms: (time_s * 1000.0).round() as i64,
            line: row.line,
            position_m: self.position.read(row)?,
            speed_mps: self.speed.read(row)?,
            length_m: self.length.read(row)?,
            acceleration_mps2: match &mut self.acceleration {
                Some(acceleration) => acceleration.series.read(row)?.map(|mps2| mps2 as f32),
                None => None,
            },
            ..Default::default()
        }))
    }

    fn check_counts(&self, row: &CsvRow<'_>) -> Result<(), RecordingError> {
        if self.lanes.indices.len() > MAX_LANES {
            return row.reject_too_large(MAX_LANES, "lanes");
        }
        if self.vehicles.indices.len() > MAX_VEHICLES {
            return row.reject_too_large(MAX_VEHICLES, "vehicles");
        }
        Ok(())
    }

    /// Appends the missing and the impossible values of all columns.
    pub(super) fn report(&self, path: &Path, rows: usize, dropped: &mut Vec<DroppedItem>) {
        let length = match &self.length {
            LengthColumn::Column(series) => Some(&**series),
            LengthColumn::Constant(_) => None,
        };
        let acceleration = self.acceleration.as_ref();
        let acceleration = acceleration.map(|acceleration| &acceleration.series);
        let always = [&self.position, &self.speed];
        for series in always.into_iter().chain(length).chain(acceleration) {
            series.report(path, rows, dropped);
        }
    }
}

impl LengthColumn {
    fn read(&mut self, row: &CsvRow<'_>) -> Result<Option<f64>, RecordingError> {
        match self {
            Self::Column(series) => series.read(row),
            Self::Constant(length_m) => Ok(Some(*length_m)),
        }
    }
}

/// Texts, numbered in order of appearance.
#[derive(Default)]
pub(super) struct TextIds {
    indices: HashMap<String, u32>,
    /// Last text: neighbouring rows often have the same.
    last: (String, u32),
}

impl TextIds {
    fn index(&mut self, row: &CsvRow<'_>, column: &CsvColumn) -> Result<u32, RecordingError> {
        let text = row.text(column.index);
        if self.last.0 == text && !text.is_empty() {
            return Ok(self.last.1);
        }
        if is_missing(text) {
            return row.reject(&column.name, ColumnProblem::Empty);
        }
        self.last.0.clear();
        self.last.0 += text;
        if let Some(&index) = self.indices.get(text) {
            self.last.1 = index;
            return Ok(index);
        }
        if text.len() > MAX_ID_BYTES {
            return row.reject(
                &column.name,
                ColumnProblem::LongId {
                    limit: MAX_ID_BYTES,
                    found: excerpt(text),
                },
            );
        }
        self.last.1 = self.indices.len() as u32;
        self.indices.insert(text.to_owned(), self.last.1);
        Ok(self.last.1)
    }

    /// Returns the vehicles: by number if all ids are different whole numbers, which some tools write with a decimal
    /// point.
    pub(super) fn into_vehicles(self) -> Vec<VehicleId> {
        let mut texts: Vec<(String, u32)> = self.indices.into_iter().collect();
        texts.sort_unstable_by_key(|(_, index)| *index);
        let numbers: BTreeSet<usize> = texts
            .iter()
            .filter_map(|(text, _)| whole_number(text))
            .collect();
        let are_numbers = numbers.len() == texts.len();
        let ids = texts
            .into_iter()
            .map(|(text, index)| match whole_number(&text) {
                Some(number) if are_numbers => VehicleId { number, name: None },
                _ => VehicleId {
                    number: index as usize + 1,
                    name: Some(excerpt(&text)),
                },
            });
        ids.collect()
    }
}

fn whole_number(text: &str) -> Option<usize> {
    let (whole, zeros) = text.split_once('.').unwrap_or((text, ""));
    whole
        .parse()
        .ok()
        .filter(|_| zeros.bytes().all(|digit| digit == b'0'))
}
