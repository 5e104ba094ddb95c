//! Multilevel splitting: a pilot that places the levels, and unbiased repetitions.

use std::ops::Range;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::failures::{FailedRun, MAX_KEPT_FAILURES, choose};
use super::{Level, RareEstimate, SplittingConfig};
use crate::RateInterval;
use crumple_core::observer::{ProgressCounter, Stopped};
use crumple_sim::random::{NoiseShare, Purpose, Stream, stream};

/// Minimum number of runs between checkpoints: writing one costs milliseconds.
const MIN_RUNS_PER_WRITE: u64 = 500;
/// Maximum number of levels: a rarer failure than about 10⁻¹² is not reached.
pub const MAX_LEVELS: usize = 18;
/// Population sizes of pilots, relative to a repetition. The next pilot runs if the earlier ones reached no failure: a
/// larger population is less likely to converge to small margins without failures.
pub const PILOT_FACTORS: [usize; 3] = [1, 2, 4];
/// Offset of the random streams of later pilots; those of repetitions start at 1.
const LATER_PILOT_STREAM_OFFSET: u64 = 1 << 41;
/// Offset of the random streams that choose the failures to keep, so that the other streams do not depend on them.
const FAILURE_STREAM_OFFSET: u64 = 1 << 42;
const LEVEL_SHARE: f64 = 0.2;
const MOVES_PER_LEVEL: usize = 4;
/// Smallest weight of a noise share. Smaller ones, dropped to save time, together change the noise by less than a
/// millionth.
const MIN_NOISE_WEIGHT: f64 = 1e-8;
/// Share of moves that resample all noise. It decorrelates runs that do not depend on their noise.
const NEW_NOISE_SHARE: f64 = 0.25;
/// Optimal acceptance of a random walk (Papaioannou and others, MCMC algorithms for subset simulation, 2015).
const TARGET_ACCEPTANCE: f64 = 0.44;
/// Gain of the pilot's step adaptation to acceptance.
const STEP_ADAPTATION_RATE: f64 = 1.5;
const MIN_STEP: f64 = 0.02;
const FIRST_STEP: f64 = 0.5;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct RandomInputs {
    /// Independent standard normal numbers, one per parameter.
    pub normal: Vec<f64>,
    /// Noise. The first seed is also that of all other random numbers.
    pub noise: Vec<NoiseShare>,
}

/// A problem whose runs have a margin.
pub(super) trait LimitState: Sync {
    type Error: From<Stopped> + Send;

    fn dimension(&self) -> usize;

    /// Returns the margins of runs, in order: negative for a failure. NaN counts as far from failing.
    ///
    /// # Errors
    /// The first run that fails.
    fn margins(&self, states: &[RandomInputs]) -> Result<Vec<f64>, Self::Error>;
}

/// Levels that a pilot placed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplittingLevels {
    effort: SplittingConfig,
    seed: u64,
    stages: Vec<SplittingStage>,
    #[serde(alias = "pilot")]
    pilot_runs: u64,
    /// Number of independent initial samples; only those of the first pilot if a failure was reached.
    pilot_draws: u64,
    pilot_failures: u64,
    #[serde(alias = "reached")]
    reaches_failure: bool,
    /// Levels of the pilot, reported if it reaches no failure.
    pilot_levels: Vec<Level>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SplittingStage {
    threshold: f64,
    is_last: bool,
    step: f64,
}

impl SplittingStage {
    const LAST: Self = Self {
        threshold: 0.0,
        is_last: true,
        step: 1.0,
    };

    fn passes(&self, margin: f64) -> bool {
        if self.is_last {
            margin < 0.0
        } else {
            margin <= self.threshold
        }
    }
}

/// Run with its margin.
pub(super) type Particle = (RandomInputs, f64);

/// Choice of the failures that a repetition keeps.
struct FailureChoice {
    most: usize,
    random: Stream,
}

