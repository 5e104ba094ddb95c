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
use super::error::{ColumnProblem, RecordingError};
use super::map::{LengthUnit, PlatoonSpec, RecordingMapSpec, SpeedUnit};
use super::parts::{PartBounds, PartSink};
use super::series::{Clock, ColumnQuantity, Series, interpolate_holes};
use super::table::{CsvColumn, CsvRow, RowCounter, RowReader, excerpt};
use super::text_rows::Fields;
use super::{RecordedPlatoon, RecordedVehicle, Recording, RecordingFormat, TextFormat};

/// Maximum number of vehicles of a platoon: ten times that of any published recording.
const MAX_VEHICLES: usize = 200;

/// Reads the rows after the column names, with the header lines.
pub(super) fn read(
    table: &mut RowReader<'_>,
    (map, platoon): (&RecordingMapSpec, &PlatoonSpec),
    lines: &[Fields],
    names: &CsvRow<'_>,
    each: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let mut header = PlatoonHeader::default();
    lines.iter().for_each(|fields| header.read_line(platoon, fields));
    let layout = PlatoonColumns::from_names((map, platoon), names)?;
    let mut dropped = Vec::new();
    let lines_of_vehicles = layout.split(names, &header, &mut dropped)?;

    let series = |column: &CsvColumn, quantity| Series::new(column.clone(), quantity);
    let speed_series = |(&number, column)| (number, series(column, ColumnQuantity::Speed));
    let gap_series = |(&number, column)| (number, series(column, ColumnQuantity::Gap));
    let mut samples = PlatoonSamples {
        map,
        platoon,
        header,
        speeds: layout.speeds.iter().map(speed_series).collect(),
        gaps: layout.gaps.iter().map(gap_series).collect(),
        time_s: Vec::new(),
        line: Vec::new(),
    };
    let (mut clock, speeds) = (layout.time, &layout.speeds);
    let mut counter = RowCounter::new(&names.fields);
    let mut bounds = PartBounds::new(2 * speeds.len());
    while let Some(row) = table.next_row()? {
        counter.check_row(row)?;
        let Some(now_s) = clock.tick(row)? else { continue };
        if bounds.ends_before((now_s * 1000.0).round() as i64) {
            let (core_ms, next_ms) = bounds.next();
            let text = TextFormat { time: clock.detected(), ..table.format() };
            let time = clock.column.factor;
            let part = samples.part(table, (&lines_of_vehicles, speeds), (core_ms, time, text), mem::take(&mut dropped))?;
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
    table.check_samples(counter.rows, &mut dropped)?;
    let text = TextFormat { time: clock.detected(), ..table.format() };
    let time_factor = clock.column.factor;
    clock.report(&mut dropped);
    for series in samples.speeds.values().chain(samples.gaps.values()) {
        series.report(table.path(), counter.rows, &mut dropped);
    }
    let core_ms = bounds.next().0;
    each(samples.part(table, (&lines_of_vehicles, speeds), (core_ms, time_factor, text), dropped)?)?;
    Ok(())
}

/// Samples of the current part.
struct PlatoonSamples<'m> {
    map: &'m RecordingMapSpec,
    platoon: &'m PlatoonSpec,
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
        let Self { map, platoon, header, speeds, gaps, time_s, line } = self;
        let mut comparison = Comparison::default();
        for (ahead, gap) in gaps {
            let (Some(leader), Some(follower)) = (speeds.get(ahead), speeds.get(&(ahead + 1))) else { continue };
            comparison.restart();
            let samples = time_s.iter().zip(line).zip(&gap.values).zip(leader.values.iter().zip(&follower.values));
            for (((&at_s, &line), &gap_m), (leader, follower)) in samples {
                let rates_mps = leader.zip(*follower).map(|(leader, follower)| [leader, -follower]);
                comparison.add((at_s, line), gap_m, rates_mps);
            }
        }
        let (speed, spacing) = (&platoon.speed, &platoon.spacing);
        let hypotheses: Vec<_> =
            Hypothesis::units(&speed.column, (SpeedUnit::ALL, speed.unit.factor()), [false, true, true])
                .chain(Hypothesis::units(
                    &spacing.column,
                    (LengthUnit::ALL, spacing.unit.factor()),
                    [true, false, false],
                ))
                .chain(Hypothesis::times(&map.time, time_factor))
                .collect();
        let columns = [format!("the change of {}", spacing.column), format!("the difference of {}", speed.column)];
        comparison.check(table, &speed.column, [&columns[0], &columns[1]], (&hypotheses, &mut dropped))?;

        let mut filled = |series: &Series| {
            let mut values = series.values.clone();
            if let Some((count, first)) = interpolate_holes(&mut values, time_s, map.interpolate_s) {
                let (path, column) = (table.path().to_owned(), series.column.name.clone());
                let line = line.get(first).copied().unwrap_or(0);
                dropped.push(DroppedItem { path, line, omission: Omission::Interpolated { column, count } });
            }
            values
        };
        let mut speeds_mps: BTreeMap<_, _> = speeds.iter().map(|(&number, one)| (number, filled(one))).collect();
        let mut gaps_by_number: BTreeMap<_, _> = gaps.iter().map(|(&number, one)| (number, filled(one))).collect();

        let mut platoons = Vec::new();
        for numbers in lines_of_vehicles {
            let gaps_m = numbers.iter().rev().skip(1).rev();
            let gaps_m = gaps_m.map(|number| gaps_by_number.remove(number).unwrap_or_default()).collect();
            let vehicle = |&number: &usize| RecordedVehicle {
                number,
                name: header.name_of(number, recorded),
                speed_mps: speeds_mps.remove(&number).unwrap_or_default(),
            };
            let (vehicles, core_ms) = (numbers.iter().map(vehicle).collect(), core_ms.clone());
            let (time_s, line) = (time_s.clone(), line.clone());
            platoons.push(RecordedPlatoon { event: None, time_s, line, vehicles, gaps_m, core_ms });
        }
        Ok(Recording {
            path: table.path().to_owned(),
            format: RecordingFormat::from_map(map),
            text,
            platoons,
            traffic: None,
            dropped,
        })
    }
}

