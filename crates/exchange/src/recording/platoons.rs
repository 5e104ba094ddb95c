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
use super::series::{ColumnQuantity, Series, interpolate_holes};
use super::table::{CsvColumn, CsvRow, RowReader};
use super::text_rows::Fields;
use super::{RecordedPlatoon, RecordedVehicle, Recording, TextFormat};

/// Reads the rows after the column names, with the header lines.
pub(super) fn read(
    table: &mut RowReader<'_>,
    (map, platoon): (&RecordingMapSpec, &PlatoonSpec),
    lines: &[Fields],
    names: &CsvRow<'_>,
    each: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let mut header = PlatoonHeader::default();
    lines
        .iter()
        .for_each(|fields| header.read_line(platoon, fields));
    let layout = PlatoonColumns::from_names((map, platoon), names)?;
    let mut dropped = Vec::new();
    let lines_of_vehicles = layout.split(names, &header, &mut dropped)?;

    let series = |column: &CsvColumn, quantity| Series::new(column.clone(), quantity);
    let speed_series = |(&number, column)| (number, series(column, ColumnQuantity::Speed));
    let gap_series = |(&number, column)| (number, series(column, ColumnQuantity::Gap));
    let mut samples = PlatoonSamples {
        map,
        header,
        speeds: layout.speeds.iter().map(speed_series).collect(),
        gaps: layout.gaps.iter().map(gap_series).collect(),
        time_s: Vec::new(),
        line: Vec::new(),
    };
    let (mut clock, speeds) = (layout.time, &layout.speeds);
    let mut bounds = PartBounds::new(2 * speeds.len());
    while let Some(row) = table.next_sample(&names.fields)? {
        let now_s = clock.read(row)?;
        if !clock.advance(row, now_s) {
            continue;
        }
        if bounds.ends_before((now_s * 1000.0).round() as i64) {
            let (core_ms, next_ms) = bounds.next();
            let text = TextFormat {
                time: clock.detected(),
                ..table.format()
            };
            let time = clock.column.factor;
            let part = samples.part(
                table,
                (&lines_of_vehicles, speeds),
                (core_ms, time, text),
                mem::take(&mut dropped),
            )?;
            if !each(part)? {
                return Ok(());
            }
            samples.forget_before(next_ms as f64 / 1000.0);
        }
        let row = table.row();
        samples.time_s.push(now_s);
        samples.line.push(row.line);
        for series in samples.speeds.values_mut() {
            let value = series.read(row)?;
            series.values.push(value);
        }
        for series in samples.gaps.values_mut() {
            let value = series.read_minus(row, platoon.length_m.unwrap_or(0.0))?;
            series.values.push(value);
        }
    }
    table.check_samples(&mut dropped)?;
    let text = TextFormat {
        time: clock.detected(),
        ..table.format()
    };
    let time_factor = clock.column.factor;
    clock.report(&mut dropped);
    for series in samples.speeds.values().chain(samples.gaps.values()) {
        series.report(table.path(), table.samples, &mut dropped);
    }
    let core_ms = bounds.next().0;
    each(samples.part(
        table,
        (&lines_of_vehicles, speeds),
        (core_ms, time_factor, text),
        dropped,
    )?)?;
    Ok(())
}

/// Samples of the current part.
struct PlatoonSamples<'m> {
    map: &'m RecordingMapSpec,
    header: PlatoonHeader,
    speeds: BTreeMap<usize, Series>,
    gaps: BTreeMap<usize, Series>,
    time_s: Vec<f64>,
    line: Vec<u64>,
}

impl PlatoonSamples<'_> {
    fn forget_before(&mut self, time_s: f64) {
        let count = self.time_s.partition_point(|known_s| *known_s < time_s);
        self.time_s.drain(..count);
        self.line.drain(..count);
        let series = self.speeds.values_mut().chain(self.gaps.values_mut());
        series.for_each(|series| drop(series.values.drain(..count)));
    }

    /// Converts the samples to platoons.
    fn part(
        &self,
        table: &RowReader<'_>,
        (lines_of_vehicles, recorded): (&[Vec<usize>], &BTreeMap<usize, CsvColumn>),
        (core_ms, time_factor, text): (Range<i64>, f64, TextFormat),
        mut dropped: Vec<DroppedItem>,
    ) -> Result<Recording, RecordingError> {
        let Self {
            map,
            header,
            speeds,
            gaps,
            time_s,
            line,
            ..
        } = self;
        for (ahead, gap) in gaps {
            let (Some(leader), Some(follower)) = (speeds.get(ahead), speeds.get(&(ahead + 1)))
            else {
                continue;
            };
            let mut comparison = Comparison::default();
            let samples = time_s
                .iter()
                .zip(line)
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
                .chain(Hypothesis::times(&map.time, time_factor))
                .collect();
            let columns = [&format!("the change of {}", gap.name), &*difference];
            comparison.check(table, &difference, columns, (&hypotheses, &mut dropped))?;
        }

        let mut filled = |series: &Series| {
            let mut values = series.values.clone();
            if let Some((count, first)) = interpolate_holes(&mut values, time_s, map.interpolate_s)
            {
                let (path, line) = (
                    table.path().to_owned(),
                    line.get(first).copied().unwrap_or(0),
                );
                let omission = Omission::interpolated(&series.column.name, count);
                dropped.push(DroppedItem {
                    path,
                    line,
                    omission,
                });
            }
            values
        };
        let mut speeds_mps: BTreeMap<_, _> = speeds
            .iter()
            .map(|(&number, one)| (number, filled(one)))
            .collect();
        let mut gaps_by_number: BTreeMap<_, _> = gaps
            .iter()
            .map(|(&number, one)| (number, filled(one)))
            .collect();

        let mut platoons = Vec::new();
        for numbers in lines_of_vehicles {
            let gaps_m = numbers.iter().rev().skip(1).rev();
            let gaps_m = gaps_m
                .map(|number| gaps_by_number.remove(number).unwrap_or_default())
                .collect();
            let vehicle = |&number: &usize| RecordedVehicle {
                number,
                name: header.name_of(number, recorded),
                speed_mps: speeds_mps.remove(&number).unwrap_or_default(),
            };
            let (vehicles, core_ms) = (numbers.iter().map(vehicle).collect(), core_ms.clone());
            let (time_s, line) = (time_s.clone(), line.clone());
            platoons.push(RecordedPlatoon {
                event: None,
                time_s,
                line,
                vehicles,
                gaps_m,
                core_ms,
            });
        }
        Ok(Recording {
            path: table.path().to_owned(),
            format: map.name.clone(),
            text,
            platoons,
            traffic: None,
            dropped,
        })
    }
}
