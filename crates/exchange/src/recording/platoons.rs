//! Recordings of platoons, such as OpenACC's: each row holds all vehicles at one instant.
//!
//! OpenACC files have five header lines (`Date`, `Vehicle_order`, `Number_of_vehicles`, `ACC`, `Distance_setting`), the
//! column names, then one row each 0.1 s. `Speed<k>` is the speed of vehicle k in m/s, `IVS<k>` the spacing in metres
//! from its rear bumper to the front bumper of vehicle k + 1. Antenna positions in the other columns are unused,
//! because the distance from antenna to bumper is unknown.
//!
//! `IVS<k>` always refers to vehicles k and k + 1 of the platoon, recorded or not: without columns of vehicle 8, `IVS7`
//! and `IVS8` are absent and `IVS9` is still the spacing from vehicle 9 to vehicle 10 (in the published files it
//! follows the distance of their antennas). The platoon is split at such holes.

use std::collections::BTreeMap;
use std::mem;
use std::ops::Range;

use super::consistency::{Comparison, Hypothesis};
use super::dropped::{DroppedItem, Omission};
use super::error::RecordingError;
use super::map::{LengthUnit, PlatoonSpec, RecordingMapSpec};
use super::parts::{PartBounds, PartSink};
use super::platoon_columns::{PlatoonColumns, PlatoonHeader};
use super::series::{Clock, ColumnQuantity, Series, interpolate_holes};
use super::table::{CsvColumn, CsvRow, RowReader};
use super::text_rows::Fields;
use super::{RecordedPlatoon, RecordedVehicle, Recording, TextFormat};

/// Reads the rows after the column names, with the header lines.
pub(super) fn read(
    table: &mut RowReader<'_>,
    (map, platoon): (&RecordingMapSpec, &PlatoonSpec),
    lines: &[Fields],
    names: &CsvRow<'_>,
    sink: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let mut reader = PlatoonReader::new((map, platoon), lines, names)?;
    let mut bounds = PartBounds::new(2 * reader.speeds.len());
    while let Some(row) = table.next_sample(&names.fields)? {
        let now_s = reader.clock.read(row)?;
        if !reader.clock.advance(row, now_s) {
            continue;
        }
        if bounds.ends_before((now_s * 1000.0).round() as i64) {
            let part = bounds.next();
            if !sink(reader.part(table, part.core_ms)?)? {
                return Ok(());
            }
            reader.forget_before(part.next_from_ms as f64 / 1000.0);
        }
        reader.read_values(table.row(), now_s)?;
    }
    table.check_samples(&mut reader.dropped)?;
    reader.report_values(table);
    sink(reader.part(table, bounds.next().core_ms)?)?;
    Ok(())
}

/// Columns of a platoon with the samples of the current part.
struct PlatoonReader<'m> {
    map: &'m RecordingMapSpec,
    /// Length of a leader that recorded spacings include, in metres.
    included_length_m: f64,
    header: PlatoonHeader,
    /// Numbers of the vehicles of each line without holes.
    lines_of_vehicles: Vec<Vec<usize>>,
    clock: Clock,
    /// Speeds by number of the vehicle.
    speeds: BTreeMap<usize, Series>,
    /// Spacings by number of the vehicle ahead.
    gaps: BTreeMap<usize, Series>,
    time_s: Vec<f64>,
    line: Vec<u64>,
    /// Omissions that no part contains so far.
    dropped: Vec<DroppedItem>,
}

