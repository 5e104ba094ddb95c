//! Failures per episode, per hour and per 1000 km, where a space says in how much driving its episodes were seen.
//!
//! Three things are uncertain. *Counting*: how often episodes come, of which N were seen. *Sampling*: the probability of a failure in the
//! fitted space, of which a count or an estimate saw some runs. And the *data*: the fitted space is not the traffic, and other episodes
//! would have made another. The rate per hour is the product of episodes an hour and failures an episode. Its interval without the data's
//! uncertainty is the product of both intervals, each at 1 − α/2, which hold together at 1 − α (Bonferroni). The data's uncertainty
//! comes of resamples of the episodes, to each of which the space is fitted again.
//!
//! Brakings that the space does not describe happened in the same hours. Rates per hour count them as if they failed as often as the episodes: each
//! episode stands for (N + left out) / N brakings. Without them, a rate would be too low because a recording is bad.

mod counting;
mod resample_shards;
mod resampling;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub(crate) use counting::{EpisodeClusters, expected_count_interval};
pub(super) use resample_shards::{MergedResamples, ResampleCountMismatch, ResampleShard, resample_range};
pub(crate) use resampling::estimate_on_resamples;
pub use resampling::{MIN_RESAMPLES, Resamples, ResamplingError, count_on_resamples};

use super::RateInterval;
use super::rare::RareEstimate;
use crumple_world::scenario::space::ScenarioSpace;

/// Confidence of all intervals.
pub const CONFIDENCE: f64 = 0.95;

/// A figure and between which it lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct IntervalEstimate {
    /// The estimate.
    pub estimate: f64,
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

/// Failures as they would be met on the road.
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

/// How often a controller fails where the space was observed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RatePerExposure {
    /// Episodes that were seen and that the space describes.
    pub episodes: u64,
    /// Brakings besides that it does not describe: rates per hour and per 1000 km count them as if they failed as often.
    #[serde(default)]
    pub left_out: u64,
    /// Waves that they belong to.
    #[serde(rename = "waves")]
    pub clusters: u64,
    /// Hours in which they were seen.
    pub hours: f64,
    /// Kilometres.
    pub kilometres: f64,
    /// Confidence of all intervals.
    pub confidence: f64,
    /// Taking the fitted space for the truth: counting and sampling alone.
    pub fitted: FailureRates,
    /// With the data's uncertainty, if it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "with_data")]
    pub with_data_uncertainty: Option<WithDataUncertainty>,
    /// Why it is not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "without_data")]
    pub data_uncertainty_missing: Option<String>,
}

/// Figures with the data's uncertainty, and where the uncertainty is from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WithDataUncertainty {
    /// The figures.
    #[serde(rename = "figures")]
    pub rates: FailureRates,
    /// Resamples of the episodes.
    pub resamples: u32,
    /// Those to which no space could be fitted.
    #[serde(rename = "unfit")]
    pub failed_fits: u32,
    /// Runs made for each; none where each has an estimate by splitting of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub runs_each: Option<u32>,
    /// Variances relative to the squared estimate: of the number of episodes, ...
    pub counting_variance: f64,
    /// ... of the probability of a failure as the episodes differ, less what is sampling in the resamples; none without failures, ...
    pub data_variance: Option<f64>,
    /// ... and of the count or estimate in the fitted space; none without failures.
    pub sampling_variance: Option<f64>,
}

/// What is known of the probability of a failure in the fitted space.
#[derive(Debug, Clone, Copy)]
pub enum FailureProbability<'a> {
    /// Failures counted, runs that may have been failures, and all runs.
    Counted {
        /// Failures.
        failures: u64,
        /// Runs that were cut short by others, and may have become failures.
        unknown: u64,
        /// Runs.
        runs: u64,
    },
    /// An estimate by splitting.
    Estimated(&'a RareEstimate),
}