struct ParticlePopulation<'a, P: LimitState> {
    problem: &'a P,
    samples: usize,
    random: Stream,
    evaluations: u64,
    counter: &'a ProgressCounter<'a>,
}

/// Result of a repetition by splitting.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Repetition {
    #[serde(alias = "failures")]
    initial_failures: u64,
    #[serde(alias = "seen")]
    levels: Vec<LevelStats>,
    evaluations: u64,
    /// Random sample of the failures at the last level.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    failed: Vec<FailedRun>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LevelStats {
    share: f64,
    accepted: u64,
    proposed: u64,
}

impl SplittingLevels {
    /// Runs the pilot; retries with larger populations if it reaches no failure.
    ///
    /// # Errors
    /// Errors of the problem.
    pub(super) fn run_pilots<P: LimitState>(
        problem: &P,
        effort: SplittingConfig,
        seed: u64,
        counter: &ProgressCounter<'_>,
    ) -> Result<Self, P::Error> {
        let mut pilot = Self::run_pilot(problem, effort, seed, 0, counter)?;
        let [first_draws, first_failures] = [pilot.pilot_draws, pilot.pilot_failures];
        for attempt in 1..PILOT_FACTORS.len() {
            if pilot.reaches_failure {
                break;
            }
            let next = Self::run_pilot(problem, effort, seed, attempt, counter)?;
            // Earlier samples decide if a further pilot runs, so its samples may not be pooled with them. If
            // repetitions follow, only the first pilot's samples count.
            let [draws, failures] = match next.reaches_failure {
                true => [first_draws, first_failures],
                false => [
                    pilot.pilot_draws + next.pilot_draws,
                    pilot.pilot_failures + next.pilot_failures,
                ],
            };
            pilot = Self {
                pilot_runs: pilot.pilot_runs + next.pilot_runs,
                pilot_draws: draws,
                pilot_failures: failures,
                ..next
            };
        }
        Ok(pilot)
    }

    /// Runs a pilot, which places the levels down to a failure.
    ///
    /// # Errors
    /// Errors of the problem.
    pub(super) fn run_pilot<P: LimitState>(
        problem: &P,
        effort: SplittingConfig,
        seed: u64,
        attempt: usize,
        counter: &ProgressCounter<'_>,
    ) -> Result<Self, P::Error> {
        let effort = effort.clamped();
        let samples = effort.samples * PILOT_FACTORS.get(attempt).copied().unwrap_or(1);
        let stream_number = if attempt == 0 {
            0
        } else {
            LATER_PILOT_STREAM_OFFSET + attempt as u64
        };
        let random = stream(seed, Purpose::RareEvents, stream_number);
        let mut particles = ParticlePopulation::new(problem, samples, random, counter);
        let mut population = particles.sample_initial()?;
        let mut pilot = Self {
            effort,
            seed,
            stages: Vec::new(),
            pilot_runs: 0,
            pilot_draws: samples as u64,
            pilot_failures: count_failures(&population),
            reaches_failure: false,
            pilot_levels: Vec::new(),
        };
        while let Some(mut stage) = pilot.place_next_stage(&population, samples) {
            let survivors = stage.survivors(population);
            let share = survivors.len() as f64 / samples as f64;
            population = particles.resample(survivors);
            let moves = particles.move_and_adapt_step(&mut population, &mut stage)?;
            let probability_before = pilot
                .pilot_levels
                .last()
                .map_or(1.0, |level| level.probability);
            pilot.pilot_levels.push(Level {
                margin: stage.threshold,
                probability: probability_before * share,
                share,
                step: Some(stage.step),
                acceptance: Some(moves.acceptance()),
                ..Level::default()
            });
            pilot.stages.push(stage);
        }
        pilot.pilot_runs = particles.evaluations;
        Ok(pilot)
    }

