//! Failures per episode, per hour and per 1000 km, for spaces that state their exposure.
//!
//! Three sources of uncertainty: *counting*, the number N of episodes; *sampling*, the probability of a failure in the
//! fitted space; and *data*, because other episodes would have given another space. The rate per hour is episodes per
//! hour times failures per episode. Its interval without data uncertainty is the product of both intervals at 1 − α/2,
//! which hold together at 1 − α (Bonferroni). Data uncertainty is the spread over spaces that are fitted to resamples
//! of the episodes.
//!
//! Rates per hour assume that brakings which the space omits fail as often as the episodes: each episode counts for
//! (N + omitted) / N brakings. Otherwise a bad recording would lower the rate.

mod counting;
#[cfg(test)]
mod recorded_tests;
mod resampling;
#[cfg(test)]
mod tests;
mod text;

use std::fmt;

use serde::{Deserialize, Serialize};

pub(crate) use counting::{EpisodeClusters, expected_count_interval};
pub(crate) use resampling::estimate_on_resamples;
pub use resampling::{
    DEFAULT_RESAMPLES, DEFAULT_RUNS_PER_RESAMPLE, MIN_RESAMPLES, Resamples, ResamplingError,
    count_on_resamples,
};

use super::RateInterval;
use super::rare::RareEstimate;
use crumple_core::digits::{format_rounded, format_rounded_down, format_rounded_up};
use crumple_spaces::ScenarioSpace;

/// Confidence level of all intervals.
pub const CONFIDENCE: f64 = 0.95;

/// An estimate with its interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct IntervalEstimate {
    /// Point estimate.
    pub estimate: f64,
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

impl IntervalEstimate {
    /// Returns the rate of independent events that were counted in an exposure, with its exact interval (Garwood, 1936)
    /// at [`CONFIDENCE`].
    #[must_use]
    pub fn poisson_rate(events: u64, exposure: f64) -> Self {
        let [lower, upper] =
            expected_count_interval(EpisodeClusters::singletons(events), CONFIDENCE);
        Self {
            estimate: events as f64 / exposure,
            lower: lower / exposure,
            upper: upper / exposure,
        }
    }
}

/// Writes the estimate and its interval, whose ends are rounded outward: `1.23 (0.456 to 3.4)`.
impl fmt::Display for IntervalEstimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&format!(
            "{} ({} to {})",
            format_rounded(self.estimate, 3),
            format_rounded_down(self.lower, 3),
            format_rounded_up(self.upper, 3)
        ))
    }
}

/// Rates of failures on the road.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailureRates {
    /// Failures per episode.
    pub per_episode: IntervalEstimate,
    /// Failures per hour of following.
    pub per_hour: IntervalEstimate,
    /// Failures per 1000 km of following.
    pub per_1000_km: IntervalEstimate,
}

/// Rates of failures of a controller in the traffic that a space was fitted to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RatePerExposure {
    /// Observed episodes that the space describes.
    pub episodes: u64,
    /// Brakings that the space omits; rates per hour and per 1000 km assume that they fail as often.
    #[serde(default, alias = "left_out")]
    pub undescribed_brakings: u64,
    /// Clusters of the episodes.
    #[serde(alias = "waves")]
    pub clusters: u64,
    /// Hours of observation.
    pub hours: f64,
    /// Kilometres of observation.
    pub kilometres: f64,
    /// Confidence level of all intervals.
    pub confidence: f64,
    /// Rates with counting and sampling uncertainty only.
    pub fitted: FailureRates,
    /// Rates with data uncertainty, if it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "with_data")]
    pub with_data_uncertainty: Option<WithDataUncertainty>,
    /// Reason why data uncertainty is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "without_data")]
    pub data_uncertainty_missing: Option<String>,
}

/// Rates with data uncertainty, and its composition.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WithDataUncertainty {
    /// Rates of failures.
    #[serde(alias = "figures")]
    pub rates: FailureRates,
    /// Number of resamples.
    pub resamples: u32,
    /// Number of resamples to which no space could be fitted.
    #[serde(alias = "unfit")]
    pub failed_fits: u32,
    /// Number of runs per resample; `None` if the probability in each resample is estimated by splitting.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub runs_each: Option<u32>,
    /// Variance of the number of episodes, relative to the squared estimate.
    pub counting_variance: f64,
    /// Relative variance of the failure probability among resamples, less their sampling variance; `None` without
    /// failures.
    pub data_variance: Option<f64>,
    /// Relative variance of the count or estimate in the fitted space; `None` without failures.
    pub sampling_variance: Option<f64>,
}

/// Failure probability in the fitted space.
#[derive(Debug, Clone, Copy)]
pub enum FailureProbability<'a> {
    /// Counts of runs.
    Counted {
        /// Number of failures.
        failures: u64,
        /// Number of runs that ended early, which may have become failures.
        unknown: u64,
        /// Number of runs.
        runs: u64,
    },
    /// Estimate by splitting or importance sampling.
    Estimated(&'a RareEstimate),
}

