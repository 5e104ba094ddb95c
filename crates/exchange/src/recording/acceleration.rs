//! Consistency of recorded accelerations with the speeds that they change. Nothing else uses them.

use super::consistency::{Comparison, Hypothesis};
use super::dropped::DroppedItem;
use super::error::RecordingError;
use super::map::{AccelerationUnit, SpeedSpec};
use super::series::{ColumnQuantity, Series};
use super::table::{CsvColumn, CsvRow, RowReader};

/// Column of accelerations, compared with a column of speeds.
pub(super) struct AccelerationCheck {
    pub(super) series: Series,
    comparison: Comparison,
    speed: String,
}

impl AccelerationCheck {
    /// Returns the check of a speed whose acceleration the map names.
    pub(super) fn find(
        names: &CsvRow<'_>,
        speed: &SpeedSpec,
    ) -> Result<Option<Self>, RecordingError> {
        let Some(acceleration) = &speed.acceleration else {
            return Ok(None);
        };
        let column = CsvColumn::find(
            names,
            &acceleration.column,
            AccelerationUnit::column_unit(acceleration.unit),
        )?;
        let series = Series::new(column, ColumnQuantity::Signed);
        Ok(Some(Self {
            series,
            comparison: Comparison::for_speeds(),
            speed: speed.column.clone(),
        }))
    }

    /// Ends the current comparison, for another vehicle.
    pub(super) fn restart(&mut self) {
        self.comparison.restart();
    }

    pub(super) fn add(
        &mut self,
        at: (f64, u64),
        speed_mps: Option<f64>,
        acceleration_mps2: Option<f64>,
    ) {
        self.comparison
            .add(at, speed_mps, acceleration_mps2.map(|mps2| [mps2, 0.0]));
    }

    /// Checks what was added, and forgets it.
    pub(super) fn check(
        &mut self,
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        let column = &self.series.column;
        let sign = Hypothesis {
            factors: [1.0, -1.0, 1.0],
            reason: format!("{} has the opposite sign", column.name),
        };
        let units = Hypothesis::units(
            &column.name,
            (AccelerationUnit::ALL, column.factor),
            [false, true, false],
        );
        let hypotheses: Vec<_> = std::iter::once(sign).chain(units).collect();
        let change = format!("the change of {}", self.speed);
        let comparison = std::mem::replace(&mut self.comparison, Comparison::for_speeds());
        comparison.check(
            table,
            &column.name,
            [&change, &column.name],
            (&hypotheses, dropped),
        )?;
        Ok(())
    }
}
