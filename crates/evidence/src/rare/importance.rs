//! Importance sampling with exact weights. Populations climb to the failure as in [`splitting`](super::splitting). A
//! mixture of normal distributions is fitted to their failures and improved by rounds of weighted samples (the
//! cross-entropy method, Rubinstein 1997; with mixtures Kurtz and Song 2013). These runs are discarded. The weight of a
//! sample is the ratio of the two densities, so the mean weight of failures is unbiased for any mixture. A tenth of the
//! samples has the original distribution, which bounds the weights (Hesterberg 1995).

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::mixture::{Mixture, OriginMoments, WeightedPoint};
use super::splitting::{LimitState, RandomInputs};
use super::splitting::{Particle, ParticlePopulation, new_noise_seed};
use super::{Level, RareEstimate, SplittingConfig, SplittingLevels};
use crumple_core::observer::ProgressCounter;
use crumple_world::random::{Purpose, Stream, stream};

/// Number of populations for the initial fit: several find separate failure regions.
const FIT_POPULATIONS: u64 = 3;
const REFIT_ROUNDS: u64 = 3;
/// Samples per round, in populations.
const POPULATIONS_PER_ROUND: usize = 4;
/// Offset of the random streams of discarded runs; those of repetitions start at 1.
const FITTING_STREAM_OFFSET: u64 = 1 << 40;

/// Proposal distribution of importance sampling.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImportanceProposal {
    #[serde(rename = "climbed")]
    pub(super) splitting: SplittingLevels,
    mixture: Option<Mixture>,
    /// Number of runs for the fit, without those of the pilot.
    #[serde(rename = "fitting")]
    fitting_runs: u64,
}

/// State of an unfinished fit; it determines all further work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MixtureFitting {
    #[serde(rename = "climbed")]
    splitting: SplittingLevels,
    #[serde(rename = "arrived")]
    populations: Vec<PopulationTrace>,
    mixture: Option<Mixture>,
    rounds: u64,
    runs: u64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PopulationTrace {
    levels: Vec<OriginMoments>,
    failures: Vec<Vec<f64>>,
}

/// Result of a repetition by importance sampling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WeightedRepetition {
    /// Mean weight of the runs; runs without failure count as 0.
    probability: f64,
    /// Largest weight of a failed run, relative to the sum in this repetition.
    #[serde(rename = "largest")]
    largest_weight_share: f64,
    evaluations: u64,
}

impl ImportanceProposal {
    /// Runs or resumes the climb and the fit. Calls `keep` with each state worth saving.
    pub(super) fn fit<P: LimitState>(
        problem: &P,
        mut begun: MixtureFitting,
        keep: &mut dyn FnMut(&MixtureFitting) -> Result<(), P::Error>,
        counter: &ProgressCounter<'_>,
    ) -> Result<Self, P::Error> {
        let (effort, seed) = (begun.splitting.effort, begun.splitting.seed);
        let stages = begun.splitting.stages.to_vec();
        if !begun.splitting.reaches_failure() {
            return Ok(Self { splitting: begun.splitting, mixture: None, fitting_runs: 0 });
        }
        while begun.mixture.is_none() && (begun.populations.len() as u64) < FIT_POPULATIONS {
            let random = stream(seed, Purpose::RareEvents, FITTING_STREAM_OFFSET + begun.populations.len() as u64);
            let mut climber = ParticlePopulation::new(problem, effort.samples, random, counter);
            let there = climber.level_populations(&stages)?;
            begun.populations.push(PopulationTrace::from_levels(&there, stages.len()));
            begun.runs += climber.evaluations;
            keep(&begun)?;
        }
        if begun.mixture.is_none() {
            let mut random = stream(seed, Purpose::RareEvents, FITTING_STREAM_OFFSET + FIT_POPULATIONS);
            begun.mixture = PopulationTrace::fit_mixture(&begun.populations, &mut random);
            begun.populations.clear();
        }
        for round in begun.rounds..REFIT_ROUNDS {
            let Some(known) = &begun.mixture else { break };
            let random = stream(seed, Purpose::RareEvents, FITTING_STREAM_OFFSET + FIT_POPULATIONS + 1 + round);
            let mut climber = ParticlePopulation::new(problem, POPULATIONS_PER_ROUND * effort.samples, random, counter);
            let failed = draw_weighted_failures(&mut climber, known)?;
            begun.runs += climber.evaluations;
            begun.mixture = known.em_step(&failed).or(begun.mixture);
            begun.rounds = round + 1;
            keep(&begun)?;
        }
        Ok(Self { splitting: begun.splitting, mixture: begun.mixture, fitting_runs: begun.runs })
    }

    pub(super) fn has_dimension(&self, dimension: usize) -> bool {
        self.mixture.iter().all(|mixture| mixture.has_dimension(dimension))
    }

    pub(super) fn reaches_failure(&self) -> bool {
        self.mixture.is_some()
    }

    pub(super) fn planned_runs(&self) -> u64 {
        let effort = self.splitting.effort;
        if self.reaches_failure() { (effort.repetitions * effort.samples) as u64 } else { 0 }
    }

