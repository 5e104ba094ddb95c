//! Volume shares of the cells of a box. Counting cuts is not enough: in a range of a few floating-point numbers the
//! middle is rounded.

use super::{PartitionCell, ReachClaim};
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
        let mut verified = 0.0;
        let mut falsified = 0.0;
        for (cell, _, share) in leaves {
            match cell {
                PartitionCell::Verified => verified = add_shares(verified, share),
                PartitionCell::Falsified(_) => falsified = add_shares(falsified, share),
                PartitionCell::Undecided | PartitionCell::Cut(_) => {}
            }
        }
        Ok([verified, falsified])
    }
}

/// Bounds from below the volume share of a part of a bisected cell with share `share`, rounding of the middle included.
pub(super) fn part_share(share: f64, part: Interval, whole: Interval) -> f64 {
    if exact_width(part) == exact_width(whole).map(|number| 0.5 * number) {
        return 0.5 * share;
    }
    let [part_width, whole_width] =
        [part, whole].map(|range| Interval::point(range.high()) - Interval::point(range.low()));
    (Interval::point(share) * part_width.over(whole_width))
        .low()
        .clamp(0.0, share)
}

/// Returns the rounded width of a range, and its rounding error.
fn exact_width(range: Interval) -> [f64; 2] {
    let high = range.high();
    let low = -range.low();
    let sum = high + low;
    let of_low = sum - high;
    [sum, (high - (sum - of_low)) + (low - of_low)]
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
