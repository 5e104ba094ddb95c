//! The climb: a pilot that places the levels, and repetitions that are unbiased.

use std::ops::Range;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{Level, RareEstimate, SplittingConfig};
use crate::RateInterval;
use crumple_core::observer::{ProgressCounter, Stopped};
use crumple_world::random::{Purpose, Stream, stream};

/// Levels after which the pilot gives up: failures are then rarer than about 10⁻¹².
pub const MAX_LEVELS: usize = 18;
/// Populations of pilots, as multiples of that of a repetition: the next one climbs where those before reached no failure. A population that is small
/// may be led by its levels to where margins are small and nothing fails; one that is larger keeps more ways open.
pub const PILOT_FACTORS: [usize; 3] = [1, 2, 4];
/// Streams of all pilots but the first; those of repetitions are counted from 1.
const LATER_PILOT_STREAM_OFFSET: u64 = 1 << 41;
/// Share of a population that passes a level.
const LEVEL_SHARE: f64 = 0.2;
/// Moves of each run below each level.
const MOVES_PER_LEVEL: usize = 4;
/// Share of moves that also draw the noise anew.
const NEW_NOISE_SHARE: f64 = 0.25;
/// Acceptance at which a random walk gets on fastest (Papaioannou and others, MCMC algorithms for subset simulation, 2015).
const TARGET_ACCEPTANCE: f64 = 0.44;
/// How strongly the pilot's step reacts to the acceptance.
const STEP_ADAPTATION_RATE: f64 = 1.5;
const MIN_STEP: f64 = 0.02;

/// Everything that chance decides in a run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RandomInputs {
    /// Independent standard normal numbers, one a parameter.
    pub normal: Vec<f64>,
    /// Seed of all noise.
    pub noise_seed: u64,
}

/// Runs with a margin.
pub(super) trait LimitState: Sync {
    /// Why a run cannot be made.
    type Error: From<Stopped> + Send;

    /// How many standard normal numbers decide a run.
    fn dimension(&self) -> usize;

    /// The margins of runs, in their order: negative where the run fails. NaN counts as far from failing.
    ///
    /// # Errors
    /// The first run that cannot be made.
    fn margins(&self, states: &[RandomInputs]) -> Result<Vec<f64>, Self::Error>;
}

/// The levels that a pilot has placed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplittingLevels {
    effort: SplittingConfig,
    seed: u64,
    stages: Vec<SplittingStage>,
    /// How many runs the pilots took.
    #[serde(rename = "pilot")]
    pilot_runs: u64,
    /// With how many independent draws they began: where a failure was reached, the first alone.
    pilot_draws: u64,
    /// How many of those failed.
    pilot_failures: u64,
    #[serde(rename = "reached")]
    reaches_failure: bool,
    /// What the pilot saw, for want of anything better where it does not reach a failure.
    pilot_levels: Vec<Level>,
}

/// A level on the way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SplittingStage {
    threshold: f64,
    is_last: bool,
    step: f64,
}

impl SplittingStage {
    const LAST: Self = Self { threshold: 0.0, is_last: true, step: 1.0 };

    fn passes(&self, margin: f64) -> bool {
        if self.is_last { margin < 0.0 } else { margin <= self.threshold }
    }
}

/// A run and its margin.
pub(super) type Particle = (RandomInputs, f64);

/// One population, with a stream of its own.
pub(super) struct ParticlePopulation<'a, P: LimitState> {
    problem: &'a P,
    samples: usize,
    random: Stream,
    pub(super) evaluations: u64,
    counter: &'a ProgressCounter<'a>,
}

/// What came of one repetition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Repetition {
    /// How many runs failed of those that it began with.
    #[serde(rename = "failures")]
    initial_failures: u64,
    /// At each level that it reached.
    #[serde(rename = "seen")]
    levels: Vec<LevelStats>,
    /// Runs made.
    evaluations: u64,
}

/// What a repetition saw at one level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LevelStats {
    share: f64,
    accepted: u64,
    proposed: u64,
}