    /// Returns the next stage, before its step is adapted. At a failure, or if no level can follow, returns `None`,
    /// after it has added the last stage if there is one.
    fn place_next_stage(
        &mut self,
        population: &[Particle],
        samples: usize,
    ) -> Option<SplittingStage> {
        let before = self.stages.last();
        let step = before.map_or(FIRST_STEP, |stage| stage.step);
        let threshold_before = before.map_or(f64::INFINITY, |stage| stage.threshold);
        match NextLevel::after(population, samples, threshold_before) {
            NextLevel::Failure => {
                self.stages.push(SplittingStage::LAST);
                self.reaches_failure = true;
                None
            }
            NextLevel::Threshold(threshold) if self.stages.len() < MAX_LEVELS => {
                Some(SplittingStage {
                    threshold,
                    is_last: false,
                    step,
                })
            }
            NextLevel::Threshold(_) | NextLevel::Stuck => None,
        }
    }

    /// True if the pilot reached a failure.
    #[must_use]
    pub fn reaches_failure(&self) -> bool {
        self.reaches_failure
    }

    /// Returns the maximum number of runs of the repetitions.
    #[must_use]
    pub fn planned_runs(&self) -> u64 {
        let moves = MOVES_PER_LEVEL * self.stages.len().saturating_sub(1);
        if self.reaches_failure {
            (self.effort.repetition_count * self.effort.samples * (1 + moves)) as u64
        } else {
            0
        }
    }

    fn pilot_estimate(&self) -> RareEstimate {
        RareEstimate {
            evaluations: self.pilot_runs,
            independent_runs: self.pilot_draws,
            independent_failures: self.pilot_failures,
            levels: self.pilot_levels.clone(),
            ..RareEstimate::default()
        }
    }

    /// Runs some of the repetitions; each depends only on the seed and its number.
    ///
    /// # Errors
    /// Errors of the problem.
    pub(super) fn run_repetitions<P: LimitState>(
        &self,
        problem: &P,
        repetitions: Range<u64>,
        counter: &ProgressCounter<'_>,
    ) -> Result<Vec<Repetition>, P::Error> {
        let planned = if self.reaches_failure {
            self.effort.repetition_count as u64
        } else {
            0
        };
        let repetitions = repetitions.start..repetitions.end.min(planned);
        repetitions
            .into_par_iter()
            .map(|index| {
                let random = stream(self.seed, Purpose::RareEvents, 1 + index);
                let choice_stream = FAILURE_STREAM_OFFSET + index;
                let choice = FailureChoice {
                    most: MAX_KEPT_FAILURES.div_ceil(self.effort.repetition_count),
                    random: stream(self.seed, Purpose::RareEvents, choice_stream),
                };
                ParticlePopulation::new(problem, self.effort.samples, random, counter)
                    .descend(&self.stages, choice)
            })
            .collect()
    }

    /// Runs all repetitions. The result does not depend on the number of threads.
    ///
    /// # Errors
    /// Errors of the problem.
    pub(super) fn estimate<P: LimitState>(
        &self,
        problem: &P,
        counter: &ProgressCounter<'_>,
    ) -> Result<RareEstimate, P::Error> {
        Ok(self.summary(self.run_repetitions(problem, 0..u64::MAX, counter)?))
    }

    /// Returns the number of repetitions between checkpoints: at least one per thread, and more if they are short.
    pub(super) fn repetitions_per_write(&self) -> u64 {
        let runs_each = (self.planned_runs() / self.effort.repetition_count.max(1) as u64).max(1);
        MIN_RUNS_PER_WRITE
            .div_ceil(runs_each)
            .max(rayon::current_num_threads() as u64)
    }

    pub(super) fn is_placed_by(&self, effort: SplittingConfig, seed: u64) -> bool {
        self.effort == effort.clamped() && self.seed == seed
    }

