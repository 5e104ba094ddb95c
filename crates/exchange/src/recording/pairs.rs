//! Recordings of pairs: each row holds one leader and one follower of an event at one instant.
//!
//! Rows of one event are consecutive; each event becomes a platoon of two. The relative speed supplies a missing speed,
//! or is checked against both.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;
use std::{iter, mem};

use super::acceleration::AccelerationCheck;
use super::consistency::Comparison;
use super::dropped::{DroppedItem, Omission, SPEEDS_LEFT_OUT};
use super::error::{ColumnProblem, RecordingError};
use super::map::{ColumnUnit, LengthUnit, PairsSpec, RecordingMapSpec, Sign, SpeedSpec, SpeedUnit};
use super::parts::{PART_ROWS, PartBounds, PartSink};
use super::series::{Clock, ColumnQuantity, Series, interpolate_holes};
use super::table::{CsvColumn, CsvRow, RowReader, excerpt};
use super::target_switches::PairSamples;
use super::{RecordedPlatoon, RecordedVehicle, Recording, TextFormat};
use crumple_core::digits::format_fixed;

/// Largest contradiction of the three speeds due to rounding and filtering, in m/s.
const SPEED_TOLERANCE_MPS: f64 = 0.1;
/// Number of rows that take as much memory as an event without rows.
const EVENT_ROWS: usize = 8;
/// Maximum number of events of a file. Each takes about 50 bytes beside its samples.
const MAX_EVENTS: usize = 1_000_000;

/// Reads the rows after the column names.
pub(super) fn read(
    table: &mut RowReader<'_>,
    (map, pairs): (&RecordingMapSpec, &PairsSpec),
    names: &CsvRow<'_>,
    each: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let mut events = EventReader::new((map, pairs), names)?;
    while let Some(row) = table.next_sample(&names.fields)? {
        events.read_row(row)?;
        if events.finished_rows > PART_ROWS {
            let part = events.part(table, Vec::new())?;
            if !each(part)? {
                return Ok(());
            }
        }
    }
    let mut dropped = Vec::new();
    table.check_samples(&mut dropped)?;
    events.finish_event();
    let speeds = [&events.follower, &events.relative, &events.leader]
        .into_iter()
        .flatten();
    let accelerations = events
        .accelerations
        .iter()
        .flatten()
        .map(|acceleration| &acceleration.series);
    for series in iter::once(&events.gap).chain(speeds).chain(accelerations) {
        series.report(table.path(), table.samples, &mut dropped);
    }
    let mut last = events.part(table, dropped)?;
    events.clock.report(&mut last.dropped);
    last.dropped.extend(events.contradictions);
    each(last)?;
    Ok(())
}

/// Finished events, and the current one.
pub(super) struct EventReader<'m> {
    pub(super) spec: (&'m RecordingMapSpec, &'m PairsSpec),
    platoons: Vec<RecordedPlatoon>,
    /// Number of rows of these platoons.
    finished_rows: usize,
    bounds: PartBounds,
    /// Column of the event. `event` holds the full text, since names may differ in the last character.
    column: Option<CsvColumn>,
    /// Accelerations of the follower and of the leader.
    pub(super) accelerations: [Option<AccelerationCheck>; 2],
    event: Option<String>,
    /// Last time and line of each finished event, by the hash of its name, which may be long.
    finished: HashMap<u64, (f64, u64)>,
    pub(super) clock: Clock,
    samples: PairSamples,
    pub(super) gap: Series,
    pub(super) follower: Option<Series>,
    pub(super) relative: Option<Series>,
    pub(super) leader: Option<Series>,
    contradictions: Option<DroppedItem>,
    /// Changes of the gap against closing speeds, and closing speeds against both speeds.
    pub(super) gap_change: Comparison,
    pub(super) closing: Comparison,
    /// Line of the first switch to another target, and all switches.
    switches: Option<(u64, Omission)>,
    /// First line and number of interpolated spacings, follower speeds and leader speeds.
    interpolated: [Option<(u64, usize)>; 3],
}