impl SplittingLevels {
    /// Runs the pilot, and larger ones where it reaches no failure.
    ///
    /// # Errors
    /// Those of the problem.
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
            // Whether there is a next one is not independent of what the draws before came to: with repetitions, those do that there are
            // in any case.
            let (draws, failures) = match next.reaches_failure {
                true => first,
                false => (pilot.pilot_draws + next.pilot_draws, pilot.pilot_failures + next.pilot_failures),
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

    /// What one of the pilots comes to.
    pub(super) fn run_pilot<P: LimitState>(
        problem: &P,
        effort: SplittingConfig,
        seed: u64,
        attempt: usize,
        counter: &ProgressCounter<'_>,
    ) -> Result<Self, P::Error> {
        let effort = effort.clamped();
        let samples = effort.samples * PILOT_FACTORS.get(attempt).copied().unwrap_or(1);
        let own = if attempt == 0 { 0 } else { LATER_PILOT_STREAM_OFFSET + attempt as u64 };
        let mut climber = ParticlePopulation::new(problem, samples, stream(seed, Purpose::RareEvents, own), counter);
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
            // Where most of the population lies on a plateau, the level is whatever lies below it, however few that are.
            let plateau = before.min(margins.last().copied().unwrap_or(before));
            let below = margins.iter().rev().copied().find(|margin| *margin < plateau);
            let Some(threshold) = (if quantile < plateau { Some(quantile) } else { below }) else { break };
            if threshold < 0.0 {
                pilot.stages.push(SplittingStage::LAST);
                pilot.reaches_failure = true;
                break;
            }
            if pilot.stages.len() == MAX_LEVELS {
                break;
            }
            let mut stage = SplittingStage { threshold, is_last: false, step };
            let survivors: Vec<Particle> = population.into_iter().filter(|(_, margin)| stage.passes(*margin)).collect();
            let share = survivors.len() as f64 / samples as f64;
            probability *= share;
            population = climber.resample(survivors);
            let (mut accepted, mut proposed) = (0, 0);
            for _ in 0..MOVES_PER_LEVEL {
                let (taken, tried) = climber.mcmc_move(&mut population, &stage)?;
                let acceptance = taken as f64 / tried.max(1) as f64;
                stage.step =
                    (stage.step * (STEP_ADAPTATION_RATE * (acceptance - TARGET_ACCEPTANCE)).exp()).clamp(MIN_STEP, 1.0);
                (accepted, proposed) = (accepted + taken, proposed + tried);
            }
            (step, before) = (stage.step, threshold);
            pilot.stages.push(stage);
            let acceptance = Some(accepted as f64 / proposed.max(1) as f64);
            pilot.pilot_levels.push(Level {
                margin: threshold,
                smallest_gap_m: None,
                probability,
                share,
                step: Some(step),
                acceptance,
            });
        }
        pilot.pilot_runs = climber.evaluations;
        Ok(pilot)
    }

    /// Whether the pilot reached a failure.
    #[must_use]
    pub fn reaches_failure(&self) -> bool {
        self.reaches_failure
    }

    /// How many runs the repetitions will make at most.
    #[must_use]
    pub fn planned_runs(&self) -> u64 {
        let moves = MOVES_PER_LEVEL * self.stages.len().saturating_sub(1);
        if self.reaches_failure { (self.effort.repetitions * self.effort.samples * (1 + moves)) as u64 } else { 0 }
    }

    /// How much work goes into it.
    pub(super) fn effort(&self) -> SplittingConfig {
        self.effort
    }

    /// Seed of everything.
    pub(super) fn seed(&self) -> u64 {
        self.seed
    }

    /// The levels that repetitions climb, the failure last.
    pub(super) fn stages(&self) -> &[SplittingStage] {
        &self.stages
    }

    /// What the pilot alone says.
    pub(super) fn pilot_estimate(&self) -> RareEstimate {
        RareEstimate {
            evaluations: self.pilot_runs,
            independent_runs: self.pilot_draws,
            independent_failures: self.pilot_failures,
            levels: self.pilot_levels.clone(),
            ..RareEstimate::empty()
        }
    }