impl FailureProbability<'_> {
    fn estimate(self) -> Option<f64> {
        match self {
            Self::Counted { failures, runs, .. } => {
                (runs > 0).then(|| failures as f64 / runs as f64)
            }
            // Without a reached failure, only an upper end is known.
            Self::Estimated(estimate) => estimate
                .probability
                .or((estimate.independent_runs > 0).then_some(0.0)),
        }
    }

    fn interval(self, confidence: f64) -> Option<[f64; 2]> {
        match self {
            Self::Counted {
                failures,
                unknown,
                runs,
            } => Some([
                RateInterval::clopper_pearson(failures, runs, confidence).lower,
                RateInterval::clopper_pearson(failures + unknown, runs, confidence).upper,
            ]),
            // Equal repetitions have no spread; the independent initial runs then bound the probability.
            Self::Estimated(estimate) => {
                let spread = estimate
                    .interval(confidence)
                    .filter(|[low, high]| low < high);
                spread.or_else(|| estimate.independent_interval(confidence))
            }
        }
    }

    fn relative_variance(self) -> Option<f64> {
        match self {
            Self::Counted { failures: 0, .. } => None,
            Self::Counted { failures, runs, .. } => {
                Some((1.0 - failures as f64 / runs as f64) / failures as f64)
            }
            Self::Estimated(estimate) => estimate
                .coefficient_of_variation
                .map(|variation| variation * variation),
        }
    }
}

impl RatePerExposure {
    /// Computes the rates on the road; `None` without exposure of the space or without runs.
    #[must_use]
    pub fn new(
        space: &ScenarioSpace,
        probability: FailureProbability<'_>,
        resamples: Result<&Resamples, &ResamplingError>,
    ) -> Option<Self> {
        let exposure = space.spec().exposure.as_ref()?;
        let clusters = episode_clusters(space);
        let estimate = probability.estimate()?;
        let alpha = 1.0 - CONFIDENCE;
        let [low, high] = probability.interval(CONFIDENCE)?;
        let counted = expected_count_interval(clusters, 1.0 - alpha / 2.0);
        let episodes = exposure.episodes as f64;
        let stands_for = (episodes + exposure.undescribed_brakings as f64) / episodes;
        let figures = |apart: [f64; 3], jointly: [f64; 2]| {
            let [estimate, low, high] = apart;
            let per = |amount: f64| IntervalEstimate {
                estimate: estimate * stands_for * episodes / amount,
                lower: jointly[0] * stands_for * counted[0] / amount,
                upper: jointly[1] * stands_for * counted[1] / amount,
            };
            FailureRates {
                per_episode: IntervalEstimate {
                    estimate,
                    lower: low,
                    upper: high,
                },
                per_hour: per(exposure.hours),
                per_1000_km: per(exposure.kilometres / 1000.0),
            }
        };
        let jointly = probability.interval(1.0 - alpha / 2.0)?;
        let fitted = figures([estimate, low, high], jointly);
        let with_data = resamples.ok().and_then(|resamples| {
            // Data uncertainty never shortens the interval, even if all resamples lie on one side.
            let with =
                |[low, high]: [f64; 2], range: [f64; 2]| [low.min(range[0]), high.max(range[1])];
            let [low, high] = with(resamples.percentile_interval(CONFIDENCE)?, [low, high]);
            Some(WithDataUncertainty {
                rates: figures(
                    [estimate, low, high],
                    with(resamples.percentile_interval(1.0 - alpha / 2.0)?, jointly),
                ),
                resamples: resamples.count(),
                failed_fits: resamples.failed_fits,
                runs_each: resamples.runs_each,
                counting_variance: clusters.sum_of_squares / episodes.powi(2),
                data_variance: (estimate > 0.0)
                    .then(|| resamples.data_variance / (estimate * estimate)),
                sampling_variance: probability.relative_variance(),
            })
        });
        Some(Self {
            episodes: exposure.episodes,
            undescribed_brakings: exposure.undescribed_brakings,
            clusters: clusters.clusters,
            hours: exposure.hours,
            kilometres: exposure.kilometres,
            confidence: CONFIDENCE,
            fitted,
            with_data_uncertainty: with_data,
            data_uncertainty_missing: resamples.err().map(ToString::to_string),
        })
    }
}

/// Returns the clusters of a space's episodes; clusters of one each if unknown.
fn episode_clusters(space: &ScenarioSpace) -> EpisodeClusters {
    let Some(observed) = &space.spec().observed else {
        return EpisodeClusters::singletons(
            space
                .spec()
                .exposure
                .as_ref()
                .map_or(0, |exposure| exposure.episodes),
        );
    };
    let mut sizes = vec![0; observed.braking_clusters.len()];
    for cluster in &observed.braking_clusters {
        if let Some(size) = sizes.get_mut(*cluster as usize) {
            *size += 1;
        }
    }
    sizes.retain(|size| *size > 0);
    EpisodeClusters::from_sizes(&sizes)
}
