//! Rows of signals with several clocks: at the times of the spacings or positions, with all others interpolated.

use csv::StringRecord;

use super::error::BinaryProblem;
use super::map::{RecordingMapSpec, TimeSpec};
use super::mdf::{Signal, SignalSet};
use super::table::BinaryRows;

/// Largest interval between two values that are interpolated, in seconds.
const MAX_INTERVAL_S: f64 = 0.5;

pub(super) struct ResampledSignals {
    signals: SignalSet,
    /// Clock of the rows, and number of the next row.
    base: usize,
    row: usize,
    /// Index of the last time of each clock that is not after the row.
    last: Vec<usize>,
    /// True for each signal that is an id, whose value holds until the next one.
    is_id: Vec<bool>,
    /// Size of the map's unit of time in seconds, if its column stands for the clocks.
    time_unit_s: Option<f64>,
}

impl ResampledSignals {
    /// Returns the rows with the names of the columns. The time of the map stands for the clocks of the groups.
    pub(super) fn new(signals: SignalSet, map: &RecordingMapSpec) -> (Self, StringRecord) {
        let is_base = |signal: &&Signal| map.column_role(&signal.name).is_some_and(|role| role.is_spacing);
        let base = signals.signals.iter().find(is_base).map_or(0, |signal| signal.clock);
        let is_id =
            signals.signals.iter().map(|one| map.column_role(&one.name).is_some_and(|role| role.is_id)).collect();
        let (time, time_unit_s) = match &map.time {
            TimeSpec::Clock(clock) => (Some(clock.column.as_str()), Some(clock.unit.map_or(1.0, |unit| unit.factor()))),
            TimeSpec::Frames(_) => (None, None),
        };
        let names = time.into_iter().chain(signals.signals.iter().map(|signal| signal.name.as_str())).collect();
        let last = vec![0; signals.clocks_s.len()];
        (Self { signals, base, row: 0, last, is_id, time_unit_s }, names)
    }

    /// Returns the value of a signal at a time, between the last time of its clock that is not later and the next.
    fn value(&self, signal: &Signal, is_id: bool, at_s: f64) -> f64 {
        let last = self.last.get(signal.clock).copied().unwrap_or(0);
        let sample =
            |index: usize| Some((*self.signals.clocks_s.get(signal.clock)?.get(index)?, *signal.values.get(index)?));
        match (sample(last), sample(last + 1)) {
            (Some((time_s, value)), _) if time_s == at_s => value,
            (Some((time_s, value)), _) if is_id && (0.0..=MAX_INTERVAL_S).contains(&(at_s - time_s)) => value,
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

impl BinaryRows for ResampledSignals {
    fn next_row(&mut self, texts: &mut StringRecord, numbers: &mut Vec<f64>) -> Result<bool, BinaryProblem> {
        let Some(&at_s) = self.signals.clocks_s.get(self.base).and_then(|clock| clock.get(self.row)) else {
            return Ok(false);
        };
        self.row += 1;
        for (last, times_s) in self.last.iter_mut().zip(&self.signals.clocks_s) {
            while times_s.get(*last + 1).is_some_and(|next_s| *next_s <= at_s) {
                *last += 1;
            }
        }
        if let Some(unit_s) = self.time_unit_s {
            texts.push_field("");
            numbers.push(at_s / unit_s);
        }
        for (signal, &is_id) in self.signals.signals.iter().zip(&self.is_id) {
            let value = self.value(signal, is_id, at_s);
            texts.push_field(&if is_id && value.is_finite() { value.to_string() } else { String::new() });
            numbers.push(value);
        }
        Ok(true)
    }
}