    /// Runs some of the repetitions: each is a function of the seed and its number alone.
    ///
    /// # Errors
    /// Those of the problem.
    pub(super) fn run_repetitions<P: LimitState>(
        &self,
        problem: &P,
        repetitions: Range<u64>,
        counter: &ProgressCounter<'_>,
    ) -> Result<Vec<Repetition>, P::Error> {
        let repetitions = if self.reaches_failure { repetitions } else { 0..0 };
        let repeat = |index: u64| {
            let random = stream(self.seed, Purpose::RareEvents, 1 + index);
            let mut climber = ParticlePopulation::new(problem, self.effort.samples, random, counter);
            let mut seen = Vec::with_capacity(self.stages.len());
            let failures = climber.climb(&self.stages, None, |here, _| seen.push(here))?;
            Ok(Repetition { initial_failures: failures, levels: seen, evaluations: climber.evaluations })
        };
        repetitions.into_par_iter().map(repeat).collect()
    }

    /// Whether it was placed by that seed with that effort.
    pub(super) fn is_placed_by(&self, effort: SplittingConfig, seed: u64) -> bool {
        self.effort == effort.clamped() && self.seed == seed
    }

    /// Whether these repetitions could have come of it.
    pub(super) fn is_consistent_with(&self, repetitions: &[Repetition]) -> bool {
        let samples = self.effort.samples as u64;
        let moves = samples.saturating_mul(MOVES_PER_LEVEL as u64);
        let is_share = |seen: &LevelStats| {
            (0.0..=1.0).contains(&seen.share) && seen.accepted <= seen.proposed && seen.proposed <= moves
        };
        let may_be = |one: &Repetition| {
            let most = moves.saturating_mul(self.stages.len() as u64).saturating_add(samples);
            let is_short = one.levels.len() <= self.stages.len() && one.initial_failures <= samples;
            is_short && one.levels.iter().all(is_share) && one.evaluations <= most
        };
        repetitions.iter().all(may_be)
    }

    /// What all repetitions come to, in their order.
    #[must_use]
    pub fn summary(&self, repeated: Vec<Repetition>) -> RareEstimate {
        let independent_runs = (1 + repeated.len() as u64) * self.effort.samples as u64;
        let independent_failures =
            repeated.iter().map(|one| one.initial_failures).fold(self.pilot_failures, u64::saturating_add);
        if !self.reaches_failure {
            return self.pilot_estimate();
        }
        let evaluations = repeated.iter().map(|one| one.evaluations).fold(self.pilot_runs, u64::saturating_add);
        let seen: Vec<Vec<LevelStats>> = repeated.into_iter().map(|one| one.levels).collect();
        // A repetition that died out before the last level has seen no failure.
        let product = |seen: &Vec<LevelStats>, levels: usize| -> f64 {
            if seen.len() < levels { 0.0 } else { seen.iter().take(levels).map(|seen| seen.share).product() }
        };
        let levels = self.stages.iter().enumerate().map(|(index, stage)| {
            let here: Vec<&LevelStats> = seen.iter().filter_map(|seen| seen.get(index)).collect();
            let sum = |of: fn(&&LevelStats) -> u64| here.iter().map(of).fold(0, u64::saturating_add);
            let [accepted, proposed] = [sum(|seen| seen.accepted), sum(|seen| seen.proposed)];
            Level {
                margin: stage.threshold,
                smallest_gap_m: None,
                probability: mean(&seen.iter().map(|seen| product(seen, index + 1)).collect::<Vec<_>>()),
                share: mean(&here.iter().map(|seen| seen.share).collect::<Vec<_>>()),
                step: (!stage.is_last).then_some(stage.step),
                acceptance: (proposed > 0).then(|| accepted as f64 / proposed as f64),
            }
        });
        let levels: Vec<Level> = levels.collect();
        let repetitions: Vec<f64> = seen.iter().map(|seen| product(seen, self.stages.len())).collect();
        let begun =
            RareEstimate { evaluations, independent_runs, independent_failures, levels, ..RareEstimate::empty() };
        begun.with_repetitions(repetitions)
    }
}

impl RareEstimate {
    /// Of nothing.
    pub(super) fn empty() -> Self {
        Self {
            probability: None,
            coefficient_of_variation: None,
            interval_95: None,
            repetitions: Vec::new(),
            evaluations: 0,
            independent_runs: 0,
            independent_failures: 0,
            levels: Vec::new(),
            largest_weight: None,
        }
    }

