//! Data uncertainty: failure probabilities in spaces that are fitted to resamples of the episodes.

use rand::RngExt;
use rayon::prelude::*;
use statrs::distribution::{Beta, ContinuousCDF};

use crate::fit::{find_edit, refit, resample};
use crate::rare::RareEstimate;
use crumple_sim::random::{Purpose, derived_seed, stream};
use crumple_spaces::{ObservedData, ScenarioSpace};

/// Offset that separates random streams of posterior samples from those of resamples.
const DRAW_STREAM_OFFSET: u64 = 1 << 40;
/// Minimum number of resamples for intervals. Joint intervals leave 1.25 % at each end, and the k-th of n sorted values
/// has k / (n + 1) below it, so (n + 1) · 0.0125 ≥ 1.
pub const MIN_RESAMPLES: u32 = 79;
/// Number of resamples, unless a user requests another one.
pub const DEFAULT_RESAMPLES: u32 = 200;
/// Number of runs in each resample, unless a user requests another one.
pub const DEFAULT_RUNS_PER_RESAMPLE: u32 = 500;

/// Reason why data uncertainty is unknown.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ResamplingError {
    /// Resampling was not requested.
    #[error("no resampling was requested")]
    NotRequested,
    /// Too few resamples for percentiles.
    #[error("{requested} resamples are too few for an interval: use at least {MIN_RESAMPLES}")]
    TooFew {
        /// Requested number of resamples.
        requested: u32,
    },
    /// The space does not hold its data.
    #[error("the space does not contain the data to which it was fitted")]
    NoData,
    /// The space was edited after it was fitted, so resamples would not represent it.
    #[error(
        "{what} was changed after the space was fitted to its `observed` values, so resamples would not represent it"
    )]
    Edited {
        /// Edited part of the space.
        what: String,
    },
    /// Too few resamples to which a space could be fitted.
    #[error(
        "only {fitted} of {tried} resamples could be fitted, and an interval needs {MIN_RESAMPLES}"
    )]
    TooFewFits {
        /// Number of fitted spaces.
        fitted: u32,
        /// Number of attempts.
        tried: u32,
    },
}

/// Failure probabilities in spaces that are fitted to resamples.
#[derive(Debug, Clone, PartialEq)]
pub struct Resamples {
    /// A lower and an upper value of the probability per resample, each list sorted. Their spread contains data
    /// uncertainty and sampling uncertainty. The lower value is 0 for a resample without failures; the upper value is 1
    /// if all runs failed.
    pub sorted_bounds: [Vec<f64>; 2],
    /// Number of resamples to which no space could be fitted; they were replaced.
    pub failed_fits: u32,
    /// Number of runs per resample; `None` if the probability in each resample is a rare-event estimate.
    pub runs_each: Option<u32>,
    /// Variance of the probabilities, less their sampling variance; at least 0.
    pub data_variance: f64,
}

impl Resamples {
    /// Creates resamples from their estimates, the bounds drawn for each, and the sum of the variances within them.
    fn new(
        estimates: &[f64],
        mut bounds: [Vec<f64>; 2],
        within: f64,
        failed_fits: u32,
        runs_each: Option<u32>,
    ) -> Self {
        bounds
            .iter_mut()
            .for_each(|drawn| drawn.sort_by(f64::total_cmp));
        let within = within / estimates.len() as f64;
        let data_variance = (sample_variance(estimates) - within).max(0.0);
        Self {
            sorted_bounds: bounds,
            failed_fits,
            runs_each,
            data_variance,
        }
    }

    /// Returns Efron's percentile interval: the values at rank ⌊(n + 1) α/2⌋ from both ends of n; `None` with too few
    /// values.
    #[must_use]
    pub fn percentile_interval(&self, confidence: f64) -> Option<[f64; 2]> {
        let [lows, highs] = &self.sorted_bounds;
        // 1 − (1 − α) is not exactly α.
        let rank = (0.5 * (1.0 - confidence) * (lows.len() + 1) as f64 + 1e-9).floor() as usize;
        let from_end = rank.checked_sub(1)?;
        Some([
            *lows.get(from_end)?,
            *highs.get(highs.len().checked_sub(rank)?)?,
        ])
    }

    /// Returns the number of resamples.
    #[must_use]
    pub fn count(&self) -> u32 {
        self.sorted_bounds[0].len() as u32
    }
}

/// Spaces that are fitted to resamples.
struct RefittedSpaces {
    /// Each space with the index of its resample.
    spaces: Vec<(u64, ScenarioSpace)>,
    /// Number of resamples to which no space could be fitted.
    unfit: u32,
}

fn refit_to_resample(
    space: &ScenarioSpace,
    observed: &ObservedData,
    seed: u64,
    index: u64,
) -> Option<(u64, ScenarioSpace)> {
    let refitted = refit(space.spec(), &resample(observed, seed, index)).ok()?;
    Some((index, refitted))
}

/// Returns the data of a space, if enough resamples are requested and the space is as it was fitted.
fn check_resampling(
    space: &ScenarioSpace,
    resamples: u32,
) -> Result<&ObservedData, ResamplingError> {
    match resamples {
        0 => return Err(ResamplingError::NotRequested),
        1..MIN_RESAMPLES => {
            return Err(ResamplingError::TooFew {
                requested: resamples,
            });
        }
        _ => {}
    }
    let observed = space.spec().observed.as_ref();
    let observed = observed.ok_or(ResamplingError::NoData)?;
    match find_edit(space, observed) {
        Ok(None) => Ok(observed),
        Ok(Some(name)) => Err(ResamplingError::Edited {
            what: format!("`{name}`"),
        }),
        Err(why) => Err(ResamplingError::Edited {
            what: format!("the space ({why})"),
        }),
    }
}

