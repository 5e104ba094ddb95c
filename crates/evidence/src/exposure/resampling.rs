//! What the probability of a failure would have been, had other episodes been seen.

use rand::RngExt;
use rayon::prelude::*;
use statrs::distribution::{Beta, ContinuousCDF};

use crate::fit::{find_edit, refit, resample};
use crate::rare::RareEstimate;
use crumple_world::random::{Purpose, derived_seed, stream};
use crumple_world::scenario::space::ScenarioSpace;

/// Tells the streams of what is drawn besides the resamples from theirs.
const DRAW_STREAM_OFFSET: u64 = 1 << 40;
/// The fewest resamples from which intervals are stated. The joint ones leave 1.25 % at each end, and of n values the k-th lowest has a share of
/// k / (n + 1) below it, so that there has to be a first: (n + 1) · 0.0125 ≥ 1.
pub const MIN_RESAMPLES: u32 = 79;

/// Why the data's uncertainty is not stated.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ResamplingError {
    /// Nobody asked.
    #[error("nothing was resampled")]
    NotRequested,
    /// Fewer than percentiles take.
    #[error("{requested} resamples are too few for an interval: {MIN_RESAMPLES} are needed")]
    TooFew {
        /// How many were to be made.
        requested: u32,
    },
    /// There is nothing to resample.
    #[error("the space does not hold what it was fitted to")]
    NoData,
    /// The space is another one than what is fitted to its data: resamples would be spaces of their own kind.
    #[error(
        "{what} is not what is fitted to the `observed` values that the space holds: it was changed since, and resamples would not be"
    )]
    Edited {
        /// What was changed.
        what: String,
    },
    /// Too many resamples are such that no space can be fitted.
    #[error(
        "a space could be fitted to {fitted} of {tried} resamples only, and {MIN_RESAMPLES} are needed for an interval"
    )]
    TooFewFits {
        /// To how many one could.
        fitted: u32,
        /// Of so many.
        tried: u32,
    },
}

/// The probability of a failure in spaces fitted to resamples.
#[derive(Debug, Clone, PartialEq)]
pub struct Resamples {
    /// Two probabilities a resample, each sorted, drawn from what is known of its probability: they spread as data and sampling together.
    /// The lower one is 0 where no run failed, the higher one 1 where all did.
    pub sorted_bounds: [Vec<f64>; 2],
    /// Resamples to which no space could be fitted: others were drawn in their place.
    pub failed_fits: u32,
    /// Runs made for each; none where each has an estimate of its own.
    pub runs_each: Option<u32>,
    /// The variance of the probabilities, less what is sampling in them; from 0.
    pub data_variance: f64,
}