    pub(super) fn is_consistent_with(&self, repetitions: &[Repetition], dimension: usize) -> bool {
        let samples = self.effort.samples as u64;
        let max_moves = samples.saturating_mul(MOVES_PER_LEVEL as u64);
        let max_evaluations = max_moves
            .saturating_mul(self.stages.len() as u64)
            .saturating_add(samples);
        repetitions.iter().all(|repetition| {
            repetition.levels.len() <= self.stages.len()
                && repetition.initial_failures <= samples
                && repetition.failed.len() <= MAX_KEPT_FAILURES
                && repetition
                    .failed
                    .iter()
                    .all(|run| run.is_possible(dimension))
                && repetition.evaluations <= max_evaluations
                && repetition
                    .levels
                    .iter()
                    .all(|level| level.is_possible(max_moves))
        })
    }

    /// Returns the estimate from all repetitions, in order.
    #[must_use]
    pub fn summary(&self, repetitions: Vec<Repetition>) -> RareEstimate {
        if !self.reaches_failure {
            return self.pilot_estimate();
        }
        let independent_failures = repetitions
            .iter()
            .map(|repetition| repetition.initial_failures)
            .fold(self.pilot_failures, u64::saturating_add);
        let evaluations = repetitions
            .iter()
            .map(|repetition| repetition.evaluations)
            .fold(self.pilot_runs, u64::saturating_add);
        let stages = self.stages.iter().enumerate();
        let estimate = RareEstimate {
            evaluations,
            independent_runs: (1 + repetitions.len() as u64) * self.effort.samples as u64,
            independent_failures,
            levels: stages
                .map(|(index, stage)| stage.summary(index, &repetitions))
                .collect(),
            ..RareEstimate::default()
        };
        estimate.with_repetitions(probabilities_down_to(&repetitions, self.stages.len()))
    }
}

impl Repetition {
    /// Returns the probability of a failure that this repetition estimates, if its population reached one.
    pub(super) fn probability(&self) -> f64 {
        self.levels.iter().map(|stats| stats.share).product()
    }

    pub(super) fn failed_runs(&self) -> &[FailedRun] {
        &self.failed
    }
}

impl LevelStats {
    /// True if a population can have these statistics after at most `max_moves` moves.
    fn is_possible(&self, max_moves: u64) -> bool {
        (0.0..=1.0).contains(&self.share)
            && self.accepted <= self.proposed
            && self.proposed <= max_moves
    }
}

impl SplittingStage {
    /// Returns the particles that pass this level.
    fn survivors(&self, population: Vec<Particle>) -> Vec<Particle> {
        population
            .into_iter()
            .filter(|(_, margin)| self.passes(*margin))
            .collect()
    }

    /// Returns the means of the repetitions at this stage, the `index`-th one.
    fn summary(&self, index: usize, repetitions: &[Repetition]) -> Level {
        let mut shares = Vec::new();
        let mut moves = MoveCounts::default();
        for stats in repetitions
            .iter()
            .filter_map(|repetition| repetition.levels.get(index))
        {
            shares.push(stats.share);
            moves.add(MoveCounts {
                accepted: stats.accepted,
                proposed: stats.proposed,
            });
        }
        Level {
            margin: self.threshold,
            probability: mean(&probabilities_down_to(repetitions, index + 1)),
            share: mean(&shares),
            step: (!self.is_last).then_some(self.step),
            acceptance: (moves.proposed > 0).then(|| moves.acceptance()),
            ..Level::default()
        }
    }
}

/// Returns the probability that each repetition estimates for reaching a number of levels: the product of the shares,
/// or 0 if its population did not reach them.
fn probabilities_down_to(repetitions: &[Repetition], levels: usize) -> Vec<f64> {
    let probabilities = repetitions.iter().map(|repetition| {
        if repetition.levels.len() < levels {
            return 0.0;
        }
        let reached = repetition.levels.iter().take(levels);
        reached.map(|stats| stats.share).product()
    });
    probabilities.collect()
}

