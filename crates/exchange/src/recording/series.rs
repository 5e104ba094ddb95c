//! Columns under construction: increasing times, plausible values, and counts of all others.

use std::mem;
use std::path::Path;

use super::dropped::{CHECK_UNIT, DroppedItem, Omission};
use super::error::{ColumnProblem, LineProblem, RecordingError};
use super::map::{ClockSpec, ColumnUnit, TimeSpec, TimeUnit};
use super::number::{is_time_of_day, parse_iso_s};
use super::table::{CsvColumn, CsvRow, excerpt};
use crumple_core::digits::{format_fixed, format_number};

/// Largest magnitude of a time, in seconds; still exact to a millisecond.
const MAX_TIME_S: f64 = 1e10;
/// A time that is earlier than the last by more is no late row, in seconds.
const MIN_RESTART_S: f64 = 1.0;
const DAY_S: f64 = 86_400.0;
/// Longest step between two rows over midnight, in seconds.
const MAX_MIDNIGHT_STEP_S: f64 = 3600.0;
/// Largest gap within a platoon, in metres; vehicles further apart do not follow.
const MAX_GAP_M: f64 = 1000.0;
/// Largest speed of a scenario, in m/s.
const MAX_SPEED_MPS: f64 = 100.0;
/// Speeds above are reported, because their unit may be wrong, in m/s.
pub(super) const MAX_USUAL_SPEED_MPS: f64 = 50.0;
/// Speeds against the direction of travel up to this are noise of a standing vehicle, or it rolls back, in m/s.
pub(super) const STANDING_NOISE_MPS: f64 = 0.3;
/// Part of the sentence about rows that are not in the order of time.
pub(super) const NOT_LATER: &str =
    " rows are not later than the row before and were left out, the first one here";
/// Shortest and longest vehicle of a scenario, in metres.
const LENGTH_RANGE_M: [f64; 2] = [0.1, 100.0];

/// Rounds to three decimals, as scenario files do: a millimetre, a millimetre per second, a millisecond.
pub(super) fn round_to_milli(value: f64) -> f64 {
    // Adding zero turns -0 into 0.
    (value * 1000.0).round() / 1000.0 + 0.0
}

/// Column of times; drops rows less than a millisecond later than the last valid row.
pub(super) struct Clock {
    pub(super) column: CsvColumn,
    last_s: Option<f64>,
    /// Rows that are not later.
    not_later: Option<DroppedItem>,
    /// Places where the time starts anew.
    restarts: Option<DroppedItem>,
    format: ClockFormat,
    is_first: bool,
    /// Days since that of the first row, if rows have times of day, and the last time, with these days.
    days: f64,
    last_read_s: Option<f64>,
}

/// Format of the times of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ClockFormat {
    /// Numbers in the unit of the map.
    Stated,
    /// Numbers in a detected unit, seconds before the first row.
    Unit(&'static str),
    Iso,
}

impl Clock {
    pub(super) fn find(names: &CsvRow<'_>, time: &TimeSpec) -> Result<Self, RecordingError> {
        let column = match time {
            TimeSpec::Clock(clock) => {
                CsvColumn::find(names, &clock.column, TimeUnit::column_unit(clock.unit))
            }
            TimeSpec::Frames(frames) => {
                let unit = ColumnUnit::Frames(1.0 / frames.rate_hz);
                CsvColumn::find(names, &frames.column, unit)
            }
        }?;
        let format = match time {
            // Times in seconds may count from 1970, in a smaller unit.
            TimeSpec::Clock(ClockSpec { unit: None, .. })
                if column.unit_in_name.is_none_or(|unit| unit == "s") =>
            {
                ClockFormat::Unit("s")
            }
            _ => ClockFormat::Stated,
        };
        Ok(Self {
            column,
            last_s: None,
            not_later: None,
            restarts: None,
            format,
            is_first: true,
            days: 0.0,
            last_read_s: None,
        })
    }

