//! Consistency of the columns of pairs.

use std::iter;

use super::consistency::Hypothesis;
use super::dropped::DroppedItem;
use super::error::RecordingError;
use super::map::{LengthUnit, SpeedUnit};
use super::pairs::EventReader;
use super::series::Series;
use super::table::RowReader;

/// Name of a column, and size of its unit.
type ColumnAndUnit<'s> = (&'s str, f64);

impl EventReader<'_> {
    /// Compares the closing speed with both speeds, and the gap with the closing speed.
    pub(super) fn check(
        &mut self,
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        let speeds = [&self.leader, &self.follower].map(column_and_unit);
        let relative = column_and_unit(&self.relative);
        self.check_closing_speed(relative, speeds, table, dropped)?;
        self.check_gap(relative, speeds, table, dropped)?;
        let [_, (follower, _)] = speeds;
        match &mut self.behind {
            Some(behind) => {
                let time = (self.map, self.clock.column.factor);
                behind.check(follower, time, table, dropped)
            }
            None => Ok(()),
        }
    }

    /// Compares the relative speed with the speeds of leader and follower.
    fn check_closing_speed(
        &self,
        (relative, relative_unit): ColumnAndUnit<'_>,
        speeds: [ColumnAndUnit<'_>; 2],
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        let [(leader, _), (follower, _)] = speeds;
        let difference = format!("{leader} - {follower}");
        let units = (SpeedUnit::ALL, relative_unit);
        let hypotheses: Vec<_> = iter::once(Hypothesis {
            factors: [-1.0, 1.0, 1.0],
            ..Hypothesis::opposite_sign(relative)
        })
        .chain(Hypothesis::units(relative, units, [true, false, false]))
        .chain(Hypothesis::speeds(speeds, &difference))
        .collect();
        self.closing.check(
            table,
            relative,
            [relative, &difference],
            (&hypotheses, dropped),
        )?;
        Ok(())
    }

    /// Compares the change of the gap with the relative speed, or with the difference of both speeds.
    fn check_gap(
        &self,
        (relative, relative_unit): ColumnAndUnit<'_>,
        speeds: [ColumnAndUnit<'_>; 2],
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        let [(leader, _), (follower, _)] = speeds;
        let difference = format!("{leader} - {follower}");
        let has_relative = self.relative.is_some();
        let mut hypotheses = Vec::new();
        if has_relative {
            let units = (SpeedUnit::ALL, relative_unit);
            hypotheses.push(Hypothesis::opposite_sign(relative));
            hypotheses.extend(Hypothesis::units(relative, units, [false, true, true]));
        } else {
            hypotheses.push(Hypothesis {
                factors: [1.0, -1.0, -1.0],
                reason: format!("{leader} and {follower} look exchanged"),
            });
            hypotheses.extend(Hypothesis::speeds(speeds, &difference));
        }
        let gap = &self.gap.column;
        let gap_units = (LengthUnit::ALL, gap.factor);
        hypotheses.extend(Hypothesis::units(
            &gap.name,
            gap_units,
            [true, false, false],
        ));
        hypotheses.extend(Hypothesis::times(&self.map.time, self.clock.column.factor));
        let stated = if has_relative { relative } else { &difference };
        let change = format!("the change of {}", gap.name);
        self.gap_change
            .check(table, stated, [&change, stated], (&hypotheses, dropped))?;
        Ok(())
    }
}

/// Returns name and unit of a column of speeds; an empty name if there is no such column.
pub(super) fn column_and_unit(series: &Option<Series>) -> ColumnAndUnit<'_> {
    match series {
        Some(series) => (series.column.name.as_str(), series.column.factor.abs()),
        None => ("", 1.0),
    }
}