/// Next level of a pilot.
enum NextLevel {
    /// Enough of the population fails, or its level lies below zero.
    Failure,
    /// Margin down to which the population passes.
    Threshold(f64),
    /// No margin is smaller than the earlier level.
    Stuck,
}

impl NextLevel {
    /// Places the level after `threshold_before`: the quantile of the margins that [`LEVEL_SHARE`] of the population
    /// passes.
    fn after(population: &[Particle], samples: usize, threshold_before: f64) -> Self {
        let passing = (LEVEL_SHARE * samples as f64).ceil() as usize;
        if count_failures(population) >= passing as u64 {
            return Self::Failure;
        }
        let mut margins: Vec<f64> = population.iter().map(|(_, margin)| *margin).collect();
        margins.sort_by(f64::total_cmp);
        let quantile = margins.get(passing - 1).copied().unwrap_or(f64::INFINITY);
        // If most of the population has the same margin, the level is the next smaller margin, even if few runs pass.
        let plateau = threshold_before.min(margins.last().copied().unwrap_or(threshold_before));
        let threshold = if quantile < plateau {
            Some(quantile)
        } else {
            margins.into_iter().rev().find(|margin| *margin < plateau)
        };
        match threshold {
            Some(threshold) if threshold < 0.0 => Self::Failure,
            Some(threshold) => Self::Threshold(threshold),
            None => Self::Stuck,
        }
    }
}

/// Numbers of moves, without those that resampled all noise.
#[derive(Clone, Copy, Default)]
struct MoveCounts {
    accepted: u64,
    proposed: u64,
}

impl MoveCounts {
    fn add(&mut self, more: Self) {
        self.accepted = self.accepted.saturating_add(more.accepted);
        self.proposed = self.proposed.saturating_add(more.proposed);
    }

    fn acceptance(self) -> f64 {
        self.accepted as f64 / self.proposed.max(1) as f64
    }
}

impl RareEstimate {
    /// Sets mean and spread of independent repetitions.
    fn with_repetitions(self, repetitions: Vec<f64>) -> Self {
        let mean = mean(&repetitions);
        let coefficient_of_variation = variation_of_mean(&repetitions, mean);
        let estimate = Self {
            probability: Some(mean),
            coefficient_of_variation,
            repetitions,
            ..self
        };
        Self {
            interval_95: estimate.interval(0.95),
            ..estimate
        }
    }

    /// Returns a confidence interval of the probability, computed as [`Self::interval_95`].
    #[must_use]
    pub fn interval(&self, confidence: f64) -> Option<[f64; 2]> {
        let probability = self.probability?;
        let variation = self.coefficient_of_variation?;
        match self.counted_failures() {
            Some((failures, runs)) => {
                let RateInterval { lower, upper } =
                    RateInterval::clopper_pearson(failures, runs, confidence);
                Some([lower, upper])
            }
            None => lognormal_interval(probability, variation, self.repetitions.len(), confidence),
        }
    }

    /// Returns failures and runs of the repetitions if failure is the only level: then runs are counted, not split. If
    /// all runs fail, the spread is zero and meaningless.
    fn counted_failures(&self) -> Option<(u64, u64)> {
        let repetitions = self.repetitions.len() as u64;
        let runs_each = self.independent_runs / (1 + repetitions);
        let is_counted = self.levels.len() == 1 && runs_each > 0 && repetitions > 0;
        is_counted.then(|| {
            let failures = self
                .repetitions
                .iter()
                .map(|share| (share * runs_each as f64).round() as u64)
                .sum();
            (failures, runs_each * repetitions)
        })
    }

    /// Returns the Clopper-Pearson interval of the independent initial samples; `None` if their number is unknown.
    #[must_use]
    pub fn independent_interval(&self, confidence: f64) -> Option<[f64; 2]> {
        let runs = self.independent_runs;
        let RateInterval { lower, upper } = (runs > 0)
            .then(|| RateInterval::clopper_pearson(self.independent_failures, runs, confidence))?;
        Some([lower, upper])
    }
}

