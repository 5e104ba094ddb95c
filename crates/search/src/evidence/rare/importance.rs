//! Draws from where failures are, with exact weights.
//!
//! Populations climb to the failure as in [`splitting`](super::splitting), and a mixture of normal laws is fitted to where they arrive; a few
//! rounds of weighted draws of it make it fit better (the cross-entropy method, Rubinstein 1997; with mixtures Kurtz and Song 2013). All of
//! these runs are then thrown away. Each draw of the estimate has the ratio of the two densities as its weight, so that the mean of the weights
//! of those that fail is unbiased, whatever was fitted. A tenth of the draws are of the law itself, which bounds the weights
//! (Hesterberg 1995).

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::mixture::{Mixture, Seen};
use super::splitting::{Climber, new_noise};
use super::{Estimate, Level, Problem, Splitting, State};
use crumple_world::random::{Purpose, stream};

/// Populations that climb to what the mixture is fitted to, beside one another: several find several ways to fail.
const POPULATIONS: u64 = 3;
/// Rounds of draws by which it is made better.
const ROUNDS: u64 = 3;
/// Populations' worth of draws in a round.
const DRAWS: usize = 4;
/// Streams of what is thrown away; those of repetitions are counted from 1.
const APART: u64 = 1 << 40;

/// The mixture that draws are made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Importance {
    pub(super) climbed: Splitting,
    mixture: Option<Mixture>,
    /// Runs made to fit it, beside those of the climb's pilot.
    fitting: u64,
}

/// What came of one repetition.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weighed {
    /// Mean weight of the runs, those that hold counting as 0.
    probability: f64,
    /// The largest weight of a run that failed, of the sum of all in this repetition.
    largest: f64,
    evaluations: u64,
}

impl Importance {
    /// Places levels, climbs them and fits.
    pub(super) fn pilot<P: Problem>(
        problem: &P,
        climbed: Splitting,
        done: &(dyn Fn(u64) + Sync),
    ) -> Result<Self, P::Error> {
        let (effort, seed) = (climbed.effort(), climbed.seed());
        if !climbed.reaches_failure() {
            return Ok(Self { climbed, mixture: None, fitting: 0 });
        }
        let mut fitting = 0;
        let mut seen: Vec<Vec<Seen>> = vec![Vec::new(); climbed.stages().len()];
        for index in 0..POPULATIONS {
            let random = stream(seed, Purpose::RareEvents, APART + index);
            let mut climber = Climber::new(problem, effort.samples, random, done);
            for (level, there) in seen.iter_mut().zip(climber.populations(climbed.stages())?) {
                level.extend(there.into_iter().map(|(state, _)| Seen { at: state.normal, weight: 1.0 }));
            }
            fitting += climber.evaluations;
        }
        let mut random = stream(seed, Purpose::RareEvents, APART + POPULATIONS);
        let mut mixture = Mixture::fit(&seen, &mut random);
        for round in 0..ROUNDS {
            let Some(known) = &mixture else { break };
            let random = stream(seed, Purpose::RareEvents, APART + POPULATIONS + 1 + round);
            let mut climber = Climber::new(problem, DRAWS * effort.samples, random, done);
            let failed = weighed(&mut climber, known)?;
            fitting += climber.evaluations;
            mixture = known.refitted(&failed).or(mixture);
        }
        Ok(Self { climbed, mixture, fitting })
    }

    /// Whether there is something to draw from.
    pub(super) fn reaches_failure(&self) -> bool {
        self.mixture.is_some()
    }

    /// How many runs the repetitions will make.
    pub(super) fn runs_ahead(&self) -> u64 {
        let effort = self.climbed.effort();
        if self.reaches_failure() { (effort.repetitions * effort.samples) as u64 } else { 0 }
    }

    /// Some of the repetitions: each is a function of the seed and its number alone.
    pub(super) fn repeat<P: Problem>(
        &self,
        problem: &P,
        repetitions: Range<u64>,
        done: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<Weighed>, P::Error> {
        let Some(mixture) = &self.mixture else { return Ok(Vec::new()) };
        let (effort, seed) = (self.climbed.effort(), self.climbed.seed());
        let repeat = |index: u64| {
            let random = stream(seed, Purpose::RareEvents, 1 + index);
            let mut climber = Climber::new(problem, effort.samples, random, done);
            let failed = weighed(&mut climber, mixture)?;
            let (sum, largest) =
                failed.iter().fold((0.0, 0.0_f64), |(sum, most), one| (sum + one.weight, most.max(one.weight)));
            let largest = if sum > 0.0 { largest / sum } else { 0.0 };
            Ok(Weighed { probability: sum / effort.samples as f64, largest, evaluations: climber.evaluations })
        };
        repetitions.into_par_iter().map(repeat).collect()
    }

    /// Whether these repetitions could have come of it.
    pub(super) fn may_have(&self, repetitions: &[Weighed]) -> bool {
        let effort = self.climbed.effort();
        let is_mean = |one: &Weighed| one.probability.is_finite() && one.probability >= 0.0;
        repetitions
            .iter()
            .all(|one| is_mean(one) && (0.0..=1.0).contains(&one.largest) && one.evaluations == effort.samples as u64)
    }

    /// What all repetitions come to, in their order.
    pub(super) fn summary(&self, repeated: &[Weighed]) -> Estimate {
        let mut begun = self.climbed.begun();
        begun.evaluations = begun.evaluations.saturating_add(self.fitting);
        if !self.reaches_failure() {
            return begun;
        }
        let shares: Vec<f64> = repeated.iter().map(|one| one.probability).collect();
        let evaluations = repeated.iter().map(|one| one.evaluations).fold(begun.evaluations, u64::saturating_add);
        let sum: f64 = shares.iter().sum();
        let largest = repeated.iter().map(|one| one.largest * one.probability).fold(0.0, f64::max);
        let largest_weight = (sum > 0.0).then_some(largest / sum);
        // Weights first: an estimate without any of one level would be taken for a count.
        let mut estimate = Estimate { evaluations, largest_weight, ..begun }.of_repetitions(shares);
        let probability = estimate.probability.unwrap_or(0.0);
        let before = estimate.levels.last().map_or(1.0, |level| level.probability);
        let share = if before > 0.0 { (probability / before).min(1.0) } else { 0.0 };
        estimate.levels.push(Level { margin: 0.0, probability, share, step: None, acceptance: None });
        estimate
    }
}

/// A population of draws, of which those that fail are returned, with their weights.
fn weighed<P: Problem>(climber: &mut Climber<'_, P>, mixture: &Mixture) -> Result<Vec<Seen>, P::Error> {
    let drawn = climber
        .drawn(|dimension, random| State { normal: mixture.draw(dimension, random), noise: new_noise(random) })?;
    let failed = drawn.into_iter().filter(|(_, margin)| *margin < 0.0);
    Ok(failed.map(|(state, _)| Seen { weight: mixture.weight(&state.normal), at: state.normal }).collect())
}