impl<'m> PlatoonReader<'m> {
    /// Finds the columns of the platoon, and splits it where a spacing is unknown.
    fn new(
        (map, platoon): (&'m RecordingMapSpec, &PlatoonSpec),
        lines: &[Fields],
        names: &CsvRow<'_>,
    ) -> Result<Self, RecordingError> {
        let mut header = PlatoonHeader::default();
        lines
            .iter()
            .for_each(|fields| header.read_line(platoon, fields));
        let columns = PlatoonColumns::from_names((map, platoon), names)?;
        let mut dropped = Vec::new();
        Ok(Self {
            map,
            included_length_m: platoon.length_m.unwrap_or(0.0),
            lines_of_vehicles: columns.split(names, &header, &mut dropped)?,
            header,
            clock: columns.time,
            speeds: series_by_number(columns.speeds, ColumnQuantity::Speed),
            gaps: series_by_number(columns.gaps, ColumnQuantity::Gap),
            time_s: Vec::new(),
            line: Vec::new(),
            dropped,
        })
    }

    /// Adds the values of a row.
    fn read_values(&mut self, row: &CsvRow<'_>, now_s: f64) -> Result<(), RecordingError> {
        self.time_s.push(now_s);
        self.line.push(row.line);
        for series in self.speeds.values_mut() {
            let value = series.read(row)?;
            series.values.push(value);
        }
        for series in self.gaps.values_mut() {
            let value = series.read_minus(row, self.included_length_m)?;
            series.values.push(value);
        }
        Ok(())
    }

    /// Adds missing and impossible values of all rows to the omissions.
    fn report_values(&mut self, table: &RowReader<'_>) {
        self.clock.report(&mut self.dropped);
        for series in self.speeds.values().chain(self.gaps.values()) {
            series.report(table.path(), table.samples, &mut self.dropped);
        }
    }

    fn forget_before(&mut self, time_s: f64) {
        let count = self.time_s.partition_point(|row_s| *row_s < time_s);
        self.time_s.drain(..count);
        self.line.drain(..count);
        let series = self.speeds.values_mut().chain(self.gaps.values_mut());
        series.for_each(|series| drop(series.values.drain(..count)));
    }

    /// Converts the samples to platoons.
    fn part(
        &mut self,
        table: &RowReader<'_>,
        core_ms: Range<i64>,
    ) -> Result<Recording, RecordingError> {
        let mut dropped = mem::take(&mut self.dropped);
        self.check_gaps(table, &mut dropped)?;
        let mut speeds_mps = self.fill_holes(&self.speeds, table, &mut dropped);
        let mut gaps_m = self.fill_holes(&self.gaps, table, &mut dropped);
        let mut platoons = Vec::new();
        for numbers in &self.lines_of_vehicles {
            let vehicles = numbers.iter().map(|&number| RecordedVehicle {
                number,
                name: self.header.name_of(number, &self.speeds),
                speed_mps: speeds_mps.remove(&number).unwrap_or_default(),
            });
            let vehicles = vehicles.collect();
            let followed = numbers[..numbers.len().saturating_sub(1)].iter();
            let gaps_m = followed.map(|number| gaps_m.remove(number).unwrap_or_default());
            platoons.push(RecordedPlatoon {
                event: None,
                time_s: self.time_s.clone(),
                line: self.line.clone(),
                vehicles,
                gaps_m: gaps_m.collect(),
                lead_count: numbers.len().saturating_sub(1),
                core_ms: core_ms.clone(),
            });
        }
        Ok(Recording {
            path: table.path().to_owned(),
            format: self.map.name.clone(),
            text: TextFormat {
                time: self.clock.detected(),
                ..table.format()
            },
            platoons,
            traffic: None,
            dropped,
        })
    }

    /// Compares the change of each gap with the speeds of its two vehicles.
    fn check_gaps(
        &self,
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        for (number, gap) in &self.gaps {
            if let Some(leader) = self.speeds.get(number)
                && let Some(follower) = self.speeds.get(&(number + 1))
            {
                self.check_gap(gap, [leader, follower], table, dropped)?;
            }
        }
        Ok(())
    }

    /// Compares the change of a gap with the speeds of leader and follower.
    fn check_gap(
        &self,
        gap: &Series,
        [leader, follower]: [&Series; 2],
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        let mut comparison = Comparison::default();
        let samples = self
            .time_s
            .iter()
            .zip(&self.line)
            .zip(&gap.values)
            .zip(leader.values.iter().zip(&follower.values));
        for (((&at_s, &line), &gap_m), (leader, follower)) in samples {
            let rates_mps = leader
                .zip(*follower)
                .map(|(leader, follower)| [leader, -follower]);
            comparison.add((at_s, line), gap_m, rates_mps);
        }
        let [leader, follower, gap] = [leader, follower, gap].map(|series| &series.column);
        let difference = format!("{} - {}", leader.name, follower.name);
        let speeds = [leader, follower].map(|column| (column.name.as_str(), column.factor));
        let hypotheses: Vec<_> = Hypothesis::speeds(speeds, &difference)
            .chain(Hypothesis::units(
                &gap.name,
                (LengthUnit::ALL, gap.factor),
                [true, false, false],
            ))
            .chain(Hypothesis::times(&self.map.time, self.clock.column.factor))
            .collect();
        let columns = [&format!("the change of {}", gap.name), &*difference];
        comparison.check(table, &difference, columns, (&hypotheses, dropped))?;
        Ok(())
    }

    /// Returns the values of columns with short holes interpolated, as the map demands.
    fn fill_holes(
        &self,
        columns: &BTreeMap<usize, Series>,
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> BTreeMap<usize, Vec<Option<f64>>> {
        let mut values_by_number = BTreeMap::new();
        for (&number, series) in columns {
            let mut values = series.values.clone();
            if let Some((count, first)) =
                interpolate_holes(&mut values, &self.time_s, self.map.interpolate_s)
            {
                dropped.push(DroppedItem {
                    path: table.path().to_owned(),
                    line: self.line.get(first).copied().unwrap_or(0),
                    omission: Omission::interpolated(&series.column.name, count),
                });
            }
            values_by_number.insert(number, values);
        }
        values_by_number
    }
}

fn series_by_number(
    columns: BTreeMap<usize, CsvColumn>,
    quantity: ColumnQuantity,
) -> BTreeMap<usize, Series> {
    columns
        .into_iter()
        .map(|(number, column)| (number, Series::new(column, quantity)))
        .collect()
}
