//! Rows of tracks, as in highD and NGSIM: each row holds one vehicle among many at one instant.

use std::collections::{BTreeSet, HashMap};
use std::ops::Range;
use std::sync::Arc;

use super::acceleration::AccelerationCheck;
use super::consistency::{Comparison, Hypothesis};
use super::dropped::{DroppedItem, Omission};
use super::error::{ColumnProblem, LineProblem, RecordingError};
use super::map::{
    ColumnUnit, LengthSpec, LengthUnit, RecordingMapSpec, SpeedUnit, TimeSpec, TracksSpec,
};
use super::parts::{ALL_TIMES, MAX_POINTS, MAX_SIMULTANEOUS, PART_ROWS, PartBounds, PartSink};
use super::series::{Clock, ColumnQuantity, Series};
use super::spill::SpilledPoints;
use super::table::{CsvColumn, CsvRow, RowReader, excerpt, is_missing};
use super::tracks::{self, TrackPoint, TrackRules, VehicleId};
use super::{RecordedTraffic, Recording, TextFormat};

const MAX_LANES: usize = 10_000;
/// Each takes about 200 bytes.
const MAX_VEHICLES: usize = 2 * PART_ROWS;
/// Longest id of a vehicle, in bytes.
const MAX_ID_BYTES: usize = 200;

/// Reads the rows after the column names.
pub(super) fn read(
    table: &mut RowReader<'_>,
    (map, spec): (&RecordingMapSpec, &TracksSpec),
    names: &CsvRow<'_>,
    each: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let mut clock = Clock::find(names, &map.time)?;
    let vehicle = CsvColumn::find(names, &spec.vehicle, ColumnUnit::None)?;
    let lane = spec
        .lane
        .as_ref()
        .map(|name| CsvColumn::find(names, name, ColumnUnit::None))
        .transpose()?;
    let series =
        |name: &str, unit, quantity| Ok(Series::new(CsvColumn::find(names, name, unit)?, quantity));
    let mut position = series(
        &spec.position.column,
        LengthUnit::of_column(spec.position.unit),
        ColumnQuantity::Signed,
    )?;
    let mut speed = series(
        &spec.speed.column,
        SpeedUnit::of_column(spec.speed.unit),
        ColumnQuantity::SignedSpeed,
    )?;
    let (mut length, constant_m) = match &spec.length {
        LengthSpec::Column(column) => (
            Some(series(
                &column.name,
                LengthUnit::of_column(column.unit),
                ColumnQuantity::Length,
            )?),
            0.0,
        ),
        LengthSpec::Metres(metres) => (None, *metres),
    };
    let mut acceleration = AccelerationCheck::find(names, &spec.speed)?;
    let (mut vehicles, mut lanes) = (TextIds::default(), TextIds::default());
    let (mut points, mut spilled) = (Vec::new(), SpilledPoints::default());
    let path = table.path();
    let disk = |source| RecordingError::Spill {
        path: path.to_owned(),
        source,
    };
    while let Some(row) = table.next_sample(&names.fields)? {
        let time_s = clock.read(row)?;
        // SUMO writes a row without values for a time without vehicles.
        if [vehicle.index, position.column.index, speed.column.index]
            .iter()
            .all(|&index| is_missing(row.text(index)))
        {
            continue;
        }
        let vehicle = vehicles.index(row, &vehicle)?;
        // A vehicle without a lane could be in any lane.
        let lane = lane
            .as_ref()
            .map_or(Ok(0), |column| lanes.index(row, column))?;
        for (known, limit, what) in [
            (&lanes, MAX_LANES, "lanes"),
            (&vehicles, MAX_VEHICLES, "vehicles"),
        ] {
            if known.indices.len() > limit {
                return row.reject_too_large(limit, what);
            }
        }
        let (position_m, speed_mps) = (position.read(row)?, speed.read(row)?);
        let length_m = length
            .as_mut()
            .map_or(Ok(Some(constant_m)), |series| series.read(row))?;
        let acceleration_mps2 = acceleration
            .as_mut()
            .map_or(Ok(None), |one| one.series.read(row))?
            .map(|mps2| mps2 as f32);
        // Points with unknown values stay in the list; without them, the next vehicle would seem to follow the wrong
        // leader.
        let time_ms = (time_s * 1000.0).round() as i64;
        let line = row.line;
        points.push(TrackPoint {
            vehicle,
            lane,
            time_ms,
            line,
            position_m,
            speed_mps,
            length_m,
            acceleration_mps2,
            ..Default::default()
        });
        if points.len() > PART_ROWS {
            spilled.write(&mut points).map_err(disk)?;
        }
    }
    let mut dropped = Vec::new();
    table.check_samples(&mut dropped)?;
    let accelerations = acceleration.as_ref().map(|one| &one.series);
    for series in [
        Some(&position),
        Some(&speed),
        length.as_ref(),
        accelerations,
    ]
    .into_iter()
    .flatten()
    {
        series.report(path, table.samples, &mut dropped);
    }
    let time = (clock.column.factor, clock.detected());
    let (columns, vehicles) = (
        [position.column, speed.column],
        vehicles.into_vehicles().into(),
    );
    let mut parts = TrafficParts {
        table,
        map,
        spec,
        columns,
        time,
        acceleration,
        vehicles,
        dropped,
    };
    if spilled.is_empty() {
        each(parts.part(points, ALL_TIMES)?)?;
        return Ok(());
    }
    spilled.write(&mut points).map_err(disk)?;
    let mut sorted = spilled.read().map_err(disk)?;
    let mut bounds = PartBounds::new(0);
    let mut simultaneous = 0;
    while let Some(point) = sorted.next().map_err(disk)? {
        if bounds.ends_before(point.time_ms) {
            let (core_ms, next_ms) = bounds.next();
            let [margin, core_end] = [next_ms, core_ms.end]
                .map(|from_ms| points.partition_point(|known| known.time_ms < from_ms));
            let margin = points[margin.max(core_end.saturating_sub(PART_ROWS))..].to_vec();
            let part = std::mem::replace(&mut points, margin);
            if !each(parts.part(part, core_ms)?)? {
                return Ok(());
            }
        }
        simultaneous = match points.last() {
            Some(before) if before.time_ms == point.time_ms => simultaneous + 1,
            _ => 1,
        };
        if simultaneous > MAX_SIMULTANEOUS {
            let problem = LineProblem::TooLarge {
                limit: MAX_SIMULTANEOUS,
                what: "rows at one time",
            };
            return Err(RecordingError::Line {
                path: path.to_owned(),
                line: point.line,
                problem,
            });
        }
        points.push(point);
    }
    each(parts.part(points, bounds.next().0)?)?;
    Ok(())
}

