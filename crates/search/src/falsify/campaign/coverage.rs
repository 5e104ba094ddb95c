//! Coverage of a scenario space.

use serde::{Deserialize, Serialize};

const BINS: usize = 10;

/// Covered bins of each coordinate, and cells of each pair of coordinates, with ten bins per coordinate.
///
/// Pairs measure the combinatorial coverage (t-way coverage with t = 2), because most failures need only one particular
/// value or a combination of two. A low coverage reveals a search that stays in one corner.
#[derive(Debug, Clone)]
pub(super) struct Coverage {
    dimension: usize,
    single: Vec<bool>,
    pairs: Vec<bool>,
}

/// Coverage in percent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CoveragePercentages {
    /// Share of the bins that were covered, over all coordinates.
    pub tenths_percent: f64,
    /// Share of the cells of two bins that were covered, over all pairs of coordinates.
    pub pairs_percent: f64,
}

impl Coverage {
    pub(super) fn new(dimension: usize) -> Self {
        let pairs = dimension * dimension.saturating_sub(1) / 2;
        Self { dimension, single: vec![false; dimension * BINS], pairs: vec![false; pairs * BINS * BINS] }
    }

    pub(super) fn add(&mut self, point: &[f64]) {
        let bins: Vec<usize> = point.iter().map(|x| ((x * BINS as f64) as usize).min(BINS - 1)).collect();
        let mut pair = 0;
        for (i, &a) in bins.iter().enumerate().take(self.dimension) {
            mark(&mut self.single, i * BINS + a);
            for &b in bins.iter().skip(i + 1) {
                mark(&mut self.pairs, (pair * BINS + a) * BINS + b);
                pair += 1;
            }
        }
    }

    pub(super) fn percentages(&self) -> CoveragePercentages {
        let percent = |cells: &[bool]| {
            let tried = cells.iter().filter(|cell| **cell).count();
            if cells.is_empty() { 100.0 } else { 100.0 * tried as f64 / cells.len() as f64 }
        };
        CoveragePercentages { tenths_percent: percent(&self.single), pairs_percent: percent(&self.pairs) }
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.single.iter_mut().zip(&other.single).for_each(|(cell, other)| *cell |= other);
        self.pairs.iter_mut().zip(&other.pairs).for_each(|(cell, other)| *cell |= other);
    }
}

fn mark(cells: &mut [bool], index: usize) {
    if let Some(cell) = cells.get_mut(index) {
        *cell = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_diagonal_covers_a_tenth_of_the_pairs() {
        let mut coverage = Coverage::new(3);
        for tenth in 0..10 {
            coverage.add(&[f64::from(tenth) / 10.0 + 0.05; 3]);
        }
        assert_eq!(coverage.percentages(), CoveragePercentages { tenths_percent: 100.0, pairs_percent: 10.0 });
        let mut corner = Coverage::new(3);
        corner.add(&[1.0, 0.0, 1.0]);
        assert!((corner.percentages().pairs_percent - 1.0).abs() < 1e-12);
        coverage.merge(&corner);
        assert!((coverage.percentages().pairs_percent - 100.0 * 32.0 / 300.0).abs() < 1e-9);
    }
}