fn count_failures(population: &[Particle]) -> u64 {
    population
        .iter()
        .filter(|(_, margin)| *margin < 0.0)
        .count() as u64
}

impl<'a, P: LimitState> ParticlePopulation<'a, P> {
    pub(super) fn new(
        problem: &'a P,
        samples: usize,
        random: Stream,
        counter: &'a ProgressCounter<'a>,
    ) -> Self {
        Self {
            problem,
            samples,
            random,
            evaluations: 0,
            counter,
        }
    }

    /// Moves a population down the levels. The repetition has the statistics of each level that the population
    /// reached.
    fn descend(
        mut self,
        stages: &[SplittingStage],
        mut choice: FailureChoice,
    ) -> Result<Repetition, P::Error> {
        let mut population = self.sample_initial()?;
        let initial_failures = count_failures(&population);
        let mut failed = Vec::new();
        let mut levels = Vec::with_capacity(stages.len());
        for stage in stages {
            let survivors = stage.survivors(population);
            let share = survivors.len() as f64 / self.samples as f64;
            let mut moves = MoveCounts::default();
            if stage.is_last {
                failed = choose(&survivors, choice.most, &mut choice.random);
            }
            population = self.resample(survivors);
            if !stage.is_last && !population.is_empty() {
                for _ in 0..MOVES_PER_LEVEL {
                    moves.add(self.mcmc_move(&mut population, stage)?);
                }
            }
            levels.push(LevelStats {
                share,
                accepted: moves.accepted,
                proposed: moves.proposed,
            });
            if population.is_empty() {
                break;
            }
        }
        Ok(Repetition {
            initial_failures,
            levels,
            evaluations: self.evaluations,
            failed,
        })
    }

    fn sample_initial(&mut self) -> Result<Vec<Particle>, P::Error> {
        let dimension = self.problem.dimension();
        let states: Vec<RandomInputs> = (0..self.samples)
            .map(|_| RandomInputs::sample(dimension, &mut self.random))
            .collect();
        let margins = self.evaluate_margins(&states)?;
        Ok(states.into_iter().zip(margins).collect())
    }

    /// Restores the population size with equally many copies of each survivor; random survivors get one more.
    fn resample(&mut self, mut survivors: Vec<Particle>) -> Vec<Particle> {
        let alive = survivors.len();
        if alive == 0 {
            return survivors;
        }
        for index in 0..self.samples % alive {
            let random_index = self.random.random_range(index..alive);
            survivors.swap(index, random_index);
        }
        survivors
            .iter()
            .cycle()
            .take(self.samples)
            .cloned()
            .collect()
    }

    /// Moves the population within a new level, and adapts the step of the level to the acceptance after each move.
    fn move_and_adapt_step(
        &mut self,
        population: &mut [Particle],
        stage: &mut SplittingStage,
    ) -> Result<MoveCounts, P::Error> {
        let mut all_moves = MoveCounts::default();
        for _ in 0..MOVES_PER_LEVEL {
            let moves = self.mcmc_move(population, stage)?;
            let excess = moves.acceptance() - TARGET_ACCEPTANCE;
            stage.step = (stage.step * (STEP_ADAPTATION_RATE * excess).exp()).clamp(MIN_STEP, 1.0);
            all_moves.add(moves);
        }
        Ok(all_moves)
    }

