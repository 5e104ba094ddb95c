//! Share of a region that a set contains.

use super::InvariantClaim;
use super::table::{HeightTable, TableAxis};
use crate::Rejection;
use crate::interval::Interval;

impl InvariantClaim {
    /// Returns a lower bound of the set's share of the region's volume.
    ///
    /// # Errors
    /// [`Rejection`] if the region is invalid.
    pub fn share(&self, table: &HeightTable) -> Result<f64, Rejection> {
        let point = Interval::point;
        let [own, leader] = self.axes;
        let is_line = self.region_is_line();
        self.check_region(is_line)?;
        let own_region = [
            self.region_own_mps[0],
            self.region_own_mps[1].min(self.initial_own_mps_at_most),
        ];
        let mut volume = Interval::ZERO;
        for i in 0..own.cells as usize {
            let Some(own_width) = width_inside(own, i, own_region) else {
                continue;
            };
            for j in 0..(leader.cells as usize).max(1) {
                let leader_width = if is_line {
                    Some(Interval::ONE)
                } else {
                    width_inside(leader, j, self.region_leader_mps)
                };
                let Some(leader_width) = leader_width else {
                    continue;
                };
                let depth = point(self.region_gap_m) - table.mean_height([i, j]);
                volume += depth.max(Interval::ZERO) * own_width * leader_width;
            }
        }
        let [own_width, leader_width] =
            [self.region_own_mps, self.region_leader_mps].map(|[low, high]| {
                if low == high {
                    Interval::ONE
                } else {
                    point(high) - point(low)
                }
            });
        Ok(volume
            .over(point(self.region_gap_m) * own_width * leader_width)
            .low()
            .max(0.0))
    }

    /// True if the region has a single speed of the leader, that of the table.
    fn region_is_line(&self) -> bool {
        let leader = self.axes[1];
        let [low, high] = self.region_leader_mps;
        leader.cells == 0 && high - low == 0.0 && low == leader.low
    }

    fn check_region(&self, is_line: bool) -> Result<(), Rejection> {
        let [own_width, leader_width] =
            [self.region_own_mps, self.region_leader_mps].map(|[low, high]| high - low);
        let is_region = self.region_gap_m > 0.0 && self.region_gap_m.is_finite() && own_width > 0.0;
        if is_region
            && own_width.is_finite()
            && (is_line || leader_width > 0.0 && leader_width.is_finite())
        {
            Ok(())
        } else {
            Err(Rejection::invalid(
                "region_gap_m",
                "must be positive and finite, and the speeds of the region must increase",
            ))
        }
    }
}

/// Returns the width of a cell, or `None` if it is not entirely within a range.
fn width_inside(axis: TableAxis, index: usize, [low, high]: [f64; 2]) -> Option<Interval> {
    let range = axis.cell(index);
    (range.low() >= low && range.high() <= high)
        .then(|| Interval::point(range.high()) - Interval::point(range.low()))
}
