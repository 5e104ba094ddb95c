//! Rows of signals with several clocks: at the times of the spacings or positions, with all others interpolated.

use super::error::BinaryProblem;
use super::limits;
use super::map::{ColumnRole, RecordingMapSpec, TimeSpec};
use super::mdf::{MdfError, Signal, SignalStream};
use super::table::BinaryRows;
use super::text_rows::Fields;

/// Largest interval between two values that are interpolated, in seconds.
const MAX_INTERVAL_S: f64 = 0.5;

pub(super) struct ResampledSignals {
    stream: SignalStream,
    /// Clock of the rows, and number of the next row.
    base: usize,
    row: usize,
    /// Number of rows that the file may still have.
    rows_left: u64,
    /// Time of the row before, in seconds.
    row_s: Option<f64>,
    /// Index of the last time of each clock that is not after the row.
    last: Vec<usize>,
    /// True for each signal that is an id, whose value holds until the next one.
    is_id: Vec<bool>,
    /// Size of the map's unit of time in seconds, if its column stands for the clocks.
    time_unit_s: Option<f64>,
}

impl ResampledSignals {
    /// Creates the rows at the times of the first spacing or position of the map.
    pub(super) fn new(stream: SignalStream, map: &RecordingMapSpec) -> Self {
        let roles: Vec<Option<ColumnRole>> = stream
            .set
            .signals
            .iter()
            .map(|signal| map.column_role(&signal.name))
            .collect();
        let spacing = roles
            .iter()
            .position(|role| role.is_some_and(|role| role.is_spacing));
        Self {
            base: spacing.map_or(0, |spacing| stream.set.signals[spacing].clock),
            row: 0,
            rows_left: limits::max_rows(stream.file_bytes()),
            row_s: None,
            last: vec![0; stream.set.clocks_s.len()],
            is_id: roles
                .into_iter()
                .map(|role| role.is_some_and(|role| role.is_id))
                .collect(),
            time_unit_s: match &map.time {
                TimeSpec::Clock(clock) => Some(clock.unit.map_or(1.0, |unit| unit.seconds())),
                TimeSpec::Frames(_) => None,
            },
            stream,
        }
    }

    /// Returns the names of the columns. The time of the map stands for the clocks of the groups.
    pub(super) fn names(&self, map: &RecordingMapSpec) -> Fields {
        let time = match &map.time {
            TimeSpec::Clock(clock) => Some(clock.column.as_str()),
            TimeSpec::Frames(_) => None,
        };
        let signals = self.stream.set.signals.iter();
        time.into_iter()
            .chain(signals.map(|signal| signal.name.as_str()))
            .collect()
    }

    /// Returns the units of the columns.
    pub(super) fn units(&self) -> Fields {
        let signals = self.stream.set.signals.iter();
        self.time_unit_s
            .map(|_| "")
            .into_iter()
            .chain(signals.map(|signal| signal.unit.as_str()))
            .collect()
    }

    /// Returns the value of a signal at a time, between the last time of its clock that is not later and the next.
    fn value(&self, signal: &Signal, is_id: bool, at_s: f64) -> f64 {
        let last = self.last.get(signal.clock).copied().unwrap_or(0);
        let [before, after] = [last, last + 1].map(|index| {
            Some((
                *self.stream.set.clocks_s.get(signal.clock)?.get(index)?,
                *signal.values.get(index)?,
            ))
        });
        match (before, after) {
            (Some((time_s, value)), _) if time_s == at_s => value,
            (Some((time_s, value)), _)
                if is_id && (0.0..=MAX_INTERVAL_S).contains(&(at_s - time_s)) =>
            {
                value
            }
            (Some((from_s, from)), Some((to_s, to))) if (from_s..to_s).contains(&at_s) => {
                let interval_s = to_s - from_s;
                if is_id || interval_s > MAX_INTERVAL_S {
                    f64::NAN
                } else {
                    from + (to - from) / interval_s * (at_s - from_s)
                }
            }
            _ => f64::NAN,
        }
    }
}

impl ResampledSignals {
    /// Returns the time of the next row, and reads all values until then and [`MAX_INTERVAL_S`] longer.
    fn next_time_s(&mut self) -> Result<Option<f64>, BinaryProblem> {
        loop {
            if let Some(at_s) = self.row_time_s()
                && self.is_read_around(at_s)
            {
                self.row_s = Some(at_s);
                return Ok(self.row_s);
            }
            if self.stream.is_full() {
                self.forget_earlier_values();
            }
            loop {
                if !self.stream.advance()? {
                    self.stream.check_frames()?;
                    return Ok(self.row_time_s());
                }
                if self.stream.is_full() {
                    break;
                }
            }
        }
    }

    /// Returns the time of the next row, if it was read.
    fn row_time_s(&self) -> Option<f64> {
        let clock_s = self.stream.set.clocks_s.get(self.base)?;
        clock_s.get(self.row).copied()
    }

    /// Returns whether all values until a time, and [`MAX_INTERVAL_S`] longer, were read.
    fn is_read_around(&self, at_s: f64) -> bool {
        self.stream
            .read_until_s()
            .is_none_or(|until_s| until_s > at_s + MAX_INTERVAL_S)
    }

    /// Removes values before the row, which are not needed any more.
    fn forget_earlier_values(&mut self) {
        let mut counts = self.last.clone();
        if let Some(count) = counts.get_mut(self.base) {
            *count = self.row.saturating_sub(1).min(*count);
        }
        // Values are moved in memory, so few of them are not worth it.
        for (count, clock) in counts.iter_mut().zip(&self.stream.set.clocks_s) {
            *count = if *count * 4 < clock.len() { 0 } else { *count };
        }
        self.row -= counts.get(self.base).copied().unwrap_or(0);
        self.stream.set.forget(&counts, self.row_s);
        self.last
            .iter_mut()
            .zip(counts)
            .for_each(|(last, count)| *last -= count);
    }
}

impl BinaryRows for ResampledSignals {
    fn next_row(
        &mut self,
        texts: &mut Fields,
        numbers: &mut Vec<f64>,
    ) -> Result<bool, BinaryProblem> {
        let Some(at_s) = self.next_time_s()? else {
            return Ok(false);
        };
        self.row += 1;
        let limit = limits::max_rows(self.stream.file_bytes());
        let too_large = MdfError::TooLarge {
            limit,
            what: "rows, one for each spacing or position",
        };
        self.rows_left = self.rows_left.checked_sub(1).ok_or(too_large)?;
        for (last, times_s) in self.last.iter_mut().zip(&self.stream.set.clocks_s) {
            while times_s.get(*last + 1).is_some_and(|next_s| *next_s <= at_s) {
                *last += 1;
            }
        }
        // A clock that starts anew has later times before the next row.
        if let Some(last) = self.last.get_mut(self.base) {
            *last = self.row - 1;
        }
        if let Some(unit_s) = self.time_unit_s {
            texts.push_field("");
            numbers.push(at_s / unit_s);
        }
        for (signal, &is_id) in self.stream.set.signals.iter().zip(&self.is_id) {
            let value = self.value(signal, is_id, at_s);
            texts.push_field(&if is_id && value.is_finite() {
                value.to_string()
            } else {
                String::new()
            });
            numbers.push(value);
        }
        Ok(true)
    }
}
