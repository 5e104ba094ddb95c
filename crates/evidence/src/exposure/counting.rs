//! How often something happens of which so many were counted.

use statrs::distribution::{ContinuousCDF, Gamma};

/// Waves of episodes: how many, and how large.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EpisodeClusters {
    /// How many.
    pub clusters: u64,
    /// Episodes in all of them: Σ S, where S is the size of a wave.
    pub episodes: u64,
    /// Σ S².
    pub sum_of_squares: f64,
    /// The largest S; 1 if there is no wave.
    pub largest: u64,
}

impl EpisodeClusters {
    /// So many waves of one episode.
    #[must_use]
    pub(crate) fn singletons(episodes: u64) -> Self {
        Self { clusters: episodes, episodes, sum_of_squares: episodes as f64, largest: 1 }
    }

    /// Waves of these sizes.
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

/// Between which expected numbers of episodes what was seen lies, with a confidence.
///
/// Waves come independently of each other, as a Poisson process; episodes of a wave do not. With the sizes S of the waves as weights, the
/// sum y = Σ S and its variance v = Σ S², the ends are quantiles of gamma distributions with mean and variance y and v, below, and y + M and
/// v + M², above, where M is the largest S (Fay and Feuer, Confidence intervals for directly standardized rates, Statistics in Medicine
/// 16, 1997). Where every wave is of one episode, that is the exact interval of Poisson's distribution (Garwood, 1936).
#[must_use]
pub(crate) fn expected_count_interval(seen: EpisodeClusters, confidence: f64) -> [f64; 2] {
    let (sum, variance, largest) = (seen.episodes as f64, seen.sum_of_squares, seen.largest as f64);
    let tail = 0.5 * (1.0 - confidence);
    let quantile = |mean: f64, variance: f64, share: f64| {
        Gamma::new(mean * mean / variance, mean / variance).map_or(f64::NAN, |gamma| gamma.inverse_cdf(share))
    };
    let low = if sum > 0.0 { quantile(sum, variance, tail) } else { 0.0 };
    [low, quantile(sum + largest, variance + largest * largest, 1.0 - tail)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tabulated by Garwood; and waves of many are as uncertain as fewer waves.
    #[test]
    fn lone_waves_have_the_exact_interval_of_poisson() {
        for (count, low, high) in [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.390), (100, 81.364, 121.627)] {
            let [found_low, found_high] = expected_count_interval(EpisodeClusters::singletons(count), 0.95);
            assert!(
                (found_low - low).abs() < 1e-3 && (found_high - high).abs() < 1e-3,
                "{count}: {found_low} {found_high}"
            );
        }
        let [low, high] = expected_count_interval(EpisodeClusters::from_sizes(&[3; 10]), 0.95);
        let [lone_low, lone_high] = expected_count_interval(EpisodeClusters::from_sizes(&[1; 10]), 0.95);
        assert!((low - 3.0 * lone_low).abs() < 1e-9 && (high - 3.0 * lone_high).abs() < 1e-9);
    }

    /// However many there are, and none is dropped: a Poisson count is about normal then.
    #[test]
    fn very_many_episodes_are_not_taken_for_fewer() {
        let deviation = 1e7_f64.sqrt();
        let [low, high] = expected_count_interval(EpisodeClusters::singletons(10_000_000), 0.95);
        assert!((1e7 - low - 1.96 * deviation).abs() < 10.0, "{low}");
        assert!((high - 1e7 - 1.96 * deviation).abs() < 10.0, "{high}");
    }
}
