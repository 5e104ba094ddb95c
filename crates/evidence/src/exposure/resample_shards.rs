//! Distribution of resamples over shards. The seed determines the order of the fitted spaces, which every machine can
//! fit again. A shard simulates some of them and saves the results; the merge repeats the fits and takes these results.

use std::ops::Range;

/// Returns the resamples of consecutive parts of the work, out of `all` parts. Consecutive parts have consecutive
/// resamples.
pub(crate) fn resample_range(resamples: u32, parts: &Range<u64>, all: u64) -> Range<u64> {
    let before = |part: u64| (u128::from(part) * u128::from(resamples)).div_ceil(u128::from(all.max(1))) as u64;
    before(parts.start)..before(parts.end)
}

/// An iteration over all resamples that evaluates those of a shard.
pub(crate) struct ResampleShard<T> {
    range: Range<u64>,
    next: u64,
    results: Vec<T>,
}

impl<T: Clone> ResampleShard<T> {
    pub(crate) fn new(own: Range<u64>) -> Self {
        Self { range: own, next: 0, results: Vec::new() }
    }

    /// Returns the result of the next resample if it belongs to the shard, and `none` otherwise.
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

    pub(crate) fn into_results(self) -> Vec<T> {
        self.results
    }
}

/// Saved results of all shards, in order.
pub(crate) struct MergedResamples<T> {
    results: std::vec::IntoIter<T>,
}

#[derive(Debug)]
pub(crate) struct ResampleCountMismatch;

impl<T> MergedResamples<T> {
    pub(crate) fn new(kept: Vec<T>) -> Self {
        Self { results: kept.into_iter() }
    }

    pub(crate) fn next(&mut self) -> Result<T, ResampleCountMismatch> {
        self.results.next().ok_or(ResampleCountMismatch)
    }

    pub(crate) fn finish(self) -> Result<(), ResampleCountMismatch> {
        if self.results.len() == 0 { Ok(()) } else { Err(ResampleCountMismatch) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
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