    /// Runs some of the repetitions; each depends only on the seed and its number.
    pub(super) fn run_repetitions<P: LimitState>(
        &self,
        problem: &P,
        repetitions: Range<u64>,
        counter: &ProgressCounter<'_>,
    ) -> Result<Vec<WeightedRepetition>, P::Error> {
        let Some(mixture) = &self.mixture else { return Ok(Vec::new()) };
        let (effort, seed) = (self.splitting.effort, self.splitting.seed);
        let repeat = |index: u64| {
            let random = stream(seed, Purpose::RareEvents, 1 + index);
            let mut climber = ParticlePopulation::new(problem, effort.samples, random, counter);
            let failed = draw_weighted_failures(&mut climber, mixture)?;
            let (sum, largest) =
                failed.iter().fold((0.0, 0.0_f64), |(sum, most), one| (sum + one.weight, most.max(one.weight)));
            let largest = if sum > 0.0 { largest / sum } else { 0.0 };
            Ok(WeightedRepetition {
                probability: sum / effort.samples as f64,
                largest_weight_share: largest,
                evaluations: climber.evaluations,
            })
        };
        repetitions.into_par_iter().map(repeat).collect()
    }

    pub(super) fn is_consistent_with(&self, repetitions: &[WeightedRepetition]) -> bool {
        let effort = self.splitting.effort;
        let is_mean = |one: &WeightedRepetition| one.probability.is_finite() && one.probability >= 0.0;
        repetitions.iter().all(|one| {
            is_mean(one) && (0.0..=1.0).contains(&one.largest_weight_share) && one.evaluations == effort.samples as u64
        })
    }

    pub(super) fn summary(&self, repeated: &[WeightedRepetition]) -> RareEstimate {
        let mut begun = self.splitting.pilot_estimate();
        begun.evaluations = begun.evaluations.saturating_add(self.fitting_runs);
        if !self.reaches_failure() {
            return begun;
        }
        let shares: Vec<f64> = repeated.iter().map(|one| one.probability).collect();
        let evaluations = repeated.iter().map(|one| one.evaluations).fold(begun.evaluations, u64::saturating_add);
        let sum: f64 = shares.iter().sum();
        let largest = repeated.iter().map(|one| one.largest_weight_share * one.probability).fold(0.0, f64::max);
        let largest_weight = (sum > 0.0).then_some(largest / sum);
        // Weights first: without them, an estimate with a single level would be taken for a count.
        let mut estimate = RareEstimate { evaluations, largest_weight, ..begun }.with_repetitions(shares);
        let probability = estimate.probability.unwrap_or(0.0);
        let before = estimate.levels.last().map_or(1.0, |level| level.probability);
        let share = if before > 0.0 { (probability / before).min(1.0) } else { 0.0 };
        estimate.levels.push(Level { probability, share, ..Level::default() });
        estimate
    }
}

impl MixtureFitting {
    pub(super) fn new(climbed: SplittingLevels) -> Self {
        Self { splitting: climbed, populations: Vec::new(), mixture: None, rounds: 0, runs: 0 }
    }

    pub(super) fn is_consistent_with(&self, effort: SplittingConfig, seed: u64, dimension: usize) -> bool {
        let is_place = |place: &Vec<f64>| place.len() == dimension;
        self.splitting.is_placed_by(effort, seed)
            && self.populations.len() as u64 <= FIT_POPULATIONS
            && self.rounds <= REFIT_ROUNDS
            && self.mixture.iter().all(|mixture| mixture.has_dimension(dimension))
            && self.populations.iter().all(|arrived| arrived.failures.iter().all(is_place))
    }
}

impl PopulationTrace {
    /// Summarises the populations below the levels, failures last; an extinct population reached fewer.
    fn from_levels(there: &[Vec<Particle>], levels: usize) -> Self {
        let places =
            |level: &Vec<Particle>| OriginMoments::from_points(level.iter().map(|(state, _)| state.normal.as_slice()));
        let failures = there.get(levels.saturating_sub(1)).into_iter().flatten();
        Self {
            levels: there.iter().map(places).collect(),
            failures: failures.map(|(state, _)| state.normal.clone()).collect(),
        }
    }

    fn fit_mixture(arrived: &[Self], random: &mut Stream) -> Option<Mixture> {
        let mut levels: Vec<OriginMoments> = Vec::new();
        for population in arrived {
            levels.resize(levels.len().max(population.levels.len()), OriginMoments::default());
            levels.iter_mut().zip(&population.levels).for_each(|(level, more)| level.merge(more));
        }
        let failures = arrived.iter().flat_map(|population| &population.failures);
        let failures: Vec<WeightedPoint> =
            failures.map(|at| WeightedPoint { point: at.clone(), weight: 1.0 }).collect();
        Mixture::fit(&levels, &failures, random)
    }
}

fn draw_weighted_failures<P: LimitState>(
    climber: &mut ParticlePopulation<'_, P>,
    mixture: &Mixture,
) -> Result<Vec<WeightedPoint>, P::Error> {
    let drawn = climber.sample_with(|dimension, random| RandomInputs {
        normal: mixture.draw(dimension, random),
        noise_seed: new_noise_seed(random),
    })?;
    let failed = drawn.into_iter().filter(|(_, margin)| *margin < 0.0);
    Ok(failed
        .map(|(state, _)| WeightedPoint { weight: mixture.importance_weight(&state.normal), point: state.normal })
        .collect())
}
