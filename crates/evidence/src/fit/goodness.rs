//! Goodness of fit of a distribution, by bootstrap.

use rand::RngExt;
use rayon::prelude::*;
use serde::Serialize;

use super::family::FamilyFit;
use crumple_sim::random::{Purpose, stream};
use crumple_spaces::ParameterDistribution;

/// Distances of values from a fitted distribution. Each p-value is the share of samples of the fit, fitted again, with
/// at least that distance (a parametric bootstrap: Stute, González Manteiga and Presedo Quindimil, Metrika 40, 1993).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GoodnessOfFit {
    /// Kolmogorov-Smirnov statistic: the largest distance of the distribution functions.
    pub kolmogorov_smirnov: f64,
    /// P-value of the Kolmogorov-Smirnov statistic.
    pub kolmogorov_smirnov_p: f64,
    /// Cramér-von Mises statistic: the mean squared distance times the number of values.
    pub cramer_von_mises: f64,
    /// P-value of the Cramér-von Mises statistic.
    pub cramer_von_mises_p: f64,
    /// Number of bootstrap samples.
    pub samples: u32,
}

/// Extrapolation of a fit beyond the observed values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Tails {
    /// Smallest observed value.
    pub smallest: f64,
    /// Largest observed value.
    pub largest: f64,
    /// Fitted probability of smaller values.
    pub below_smallest: f64,
    /// Fitted probability of larger values.
    pub beyond_largest: f64,
    /// Number of values below the fitted 10 % quantile, which support the lower tail.
    pub in_lower_tenth: u32,
    /// Number of values above the fitted 90 % quantile, which support the upper tail.
    pub in_upper_tenth: u32,
}

impl Tails {
    pub(super) fn new(sorted: &[f64], fitted: &ParameterDistribution) -> Self {
        let smallest = sorted.first().copied().unwrap_or(f64::NAN);
        let largest = sorted.last().copied().unwrap_or(f64::NAN);
        let [low, high] = [0.1, 0.9].map(|share| fitted.quantile(share));
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

/// P-value below which a family does not fit.
pub const MIN_P_VALUE: f64 = 0.05;

impl GoodnessOfFit {
    /// Returns the smaller p-value of both statistics.
    #[must_use]
    pub fn smallest_p(&self) -> f64 {
        self.kolmogorov_smirnov_p.min(self.cramer_von_mises_p)
    }

    /// True if either statistic rejects the family at [`MIN_P_VALUE`].
    #[must_use]
    pub fn is_rejected(&self) -> bool {
        self.smallest_p() < MIN_P_VALUE
    }
}

/// Formats a p-value, with two significant digits if it is small: 1 in 200 is 0.0050.
#[must_use]
pub fn format_p_value(p: f64) -> String {
    let decimals = if p > 0.0 && p < 0.1 {
        (1.0 - p.log10()).ceil().min(12.0) as usize
    } else {
        2
    };
    format!("{p:.decimals$}")
}

fn edf_statistics(sorted: &[f64], fitted: &ParameterDistribution) -> [f64; 2] {
    let n = sorted.len() as f64;
    let mut largest = 0.0_f64;
    let mut squares = 1.0 / (12.0 * n);
    for (index, &value) in sorted.iter().enumerate() {
        let below = fitted.cdf(value);
        let index = index as f64;
        largest = largest
            .max((index + 1.0) / n - below)
            .max(below - index / n);
        squares += ((2.0 * index + 1.0) / (2.0 * n) - below).powi(2);
    }
    [largest, squares]
}

impl GoodnessOfFit {
    /// Computes the bootstrap for sorted values in a range; `feature` separates the random streams of several fits.
    pub(super) fn bootstrap(
        sorted: &[f64],
        range: [f64; 2],
        fit: &FamilyFit,
        fitted: &ParameterDistribution,
        (samples, seed, feature): (u32, u64, u64),
    ) -> Self {
        let observed = edf_statistics(sorted, fitted);
        let resampled: Vec<[f64; 2]> = (0..samples)
            .into_par_iter()
            .filter_map(|index| {
                let stream_number = (feature << 32) + u64::from(index);
                let mut random = stream(seed, Purpose::Resampling, stream_number);
                let mut values: Vec<f64> = sorted
                    .iter()
                    .map(|_| fitted.quantile(random.random()))
                    .collect();
                values.sort_by(f64::total_cmp);
                let refitted = fit.family.fit(&values, range).ok()?;
                Some(edf_statistics(
                    &values,
                    &refitted.distribution.build().ok()?,
                ))
            })
            .collect();
        let [kolmogorov_smirnov_p, cramer_von_mises_p] = [0, 1].map(|statistic| {
            let as_far = resampled
                .iter()
                .filter(|distances| distances[statistic] >= observed[statistic])
                .count();
            (as_far + 1) as f64 / (resampled.len() + 1) as f64
        });
        Self {
            kolmogorov_smirnov: observed[0],
            kolmogorov_smirnov_p,
            cramer_von_mises: observed[1],
            cramer_von_mises_p,
            samples: resampled.len() as u32,
        }
    }
}