fn refit_to_resamples(
    space: &ScenarioSpace,
    seed: u64,
    resamples: u32,
) -> Result<RefittedSpaces, ResamplingError> {
    let observed = check_resampling(space, resamples)?;
    let mut spaces: Vec<(u64, ScenarioSpace)> = (0..u64::from(resamples))
        .into_par_iter()
        .filter_map(|index| refit_to_resample(space, observed, seed, index))
        .collect();
    let mut tried = resamples;
    while spaces.len() < resamples as usize && tried < 2 * resamples {
        spaces.extend(refit_to_resample(space, observed, seed, u64::from(tried)));
        tried += 1;
    }
    let fitted = spaces.len() as u32;
    if fitted < MIN_RESAMPLES {
        Err(ResamplingError::TooFewFits { fitted, tried })
    } else {
        let unfit = tried - fitted;
        Ok(RefittedSpaces { spaces, unfit })
    }
}

/// Counts failures in spaces that are fitted to resamples; `failures` takes a space, a seed and a number of runs. The
/// inner error is the reason why data uncertainty is unknown.
///
/// # Errors
/// Errors of `failures`.
pub fn count_on_resamples<E>(
    space: &ScenarioSpace,
    seed: u64,
    resamples: u32,
    runs: u32,
    failures: &mut dyn FnMut(&ScenarioSpace, u64, u64) -> Result<u64, E>,
) -> Result<Result<Resamples, ResamplingError>, E> {
    let refitted = match refit_to_resamples(space, seed, resamples) {
        Ok(refitted) => refitted,
        Err(why) => return Ok(Err(why)),
    };
    let mut shares = Vec::new();
    let mut bounds = [Vec::new(), Vec::new()];
    let mut within = 0.0;
    let n = f64::from(runs);
    for (index, space) in refitted.spaces {
        let failed = failures(
            &space,
            derived_seed(seed, DRAW_STREAM_OFFSET + index),
            u64::from(runs),
        )? as f64;
        let share = failed / n;
        within += share * (1.0 - share) / (n - 1.0).max(1.0);
        shares.push(share);
        let u: f64 = stream(seed, Purpose::Resampling, DRAW_STREAM_OFFSET + index).random();
        let [lower, upper] = posterior_bounds(failed, n, u);
        bounds[0].push(lower);
        bounds[1].push(upper);
    }
    Ok(Ok(Resamples::new(
        &shares,
        bounds,
        within,
        refitted.unfit,
        Some(runs),
    )))
}

/// Estimates the probability in spaces that are fitted to resamples; `estimate` takes a space and a seed. The inner
/// error is the reason why data uncertainty is unknown. Reweighting the failed runs of the fitted space would cost no
/// simulations, but was unusable: at a probability of 10⁻⁶ one run had all the weight, and other kinds of failures were
/// not among the runs.
///
/// # Errors
/// Errors of `estimate`.
pub(crate) fn estimate_on_resamples<E>(
    space: &ScenarioSpace,
    seed: u64,
    resamples: u32,
    estimate: &mut dyn FnMut(&ScenarioSpace, u64) -> Result<RareEstimate, E>,
) -> Result<Result<Resamples, ResamplingError>, E> {
    let refitted = match refit_to_resamples(space, seed, resamples) {
        Ok(refitted) => refitted,
        Err(why) => return Ok(Err(why)),
    };
    let mut probabilities = Vec::new();
    let mut bounds = [Vec::new(), Vec::new()];
    let mut within = 0.0;
    for (index, space) in refitted.spaces {
        let estimate = estimate(&space, derived_seed(seed, DRAW_STREAM_OFFSET + index))?;
        let probability = estimate.probability.unwrap_or(0.0);
        within += (probability * estimate.coefficient_of_variation.unwrap_or(0.0)).powi(2);
        probabilities.push(probability);
        // Without a reached failure, the last reached level is the upper bound.
        let reached = estimate
            .levels
            .iter()
            .map(|level| level.probability)
            .filter(|level| *level > 0.0);
        let at_most = if probability > 0.0 {
            probability
        } else {
            reached.fold(1.0, f64::min)
        };
        bounds[0].push(probability);
        bounds[1].push(at_most);
    }
    Ok(Ok(Resamples::new(
        &probabilities,
        bounds,
        within,
        refitted.unfit,
        None,
    )))
}

/// Returns the quantile at `u` of Jeffreys' posterior of a probability, with exact ends (Brown, Cai and DasGupta,
/// Statistical Science 16, 2001), once as a lower and once as an upper bound.
fn posterior_bounds(failed: f64, runs: f64, u: f64) -> [f64; 2] {
    let posterior = Beta::new(failed + 0.5, runs - failed + 0.5);
    let sample = posterior.map_or(failed / runs, |posterior| {
        posterior.inverse_cdf(u.clamp(1e-12, 1.0 - 1e-12))
    });
    [
        if failed == 0.0 { 0.0 } else { sample },
        if failed == runs { 1.0 } else { sample },
    ]
}

fn sample_variance(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    values
        .iter()
        .map(|value| (value - mean) * (value - mean))
        .sum::<f64>()
        / (n - 1.0).max(1.0)
}
