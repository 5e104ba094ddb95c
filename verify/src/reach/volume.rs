//! Which share of a box's volume its parts have: counting cuts would do if every cut were one in equal halves, and the middle of a range
//! of a few floating-point numbers is far from that.

use super::{InitialRanges, PartitionCell, ReachClaim};
use crate::Rejection;
use crate::interval::Interval;

impl ReachClaim {
    /// Lower bounds of the shares of the box's volume that are said to be verified, and that are in cells said to be falsified.
    ///
    /// # Errors
    /// [`Rejection`] if the cuts do not make a partition.
    pub fn volume_shares(&self) -> Result<[f64; 2], Rejection> {
        let leaves = self.leaves()?;
        // All of the box, whatever rounding has taken from its parts.
        if leaves.iter().all(|(cell, ..)| *cell == PartitionCell::Verified) {
            return Ok([1.0, 0.0]);
        }
        let of = |sums: [f64; 2], (cell, _, share): (PartitionCell, InitialRanges, f64)| match cell {
            PartitionCell::Verified => [add_shares(sums[0], share), sums[1]],
            PartitionCell::Falsified(_) => [sums[0], add_shares(sums[1], share)],
            PartitionCell::Undecided | PartitionCell::Cut(_) => sums,
        };
        Ok(leaves.into_iter().fold([0.0; 2], of))
    }
}

/// A lower bound of the share of the volume of what was cut that one part has, if the whole has `share`. Cuts are in the middle but
/// for its rounding, which in a range of a few floating-point numbers is all there is.
pub(super) fn part_share(share: f64, part: Interval, whole: Interval) -> f64 {
    // The width as a rounded number and what rounding has lost, which together are exact.
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
    (Interval::point(share) * size(part).over(size(whole))).low().clamp(0.0, share)
}

/// A lower bound of the sum of two shares, exact where the sum does not round.
fn add_shares(a: f64, b: f64) -> f64 {
    let sum = a + b;
    let of_b = sum - a;
    let lost = (a - (sum - of_b)) + (b - of_b);
    if lost < 0.0 { sum.next_down() } else { sum }
}

#[cfg(test)]
mod tests;
