//! Confidence intervals of an expected number of clustered events.

use statrs::distribution::{ContinuousCDF, Gamma};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EpisodeClusters {
    /// Number of clusters.
    pub clusters: u64,
    /// Number of episodes: Σ S, where S is the size of a cluster.
    pub episodes: u64,
    /// Σ S².
    pub sum_of_squares: f64,
    /// Largest S; 1 without clusters.
    pub largest: u64,
}

impl EpisodeClusters {
    #[must_use]
    pub(crate) fn singletons(episodes: u64) -> Self {
        Self {
            clusters: episodes,
            episodes,
            sum_of_squares: episodes as f64,
            largest: 1,
        }
    }

    #[must_use]
    pub(crate) fn from_sizes(sizes: &[u64]) -> Self {
        Self {
            clusters: sizes.len() as u64,
            episodes: sizes.iter().sum(),
            sum_of_squares: sizes.iter().map(|&size| size as f64 * size as f64).sum(),
            largest: sizes.iter().copied().max().unwrap_or(1),
        }
    }
}

/// Returns the confidence interval of the expected number of episodes. Clusters are a Poisson process; episodes of one
/// cluster depend on each other. With the sum y = Σ S and variance v = Σ S², the lower end is a quantile of the gamma
/// distribution with mean y and variance v, the upper end of that with y + M and v + M², where M is the largest S (Fay
/// and Feuer, Confidence intervals for directly standardized rates, Statistics in Medicine 16, 1997). With single
/// episodes that is the exact Poisson interval (Garwood, 1936).
#[must_use]
pub(crate) fn expected_count_interval(clusters: EpisodeClusters, confidence: f64) -> [f64; 2] {
    let sum = clusters.episodes as f64;
    let variance = clusters.sum_of_squares;
    let largest = clusters.largest as f64;
    let tail = 0.5 * (1.0 - confidence);
    let low = if sum > 0.0 {
        gamma_quantile(sum, variance, tail)
    } else {
        0.0
    };
    let high = gamma_quantile(sum + largest, variance + largest * largest, 1.0 - tail);
    [low, high]
}

/// Returns a quantile of the gamma distribution with a mean and a variance.
fn gamma_quantile(mean: f64, variance: f64, share: f64) -> f64 {
    Gamma::new(mean * mean / variance, mean / variance)
        .map_or(f64::NAN, |gamma| gamma.inverse_cdf(share))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_episodes_have_the_exact_poisson_interval() {
        for (count, low, high) in [
            (0, 0.0, 3.689),
            (1, 0.0253, 5.572),
            (10, 4.795, 18.390),
            (100, 81.364, 121.627),
        ] {
            let [lower, upper] = expected_count_interval(EpisodeClusters::singletons(count), 0.95);
            assert!(
                (lower - low).abs() < 1e-3 && (upper - high).abs() < 1e-3,
                "{count}: {lower} {upper}"
            );
        }
        let [low, high] = expected_count_interval(EpisodeClusters::from_sizes(&[3; 10]), 0.95);
        let [single_low, single_high] =
            expected_count_interval(EpisodeClusters::from_sizes(&[1; 10]), 0.95);
        assert!((low - 3.0 * single_low).abs() < 1e-9 && (high - 3.0 * single_high).abs() < 1e-9);
    }

    /// A large Poisson count is nearly normal.
    #[test]
    fn interval_of_ten_million_episodes_is_nearly_normal() {
        let deviation = 1e7_f64.sqrt();
        let [low, high] = expected_count_interval(EpisodeClusters::singletons(10_000_000), 0.95);
        assert!((1e7 - low - 1.96 * deviation).abs() < 10.0, "{low}");
        assert!((high - 1e7 - 1.96 * deviation).abs() < 10.0, "{high}");
    }
}