impl FailureProbability<'_> {
    fn estimate(self) -> Option<f64> {
        match self {
            Self::Counted { failures, runs, .. } => (runs > 0).then(|| failures as f64 / runs as f64),
            // Where no failure was reached, what is known of it is an upper end.
            Self::Estimated(estimate) => estimate.probability.or((estimate.independent_runs > 0).then_some(0.0)),
        }
    }

    fn interval(self, confidence: f64) -> Option<[f64; 2]> {
        match self {
            Self::Counted { failures, unknown, runs } => Some([
                RateInterval::clopper_pearson(failures, runs, confidence).lower,
                RateInterval::clopper_pearson(failures + unknown, runs, confidence).upper,
            ]),
            // Repetitions that all say the same, such as that nothing or everything fails, say nothing of how far they may be off: the
            // draws that they began with do, which are independent.
            Self::Estimated(estimate) => {
                let spread = estimate.interval(confidence).filter(|[low, high]| low < high);
                spread.or_else(|| estimate.independent_interval(confidence))
            }
        }
    }

    /// Variance relative to the squared estimate.
    fn relative_variance(self) -> Option<f64> {
        match self {
            Self::Counted { failures: 0, .. } => None,
            Self::Counted { failures, runs, .. } => Some((1.0 - failures as f64 / runs as f64) / failures as f64),
            Self::Estimated(estimate) => estimate.coefficient_of_variation.map(|variation| variation * variation),
        }
    }
}

impl RatePerExposure {
    /// What a probability comes to on the road; none where the space does not say in how much driving it was seen, or nothing is
    /// known of the probability.
    #[must_use]
    pub fn new(
        space: &ScenarioSpace,
        known: FailureProbability<'_>,
        resamples: Result<&Resamples, &ResamplingError>,
    ) -> Option<Self> {
        let exposure = space.spec().exposure.as_ref()?;
        let seen = episode_clusters(space);
        let (estimate, alpha) = (known.estimate()?, 1.0 - CONFIDENCE);
        let [low, high] = known.interval(CONFIDENCE)?;
        let counted = expected_count_interval(seen, 1.0 - alpha / 2.0);
        let episodes = exposure.episodes as f64;
        // With weights as those of Fay and Feuer, the interval is as many times as long.
        let stands_for = (episodes + exposure.left_out as f64) / episodes;
        let figures = |apart: [f64; 3], jointly: [f64; 2]| {
            let [estimate, low, high] = apart;
            let per = |amount: f64| IntervalEstimate {
                estimate: estimate * stands_for * episodes / amount,
                lower: jointly[0] * stands_for * counted[0] / amount,
                upper: jointly[1] * stands_for * counted[1] / amount,
            };
            FailureRates {
                per_episode: IntervalEstimate { estimate, lower: low, upper: high },
                per_hour: per(exposure.hours),
                per_1000_km: per(exposure.kilometres / 1000.0),
            }
        };
        let jointly = known.interval(1.0 - alpha / 2.0)?;
        let fitted = figures([estimate, low, high], jointly);
        let with_data = resamples.ok().and_then(|resamples| {
            // Resamples may lie all on one side of what was fitted to all episodes, and data that are uncertain make nothing more certain.
            let with = |[low, high]: [f64; 2], known: [f64; 2]| [low.min(known[0]), high.max(known[1])];
            let [low, high] = with(resamples.percentile_interval(CONFIDENCE)?, [low, high]);
            Some(WithDataUncertainty {
                rates: figures([estimate, low, high], with(resamples.percentile_interval(1.0 - alpha / 2.0)?, jointly)),
                resamples: resamples.count(),
                failed_fits: resamples.failed_fits,
                runs_each: resamples.runs_each,
                counting_variance: seen.sum_of_squares / episodes.powi(2),
                data_variance: (estimate > 0.0).then(|| resamples.data_variance / (estimate * estimate)),
                sampling_variance: known.relative_variance(),
            })
        });
        Some(Self {
            episodes: exposure.episodes,
            left_out: exposure.left_out,
            clusters: seen.clusters,
            hours: exposure.hours,
            kilometres: exposure.kilometres,
            confidence: CONFIDENCE,
            fitted,
            with_data_uncertainty: with_data,
            data_uncertainty_missing: resamples.err().map(ToString::to_string),
        })
    }
}

/// The waves in which a space's episodes came; of one each where that is not known.
fn episode_clusters(space: &ScenarioSpace) -> EpisodeClusters {
    let Some(observed) = &space.spec().observed else {
        return EpisodeClusters::singletons(space.spec().exposure.as_ref().map_or(0, |exposure| exposure.episodes));
    };
    let mut sizes = vec![0; observed.braking_clusters.len()];
    for wave in &observed.braking_clusters {
        if let Some(size) = sizes.get_mut(*wave as usize) {
            *size += 1;
        }
    }
    sizes.retain(|size| *size > 0);
    EpisodeClusters::from_sizes(&sizes)
}