impl Resamples {
    /// The values of the spread between which the confidence lies (Efron's percentiles): of n sorted values those in places ⌊(n + 1) α/2⌋ from both
    /// ends. None where there are too few for a first place.
    #[must_use]
    pub fn percentile_interval(&self, confidence: f64) -> Option<[f64; 2]> {
        let [lows, highs] = &self.sorted_bounds;
        // An end of 1 − (1 − α) is not α to the last bit.
        let place = (0.5 * (1.0 - confidence) * (lows.len() + 1) as f64 + 1e-9).floor() as usize;
        let from_end = place.checked_sub(1)?;
        Some([*lows.get(from_end)?, *highs.get(highs.len().checked_sub(place)?)?])
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> u32 {
        self.sorted_bounds[0].len() as u32
    }
}

/// The spaces fitted to resamples, and how many resamples there were to which none could be.
fn refit_to_resamples(
    space: &ScenarioSpace,
    seed: u64,
    resamples: u32,
) -> Result<(Vec<(u64, ScenarioSpace)>, u32), ResamplingError> {
    match resamples {
        0 => return Err(ResamplingError::NotRequested),
        1..MIN_RESAMPLES => return Err(ResamplingError::TooFew { requested: resamples }),
        _ => {}
    }
    let observed = space.spec().observed.as_ref().ok_or(ResamplingError::NoData)?;
    let what = match find_edit(space, observed) {
        Ok(what) => what.map(|name| format!("`{name}`")),
        Err(why) => Some(format!("the space ({why})")),
    };
    if let Some(what) = what {
        return Err(ResamplingError::Edited { what });
    }
    let again = |index: u64| Some((index, refit(space.spec(), &resample(observed, seed, index)).ok()?));
    let mut spaces: Vec<(u64, ScenarioSpace)> = (0..u64::from(resamples)).into_par_iter().filter_map(again).collect();
    let mut tried = resamples;
    while spaces.len() < resamples as usize && tried < 2 * resamples {
        spaces.extend(again(u64::from(tried)));
        tried += 1;
    }
    let fitted = spaces.len() as u32;
    if fitted < MIN_RESAMPLES {
        Err(ResamplingError::TooFewFits { fitted, tried })
    } else {
        Ok((spaces, tried - fitted))
    }
}

/// Makes new runs in each space fitted to a resample: `failures` says how many of so many runs fail there, with a seed. Or says why the data's
/// uncertainty cannot be known so.
///
/// # Errors
/// Those of `failures`.
pub fn count_on_resamples<E>(
    space: &ScenarioSpace,
    seed: u64,
    resamples: u32,
    runs: u32,
    failures: &mut dyn FnMut(&ScenarioSpace, u64, u64) -> Result<u64, E>,
) -> Result<Result<Resamples, ResamplingError>, E> {
    let (spaces, unfit) = match refit_to_resamples(space, seed, resamples) {
        Ok(fitted) => fitted,
        Err(why) => return Ok(Err(why)),
    };
    let (mut shares, mut spread, mut within) = (Vec::new(), [Vec::new(), Vec::new()], 0.0);
    let n = f64::from(runs);
    for (index, space) in spaces {
        let failed = failures(&space, derived_seed(seed, DRAW_STREAM_OFFSET + index), u64::from(runs))? as f64;
        let share = failed / n;
        within += share * (1.0 - share) / (n - 1.0).max(1.0);
        shares.push(share);
        let u: f64 = stream(seed, Purpose::Resampling, DRAW_STREAM_OFFSET + index).random();
        // Jeffreys' posterior, with its ends where they are certain (Brown, Cai and DasGupta, Statistical Science 16, 2001).
        let known = Beta::new(failed + 0.5, n - failed + 0.5);
        let drawn = known.map_or(share, |known| known.inverse_cdf(u.clamp(1e-12, 1.0 - 1e-12)));
        spread[0].push(if failed == 0.0 { 0.0 } else { drawn });
        spread[1].push(if failed == n { 1.0 } else { drawn });
    }
    let within = within / shares.len() as f64;
    spread.iter_mut().for_each(|drawn| drawn.sort_by(f64::total_cmp));
    let variance = (sample_variance(&shares) - within).max(0.0);
    Ok(Ok(Resamples { sorted_bounds: spread, failed_fits: unfit, runs_each: Some(runs), data_variance: variance }))
}

/// Estimates anew in each space fitted to a resample: `again` does, with a seed. Or says why the data's uncertainty cannot be known so.
///
/// Weighting the runs that failed by how much likelier they are there would cost nothing, and was tried: of a failure of probability
/// 10⁻⁶ one run carries all the weight, and where other failures are likelier, no run has been.
///
/// # Errors
/// Those of `again`.
pub(crate) fn estimate_on_resamples<E>(
    space: &ScenarioSpace,
    seed: u64,
    resamples: u32,
    again: &mut dyn FnMut(&ScenarioSpace, u64) -> Result<RareEstimate, E>,
) -> Result<Result<Resamples, ResamplingError>, E> {
    let (spaces, unfit) = match refit_to_resamples(space, seed, resamples) {
        Ok(fitted) => fitted,
        Err(why) => return Ok(Err(why)),
    };
    let (mut found, mut spread, mut within) = (Vec::new(), [Vec::new(), Vec::new()], 0.0);
    for (index, space) in spaces {
        let estimate = again(&space, derived_seed(seed, DRAW_STREAM_OFFSET + index))?;
        let probability = estimate.probability.unwrap_or(0.0);
        within += (probability * estimate.coefficient_of_variation.unwrap_or(0.0)).powi(2);
        found.push(probability);
        // Where no failure was reached, it is rarer than the last level that was.
        let reached = estimate.levels.iter().map(|level| level.probability).filter(|level| *level > 0.0);
        let at_most = if probability > 0.0 { probability } else { reached.fold(1.0, f64::min) };
        spread[0].push(probability);
        spread[1].push(at_most);
    }
    let within = within / found.len() as f64;
    spread.iter_mut().for_each(|drawn| drawn.sort_by(f64::total_cmp));
    let variance = (sample_variance(&found) - within).max(0.0);
    Ok(Ok(Resamples { sorted_bounds: spread, failed_fits: unfit, runs_each: None, data_variance: variance }))
}

fn sample_variance(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (n - 1.0).max(1.0)
}