#[derive(Default)]
struct PlatoonHeader {
    order: Vec<String>,
    number_of_vehicles: usize,
}

impl PlatoonHeader {
    fn read_line(&mut self, platoon: &PlatoonSpec, fields: &Fields) {
        let values = fields.iter().skip(1).filter(|value| !value.is_empty());
        let first = fields.get(0);
        if first.is_some() && first == platoon.names_line.as_deref() {
            self.order = values.map(excerpt).collect();
        } else if first.is_some() && first == platoon.count_line.as_deref() {
            self.number_of_vehicles = values.flat_map(str::parse).next().unwrap_or_default();
        }
    }

    /// Returns the name of a vehicle. Names count from vehicle 1 if there are enough, or from the first recorded
    /// vehicle if each has one; otherwise they are ambiguous.
    fn name_of(&self, number: usize, recorded: &BTreeMap<usize, CsvColumn>) -> Option<String> {
        let last = *recorded.keys().next_back()?;
        let place = if self.order.len() >= last {
            number.checked_sub(1)?
        } else if self.order.len() == recorded.len() {
            recorded.keys().position(|&known| known == number)?
        } else {
            return None;
        };
        self.order.get(place).cloned()
    }
}

struct PlatoonColumns {
    time: Clock,
    /// Speed columns by number of the vehicle.
    speeds: BTreeMap<usize, CsvColumn>,
    /// Spacing columns by number of the vehicle ahead.
    gaps: BTreeMap<usize, CsvColumn>,
    /// Name of the columns of spacings.
    spacing: String,
}

impl PlatoonColumns {
    fn from_names(
        (map, platoon): (&RecordingMapSpec, &PlatoonSpec),
        names: &CsvRow<'_>,
    ) -> Result<Self, RecordingError> {
        let time = Clock::find(names, &map.time)?;
        let (mut speeds, mut gaps) = (BTreeMap::new(), BTreeMap::new());
        for (index, name) in names.fields.iter().enumerate().filter(|(index, _)| *index != time.column.index) {
            let column = |factor| CsvColumn { name: excerpt(name), index, factor };
            let before = if let Some(number) = column_number(name, &platoon.speed.column) {
                speeds.insert(number, column(platoon.speed.unit.factor()))
            } else if let Some(number) = column_number(name, &platoon.spacing.column) {
                gaps.insert(number, column(platoon.spacing.unit.factor()))
            } else {
                None
            };
            if before.is_some() {
                return names.reject(&excerpt(name), ColumnProblem::Repeated);
            }
        }
        if speeds.len().max(gaps.len()) > MAX_VEHICLES {
            return names.reject_too_large(MAX_VEHICLES, "vehicles");
        }
        Ok(Self { time, speeds, gaps, spacing: platoon.spacing.column.clone() })
    }

    /// Splits the platoon into lines of two or more vehicles without holes; returns their numbers.
    fn split(
        &self,
        names: &CsvRow<'_>,
        header: &PlatoonHeader,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<Vec<Vec<usize>>, RecordingError> {
        let mut report = |what| dropped.push(names.dropped_item(what));
        let mut lines: Vec<Vec<usize>> = Vec::new();
        let mut ahead = 0;
        for &number in self.speeds.keys() {
            if number > ahead + 1 {
                let consequence = match ahead {
                    0 => "the platoon starts behind",
                    _ => "the platoon is split there, because the spacing is unknown",
                };
                report(Omission::VehiclesMissing { first: ahead + 1, last: number - 1, consequence });
            }
            match lines.last_mut() {
                Some(line) if number == ahead + 1 && self.gaps.contains_key(&ahead) => line.push(number),
                _ => {
                    if number == ahead + 1 && ahead > 0 {
                        let column = self.spacing.replace("{}", &ahead.to_string());
                        report(Omission::SpacingColumnMissing { column, ahead, behind: number });
                    }
                    lines.push(vec![number]);
                }
            }
            ahead = number;
        }
        // A count far beyond the columns is a typing error.
        if header.number_of_vehicles > ahead && header.number_of_vehicles <= MAX_VEHICLES {
            report(Omission::VehiclesMissing {
                first: ahead + 1,
                last: header.number_of_vehicles,
                consequence: "the platoon ends before",
            });
        }
        for (number, column) in &self.gaps {
            if !(self.speeds.contains_key(number) && self.speeds.contains_key(&(number + 1))) {
                report(Omission::SpacingWithoutVehicle { column: column.name.clone() });
            }
        }
        for line in &lines {
            if let [number] = **line {
                report(Omission::LoneVehicle { number });
            }
        }
        lines.retain(|line| line.len() > 1);
        if lines.is_empty() {
            return names.reject(&excerpt(&self.spacing.replace("{}", "1")), ColumnProblem::NoFollower);
        }
        Ok(lines)
    }
}

/// Returns the number, from 1, of a column such as `Speed2`, for the pattern `Speed{}`.
pub(super) fn column_number(name: &str, called: &str) -> Option<usize> {
    let (before, after) = called.split_once("{}")?;
    let number = name.strip_prefix(before)?.strip_suffix(after)?.parse::<u16>().ok()?;
    (number > 0).then_some(usize::from(number))
}
