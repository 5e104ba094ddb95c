//! Resamples that are divided over shards.
//!
//! The spaces fitted to resamples come in an order that the seed alone decides, and everybody who has the space can fit them again. A shard
//! makes the new runs in some of them, and keeps what came of each; whoever has all of that asks for the same spaces, and has the answers.

use std::ops::Range;

/// Which of so many resamples belong to some of `all` parts of the work: those of parts that follow each other follow each other, too,
/// however the parts are divided.
pub(crate) fn resample_range(resamples: u32, parts: &Range<u64>, all: u64) -> Range<u64> {
    // No larger than the number of resamples.
    let before = |part: u64| (u128::from(part) * u128::from(resamples)).div_ceil(u128::from(all.max(1))) as u64;
    before(parts.start)..before(parts.end)
}

/// The resamples of a shard, while they are gone through.
pub(crate) struct ResampleShard<T> {
    range: Range<u64>,
    next: u64,
    results: Vec<T>,
}

impl<T: Clone> ResampleShard<T> {
    pub(crate) fn new(own: Range<u64>) -> Self {
        Self { range: own, next: 0, results: Vec::new() }
    }

    /// What comes of the next one: found out if it is one of its own, and `none` otherwise.
    pub(crate) fn next<E>(&mut self, none: T, find: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        let is_own = self.range.contains(&self.next);
        self.next += 1;
        if !is_own {
            return Ok(none);
        }
        let found = find()?;
        self.results.push(found.clone());
        Ok(found)
    }

    /// What came of its own, in order.
    pub(crate) fn into_results(self) -> Vec<T> {
        self.results
    }
}

/// What shards kept of their resamples, in order.
pub(crate) struct MergedResamples<T> {
    results: std::vec::IntoIter<T>,
}

/// There are more or fewer of them than the space has.
#[derive(Debug)]
pub(crate) struct ResampleCountMismatch;

impl<T> MergedResamples<T> {
    pub(crate) fn new(kept: Vec<T>) -> Self {
        Self { results: kept.into_iter() }
    }

    /// What came of the next one.
    pub(crate) fn next(&mut self) -> Result<T, ResampleCountMismatch> {
        self.results.next().ok_or(ResampleCountMismatch)
    }

    /// Whether all were asked for.
    pub(crate) fn finish(self) -> Result<(), ResampleCountMismatch> {
        if self.results.len() == 0 { Ok(()) } else { Err(ResampleCountMismatch) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Whatever the division, parts that follow each other have resamples that do, and together they have all.
        #[test]
        fn resamples_are_divided_as_the_parts_are(
            resamples in 0..2000_u32,
            mut cuts in prop::collection::vec(0..10_000_u64, 0..20),
        ) {
            cuts.sort_unstable();
            let ends: Vec<u64> = [0].into_iter().chain(cuts).chain([10_000]).collect();
            let mut end = 0;
            for pair in ends.windows(2) {
                let own = resample_range(resamples, &(pair[0]..pair[1]), 10_000);
                prop_assert_eq!(own.start, end);
                end = own.end;
            }
            prop_assert_eq!(end, u64::from(resamples));
        }
    }
}
