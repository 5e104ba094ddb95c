//! Multilevel splitting: a pilot that places the levels, and unbiased repetitions.

use std::ops::Range;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

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

type Particle = (RandomInputs, f64);

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
        let first = (pilot.pilot_draws, pilot.pilot_failures);
        for attempt in 1..PILOT_FACTORS.len() {
            if pilot.reaches_failure {
                break;
            }
            let next = Self::run_pilot(problem, effort, seed, attempt, counter)?;
            // Earlier samples decide if a further pilot runs, so its samples may not be pooled with them. If
            // repetitions follow, only the first pilot's samples count.
            let (draws, failures) = match next.reaches_failure {
                true => first,
                false => (
                    pilot.pilot_draws + next.pilot_draws,
                    pilot.pilot_failures + next.pilot_failures,
                ),
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

    pub(super) fn run_pilot<P: LimitState>(
        problem: &P,
        effort: SplittingConfig,
        seed: u64,
        attempt: usize,
        counter: &ProgressCounter<'_>,
    ) -> Result<Self, P::Error> {
        let effort = effort.clamped();
        let samples = effort.samples * PILOT_FACTORS.get(attempt).copied().unwrap_or(1);
        let own = if attempt == 0 {
            0
        } else {
            LATER_PILOT_STREAM_OFFSET + attempt as u64
        };
        let mut climber = ParticlePopulation::new(
            problem,
            samples,
            stream(seed, Purpose::RareEvents, own),
            counter,
        );
        let mut population = climber.sample_initial()?;
        let (pilot_draws, pilot_failures) = (samples as u64, count_failures(&population));
        let (stages, pilot_levels) = (Vec::new(), Vec::new());
        let mut pilot = Self {
            effort,
            seed,
            stages,
            pilot_runs: 0,
            pilot_draws,
            pilot_failures,
            reaches_failure: false,
            pilot_levels,
        };
        let (mut step, mut probability, mut before) = (0.5, 1.0, f64::INFINITY);
        let passing = (LEVEL_SHARE * samples as f64).ceil() as usize;
        loop {
            if count_failures(&population) >= passing as u64 {
                pilot.stages.push(SplittingStage::LAST);
                pilot.reaches_failure = true;
                break;
            }
            let mut margins: Vec<f64> = population.iter().map(|(_, margin)| *margin).collect();
            margins.sort_by(f64::total_cmp);
            let quantile = margins.get(passing - 1).copied().unwrap_or(f64::INFINITY);
            // If most of the population has the same margin, the level is the next smaller margin, even if few runs
            // pass.
            let plateau = before.min(margins.last().copied().unwrap_or(before));
            let below = margins
                .iter()
                .rev()
                .copied()
                .find(|margin| *margin < plateau);
            let Some(threshold) = (if quantile < plateau {
                Some(quantile)
            } else {
                below
            }) else {
                break;
            };
            if threshold < 0.0 {
                pilot.stages.push(SplittingStage::LAST);
                pilot.reaches_failure = true;
                break;
            }
            if pilot.stages.len() == MAX_LEVELS {
                break;
            }
            let mut stage = SplittingStage {
                threshold,
                is_last: false,
                step,
            };
            let survivors: Vec<Particle> = population
                .into_iter()
                .filter(|(_, margin)| stage.passes(*margin))
                .collect();
            let share = survivors.len() as f64 / samples as f64;
            probability *= share;
            population = climber.resample(survivors);
            let (mut accepted, mut proposed) = (0, 0);
            for _ in 0..MOVES_PER_LEVEL {
                let (taken, tried) = climber.mcmc_move(&mut population, &stage)?;
                let acceptance = taken as f64 / tried.max(1) as f64;
                stage.step = (stage.step
                    * (STEP_ADAPTATION_RATE * (acceptance - TARGET_ACCEPTANCE)).exp())
                .clamp(MIN_STEP, 1.0);
                (accepted, proposed) = (accepted + taken, proposed + tried);
            }
            (step, before) = (stage.step, threshold);
            pilot.stages.push(stage);
            let acceptance = Some(accepted as f64 / proposed.max(1) as f64);
            let step = Some(step);
            pilot.pilot_levels.push(Level {
                margin: threshold,
                probability,
                share,
                step,
                acceptance,
                ..Level::default()
            });
        }
        pilot.pilot_runs = climber.evaluations;
        Ok(pilot)
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
            (self.effort.repetitions * self.effort.samples * (1 + moves)) as u64
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
            self.effort.repetitions as u64
        } else {
            0
        };
        let repetitions = repetitions.start..repetitions.end.min(planned);
        let repeat = |index: u64| {
            let random = stream(self.seed, Purpose::RareEvents, 1 + index);
            let mut climber =
                ParticlePopulation::new(problem, self.effort.samples, random, counter);
            let (initial_failures, levels) = climber.climb(&self.stages)?;
            Ok(Repetition {
                initial_failures,
                levels,
                evaluations: climber.evaluations,
            })
        };
        repetitions.into_par_iter().map(repeat).collect()
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
        let each = (self.planned_runs() / self.effort.repetitions.max(1) as u64).max(1);
        MIN_RUNS_PER_WRITE
            .div_ceil(each)
            .max(rayon::current_num_threads() as u64)
    }

    pub(super) fn is_placed_by(&self, effort: SplittingConfig, seed: u64) -> bool {
        self.effort == effort.clamped() && self.seed == seed
    }

    pub(super) fn is_consistent_with(&self, repetitions: &[Repetition]) -> bool {
        let samples = self.effort.samples as u64;
        let moves = samples.saturating_mul(MOVES_PER_LEVEL as u64);
        let is_share = |seen: &LevelStats| {
            (0.0..=1.0).contains(&seen.share)
                && seen.accepted <= seen.proposed
                && seen.proposed <= moves
        };
        let may_be = |one: &Repetition| {
            let most = moves
                .saturating_mul(self.stages.len() as u64)
                .saturating_add(samples);
            let is_short = one.levels.len() <= self.stages.len() && one.initial_failures <= samples;
            is_short && one.levels.iter().all(is_share) && one.evaluations <= most
        };
        repetitions.iter().all(may_be)
    }

    /// Returns the estimate from all repetitions, in order.
    #[must_use]
    pub fn summary(&self, repeated: Vec<Repetition>) -> RareEstimate {
        let independent_runs = (1 + repeated.len() as u64) * self.effort.samples as u64;
        let independent_failures = repeated
            .iter()
            .map(|one| one.initial_failures)
            .fold(self.pilot_failures, u64::saturating_add);
        if !self.reaches_failure {
            return self.pilot_estimate();
        }
        let evaluations = repeated
            .iter()
            .map(|one| one.evaluations)
            .fold(self.pilot_runs, u64::saturating_add);
        let seen: Vec<Vec<LevelStats>> = repeated.into_iter().map(|one| one.levels).collect();
        let product = |seen: &Vec<LevelStats>, levels: usize| -> f64 {
            if seen.len() < levels {
                0.0
            } else {
                seen.iter().take(levels).map(|seen| seen.share).product()
            }
        };
        let levels = self.stages.iter().enumerate().map(|(index, stage)| {
            let here: Vec<&LevelStats> = seen.iter().filter_map(|seen| seen.get(index)).collect();
            let sum =
                |of: fn(&&LevelStats) -> u64| here.iter().map(of).fold(0, u64::saturating_add);
            let [accepted, proposed] = [sum(|seen| seen.accepted), sum(|seen| seen.proposed)];
            Level {
                margin: stage.threshold,
                probability: mean(
                    &seen
                        .iter()
                        .map(|seen| product(seen, index + 1))
                        .collect::<Vec<_>>(),
                ),
                share: mean(&here.iter().map(|seen| seen.share).collect::<Vec<_>>()),
                step: (!stage.is_last).then_some(stage.step),
                acceptance: (proposed > 0).then(|| accepted as f64 / proposed as f64),
                ..Level::default()
            }
        });
        let levels: Vec<Level> = levels.collect();
        let repetitions: Vec<f64> = seen
            .iter()
            .map(|seen| product(seen, self.stages.len()))
            .collect();
        let begun = RareEstimate {
            evaluations,
            independent_runs,
            independent_failures,
            levels,
            ..RareEstimate::default()
        };
        begun.with_repetitions(repetitions)
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
        let (probability, variation) = (self.probability?, self.coefficient_of_variation?);
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
        let each = self.independent_runs / (1 + repetitions);
        let is_counted = self.levels.len() == 1 && each > 0 && repetitions > 0;
        is_counted.then(|| {
            let failures = self
                .repetitions
                .iter()
                .map(|share| (share * each as f64).round() as u64)
                .sum();
            (failures, each * repetitions)
        })
    }

    /// Returns the Clopper-Pearson interval of the independent initial samples; `None` if their number is unknown.
    #[must_use]
    pub fn independent_interval(&self, confidence: f64) -> Option<[f64; 2]> {
        let (failures, runs) = (self.independent_failures, self.independent_runs);
        let RateInterval { lower, upper } =
            (runs > 0).then(|| RateInterval::clopper_pearson(failures, runs, confidence))?;
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

    /// Moves a population down the levels, and returns the number of failed initial runs and the statistics of each
    /// level that the population reached.
    fn climb(&mut self, stages: &[SplittingStage]) -> Result<(u64, Vec<LevelStats>), P::Error> {
        let mut population = self.sample_initial()?;
        let failures = count_failures(&population);
        let mut levels = Vec::with_capacity(stages.len());
        for stage in stages {
            let survivors: Vec<Particle> = population
                .into_iter()
                .filter(|(_, margin)| stage.passes(*margin))
                .collect();
            let share = survivors.len() as f64 / self.samples as f64;
            let mut here = LevelStats {
                share,
                accepted: 0,
                proposed: 0,
            };
            population = self.resample(survivors);
            if !stage.is_last && !population.is_empty() {
                for _ in 0..MOVES_PER_LEVEL {
                    let (accepted, proposed) = self.mcmc_move(&mut population, stage)?;
                    here = LevelStats {
                        accepted: here.accepted + accepted,
                        proposed: here.proposed + proposed,
                        ..here
                    };
                }
            }
            levels.push(here);
            if population.is_empty() {
                break;
            }
        }
        Ok((failures, levels))
    }

    fn sample_initial(&mut self) -> Result<Vec<Particle>, P::Error> {
        let dimension = self.problem.dimension();
        let draw = |random: &mut Stream| RandomInputs {
            normal: (0..dimension)
                .map(|_| StandardNormal.sample(random))
                .collect(),
            noise: vec![NoiseShare {
                seed: new_noise_seed(random),
                weight: 1.0,
            }],
        };
        let states: Vec<RandomInputs> = (0..self.samples).map(|_| draw(&mut self.random)).collect();
        let margins = self.evaluate_margins(&states)?;
        Ok(states.into_iter().zip(margins).collect())
    }

    /// Restores the population size with equally many copies of each survivor; random survivors get one more.
    fn resample(&mut self, mut survivors: Vec<Particle>) -> Vec<Particle> {
        let alive = survivors.len();
        if alive == 0 {
            return survivors;
        }
        for place in 0..self.samples % alive {
            let other = self.random.random_range(place..alive);
            survivors.swap(place, other);
        }
        survivors
            .iter()
            .cycle()
            .take(self.samples)
            .cloned()
            .collect()
    }

    /// Moves every run once; a move that would leave the level is rejected. Returns the numbers of accepted and
    /// proposed moves, without those that resampled all noise.
    fn mcmc_move(
        &mut self,
        population: &mut [Particle],
        stage: &SplittingStage,
    ) -> Result<(u64, u64), P::Error> {
        // An autoregressive step preserves the normal distribution (Neal, 1998; "preconditioned Crank-Nicolson").
        let kept = (1.0 - stage.step * stage.step).sqrt();
        let propose = |(state, _): &Particle, random: &mut Stream| {
            let is_all_new = random.random::<f64>() < NEW_NOISE_SHARE;
            let new = NoiseShare {
                seed: new_noise_seed(random),
                weight: if is_all_new { 1.0 } else { stage.step },
            };
            let noise = if is_all_new {
                vec![new]
            } else {
                move_noise(&state.noise, kept, new)
            };
            let normal = |x: &f64| -> f64 {
                let drawn: f64 = StandardNormal.sample(random);
                kept * x + stage.step * drawn
            };
            (
                RandomInputs {
                    normal: state.normal.iter().map(normal).collect(),
                    noise,
                },
                is_all_new,
            )
        };
        let (proposals, all_new): (Vec<RandomInputs>, Vec<bool>) = population
            .iter()
            .map(|sample| propose(sample, &mut self.random))
            .unzip();
        let margins = self.evaluate_margins(&proposals)?;
        let (mut accepted, mut proposed) = (0, 0);
        for ((sample, is_all_new), (proposal, margin)) in population
            .iter_mut()
            .zip(all_new)
            .zip(proposals.into_iter().zip(margins))
        {
            let passes = stage.passes(margin);
            if !is_all_new {
                proposed += 1;
                accepted += u64::from(passes);
            }
            if passes {
                *sample = (proposal, margin);
            }
        }
        Ok((accepted, proposed))
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

/// Returns the noise after an autoregressive step.
fn move_noise(noise: &[NoiseShare], kept: f64, new: NoiseShare) -> Vec<NoiseShare> {
    let shrunk = noise.iter().map(|share| NoiseShare {
        weight: kept * share.weight,
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
