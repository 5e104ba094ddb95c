//! Arrays with one number per run, and sets of runs.

use std::ops::{Index, IndexMut};

/// Number of doubles in the widest vector register.
const MAX_F64_LANES: usize = 8;

/// One number per run of a block, padded to whole registers. Loops may write to the padding.
#[derive(Debug, Clone)]
pub(super) struct PerRun {
    values: Vec<f64>,
    runs: usize,
}

impl PerRun {
    pub(super) fn from_values(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        let runs = values.len();
        values.resize(runs.next_multiple_of(MAX_F64_LANES), 0.0);
        Self { values, runs }
    }

    pub(super) fn constant(value: f64, runs: usize) -> Self {
        Self {
            values: vec![value; runs.next_multiple_of(MAX_F64_LANES)],
            runs,
        }
    }

    pub(super) fn as_slice(&self) -> &[f64] {
        &self.values[..self.runs]
    }

    pub(super) fn as_mut_slice(&mut self) -> &mut [f64] {
        &mut self.values[..self.runs]
    }

    pub(super) fn padded(&self) -> &[f64] {
        &self.values
    }

    pub(super) fn padded_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    pub(super) fn swap_remove(&mut self, run: usize) -> f64 {
        let removed = self.values[run];
        self.runs -= 1;
        self.values[run] = self.values[self.runs];
        self.values
            .truncate(self.runs.next_multiple_of(MAX_F64_LANES));
        removed
    }
}

impl Index<usize> for PerRun {
    type Output = f64;

    #[inline]
    fn index(&self, run: usize) -> &f64 {
        &self.values[run]
    }
}

impl IndexMut<usize> for PerRun {
    #[inline]
    fn index_mut(&mut self, run: usize) -> &mut f64 {
        &mut self.values[run]
    }
}

/// A set of runs of one block, one bit per run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct RunSet(pub(super) u64);

impl RunSet {
    pub(super) const CAPACITY: usize = u64::BITS as usize;

    pub(super) fn first(count: usize) -> Self {
        Self(u64::MAX.unbounded_shr((Self::CAPACITY - count.min(Self::CAPACITY)) as u32))
    }

    pub(super) fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub(super) fn insert(&mut self, run: usize) {
        self.0 |= 1 << run;
    }

    pub(super) fn contains(self, run: usize) -> bool {
        self.0 >> run & 1 == 1
    }

    pub(super) fn intersection(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    pub(super) fn difference(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    pub(super) fn swap_remove(&mut self, run: usize, last: usize) {
        let moved = self.0 >> last & 1;
        self.0 &= !(1 << last);
        if run != last {
            self.0 = self.0 & !(1 << run) | moved << run;
        }
    }

    pub(super) fn iter(self) -> impl Iterator<Item = usize> {
        let mut rest = self.0;
        std::iter::from_fn(move || {
            let run = rest.trailing_zeros();
            rest &= rest.wrapping_sub(1);
            (run < u64::BITS).then_some(run as usize)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn swap_remove_of_a_run_set_equals_that_of_a_list(
            mut values in prop::collection::vec(-1.0..1.0f64, 1..=RunSet::CAPACITY),
            set in any::<u64>(),
            removals in prop::collection::vec(any::<prop::sample::Index>(), 0..70),
        ) {
            let mut per_run = PerRun::from_values(values.iter().copied());
            let mut runs = RunSet(set).intersection(RunSet::first(values.len()));
            let mut members: Vec<bool> = (0..values.len()).map(|run| runs.iter().any(|member| member == run)).collect();
            for removal in removals {
                if values.is_empty() {
                    break;
                }
                let run = removal.index(values.len());
                runs.swap_remove(run, values.len() - 1);
                members.swap_remove(run);
                prop_assert_eq!(per_run.swap_remove(run), values.swap_remove(run));
                prop_assert_eq!(per_run.as_slice(), values.as_slice());
                prop_assert_eq!(per_run.padded().len(), values.len().next_multiple_of(MAX_F64_LANES));
                let expected: Vec<usize> = (0..members.len()).filter(|&run| members[run]).collect();
                prop_assert_eq!(runs.iter().collect::<Vec<_>>(), expected);
            }
        }
    }
}