    /// Returns the format that the first row shows, unless the map states the unit.
    pub(super) fn detected(&self) -> Option<&'static str> {
        match self.format {
            ClockFormat::Unit(unit) => Some(unit),
            ClockFormat::Iso => Some("ISO 8601 time stamps"),
            _ => None,
        }
    }

    /// Detects the format by the first row.
    fn detect(&mut self, row: &CsvRow<'_>) -> Result<(), RecordingError> {
        if parse_iso_s(row.text(self.column.index)).is_some() {
            self.format = ClockFormat::Iso;
        }
        if !matches!(self.format, ClockFormat::Unit(_)) {
            return Ok(());
        }
        // Times since 1970 are 1.7 x 10^9 s.
        let size = row.number(&self.column)?.unwrap_or(0.0).abs();
        let unit = match size {
            1e17.. => TimeUnit::Nanoseconds,
            1e14.. => TimeUnit::Microseconds,
            1e11.. => TimeUnit::Milliseconds,
            _ => TimeUnit::Seconds,
        };
        self.column.factor = unit.seconds();
        self.format = ClockFormat::Unit(unit.name());
        Ok(())
    }

    /// Discards the last time, for a new event.
    pub(super) fn restart(&mut self) {
        self.last_s = None;
    }

    pub(super) fn read(&mut self, row: &CsvRow<'_>) -> Result<f64, RecordingError> {
        if mem::take(&mut self.is_first) {
            self.detect(row)?;
        }
        let text = row.text(self.column.index);
        if self.format == ClockFormat::Iso && !text.is_empty() {
            return match parse_iso_s(text) {
                Some(time_s) if is_time_of_day(text) => Ok(self.with_days_s(time_s)),
                Some(time_s) => Ok(time_s),
                None => row.reject(
                    &self.column.name,
                    ColumnProblem::NotATime {
                        found: excerpt(text),
                    },
                ),
            };
        }
        match row.number(&self.column)? {
            None => row.reject(&self.column.name, ColumnProblem::Empty),
            Some(time_s) if time_s.abs() > MAX_TIME_S => row.reject(
                &self.column.name,
                ColumnProblem::OutOfRange {
                    limit: MAX_TIME_S,
                    found: time_s,
                },
            ),
            Some(time_s) => Ok(time_s),
        }
    }

    /// Adds days to a time of day, or subtracts them, if rows pass midnight: the time is then at most an hour from that
    /// of the row before. Once a row is on another day, the others have the day that is nearest to the row before.
    fn with_days_s(&mut self, of_day_s: f64) -> f64 {
        let last_s = self.last_read_s.unwrap_or(of_day_s);
        let nearest = ((last_s - of_day_s) / DAY_S).round();
        let distance_s = (of_day_s + nearest * DAY_S - last_s).abs();
        if self.days != 0.0 || distance_s <= MAX_MIDNIGHT_STEP_S {
            self.days = nearest;
        }
        *self.last_read_s.insert(of_day_s + self.days * DAY_S)
    }

    /// Returns whether a row's time is so far before the last that another recording begins, and counts such places.
    pub(super) fn starts_anew(&mut self, row: &CsvRow<'_>, row_s: f64) -> bool {
        let Some(before_s) = self.last_s.filter(|last_s| row_s < last_s - MIN_RESTART_S) else {
            return false;
        };
        let before = format!(
            "{}: the time starts anew here ({} s after {} s); of ",
            self.column.name,
            format_number(row_s),
            format_number(before_s)
        );
        row.count(&mut self.restarts, || {
            Omission::counted(before, 0, " such places each begins another recording")
        });
        true
    }

    /// Returns whether a row's time is later than the last, and counts those that are not.
    pub(super) fn advance(&mut self, row: &CsvRow<'_>, row_s: f64) -> bool {
        if let Some(before_s) = self.last_s
            && round_to_milli(row_s) <= round_to_milli(before_s)
        {
            row.count(&mut self.not_later, || {
                let [row_s, before_s] = [row_s, before_s].map(format_number);
                let after = format!("{NOT_LATER} ({row_s} s after {before_s} s)");
                Omission::counted(format!("{}: ", self.column.name), 0, after)
            });
            return false;
        }
        self.last_s = Some(row_s);
        true
    }

    /// Moves the omissions of all rows to `dropped`.
    pub(super) fn report(&mut self, dropped: &mut Vec<DroppedItem>) {
        dropped.extend(self.not_later.take());
        dropped.extend(self.restarts.take());
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColumnQuantity {
    Speed,
    /// Speed along the road, of either sign.
    SignedSpeed,
    Gap,
    /// Length of a vehicle.
    Length,
    /// Unrestricted value: a difference or a position.
    Signed,
}

impl ColumnQuantity {
    pub(super) fn allows(self, value: f64) -> bool {
        self.excess(value) == 0.0
    }

    /// Returns how far a value is out of range; 0 within it.
    fn excess(self, value: f64) -> f64 {
        match self {
            Self::Speed if round_to_milli(value) < -STANDING_NOISE_MPS => -value,
            Self::Speed => (value - MAX_SPEED_MPS).max(0.0),
            Self::SignedSpeed => (value.abs() - MAX_SPEED_MPS).max(0.0),
            // A gap that rounds to 0 would be a collision in the scenario.
            Self::Gap if round_to_milli(value) <= 0.0 => 1e-3 - value,
            Self::Gap => (value - MAX_GAP_M).max(0.0),
            Self::Length => (LENGTH_RANGE_M[0] - value)
                .max(value - LENGTH_RANGE_M[1])
                .max(0.0),
            Self::Signed => 0.0,
        }
    }
}

/// Column under construction, with counts of missing and impossible values.
pub(super) struct Series {
    pub(super) column: CsvColumn,
    pub(super) values: Vec<Option<f64>>,
    /// Line of the first missing value, and number of missing values.
    missing: Option<(u64, usize)>,
    check: ValueCheck,
}

impl Series {
    pub(super) fn new(column: CsvColumn, quantity: ColumnQuantity) -> Self {
        Self {
            column,
            values: Vec::new(),
            missing: None,
            check: ValueCheck::new(quantity),
        }
    }

    /// Returns the row's value, if there is a possible one.
    pub(super) fn read(&mut self, row: &CsvRow<'_>) -> Result<Option<f64>, RecordingError> {
        self.read_minus(row, 0.0)
    }

    /// Returns the row's value minus `less`, such as a vehicle's length.
    pub(super) fn read_minus(
        &mut self,
        row: &CsvRow<'_>,
        less: f64,
    ) -> Result<Option<f64>, RecordingError> {
        let Some(value) = row.number(&self.column)?.map(|value| value - less) else {
            self.missing.get_or_insert((row.line, 0)).1 += 1;
            return Ok(None);
        };
        Ok(self.check.possible(row.line, value))
    }

    /// Adds missing and impossible values to `dropped`.
    pub(super) fn report(&self, path: &Path, rows: usize, dropped: &mut Vec<DroppedItem>) {
        if let Some((line, count)) = self.missing {
            let note = format!("{count} of {rows} values are missing, the first one here");
            dropped.push(note_on(path, line, &self.column.name, &note));
        }
        self.check.report(path, &self.column.name, dropped);
    }

    /// Checks that some value is possible, or all are missing.
    ///
    /// # Errors
    /// [`ColumnProblem::OnlyImpossible`] at the first impossible value.
    pub(super) fn ensure_possible(&self, path: &Path) -> Result<(), RecordingError> {
        match &self.check.impossible {
            Some(impossible) if impossible.count == self.check.count => {
                let problem = self.check.describe(impossible);
                Err(RecordingError::Line {
                    path: path.to_owned(),
                    line: impossible.first_line,
                    problem: LineProblem::Column {
                        column: self.column.name.clone(),
                        problem: ColumnProblem::OnlyImpossible(problem),
                    },
                })
            }
            _ => Ok(()),
        }
    }
}

fn note_on(path: &Path, line: u64, name: &str, note: &str) -> DroppedItem {
    DroppedItem {
        path: path.to_owned(),
        line,
        omission: Omission::Note(format!("{name}: {note}")),
    }
}

/// Check of the values of a column, or of values that follow from several columns, with counts of those to report.
pub(super) struct ValueCheck {
    quantity: ColumnQuantity,
    /// Number of values so far.
    count: usize,
    impossible: Option<ImpossibleValues>,
    /// Speeds against the direction of travel that count as 0.
    standing: Option<ImpossibleValues>,
    /// Line of the first unusual speed, and the largest speed.
    unusual: Option<(u64, f64)>,
}

struct ImpossibleValues {
    first_line: u64,
    last_line: u64,
    count: usize,
    worst: f64,
}

impl ImpossibleValues {
    fn add(values: &mut Option<Self>, line: u64, value: f64, is_worse: impl Fn(f64, f64) -> bool) {
        let values = values.get_or_insert(Self {
            first_line: line,
            last_line: line,
            count: 0,
            worst: value,
        });
        values.last_line = line;
        values.count += 1;
        if is_worse(value, values.worst) {
            values.worst = value;
        }
    }
}

impl ValueCheck {
    pub(super) fn new(quantity: ColumnQuantity) -> Self {
        Self {
            quantity,
            count: 0,
            impossible: None,
            standing: None,
            unusual: None,
        }
    }

    /// Returns the value of a line, if it is possible. A standing vehicle has the speed 0.
    pub(super) fn possible(&mut self, line: u64, value: f64) -> Option<f64> {
        let quantity = self.quantity;
        self.count += 1;
        if !quantity.allows(value) {
            ImpossibleValues::add(&mut self.impossible, line, value, |one, other| {
                quantity.excess(one) > quantity.excess(other)
            });
            return None;
        }
        let is_speed = matches!(
            quantity,
            ColumnQuantity::Speed | ColumnQuantity::SignedSpeed
        );
        if is_speed && value.abs() > MAX_USUAL_SPEED_MPS {
            let unusual = self.unusual.get_or_insert((line, 0.0));
            unusual.1 = unusual.1.max(value.abs());
        }
        if quantity != ColumnQuantity::Speed {
            return Some(value);
        }
        if round_to_milli(value) < 0.0 {
            ImpossibleValues::add(&mut self.standing, line, value, |one, other| one < other);
        }
        Some(value.max(0.0))
    }

    /// Adds what a user should know about the values of the column `name` to `dropped`.
    pub(super) fn report(&self, path: &Path, name: &str, dropped: &mut Vec<DroppedItem>) {
        if let Some((line, largest_mps)) = self.unusual {
            let largest_mps = format_fixed(largest_mps, 1);
            let note = format!("speeds up to {largest_mps} m/s, {CHECK_UNIT}");
            dropped.push(note_on(path, line, name, &note));
        }
        if let Some(standing) = &self.standing {
            let note = standing_note(standing.count, standing.worst);
            dropped.push(note_on(path, standing.first_line, name, &note));
        }
        if let Some(impossible) = &self.impossible {
            let note = self.describe(impossible);
            dropped.push(note_on(path, impossible.first_line, name, &note));
        }
    }

    fn describe(&self, impossible: &ImpossibleValues) -> String {
        let ImpossibleValues {
            last_line,
            count,
            worst,
            ..
        } = impossible;
        let all = if *count == self.count {
            ", and no possible one: its sign or unit is probably wrong"
        } else {
            ""
        };
        let plural = match self.quantity {
            ColumnQuantity::Gap => "spacings",
            ColumnQuantity::Length => "lengths",
            _ => "speeds",
        };
        let unit = match self.quantity {
            ColumnQuantity::Gap | ColumnQuantity::Length => "m",
            _ => "m/s",
        };
        format!(
            "{count} impossible {plural}, the first one here, the last one on line {last_line}, the worst {} {unit}\
             {all}",
            format_number(*worst)
        )
    }
}

/// Describes speeds against the direction of travel that count as 0.
pub(super) fn standing_note(count: usize, worst_mps: f64) -> String {
    let worst_mps = format_fixed(worst_mps, 3);
    let verb = if count == 1 { "counts" } else { "count" };
    let plural = if count == 1 { "" } else { "s" };
    format!(
        "{count} speed{plural} below 0, down to {worst_mps} m/s, {verb} as 0 (a standing vehicle), the first one here"
    )
}

/// Interpolates holes of at most `longest_s` seconds. Returns the number of new values and the first such sample.
pub(super) fn interpolate_holes(
    values: &mut [Option<f64>],
    time_s: &[f64],
    longest_s: f64,
) -> Option<(usize, usize)> {
    let mut before = None;
    let mut filled = None;
    for after in 0..values.len() {
        let Some(&to_s) = time_s.get(after) else {
            continue;
        };
        let Some(&Some(to)) = values.get(after) else {
            continue;
        };
        if let Some((from, from_s, value)) = before.replace((after, to_s, to))
            && to_s - from_s <= longest_s + 1e-9
        {
            for hole in from + 1..after {
                let share = time_s
                    .get(hole)
                    .map_or(0.0, |at_s| (at_s - from_s) / (to_s - from_s));
                if let Some(missing) = values.get_mut(hole) {
                    *missing = Some(value + (to - value) * share);
                    filled.get_or_insert((0, hole)).0 += 1;
                }
            }
        }
    }
    filled
}