impl<'m> EventReader<'m> {
    fn new(
        spec: (&'m RecordingMapSpec, &'m PairsSpec),
        names: &CsvRow<'_>,
    ) -> Result<Self, RecordingError> {
        let (map, pairs) = spec;
        let series = |name: &str, unit, quantity| {
            Ok(Series::new(CsvColumn::find(names, name, unit)?, quantity))
        };
        let speed = |speed: &Option<SpeedSpec>| {
            speed
                .as_ref()
                .map(|one| {
                    series(
                        &one.column,
                        SpeedUnit::of_column(one.unit),
                        ColumnQuantity::Speed,
                    )
                })
                .transpose()
        };
        let relative = pairs.relative_speed.as_ref().map(|one| {
            let mut relative = series(
                &one.column,
                SpeedUnit::of_column(one.unit),
                ColumnQuantity::Signed,
            )?;
            relative.column.factor *= if one.sign == Sign::LeaderMinusFollower {
                1.0
            } else {
                -1.0
            };
            Ok(relative)
        });
        let acceleration = |speed: &Option<SpeedSpec>| {
            speed
                .as_ref()
                .map_or(Ok(None), |speed| AccelerationCheck::find(names, speed))
        };
        Ok(Self {
            spec,
            accelerations: [
                acceleration(&pairs.follower_speed)?,
                acceleration(&pairs.leader_speed)?,
            ],
            platoons: Vec::new(),
            finished_rows: 0,
            bounds: PartBounds::new(3),
            column: pairs
                .event
                .as_ref()
                .map(|name| CsvColumn::find(names, name, ColumnUnit::None))
                .transpose()?,
            event: None,
            finished: HashMap::new(),
            clock: Clock::find(names, &map.time)?,
            samples: PairSamples::default(),
            gap: series(
                &pairs.spacing.column,
                LengthUnit::of_column(pairs.spacing.unit),
                ColumnQuantity::Gap,
            )?,
            follower: speed(&pairs.follower_speed)?,
            relative: relative.transpose()?,
            leader: speed(&pairs.leader_speed)?,
            contradictions: None,
            gap_change: Comparison::default(),
            closing: Comparison::default(),
            switches: None,
            interpolated: [None; 3],
        })
    }

    fn read_row(&mut self, row: &CsvRow<'_>) -> Result<(), RecordingError> {
        let event = self
            .column
            .as_ref()
            .map_or("", |column| row.text(column.index));
        if event.is_empty()
            && let Some(column) = &self.column
        {
            return row.reject(&column.name, ColumnProblem::Empty);
        }
        let now_s = self.clock.read(row)?;
        // Without a column, names are not compared: comparisons of empty texts are slow on some processors.
        if self
            .event
            .as_deref()
            .is_none_or(|known| self.column.is_some() && known != event)
            || self.clock.starts_anew(row, now_s)
        {
            self.finish_event();
            if self.finished.len() >= MAX_EVENTS {
                return row.reject_too_large(MAX_EVENTS, "events");
            }
            self.check_not_interleaved(row, event, now_s)?;
            self.event = Some(event.to_owned());
        }
        if !self.clock.advance(row, now_s) {
            return Ok(());
        }
        if self.bounds.ends_before((now_s * 1000.0).round() as i64) {
            self.end_part();
        }
        let gap_m = self
            .gap
            .read_minus(row, self.spec.1.length_m.unwrap_or(0.0))?;
        let read = |series: &mut Option<Series>| {
            series.as_mut().map_or(Ok(None), |series| series.read(row))
        };
        let speeds = (
            read(&mut self.follower)?,
            read(&mut self.relative)?,
            read(&mut self.leader)?,
        );
        let (follower_mps, leader_mps) = self.reconcile_speeds(row, speeds);
        let rates_mps = match speeds {
            (_, Some(relative), _) => Some([relative, 0.0]),
            (follower, None, leader) => leader
                .zip(follower)
                .map(|(leader, follower)| [leader, -follower]),
        };
        self.gap_change.add((now_s, row.line), gap_m, rates_mps);
        if let (Some(follower), Some(relative), Some(leader)) = speeds {
            self.closing
                .add_instant((now_s, row.line), [relative, leader, -follower]);
        }
        for (acceleration, speed_mps) in self
            .accelerations
            .iter_mut()
            .zip([follower_mps, leader_mps])
        {
            if let Some(acceleration) = acceleration {
                let value = acceleration.series.read(row)?;
                acceleration.add((now_s, row.line), speed_mps, value);
            }
        }
        self.samples.time_s.push(now_s);
        self.samples.line.push(row.line);
        self.samples.gaps_m.push(gap_m);
        self.samples.followers_mps.push(follower_mps);
        self.samples.leaders_mps.push(leader_mps);
        Ok(())
    }

    /// Rejects a row that continues an event after rows of others. A row that begins before the end of the earlier
    /// event starts another event of that name.
    fn check_not_interleaved(
        &self,
        row: &CsvRow<'_>,
        event: &str,
        now_s: f64,
    ) -> Result<(), RecordingError> {
        match (&self.column, self.finished.get(&hash_of(event))) {
            (Some(column), Some(&(last_s, last_line))) if now_s > last_s => row.reject(
                &column.name,
                ColumnProblem::Interleaved {
                    event: excerpt(event),
                    last_line,
                },
            ),
            _ => Ok(()),
        }
    }