    /// With what independent repetitions say: their mean, and their spread. A mean of weights may be above 1, which no probability is.
    pub(super) fn with_repetitions(self, repetitions: Vec<f64>) -> Self {
        let mean = mean(&repetitions);
        let coefficient_of_variation = variation_of_mean(&repetitions, mean);
        let estimate = Self { probability: Some(mean.min(1.0)), coefficient_of_variation, repetitions, ..self };
        Self { interval_95: estimate.interval(0.95), ..estimate }
    }

    /// An interval for the probability, as that at 95 %.
    #[must_use]
    pub fn interval(&self, confidence: f64) -> Option<[f64; 2]> {
        let (probability, variation) = (self.probability?, self.coefficient_of_variation?);
        match self.counted_failures() {
            Some((failures, runs)) => {
                let RateInterval { lower, upper } = RateInterval::clopper_pearson(failures, runs, confidence);
                Some([lower, upper])
            }
            None => {
                let raw = probability.max(mean(&self.repetitions));
                let [lower, upper] = lognormal_interval(raw, variation, self.repetitions.len(), confidence)?;
                // The spread of weights alone may leave nothing that is a probability.
                if lower < 1.0 { Some([lower, upper]) } else { self.independent_interval(confidence) }
            }
        }
    }

    /// Failures and runs of the repetitions where the first level is the failure itself: nothing is split then, and runs are counted. The
    /// spread of repetitions that all fail throughout is nothing, and so says nothing.
    fn counted_failures(&self) -> Option<(u64, u64)> {
        let repetitions = self.repetitions.len() as u64;
        let each = self.independent_runs / (1 + repetitions);
        let is_counted = self.levels.len() == 1 && self.largest_weight.is_none() && each > 0 && repetitions > 0;
        is_counted.then(|| {
            let failures = self.repetitions.iter().map(|share| (share * each as f64).round() as u64).sum();
            (failures, each * repetitions)
        })
    }

    /// An interval from the independent draws alone, which no level helped: Clopper's and Pearson's; none of an estimate that does not know them.
    #[must_use]
    pub fn independent_interval(&self, confidence: f64) -> Option<[f64; 2]> {
        let (failures, runs) = (self.independent_failures, self.independent_runs);
        let RateInterval { lower, upper } =
            (runs > 0).then(|| RateInterval::clopper_pearson(failures, runs, confidence))?;
        Some([lower, upper])
    }
}

/// How many of a population fail.
fn count_failures(population: &[Particle]) -> u64 {
    population.iter().filter(|(_, margin)| *margin < 0.0).count() as u64
}

impl<'a, P: LimitState> ParticlePopulation<'a, P> {
    pub(super) fn new(problem: &'a P, samples: usize, random: Stream, counter: &'a ProgressCounter<'a>) -> Self {
        Self { problem, samples, random, evaluations: 0, counter }
    }

    /// Takes a population down the levels, and says how many runs failed of the first ones; `told` hears at each level what was seen, and
    /// who is below it. Below the last one runs are moved on only with a `last_step`.
    fn climb(
        &mut self,
        stages: &[SplittingStage],
        last_step: Option<f64>,
        mut told: impl FnMut(LevelStats, &[Particle]),
    ) -> Result<u64, P::Error> {
        let mut population = self.sample_initial()?;
        let failures = count_failures(&population);
        for stage in stages {
            let survivors: Vec<Particle> = population.into_iter().filter(|(_, margin)| stage.passes(*margin)).collect();
            let share = survivors.len() as f64 / self.samples as f64;
            let mut here = LevelStats { share, accepted: 0, proposed: 0 };
            population = self.resample(survivors);
            let step = if stage.is_last { last_step } else { Some(stage.step) };
            if let Some(step) = step.filter(|_| !population.is_empty()) {
                for _ in 0..MOVES_PER_LEVEL {
                    let (accepted, proposed) = self.mcmc_move(&mut population, &SplittingStage { step, ..*stage })?;
                    here =
                        LevelStats { accepted: here.accepted + accepted, proposed: here.proposed + proposed, ..here };
                }
            }
            told(here, &population);
            if population.is_empty() {
                break;
            }
        }
        Ok(failures)
    }

