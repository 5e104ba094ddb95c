//! Recordings of pairs: each row holds one leader and one follower of an event at one instant, and perhaps the vehicle
//! behind.
//!
//! Rows of one event are consecutive; each event becomes a platoon of two or three. The relative speed supplies a
//! missing speed, or is checked against both.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;
use std::{iter, mem};

use super::acceleration::AccelerationCheck;
use super::behind::{BehindReader, BehindState};
use super::consistency::Comparison;
use super::dropped::{DroppedItem, Omission, SPEEDS_LEFT_OUT};
use super::error::{ColumnProblem, RecordingError};
use super::map::{
    ColumnUnit, LengthUnit, PairsSpec, RecordingMapSpec, RelativeSpeedSpec, Sign, SpacingSpec,
    SpeedSpec, SpeedUnit,
};
use super::parts::{PART_ROWS, PartBounds, PartSink};
use super::series::{Clock, ColumnQuantity, Series, ValueCheck, interpolate_holes};
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
    sink: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let mut events = EventReader::new(map, pairs, names)?;
    while let Some(row) = table.next_sample(&names.fields)? {
        events.read_row(row)?;
        if events.finished_rows > PART_ROWS {
            let part = events.part(table, Vec::new())?;
            if !sink(part)? {
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
    for (check, name) in [
        (&events.derived_leader, "the leader's speed"),
        (&events.derived_follower, "the follower's speed"),
    ] {
        check.report(table.path(), name, &mut dropped);
    }
    if let Some(behind) = &events.behind {
        behind.report(table, &mut dropped)?;
    }
    let mut last = events.part(table, dropped)?;
    events.clock.report(&mut last.dropped);
    last.dropped.extend(events.contradictions);
    sink(last)?;
    Ok(())
}

/// Finished events, and the current one.
pub(super) struct EventReader<'m> {
    pub(super) map: &'m RecordingMapSpec,
    /// Length of a leader that recorded spacings include, in metres.
    included_length_m: f64,
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
    /// Speeds of the leader and of the follower that follow from the other one and the relative speed.
    derived_leader: ValueCheck,
    derived_follower: ValueCheck,
    pub(super) behind: Option<BehindReader>,
    contradictions: Option<DroppedItem>,
    /// Changes of the gap against closing speeds, and closing speeds against both speeds.
    pub(super) gap_change: Comparison,
    pub(super) closing: Comparison,
    /// Line of the first switch to another target, and all switches.
    switches: Option<(u64, Omission)>,
    /// First line and number of interpolated values of each column of [`PairSamples`].
    interpolated: [Option<(u64, usize)>; 5],
}

impl<'m> EventReader<'m> {
    fn new(
        map: &'m RecordingMapSpec,
        pairs: &PairsSpec,
        names: &CsvRow<'_>,
    ) -> Result<Self, RecordingError> {
        Ok(Self {
            map,
            included_length_m: pairs.length_m.unwrap_or(0.0),
            accelerations: [
                find_acceleration(names, pairs.follower_speed.as_ref())?,
                find_acceleration(names, pairs.leader_speed.as_ref())?,
            ],
            platoons: Vec::new(),
            finished_rows: 0,
            bounds: PartBounds::new(values_per_row(pairs)),
            column: pairs
                .event
                .as_ref()
                .map(|name| CsvColumn::find(names, name, ColumnUnit::None))
                .transpose()?,
            event: None,
            finished: HashMap::new(),
            clock: Clock::find(names, &map.time)?,
            samples: PairSamples::default(),
            gap: find_spacing(names, &pairs.spacing)?,
            follower: find_speed(names, pairs.follower_speed.as_ref())?,
            relative: find_relative_speed(names, pairs.relative_speed.as_ref())?,
            leader: find_speed(names, pairs.leader_speed.as_ref())?,
            derived_leader: ValueCheck::new(ColumnQuantity::Speed),
            derived_follower: ValueCheck::new(ColumnQuantity::Speed),
            behind: pairs
                .behind
                .as_ref()
                .map(|behind| BehindReader::find(names, behind))
                .transpose()?,
            contradictions: None,
            gap_change: Comparison::default(),
            closing: Comparison::default(),
            switches: None,
            interpolated: [None; 5],
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
        let is_other_event = self
            .event
            .as_deref()
            .is_none_or(|current| self.column.is_some() && current != event);
        if is_other_event || self.clock.starts_anew(row, now_s) {
            self.begin_event(row, event, now_s)?;
        }
        if !self.clock.advance(row, now_s) {
            return Ok(());
        }
        if self.bounds.ends_before((now_s * 1000.0).round() as i64) {
            self.end_part();
        }
        self.read_values(row, now_s)
    }

    /// Ends the current event, and begins that of a row.
    fn begin_event(
        &mut self,
        row: &CsvRow<'_>,
        event: &str,
        now_s: f64,
    ) -> Result<(), RecordingError> {
        self.finish_event();
        if self.finished.len() >= MAX_EVENTS {
            return row.reject_too_large(MAX_EVENTS, "events");
        }
        self.check_not_interleaved(row, event, now_s)?;
        self.event = Some(event.to_owned());
        Ok(())
    }

    /// Adds the values of a row to the samples, and to the comparisons of columns.
    fn read_values(&mut self, row: &CsvRow<'_>, now_s: f64) -> Result<(), RecordingError> {
        let time_and_line = (now_s, row.line);
        let gap_m = self.gap.read_minus(row, self.included_length_m)?;
        let speeds = PairSpeeds {
            follower_mps: read_optional(&mut self.follower, row)?,
            relative_mps: read_optional(&mut self.relative, row)?,
            leader_mps: read_optional(&mut self.leader, row)?,
        };
        let [follower_mps, leader_mps] = self.reconcile_speeds(row, speeds);
        self.gap_change
            .add(time_and_line, gap_m, speeds.rates_of_gap());
        if let PairSpeeds {
            follower_mps: Some(follower),
            relative_mps: Some(relative),
            leader_mps: Some(leader),
        } = speeds
        {
            self.closing
                .add_instant(time_and_line, [relative, leader, -follower]);
        }
        for (acceleration, speed_mps) in self
            .accelerations
            .iter_mut()
            .zip([follower_mps, leader_mps])
        {
            if let Some(acceleration) = acceleration {
                let value = acceleration.series.read(row)?;
                acceleration.add(time_and_line, speed_mps, value);
            }
        }
        if let Some(behind) = &mut self.behind {
            let BehindState { gap_m, speed_mps } = behind.read(row, now_s, follower_mps)?;
            self.samples.gaps_behind_m.push(gap_m);
            self.samples.behind_mps.push(speed_mps);
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
    fn reconcile_speeds(&mut self, row: &CsvRow<'_>, speeds: PairSpeeds) -> [Option<f64>; 2] {
        let PairSpeeds {
            follower_mps,
            relative_mps,
            leader_mps,
        } = speeds;
        match (follower_mps, relative_mps, leader_mps) {
            (Some(follower), Some(relative), None) => {
                let leader_mps = follower + relative;
                let leader_mps = self.derived_leader.possible(row.line, leader_mps);
                [Some(follower), leader_mps]
            }
            (None, Some(relative), Some(leader)) => {
                let follower_mps = leader - relative;
                let follower_mps = self.derived_follower.possible(row.line, follower_mps);
                [follower_mps, Some(leader)]
            }
            (Some(follower), Some(relative), Some(leader)) => {
                let error_mps = (relative - (leader - follower)).abs();
                if error_mps <= SPEED_TOLERANCE_MPS {
                    return [Some(follower), Some(leader)];
                }
                self.count_contradiction(row, error_mps);
                [None, None]
            }
            (follower, None, leader) => [follower, leader],
            (None, Some(_), None) => [None, None],
        }
    }

    /// Counts a row whose relative speed differs from the difference of both speeds.
    fn count_contradiction(&mut self, row: &CsvRow<'_>, error_mps: f64) {
        let [leader, follower, relative] =
            [&self.leader, &self.follower, &self.relative].map(|series| match series {
                Some(series) => series.column.name.as_str(),
                None => "",
            });
        row.count(&mut self.contradictions, || {
            let error_mps = format_fixed(error_mps, 3);
            Omission::counted(
                format!("{relative}: differs from {leader} - {follower} in "),
                0,
                format!(" rows, the first one here (by {error_mps} m/s){SPEEDS_LEFT_OUT}"),
            )
        });
    }

    /// Converts the current event to a platoon.
    fn finish_event(&mut self) {
        self.clock.restart();
        self.gap_change.restart();
        self.behind.iter_mut().for_each(BehindReader::restart);
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
        let part = self.bounds.restarted().next();
        self.add_platoons(&event, &part.core_ms, samples);
    }

    /// Converts the first part of a long event to a platoon, and keeps its end for the next part.
    fn end_part(&mut self) {
        let part = self.bounds.next();
        let end = self
            .samples
            .time_s
            .partition_point(|time_s| time_s * 1000.0 < part.next_from_ms as f64);
        let samples = mem::take(&mut self.samples);
        self.samples = samples.clone().split_off(end);
        let event = self.event.clone().unwrap_or_default();
        self.add_platoons(&event, &part.core_ms, samples);
    }

    /// Adds samples of an event as platoons of two, one for each target of the sensor.
    fn add_platoons(&mut self, event: &str, core_ms: &Range<i64>, mut samples: PairSamples) {
        self.finished_rows += EVENT_ROWS + samples.time_s.len();
        self.fill_holes(&mut samples);
        let event = self.column.is_some().then(|| excerpt(event));
        for pair in samples.split(&mut self.switches) {
            self.platoons
                .push(platoon(pair, event.clone(), core_ms.clone()));
        }
    }

    /// Interpolates short holes, as the map demands, and counts the new values.
    fn fill_holes(&mut self, samples: &mut PairSamples) {
        let PairSamples {
            time_s,
            line,
            gaps_m,
            followers_mps,
            leaders_mps,
            gaps_behind_m,
            behind_mps,
        } = samples;
        let columns = [
            gaps_m,
            followers_mps,
            leaders_mps,
            gaps_behind_m,
            behind_mps,
        ];
        for (values, interpolated) in columns.into_iter().zip(&mut self.interpolated) {
            if let Some((count, first)) = interpolate_holes(values, time_s, self.map.interpolate_s)
            {
                interpolated
                    .get_or_insert((line.get(first).copied().unwrap_or(0), 0))
                    .1 += count;
            }
        }
    }

    /// Converts the finished platoons to a part of the recording.
    fn part(
        &mut self,
        table: &RowReader<'_>,
        mut dropped: Vec<DroppedItem>,
    ) -> Result<Recording, RecordingError> {
        let path = table.path();
        let columns = [
            "spacings",
            "the follower's speed",
            "the leader's speed",
            "spacings behind",
            "the speed of the vehicle behind",
        ];
        for (column, interpolated) in columns.into_iter().zip(mem::take(&mut self.interpolated)) {
            dropped.extend(interpolated.map(|(line, count)| DroppedItem {
                path: path.to_owned(),
                line,
                omission: Omission::interpolated(column, count),
            }));
        }
        self.check(table, &mut dropped)?;
        let accelerations = self.accelerations.iter_mut().flatten();
        accelerations
            .into_iter()
            .try_for_each(|acceleration| acceleration.check(table, &mut dropped))?;
        self.gap_change = Comparison::default();
        self.closing = Comparison::default();
        self.finished_rows = 0;
        dropped.extend(self.switches.take().map(|(line, omission)| DroppedItem {
            path: path.to_owned(),
            line,
            omission,
        }));
        Ok(Recording {
            path: path.to_owned(),
            format: self.map.name.clone(),
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

/// Converts samples to a platoon of leader and follower and, if there are columns of it, the vehicle behind.
fn platoon(pair: PairSamples, event: Option<String>, core_ms: Range<i64>) -> RecordedPlatoon {
    let mut vehicles = vec![
        pair_vehicle(1, "leader", pair.leaders_mps),
        pair_vehicle(2, "follower", pair.followers_mps),
    ];
    let mut gaps_m = vec![pair.gaps_m];
    if !pair.behind_mps.is_empty() {
        vehicles.push(pair_vehicle(3, "behind", pair.behind_mps));
        gaps_m.push(pair.gaps_behind_m);
    }
    RecordedPlatoon {
        event,
        time_s: pair.time_s,
        line: pair.line,
        vehicles,
        gaps_m,
        lead_count: 1,
        core_ms,
    }
}

fn pair_vehicle(number: usize, name: &str, speed_mps: Vec<Option<f64>>) -> RecordedVehicle {
    RecordedVehicle {
        number,
        name: Some(name.to_owned()),
        speed_mps,
    }
}

/// Returns the number of speeds and gaps in a row.
fn values_per_row(pairs: &PairsSpec) -> usize {
    if pairs.behind.is_some() { 5 } else { 3 }
}

/// Speeds of a row, as far as they are recorded.
#[derive(Debug, Clone, Copy)]
struct PairSpeeds {
    follower_mps: Option<f64>,
    /// Speed of the leader minus that of the follower.
    relative_mps: Option<f64>,
    leader_mps: Option<f64>,
}

impl PairSpeeds {
    /// Returns rates whose sum should be the change of the gap: the relative speed, or else both speeds.
    fn rates_of_gap(&self) -> Option<[f64; 2]> {
        match self.relative_mps {
            Some(relative_mps) => Some([relative_mps, 0.0]),
            None => self
                .leader_mps
                .zip(self.follower_mps)
                .map(|(leader, follower)| [leader, -follower]),
        }
    }
}

/// Reads the value of a column, if there is one.
fn read_optional(
    series: &mut Option<Series>,
    row: &CsvRow<'_>,
) -> Result<Option<f64>, RecordingError> {
    match series {
        Some(series) => series.read(row),
        None => Ok(None),
    }
}

pub(super) fn find_spacing(
    names: &CsvRow<'_>,
    spacing: &SpacingSpec,
) -> Result<Series, RecordingError> {
    let unit = LengthUnit::column_unit(spacing.unit);
    let column = CsvColumn::find(names, &spacing.column, unit)?;
    Ok(Series::new(column, ColumnQuantity::Gap))
}

/// Finds the column of a speed, if the map names one.
pub(super) fn find_speed(
    names: &CsvRow<'_>,
    speed: Option<&SpeedSpec>,
) -> Result<Option<Series>, RecordingError> {
    let Some(speed) = speed else {
        return Ok(None);
    };
    let unit = SpeedUnit::column_unit(speed.unit);
    let column = CsvColumn::find(names, &speed.column, unit)?;
    Ok(Some(Series::new(column, ColumnQuantity::Speed)))
}

/// Finds the column of the relative speed, and gives it the sign of the leader's speed minus the follower's.
pub(super) fn find_relative_speed(
    names: &CsvRow<'_>,
    speed: Option<&RelativeSpeedSpec>,
) -> Result<Option<Series>, RecordingError> {
    let Some(speed) = speed else {
        return Ok(None);
    };
    let unit = SpeedUnit::column_unit(speed.unit);
    let mut column = CsvColumn::find(names, &speed.column, unit)?;
    column.factor *= match speed.sign {
        Sign::LeaderMinusFollower => 1.0,
        Sign::FollowerMinusLeader => -1.0,
    };
    Ok(Some(Series::new(column, ColumnQuantity::Signed)))
}

fn find_acceleration(
    names: &CsvRow<'_>,
    speed: Option<&SpeedSpec>,
) -> Result<Option<AccelerationCheck>, RecordingError> {
    speed.map_or(Ok(None), |speed| AccelerationCheck::find(names, speed))
}

fn hash_of(event: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    event.hash(&mut hasher);
    hasher.finish()
}
