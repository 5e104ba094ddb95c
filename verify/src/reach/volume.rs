//! Volume shares of the cells of a box. Counting cuts is not enough: in a range of a few floating-point numbers the
//! middle is rounded.

use super::{InitialRanges, PartitionCell, ReachClaim};
use crate::Rejection;
use crate::interval::Interval;

impl ReachClaim {
    /// Returns lower bounds of the volume shares of verified and of falsified cells.
    ///
    /// # Errors
    /// [`Rejection`] if the cuts do not make a partition.
    pub fn volume_shares(&self) -> Result<[f64; 2], Rejection> {
        let leaves = self.leaves()?;
        if leaves
            .iter()
            .all(|(cell, ..)| *cell == PartitionCell::Verified)
        {
            return Ok([1.0, 0.0]);
        }
        let of = |sums: [f64; 2], (cell, _, share): (PartitionCell, InitialRanges, f64)| match cell
        {
            PartitionCell::Verified => [add_shares(sums[0], share), sums[1]],
            PartitionCell::Falsified(_) => [sums[0], add_shares(sums[1], share)],
            PartitionCell::Undecided | PartitionCell::Cut(_) => sums,
        };
        Ok(leaves.into_iter().fold([0.0; 2], of))
    }
}

/// Bounds from below the volume share of a part of a bisected cell with share `share`, rounding of the middle included.
pub(super) fn part_share(share: f64, part: Interval, whole: Interval) -> f64 {
    // Exact width: the rounded number and its rounding error.
    let width = |range: Interval| {
        let (high, low) = (range.high(), -range.low());
        let sum = high + low;
        let of_low = sum - high;
        (sum, (high - (sum - of_low)) + (low - of_low))
    };
    let (of_part, of_whole) = (width(part), width(whole));
    if of_part == (0.5 * of_whole.0, 0.5 * of_whole.1) {
        return 0.5 * share;
    }
    let size = |range: Interval| Interval::point(range.high()) - Interval::point(range.low());
    (Interval::point(share) * size(part).over(size(whole)))
        .low()
        .clamp(0.0, share)
}

/// Adds two shares, rounded down unless exact.
fn add_shares(a: f64, b: f64) -> f64 {
    let sum = a + b;
    let of_b = sum - a;
    let lost = (a - (sum - of_b)) + (b - of_b);
    if lost < 0.0 { sum.next_down() } else { sum }
}

#[cfg(test)]
mod tests;
