//! Rows of tracks, as in highD and NGSIM: each row holds one vehicle among many at one instant.

mod columns;

use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use self::columns::TrackColumns;
use super::acceleration::AccelerationCheck;
use super::consistency::{Comparison, Hypothesis};
use super::dropped::{DroppedItem, Omission};
use super::error::{LineProblem, RecordingError};
use super::map::{LengthUnit, RecordingMapSpec, SpeedUnit, TracksSpec};
use super::parts::{
    ALL_TIMES, EndedPart, MAX_POINTS, MAX_SIMULTANEOUS, PART_ROWS, PartBounds, PartSink,
};
use super::spill::SpilledPoints;
use super::table::{CsvColumn, CsvRow, RowReader};
use super::tracks::{self, TrackPoint, TrackRules, VehicleId};
use super::{RecordedTraffic, Recording, TextFormat};

/// Reads the rows after the column names.
pub(super) fn read(
    table: &mut RowReader<'_>,
    (map, spec): (&RecordingMapSpec, &TracksSpec),
    names: &CsvRow<'_>,
    sink: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let mut columns = TrackColumns::find(names, map, spec)?;
    let mut spilled = SpilledPoints::default();
    let points = read_points(table, names, &mut columns, &mut spilled)?;
    let mut dropped = Vec::new();
    table.check_samples(&mut dropped)?;
    columns.report(table.path(), table.samples, &mut dropped);
    let mut parts = TrafficParts {
        table,
        map,
        spec,
        time: (columns.clock.column.factor, columns.clock.detected()),
        columns: [columns.position.column, columns.speed.column],
        acceleration: columns.acceleration,
        vehicles: columns.vehicles.into_vehicles().into(),
        dropped,
    };
    if spilled.is_empty() {
        sink(parts.part(points, ALL_TIMES)?)?;
        return Ok(());
    }
    parts.emit(points, spilled, sink)
}

/// Reads all points. Those that are too many for memory go to `spilled`.
fn read_points(
    table: &mut RowReader<'_>,
    names: &CsvRow<'_>,
    columns: &mut TrackColumns,
    spilled: &mut SpilledPoints,
) -> Result<Vec<TrackPoint>, RecordingError> {
    let path = table.path();
    let mut points = Vec::new();
    while let Some(row) = table.next_sample(&names.fields)? {
        points.extend(columns.read(row)?);
        if points.len() > PART_ROWS {
            spilled
                .write(&mut points)
                .map_err(|source| spill_error(path, source))?;
        }
    }
    Ok(points)
}

