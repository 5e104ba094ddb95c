//! Consistency of the columns of pairs.

use std::iter;

use super::consistency::Hypothesis;
use super::dropped::DroppedItem;
use super::error::RecordingError;
use super::map::{LengthUnit, SpeedUnit};
use super::pairs::EventReader;
use super::series::Series;
use super::table::RowReader;

impl EventReader<'_> {
    /// Compares the closing speed with both speeds, and the gap with the closing speed.
    pub(super) fn check(
        &self,
        table: &RowReader<'_>,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        let name = |series: &Option<Series>| {
            series
                .as_ref()
                .map_or("", |one| &one.column.name)
                .to_owned()
        };
        let (leader, follower, relative) = (
            name(&self.leader),
            name(&self.follower),
            name(&self.relative),
        );
        let difference = format!("{leader} - {follower}");
        let units =
            |terms, column, given| Hypothesis::units(column, (SpeedUnit::ALL, given), terms);
        let unit =
            |series: &Option<Series>| series.as_ref().map_or(1.0, |one| one.column.factor.abs());
        let [leader_unit, follower_unit, relative_unit] =
            [&self.leader, &self.follower, &self.relative].map(unit);
        let of_speeds = || {
            Hypothesis::speeds(
                [(&leader, leader_unit), (&follower, follower_unit)],
                &difference,
            )
        };
        let flipped = |factors, reason| iter::once(Hypothesis { factors, reason });
        let wrong_sign = |factors| flipped(factors, format!("{relative} has the opposite sign"));
        let closing: Vec<_> = wrong_sign([-1.0, 1.0, 1.0])
            .chain(units([true, false, false], &relative, relative_unit))
            .chain(of_speeds())
            .collect();
        self.closing.check(
            table,
            &relative,
            [&relative, &difference],
            (&closing, dropped),
        )?;
        let gap = &self.gap.column;
        let common = Hypothesis::units(
            &gap.name,
            (LengthUnit::ALL, gap.factor),
            [true, false, false],
        )
        .chain(Hypothesis::times(
            &self.spec.0.time,
            self.clock.column.factor,
        ));
        let (stated, hypotheses): (_, Vec<_>) = if self.relative.is_some() {
            let of_relative = units([false, true, true], &relative, relative_unit);
            (
                &relative,
                wrong_sign([1.0, -1.0, -1.0])
                    .chain(of_relative)
                    .chain(common)
                    .collect(),
            )
        } else {
            let exchanged = flipped(
                [1.0, -1.0, -1.0],
                format!("{leader} and {follower} look exchanged"),
            );
            (
                &difference,
                exchanged.chain(of_speeds()).chain(common).collect(),
            )
        };
        let change = format!("the change of {}", gap.name);
        self.gap_change
            .check(table, stated, [&change, stated], (&hypotheses, dropped))?;
        Ok(())
    }
}
