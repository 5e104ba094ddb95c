//! Columns of the vehicle behind in recordings of pairs.

use super::consistency::{Comparison, Hypothesis};
use super::dropped::DroppedItem;
use super::error::RecordingError;
use super::map::{BehindSpec, LengthUnit, RecordingMapSpec, SpeedUnit};
use super::pairs::{find_relative_speed, find_spacing, find_speed};
use super::series::{ColumnQuantity, Series, ValueCheck};
use super::table::{CsvRow, RowReader};

/// Columns of the gap to the vehicle behind and of its speed.
pub(super) struct BehindReader {
    /// Length of the follower that recorded spacings include, in metres.
    included_length_m: f64,
    gap: Series,
    speed: Option<Series>,
    relative: Option<Series>,
    /// Speeds that follow from the relative speed.
    derived: ValueCheck,
    /// Changes of the gap against the speeds that change it.
    comparison: Comparison,
}

/// Gap to the vehicle behind, and its speed, at one sample.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BehindState {
    pub(super) gap_m: Option<f64>,
    pub(super) speed_mps: Option<f64>,
}

impl BehindReader {
    pub(super) fn find(names: &CsvRow<'_>, spec: &BehindSpec) -> Result<Self, RecordingError> {
        Ok(Self {
            included_length_m: spec.length_m.unwrap_or(0.0),
            gap: find_spacing(names, &spec.spacing)?,
            speed: find_speed(names, spec.speed.as_ref())?,
            relative: find_relative_speed(names, spec.relative_speed.as_ref())?,
            derived: ValueCheck::new(ColumnQuantity::Speed),
            comparison: Comparison::default(),
        })
    }

    /// Reads a row, in which the vehicle ahead of this one has a speed, if known.
    pub(super) fn read(
        &mut self,
        row: &CsvRow<'_>,
        now_s: f64,
        ahead_mps: Option<f64>,
    ) -> Result<BehindState, RecordingError> {
        let gap_m = self.gap.read_minus(row, self.included_length_m)?;
        let (speed_mps, rates_mps) = match (&mut self.speed, &mut self.relative) {
            (Some(speed), _) => {
                let speed_mps = speed.read(row)?;
                let rates = ahead_mps.zip(speed_mps).map(|(ahead, own)| [ahead, -own]);
                (speed_mps, rates)
            }
            (None, Some(relative)) => {
                let relative_mps = relative.read(row)?;
                let speeds = ahead_mps.zip(relative_mps);
                let speed_mps = speeds.and_then(|(ahead, relative)| {
                    self.derived.possible(row.line, ahead - relative)
                });
                (speed_mps, relative_mps.map(|relative| [relative, 0.0]))
            }
            (None, None) => (None, None),
        };
        self.comparison.add((now_s, row.line), gap_m, rates_mps);
        Ok(BehindState { gap_m, speed_mps })
    }

    /// Begins another event.
    pub(super) fn restart(&mut self) {
        self.comparison.restart();
    }

    /// Adds missing and impossible values of all rows to `dropped`.
    ///
    /// # Errors
    /// [`RecordingError::Line`] for a column without a possible value: without the vehicle behind, no collision from
    /// behind could happen.
    pub(super) fn report(
        &self,
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        let columns = [Some(&self.gap), self.speed.as_ref(), self.relative.as_ref()];
        for series in columns.into_iter().flatten() {
            series.ensure_possible(table.path())?;
            series.report(table.path(), table.samples, dropped);
        }
        let name = "the speed of the vehicle behind";
        self.derived.report(table.path(), name, dropped);
        Ok(())
    }

    /// Compares the change of the gap with the speeds: of the follower, in the column `follower`, and of the vehicle
    /// behind it.
    pub(super) fn check(
        &mut self,
        follower: &str,
        (map, time_factor): (&RecordingMapSpec, f64),
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        let comparison = std::mem::take(&mut self.comparison);
        let ahead = match follower {
            "" => "the follower's speed",
            name => name,
        };
        let (stated, mut hypotheses) = match (&self.speed, &self.relative) {
            (Some(speed), _) => {
                let own = &speed.column;
                let units = (SpeedUnit::ALL, own.factor);
                let hypotheses = Hypothesis::units(&own.name, units, [false, false, true]);
                (format!("{ahead} - {}", own.name), hypotheses.collect())
            }
            (None, Some(relative)) => {
                let column = &relative.column;
                let units = (SpeedUnit::ALL, column.factor.abs());
                let opposite = Hypothesis::opposite_sign(&column.name);
                let hypotheses = std::iter::once(opposite)
                    .chain(Hypothesis::units(&column.name, units, [false, true, true]))
                    .collect();
                (column.name.clone(), hypotheses)
            }
            (None, None) => (String::new(), Vec::new()),
        };
        let gap = &self.gap.column;
        let gap_units = (LengthUnit::ALL, gap.factor);
        hypotheses.extend(Hypothesis::units(
            &gap.name,
            gap_units,
            [true, false, false],
        ));
        hypotheses.extend(Hypothesis::times(&map.time, time_factor));
        let change = format!("the change of {}", gap.name);
        comparison.check(table, &stated, [&change, &stated], (&hypotheses, dropped))?;
        Ok(())
    }
}