    /// Returns the speeds of follower and leader from any two of the three columns; neither if they contradict one
    /// another.
    fn reconcile_speeds(
        &mut self,
        row: &CsvRow<'_>,
        (follower, relative, leader): (Option<f64>, Option<f64>, Option<f64>),
    ) -> (Option<f64>, Option<f64>) {
        let possible =
            |speed_mps: f64| ColumnQuantity::Speed.allows(speed_mps).then_some(speed_mps);
        match (follower, relative, leader) {
            (Some(follower), Some(relative), None) => {
                (Some(follower), possible(follower + relative))
            }
            (None, Some(relative), Some(leader)) => (possible(leader - relative), Some(leader)),
            (Some(follower), Some(relative), Some(leader)) => {
                let first_error_mps = (relative - (leader - follower)).abs();
                if first_error_mps <= SPEED_TOLERANCE_MPS {
                    return (Some(follower), Some(leader));
                }
                let name = |series: &Option<Series>| {
                    series
                        .as_ref()
                        .map_or("", |one| &one.column.name)
                        .to_owned()
                };
                let difference = format!("{} - {}", name(&self.leader), name(&self.follower));
                let (relative, error_mps) =
                    (name(&self.relative), format_fixed(first_error_mps, 3));
                let after =
                    format!(" rows, the first one here (by {error_mps} m/s){SPEEDS_LEFT_OUT}");
                let what = Omission::counted(
                    format!("{relative}: differs from {difference} in "),
                    0,
                    after,
                );
                row.count(&mut self.contradictions, || what);
                (None, None)
            }
            (follower, None, leader) => (follower, leader),
            (None, Some(_), None) => (None, None),
        }
    }

    /// Converts the current event to a platoon.
    fn finish_event(&mut self) {
        self.clock.restart();
        self.gap_change.restart();
        self.accelerations
            .iter_mut()
            .flatten()
            .for_each(AccelerationCheck::restart);
        let Some(event) = self.event.take() else {
            return;
        };
        let samples = mem::take(&mut self.samples);
        if let (Some(&last_s), Some(&last_line)) = (samples.time_s.last(), samples.line.last()) {
            self.finished.insert(hash_of(&event), (last_s, last_line));
        }
        let (core_ms, _) = mem::replace(&mut self.bounds, PartBounds::new(3)).next();
        self.add_platoons(&event, core_ms, samples);
    }

    /// Converts the first part of a long event to a platoon, and keeps its end for the next part.
    fn end_part(&mut self) {
        let (core_ms, next_ms) = self.bounds.next();
        let end = self
            .samples
            .time_s
            .partition_point(|time_s| time_s * 1000.0 < next_ms as f64);
        let part = mem::take(&mut self.samples);
        self.samples = part.clone().split_off(end);
        let event = self.event.clone().unwrap_or_default();
        self.add_platoons(&event, core_ms, part);
    }

    fn add_platoons(&mut self, event: &str, core_ms: Range<i64>, mut samples: PairSamples) {
        self.finished_rows += EVENT_ROWS + samples.time_s.len();
        let PairSamples {
            time_s,
            line,
            gaps_m,
            followers_mps,
            leaders_mps,
        } = &mut samples;
        for (values, interpolated) in [gaps_m, followers_mps, leaders_mps]
            .into_iter()
            .zip(&mut self.interpolated)
        {
            if let Some((count, first)) =
                interpolate_holes(values, time_s, self.spec.0.interpolate_s)
            {
                interpolated
                    .get_or_insert((line.get(first).copied().unwrap_or(0), 0))
                    .1 += count;
            }
        }
        let event = self.column.is_some().then(|| excerpt(event));
        for PairSamples {
            time_s,
            line,
            gaps_m,
            followers_mps,
            leaders_mps,
        } in samples.split(&mut self.switches)
        {
            let vehicle = |number, role: &str, speed_mps| RecordedVehicle {
                number,
                name: Some(role.to_owned()),
                speed_mps,
            };
            let vehicles = vec![
                vehicle(1, "leader", leaders_mps),
                vehicle(2, "follower", followers_mps),
            ];
            let (event, core_ms) = (event.clone(), core_ms.clone());
            self.platoons.push(RecordedPlatoon {
                event,
                time_s,
                line,
                vehicles,
                gaps_m: vec![gaps_m],
                core_ms,
            });
        }
    }

    /// Converts the finished platoons to a part of the recording.
    fn part(
        &mut self,
        table: &RowReader<'_>,
        mut dropped: Vec<DroppedItem>,
    ) -> Result<Recording, RecordingError> {
        let item = |line, omission| DroppedItem {
            path: table.path().to_owned(),
            line,
            omission,
        };
        let columns = ["spacings", "the follower's speed", "the leader's speed"];
        for (column, found) in columns.into_iter().zip(mem::take(&mut self.interpolated)) {
            dropped.extend(
                found.map(|(line, count)| item(line, Omission::interpolated(column, count))),
            );
        }
        self.check(table, &mut dropped)?;
        let accelerations = self.accelerations.iter_mut().flatten();
        accelerations
            .into_iter()
            .try_for_each(|acceleration| acceleration.check(table, &mut dropped))?;
        (self.gap_change, self.closing, self.finished_rows) =
            (Comparison::default(), Comparison::default(), 0);
        dropped.extend(
            self.switches
                .take()
                .map(|(line, omission)| item(line, omission)),
        );
        Ok(Recording {
            path: table.path().to_owned(),
            format: self.spec.0.name.clone(),
            text: TextFormat {
                time: self.clock.detected(),
                ..table.format()
            },
            platoons: mem::take(&mut self.platoons),
            traffic: None,
            dropped,
        })
    }
}

fn hash_of(event: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    event.hash(&mut hasher);
    hasher.finish()
}