/// Context of the parts of a recording.
struct TrafficParts<'t, 'p> {
    table: &'t RowReader<'p>,
    map: &'t RecordingMapSpec,
    spec: &'t TracksSpec,
    /// Columns of positions and of speeds.
    columns: [CsvColumn; 2],
    /// Size of the unit of time in seconds, and detected format.
    time: (f64, Option<&'static str>),
    acceleration: Option<AccelerationCheck>,
    vehicles: Arc<[VehicleId]>,
    /// Omissions in the rows, for the first part.
    dropped: Vec<DroppedItem>,
}

impl TrafficParts<'_, '_> {
    /// Builds the tracks of a part, whose margins lie outside of the core.
    fn part(
        &mut self,
        mut points: Vec<TrackPoint>,
        core_ms: Range<i64>,
    ) -> Result<Recording, RecordingError> {
        let Self {
            table,
            map,
            spec,
            columns,
            acceleration,
            ..
        } = self;
        let path = table.path();
        points
            .iter_mut()
            .for_each(|point| point.is_margin = !core_ms.contains(&point.time_ms));
        let mut dropped = std::mem::take(&mut self.dropped);
        let item = |line, omission| DroppedItem {
            path: path.to_owned(),
            line,
            omission,
        };
        if let Some((first, count)) = tracks::sort(&mut points) {
            let vehicle = tracks::label(&self.vehicles, first.vehicle);
            let before = format!("vehicle {vehicle} is in two places at once here; of ");
            dropped.push(item(
                first.line,
                Omission::counted(before, count, " such rows each first one is kept"),
            ));
        }
        let rules = TrackRules {
            vehicle_column: &spec.vehicle,
            reference: spec.position.of,
            interpolate_s: map.interpolate_s,
            lane_blip_s: spec.lane_blip_s,
            speeds_agree: check(
                table,
                columns,
                (&points, &map.time, self.time.0),
                &mut dropped,
            )?,
        };
        if let Some(acceleration) = acceleration {
            for vehicle in points.chunk_by(|a, b| a.vehicle == b.vehicle) {
                acceleration.restart();
                for point in vehicle {
                    let at = (point.time_ms as f64 / 1000.0, point.line);
                    acceleration.add(at, point.speed_mps, point.acceleration_mps2.map(f64::from));
                }
            }
            acceleration.check(table, &mut dropped)?;
        }
        let mut omissions = Vec::new();
        let vehicles = self.vehicles.clone();
        let traffic = RecordedTraffic::build(points, (vehicles, core_ms), rules, &mut omissions)
            .map_err(|line| {
                let problem = LineProblem::TooLarge {
                    limit: MAX_POINTS,
                    what: "rows, with those that are filled",
                };
                RecordingError::Line {
                    path: path.to_owned(),
                    line,
                    problem,
                }
            })?;
        dropped.extend(
            omissions
                .into_iter()
                .map(|(line, omission)| item(line, omission)),
        );
        Ok(Recording {
            path: path.to_owned(),
            format: map.name.clone(),
            text: TextFormat {
                time: self.time.1,
                ..table.format()
            },
            platoons: Vec::new(),
            traffic: Some(traffic),
            dropped,
        })
    }
}

/// Compares sorted positions with speeds. Returns whether they agree.
fn check(
    table: &RowReader<'_>,
    [position, speed]: &[CsvColumn; 2],
    (points, time, time_factor): (&[TrackPoint], &TimeSpec, f64),
    dropped: &mut Vec<DroppedItem>,
) -> Result<bool, RecordingError> {
    let mut comparison = Comparison::undirected();
    for vehicle in points.chunk_by(|a, b| a.vehicle == b.vehicle) {
        comparison.restart();
        for point in vehicle {
            let speed_mps = point.speed_mps.map(|speed_mps| [speed_mps.abs(), 0.0]);
            comparison.add(
                (point.time_ms as f64 / 1000.0, point.line),
                point.position_m,
                speed_mps,
            );
        }
    }
    let speeds = Hypothesis::units(
        &speed.name,
        (SpeedUnit::ALL, speed.factor),
        [false, true, false],
    );
    let positions = Hypothesis::units(
        &position.name,
        (LengthUnit::ALL, position.factor),
        [true, false, false],
    );
    let hypotheses: Vec<_> = speeds
        .chain(positions)
        .chain(Hypothesis::times(time, time_factor))
        .collect();
    let change = format!("the change of {}", position.name);
    comparison.check(
        table,
        &speed.name,
        [&change, &speed.name],
        (&hypotheses, dropped),
    )
}

/// Texts, numbered in order of appearance.
#[derive(Default)]
struct TextIds {
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
        if let Some(&known) = self.indices.get(text) {
            self.last.1 = known;
            return Ok(known);
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
    fn into_vehicles(self) -> Vec<VehicleId> {
        let mut texts: Vec<(String, u32)> = self.indices.into_iter().collect();
        texts.sort_unstable_by_key(|(_, index)| *index);
        let numbers: BTreeSet<usize> = texts
            .iter()
            .filter_map(|(text, _)| whole_number(text))
            .collect();
        let are_numbers = numbers.len() == texts.len();
        let id = |(text, index): (String, u32)| match whole_number(&text) {
            Some(number) if are_numbers => VehicleId { number, name: None },
            _ => VehicleId {
                number: index as usize + 1,
                name: Some(excerpt(&text)),
            },
        };
        texts.into_iter().map(id).collect()
    }
}

fn whole_number(text: &str) -> Option<usize> {
    let (whole, zeros) = text.split_once('.').unwrap_or((text, ""));
    whole
        .parse()
        .ok()
        .filter(|_| zeros.bytes().all(|digit| digit == b'0'))
}