fn spill_error(path: &Path, source: io::Error) -> RecordingError {
    RecordingError::Spill {
        path: path.to_owned(),
        source,
    }
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
    /// Passes on the parts of a recording that is too large for memory; `points` are its last rows.
    fn emit(
        mut self,
        mut points: Vec<TrackPoint>,
        mut spilled: SpilledPoints,
        sink: &mut PartSink<'_>,
    ) -> Result<(), RecordingError> {
        let path = self.table.path();
        spilled
            .write(&mut points)
            .map_err(|source| spill_error(path, source))?;
        let mut sorted = spilled.read().map_err(|source| spill_error(path, source))?;
        let mut bounds = PartBounds::new(0);
        let mut simultaneous = 0;
        while let Some(point) = sorted.next().map_err(|source| spill_error(path, source))? {
            if bounds.ends_before(point.time_ms) {
                let part = bounds.next();
                let margin = next_margin(&points, &part);
                let part_points = std::mem::replace(&mut points, margin);
                if !sink(self.part(part_points, part.core_ms)?)? {
                    return Ok(());
                }
            }
            simultaneous = match points.last() {
                Some(before) if before.time_ms == point.time_ms => simultaneous + 1,
                _ => 1,
            };
            if simultaneous > MAX_SIMULTANEOUS {
                return Err(self.too_large(point.line, MAX_SIMULTANEOUS, "rows at one time"));
            }
            points.push(point);
        }
        sink(self.part(points, bounds.next().core_ms)?)?;
        Ok(())
    }

    fn too_large(&self, line: u64, limit: usize, what: &'static str) -> RecordingError {
        RecordingError::Line {
            path: self.table.path().to_owned(),
            line,
            problem: LineProblem::TooLarge { limit, what },
        }
    }

    /// Builds the tracks of a part, whose margins lie outside of the core.
    fn part(
        &mut self,
        mut points: Vec<TrackPoint>,
        core_ms: Range<i64>,
    ) -> Result<Recording, RecordingError> {
        let path = self.table.path();
        for point in &mut points {
            point.is_margin = !core_ms.contains(&point.time_ms);
        }
        let mut dropped = std::mem::take(&mut self.dropped);
        let duplicates = tracks::sort(&mut points);
        dropped.extend(duplicates.map(|(first, count)| self.duplicates(&first, count)));
        let rules = TrackRules {
            reference: self.spec.position.of,
            interpolate_s: self.map.interpolate_s,
            lane_blip_s: self.spec.lane_blip_s,
            speeds_agree: self.check_speeds(&points, &mut dropped)?,
        };
        self.check_accelerations(&points, &mut dropped)?;
        let vehicles = self.vehicles.clone();
        let mut omissions = Vec::new();
        let traffic = RecordedTraffic::build(points, (vehicles, core_ms), rules, &mut omissions)
            .map_err(|line| self.too_large(line, MAX_POINTS, "rows, with those that are filled"))?;
        dropped.extend(
            omissions
                .into_iter()
                .map(|omission| dropped_item(path, omission)),
        );
        Ok(Recording {
            path: path.to_owned(),
            format: self.map.name.clone(),
            text: TextFormat {
                time: self.time.1,
                ..self.table.format()
            },
            platoons: Vec::new(),
            traffic: Some(traffic),
            dropped,
        })
    }

    fn duplicates(&self, first: &TrackPoint, count: usize) -> DroppedItem {
        let vehicle = tracks::label(&self.vehicles, first.vehicle);
        let before = format!("vehicle {vehicle} is in two places at once here; of ");
        let omission = Omission::counted(before, count, " such rows each first one is kept");
        dropped_item(self.table.path(), (first.line, omission))
    }

    /// Compares sorted positions with speeds. Returns whether they agree.
    fn check_speeds(
        &self,
        points: &[TrackPoint],
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<bool, RecordingError> {
        let mut comparison = Comparison::undirected();
        for vehicle in points.chunk_by(|a, b| a.vehicle == b.vehicle) {
            comparison.restart();
            for point in vehicle {
                let speed_mps = point.speed_mps.map(|speed_mps| [speed_mps.abs(), 0.0]);
                comparison.add(time_and_line(point), point.position_m, speed_mps);
            }
        }
        let [position, speed] = &self.columns;
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
        let times = Hypothesis::times(&self.map.time, self.time.0);
        let hypotheses: Vec<_> = speeds.chain(positions).chain(times).collect();
        let change = format!("the change of {}", position.name);
        comparison.check(
            self.table,
            &speed.name,
            [&change, &speed.name],
            (&hypotheses, dropped),
        )
    }

    /// Compares speeds with accelerations, if there are any.
    fn check_accelerations(
        &mut self,
        points: &[TrackPoint],
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        let Some(acceleration) = &mut self.acceleration else {
            return Ok(());
        };
        for vehicle in points.chunk_by(|a, b| a.vehicle == b.vehicle) {
            acceleration.restart();
            for point in vehicle {
                let acceleration_mps2 = point.acceleration_mps2.map(f64::from);
                acceleration.add(time_and_line(point), point.speed_mps, acceleration_mps2);
            }
        }
        acceleration.check(self.table, dropped)
    }
}

/// Returns the last points of a part, which are the margin of the next one. Margins of dense traffic are shorter.
fn next_margin(points: &[TrackPoint], part: &EndedPart) -> Vec<TrackPoint> {
    let [margin, core_end] = [part.next_from_ms, part.core_ms.end]
        .map(|from_ms| points.partition_point(|point| point.time_ms < from_ms));
    points[margin.max(core_end.saturating_sub(PART_ROWS))..].to_vec()
}

fn time_and_line(point: &TrackPoint) -> (f64, u64) {
    (point.time_ms as f64 / 1000.0, point.line)
}

fn dropped_item(path: &Path, (line, omission): (u64, Omission)) -> DroppedItem {
    DroppedItem {
        path: path.to_owned(),
        line,
        omission,
    }
}
