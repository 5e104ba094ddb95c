//! How well a distribution describes values: distances between what was seen and what was fitted, and how unusual they are.

use rand::RngExt;
use rayon::prelude::*;
use serde::Serialize;

use super::family::FamilyFit;
use crumple_world::random::{Purpose, stream};
use crumple_world::scenario::space::ParameterDistribution;

/// Distances between values and a distribution, each with the share of samples of the fitted distribution, fitted again, that are as far from
/// their own fit or further (a parametric bootstrap: Stute, González Manteiga and Presedo Quindimil, Metrika 40, 1993).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GoodnessOfFit {
    /// The largest distance between both distribution functions: Kolmogorov's and Smirnov's.
    pub kolmogorov_smirnov: f64,
    /// Its p-value.
    pub kolmogorov_smirnov_p: f64,
    /// The mean squared distance, times the number of values: Cramér's and von Mises'.
    pub cramer_von_mises: f64,
    /// Its p-value.
    pub cramer_von_mises_p: f64,
    /// Samples drawn.
    pub samples: u32,
}

/// What a fit says beyond what was seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Tails {
    /// The smallest value seen.
    pub smallest: f64,
    /// The largest value seen.
    pub largest: f64,
    /// The fitted probability of less than the smallest.
    pub below_smallest: f64,
    /// The fitted probability of more than the largest.
    pub beyond_largest: f64,
    /// Values below the fitted 10 % quantile, on which the lower tail rests.
    pub in_lower_tenth: u32,
    /// Values above the fitted 90 % quantile, on which the upper tail rests.
    pub in_upper_tenth: u32,
}

impl Tails {
    /// Of values that are sorted.
    pub(super) fn new(sorted: &[f64], fitted: &ParameterDistribution) -> Self {
        let (smallest, largest) =
            (sorted.first().copied().unwrap_or(f64::NAN), sorted.last().copied().unwrap_or(f64::NAN));
        let (low, high) = (fitted.quantile(0.1), fitted.quantile(0.9));
        Self {
            smallest,
            largest,
            below_smallest: fitted.cdf(smallest),
            beyond_largest: 1.0 - fitted.cdf(largest),
            in_lower_tenth: sorted.iter().filter(|value| **value < low).count() as u32,
            in_upper_tenth: sorted.iter().filter(|value| **value > high).count() as u32,
        }
    }
}

/// A p-value, with two digits that count where it is small: one of 1 in 200 is 0.0050, and would not be honest as 0.01.
#[must_use]
pub fn format_p_value(p: f64) -> String {
    let decimals = if p > 0.0 && p < 0.1 { (1.0 - p.log10()).ceil().min(12.0) as usize } else { 2 };
    format!("{p:.decimals$}")
}

/// Both distances of sorted values.
fn edf_statistics(sorted: &[f64], fitted: &ParameterDistribution) -> [f64; 2] {
    let n = sorted.len() as f64;
    let (mut largest, mut squares) = (0.0_f64, 1.0 / (12.0 * n));
    for (index, &value) in sorted.iter().enumerate() {
        let (below, index) = (fitted.cdf(value), index as f64);
        largest = largest.max((index + 1.0) / n - below).max(below - index / n);
        squares += ((2.0 * index + 1.0) / (2.0 * n) - below).powi(2);
    }
    [largest, squares]
}

impl GoodnessOfFit {
    /// Of sorted values that can only lie in a range; `place` tells the streams of several fits apart.
    pub(super) fn bootstrap(
        sorted: &[f64],
        range: [f64; 2],
        fit: &FamilyFit,
        fitted: &ParameterDistribution,
        (samples, seed, place): (u32, u64, u64),
    ) -> Self {
        let seen = edf_statistics(sorted, fitted);
        let again = |index: u32| {
            let mut random = stream(seed, Purpose::Resampling, (place << 32) + u64::from(index));
            let mut drawn: Vec<f64> = sorted.iter().map(|_| fitted.quantile(random.random())).collect();
            drawn.sort_by(f64::total_cmp);
            let refitted = fit.family.fit(&drawn, range).ok()?;
            Some(edf_statistics(&drawn, &refitted.distribution.build().ok()?))
        };
        let again: Vec<[f64; 2]> = (0..samples).into_par_iter().filter_map(again).collect();
        let share = |which: usize| {
            let as_far = again.iter().filter(|distances| distances[which] >= seen[which]).count();
            (as_far + 1) as f64 / (again.len() + 1) as f64
        };
        Self {
            kolmogorov_smirnov: seen[0],
            kolmogorov_smirnov_p: share(0),
            cramer_von_mises: seen[1],
            cramer_von_mises_p: share(1),
            samples: again.len() as u32,
        }
    }
}