    /// Moves every run once; a move that would leave the level is rejected.
    fn mcmc_move(
        &mut self,
        population: &mut [Particle],
        stage: &SplittingStage,
    ) -> Result<MoveCounts, P::Error> {
        let (proposals, all_new): (Vec<RandomInputs>, Vec<bool>) = population
            .iter()
            .map(|(state, _)| state.propose(stage.step, &mut self.random))
            .unzip();
        let margins = self.evaluate_margins(&proposals)?;
        let mut moves = MoveCounts::default();
        for ((sample, is_all_new), (proposal, margin)) in population
            .iter_mut()
            .zip(all_new)
            .zip(proposals.into_iter().zip(margins))
        {
            let passes = stage.passes(margin);
            if !is_all_new {
                moves.proposed += 1;
                moves.accepted += u64::from(passes);
            }
            if passes {
                *sample = (proposal, margin);
            }
        }
        Ok(moves)
    }

    fn evaluate_margins(&mut self, states: &[RandomInputs]) -> Result<Vec<f64>, P::Error> {
        let mut margins = self.problem.margins(states)?;
        margins
            .iter_mut()
            .filter(|margin| margin.is_nan())
            .for_each(|margin| *margin = f64::INFINITY);
        self.evaluations += states.len() as u64;
        self.counter.add(states.len() as u64)?;
        Ok(margins)
    }
}

impl RandomInputs {
    fn sample(dimension: usize, random: &mut Stream) -> Self {
        Self {
            normal: (0..dimension)
                .map(|_| StandardNormal.sample(random))
                .collect(),
            noise: vec![NoiseShare {
                seed: new_noise_seed(random),
                weight: 1.0,
            }],
        }
    }

    /// Proposes a move by an autoregressive step, which preserves the normal distribution (Neal, 1998; "preconditioned
    /// Crank-Nicolson"). Returns it, and true if it resampled all noise.
    fn propose(&self, step: f64, random: &mut Stream) -> (Self, bool) {
        let retained = (1.0 - step * step).sqrt();
        let is_all_new = random.random::<f64>() < NEW_NOISE_SHARE;
        let new = NoiseShare {
            seed: new_noise_seed(random),
            weight: if is_all_new { 1.0 } else { step },
        };
        let noise = if is_all_new {
            vec![new]
        } else {
            move_noise(&self.noise, retained, new)
        };
        let normal = self.normal.iter().map(|x| {
            let innovation: f64 = StandardNormal.sample(random);
            retained * x + step * innovation
        });
        let proposal = Self {
            normal: normal.collect(),
            noise,
        };
        (proposal, is_all_new)
    }
}

/// Returns the noise after an autoregressive step.
fn move_noise(noise: &[NoiseShare], retained: f64, new: NoiseShare) -> Vec<NoiseShare> {
    let shrunk = noise.iter().map(|share| NoiseShare {
        weight: retained * share.weight,
        ..*share
    });
    // The first seed stays, because other random numbers depend on it.
    let relevant = shrunk
        .enumerate()
        .filter(|(index, share)| *index == 0 || share.weight > MIN_NOISE_WEIGHT);
    relevant.map(|(_, share)| share).chain([new]).collect()
}

/// Returns a seed that fits the signed integers of scenario files.
fn new_noise_seed(random: &mut Stream) -> u64 {
    random.random::<u64>() >> 1
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Returns the standard deviation of the mean, relative to the mean.
fn variation_of_mean(values: &[f64], mean: f64) -> Option<f64> {
    let n = values.len() as f64;
    let variance = values
        .iter()
        .map(|value| (value - mean) * (value - mean))
        .sum::<f64>()
        / (n - 1.0);
    (mean > 0.0).then(|| (variance / n).sqrt() / mean)
}

/// Returns the interval of a log-normal mean: products of many shares are nearly log-normal.
fn lognormal_interval(
    mean: f64,
    variation: f64,
    repetitions: usize,
    confidence: f64,
) -> Option<[f64; 2]> {
    let student = StudentsT::new(0.0, 1.0, repetitions as f64 - 1.0).ok()?;
    let factor = (student.inverse_cdf(0.5 + 0.5 * confidence)
        * (variation * variation).ln_1p().sqrt())
    .exp();
    Some([mean / factor, (mean * factor).min(1.0)])
}