    /// Who is below each level, spread out, failures last; fewer levels where a population dies out.
    pub(super) fn level_populations(&mut self, stages: &[SplittingStage]) -> Result<Vec<Vec<Particle>>, P::Error> {
        // The step of the level before leads to where chances are as good.
        let last_step = stages.iter().rev().find(|stage| !stage.is_last).map_or(1.0, |before| before.step);
        let mut all = Vec::with_capacity(stages.len());
        self.climb(stages, Some(last_step), |_, population| all.push(population.to_vec()))?;
        Ok(all)
    }

    /// Independent draws.
    fn sample_initial(&mut self) -> Result<Vec<Particle>, P::Error> {
        self.sample_with(|dimension, random| RandomInputs {
            normal: (0..dimension).map(|_| StandardNormal.sample(random)).collect(),
            noise_seed: new_noise_seed(random),
        })
    }

    /// A population by any law.
    pub(super) fn sample_with(
        &mut self,
        draw: impl Fn(usize, &mut Stream) -> RandomInputs,
    ) -> Result<Vec<Particle>, P::Error> {
        let dimension = self.problem.dimension();
        let states: Vec<RandomInputs> = (0..self.samples).map(|_| draw(dimension, &mut self.random)).collect();
        let margins = self.evaluate_margins(&states)?;
        Ok(states.into_iter().zip(margins).collect())
    }

    /// Copies survivors until they are as many as at the start, each as often as any other; which of them are copied once
    /// more is drawn by lot.
    fn resample(&mut self, mut survivors: Vec<Particle>) -> Vec<Particle> {
        let alive = survivors.len();
        if alive == 0 {
            return survivors;
        }
        // The first places of a shuffle.
        for place in 0..self.samples % alive {
            let other = self.random.random_range(place..alive);
            survivors.swap(place, other);
        }
        survivors.iter().cycle().take(self.samples).cloned().collect()
    }

    /// One move of every run: what would leave the level is not done. Says how many moves that kept the noise were
    /// accepted, and how many there were.
    fn mcmc_move(&mut self, population: &mut [Particle], stage: &SplittingStage) -> Result<(u64, u64), P::Error> {
        // An autoregressive step keeps normal numbers normal (Neal, 1998; "preconditioned Crank-Nicolson").
        let kept = (1.0 - stage.step * stage.step).sqrt();
        let propose = |(state, _): &Particle, random: &mut Stream| {
            let noise =
                if random.random::<f64>() < NEW_NOISE_SHARE { new_noise_seed(random) } else { state.noise_seed };
            let mut normal = |x: &f64| -> f64 {
                let drawn: f64 = StandardNormal.sample(random);
                kept * x + stage.step * drawn
            };
            RandomInputs { normal: state.normal.iter().map(&mut normal).collect(), noise_seed: noise }
        };
        let proposals: Vec<RandomInputs> = population.iter().map(|sample| propose(sample, &mut self.random)).collect();
        let margins = self.evaluate_margins(&proposals)?;
        let (mut accepted, mut proposed) = (0, 0);
        for (sample, (proposal, margin)) in population.iter_mut().zip(proposals.into_iter().zip(margins)) {
            let passes = stage.passes(margin);
            if proposal.noise_seed == sample.0.noise_seed {
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
        margins.iter_mut().filter(|margin| margin.is_nan()).for_each(|margin| *margin = f64::INFINITY);
        self.evaluations += states.len() as u64;
        self.counter.add(states.len() as u64)?;
        Ok(margins)
    }
}

/// A seed that a scenario file can hold.
pub(super) fn new_noise_seed(random: &mut Stream) -> u64 {
    random.random::<u64>() >> 1
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Standard deviation of the mean relative to the mean.
fn variation_of_mean(values: &[f64], mean: f64) -> Option<f64> {
    let n = values.len() as f64;
    let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (n - 1.0);
    (mean > 0.0).then(|| (variance / n).sqrt() / mean)
}

/// Products of many shares are nearly log-normal, and so is their mean.
pub(super) fn lognormal_interval(mean: f64, variation: f64, repetitions: usize, confidence: f64) -> Option<[f64; 2]> {
    let student = StudentsT::new(0.0, 1.0, repetitions as f64 - 1.0).ok()?;
    let factor = (student.inverse_cdf(0.5 + 0.5 * confidence) * (variation * variation).ln_1p().sqrt()).exp();
    Some([mean / factor, (mean * factor).min(1.0)])
}
