//! Evaluation of a policy on validation scenarios, without noise.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::config::{EnvironmentConfig, EvaluationConfig, TrainingConfig};
use super::trainer::TrainingError;
use super::usefulness::{TrafficBenchmark, TrafficUsefulness};
use crumple_sim::control::IntoSource;
use crumple_sim::engine::{RecordingLevel, Run, RunError, RunOptions, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::{PaperDistribution, Scenario, built_in_scenario};

/// Seed of the validation scenarios of all trainings. Never a seed of training scenarios.
const EVALUATION_SEED: u64 = 0x0068_656c_646f_7574;

const TRAFFIC_SEED: u64 = 0x0075_7365_6675_6c20;

/// Scenarios of all evaluations.
#[derive(Debug, Clone)]
pub struct EvaluationSet {
    paper: Vec<Scenario>,
    screening: Vec<Scenario>,
    ranking: Vec<Scenario>,
    /// Number of the paper's scenarios, in order, that a policy must pass to be ranked.
    required_paper_scenarios: usize,
    environment: EnvironmentConfig,
    traffic: Option<TrafficBenchmark>,
}

const PAPER_SCENARIOS: [&str; 3] = ["paper-1", "paper-2", "paper-3"];

/// Result of an evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PolicyEvaluation {
    /// True for each of the paper's scenarios without a collision, both with the filter and with the true state.
    #[serde(alias = "paper_safe")]
    pub is_safe_in_paper: [bool; 3],
    /// Share of screening scenarios without a collision.
    pub safe_share: f64,
    /// Mean reward of the screening scenarios, as in the paper.
    pub mean_reward: f64,
    /// Ranking scenarios that ended in a collision; none if the policy was not ranked, or there are no such scenarios.
    #[serde(alias = "ranking_contacts")]
    pub ranking_collisions: Option<u64>,
    /// Smallest gap between any two vehicles in all simulations, in metres.
    pub smallest_gap_m: f64,
    /// Usefulness of a ranked policy in everyday traffic; none if it was not ranked, or there are no such scenarios.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "useful")]
    pub usefulness: Option<TrafficUsefulness>,
    /// Collision share of the ranking scenarios plus the penalty of usefulness; none if `usefulness` is none.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "both_sides")]
    pub combined_penalty: Option<f64>,
}

impl PolicyEvaluation {
    /// Returns the rank, greater is better: first safety (and usefulness, if tested), then paper-3, then the gap.
    pub(crate) fn score(&self) -> [f64; 5] {
        let safe_in_paper = self
            .is_safe_in_paper
            .map(|is_safe| f64::from(u8::from(is_safe)));
        [
            self.safe_share + safe_in_paper[0] + safe_in_paper[1],
            match (self.combined_penalty, self.ranking_collisions) {
                (Some(both_sides), _) => -both_sides,
                (None, Some(collisions)) => -(collisions as f64),
                (None, None) => f64::NEG_INFINITY,
            },
            safe_in_paper[2],
            self.smallest_gap_m,
            self.mean_reward,
        ]
    }

    /// True if no scenario, paper-3 included, ended in a collision and the smallest gap is at least `gap_m`. Without
    /// ranking scenarios always false, because the screening scenarios are too few.
    #[must_use]
    pub fn is_mastered(&self, gap_m: f64) -> bool {
        self.is_safe_in_paper == [true; 3]
            && self.ranking_collisions == Some(0)
            && self.smallest_gap_m >= gap_m
    }
}

impl EvaluationSet {
    /// Creates the paper's scenarios and samples the others from the paper's distribution.
    #[must_use]
    pub fn new(evaluation: &EvaluationConfig, environment: &EnvironmentConfig) -> Self {
        let draws = PaperDistribution {
            seed: EVALUATION_SEED,
        };
        let draw =
            |indices: std::ops::Range<u64>| indices.filter_map(|index| draws.draw(index).ok());
        let first = evaluation.screening_draws;
        Self {
            paper: PAPER_SCENARIOS
                .into_iter()
                .filter_map(built_in_scenario)
                .collect(),
            screening: draw(0..first).collect(),
            ranking: draw(first..first + evaluation.ranking_draws).collect(),
            required_paper_scenarios: 2,
            environment: environment.clone(),
            traffic: None,
        }
    }

    /// Creates the scenarios of a configuration: ranking in its spaces, if any, and traffic and recorded drives for
    /// usefulness.
    ///
    /// # Errors
    /// [`TrainingError`] if its spaces cannot be drawn from, or its drives cannot be loaded.
    pub fn from_config(config: &TrainingConfig) -> Result<Self, TrainingError> {
        let evaluation = &config.evaluation;
        let environment = &config.environment;
        let mut held_out = Self::new(evaluation, environment);
        if !config.spaces.is_empty() {
            let source = config.scenario_source()?;
            let draws =
                (0..evaluation.ranking_draws).map(|index| source.draw(EVALUATION_SEED, index));
            held_out.ranking = draws.collect::<Result<_, _>>()?;
        }
        if evaluation.usefulness_draws > 0 {
            let draws = evaluation.usefulness_draws;
            let traffic = TrafficBenchmark::new(TRAFFIC_SEED, draws, environment.estimator)?;
            held_out.traffic = Some(traffic.with_drives(config.load_drives()?)?);
        }
        Ok(held_out)
    }

    /// Replaces the ranking scenarios. Only policies that pass all three scenarios of the paper are ranked.
    pub(crate) fn with_ranking(mut self, ranking: Vec<Scenario>) -> Self {
        (self.ranking, self.required_paper_scenarios) = (ranking, PAPER_SCENARIOS.len());
        self
    }

    /// Simulates a policy in the screening scenarios and, if it passes, in the ranking scenarios.
    ///
    /// # Errors
    /// [`RunError::DecisionInterval`] if the policy's decision interval does not fit the scenarios' step.
    pub(crate) fn evaluate(&self, policy: &Arc<Policy>) -> Result<PolicyEvaluation, RunError> {
        let mut is_safe_in_paper = [true; 3];
        let mut smallest_gap_m = f64::INFINITY;
        for estimator in [EstimatorKind::Kalman, EstimatorKind::Truth] {
            let driven = drive(&self.paper, policy, estimator)?;
            for (safe, run) in is_safe_in_paper.iter_mut().zip(&driven) {
                *safe &= run.collision_s.is_none();
            }
            smallest_gap_m = smallest_gap_m.min(min_gap_m(&driven));
        }
        let draws = drive(&self.screening, policy, self.environment.estimator)?;
        let safe = draws.iter().filter(|run| run.collision_s.is_none()).count();
        let mut evaluation = PolicyEvaluation {
            is_safe_in_paper,
            safe_share: safe as f64 / draws.len().max(1) as f64,
            mean_reward: draws.iter().map(|run| self.reward(run)).sum::<f64>()
                / draws.len().max(1) as f64,
            ranking_collisions: None,
            smallest_gap_m: smallest_gap_m.min(min_gap_m(&draws)),
            usefulness: None,
            combined_penalty: None,
        };
        let is_safe = is_safe_in_paper
            .iter()
            .take(self.required_paper_scenarios)
            .all(|&safe| safe);
        if safe == draws.len() && is_safe && !self.ranking.is_empty() {
            self.rank(policy, &mut evaluation)?;
        }
        Ok(evaluation)
    }

    /// Simulates a policy in the ranking scenarios and in traffic, and adds the results.
    fn rank(
        &self,
        policy: &Arc<Policy>,
        evaluation: &mut PolicyEvaluation,
    ) -> Result<(), RunError> {
        let ranked = drive(&self.ranking, policy, self.environment.estimator)?;
        let collisions = ranked
            .iter()
            .filter(|run| run.collision_s.is_some())
            .count();
        evaluation.ranking_collisions = Some(collisions as u64);
        evaluation.smallest_gap_m = evaluation.smallest_gap_m.min(min_gap_m(&ranked));
        if let Some(traffic) = &self.traffic {
            let usefulness = traffic.evaluate(&Arc::clone(policy).into_source())?;
            evaluation.usefulness = Some(usefulness);
            let collision_share = collisions as f64 / ranked.len() as f64;
            evaluation.combined_penalty = Some(collision_share + usefulness.penalty());
        }
        Ok(())
    }

    /// Returns the paper's reward of a run of 1500 steps.
    fn reward(&self, run: &EvaluationRun) -> f64 {
        match run.collision_s {
            None => run.steps as f64 * self.environment.step_reward,
            Some(collision_s) => {
                (collision_s / run.step_s).floor() * self.environment.step_reward
                    + self.environment.collision_reward
            }
        }
    }
}

/// Number of random scenarios in the final test of a policy.
pub const UNSEEN_DRAWS: u64 = 1000;

/// Seed of the final test, the default of `crumple assess`. Training and evaluation use other seeds.
const UNSEEN_SEED: u64 = 0;

/// Counts collisions in [`UNSEEN_DRAWS`] scenarios of the paper's distribution, unused before.
///
/// # Errors
/// [`RunError::DecisionInterval`] if the policy's decision interval does not fit the scenarios' step.
pub fn count_unseen_collisions(
    policy: &Arc<Policy>,
    estimator: EstimatorKind,
) -> Result<u64, RunError> {
    let draws = PaperDistribution { seed: UNSEEN_SEED };
    let scenarios: Vec<_> = (0..UNSEEN_DRAWS)
        .filter_map(|index| draws.draw(index).ok())
        .collect();
    Ok(drive(&scenarios, policy, estimator)?
        .iter()
        .filter(|run| run.collision_s.is_some())
        .count() as u64)
}

struct EvaluationRun {
    collision_s: Option<f64>,
    smallest_gap_m: f64,
    steps: usize,
    step_s: f64,
}

fn min_gap_m(runs: &[EvaluationRun]) -> f64 {
    runs.iter()
        .map(|run| run.smallest_gap_m)
        .fold(f64::INFINITY, f64::min)
}

fn drive(
    scenarios: &[Scenario],
    policy: &Arc<Policy>,
    estimator: EstimatorKind,
) -> Result<Vec<EvaluationRun>, RunError> {
    let options = RunOptions::new(Arc::clone(policy)).with_estimator(estimator);
    let runs = scenarios
        .iter()
        .map(|scenario| Run::new(scenario, options.clone()))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(simulate_batch(
        &runs,
        RecordingLevel::Summary,
        |index, result| {
            let scenario = runs[index].scenario();
            let gaps = result
                .vehicles
                .iter()
                .filter_map(|vehicle| vehicle.min_gap_m);
            EvaluationRun {
                collision_s: result.outcome.collision().map(|collision| collision.time_s),
                smallest_gap_m: gaps.fold(f64::INFINITY, f64::min),
                steps: scenario.steps(),
                step_s: scenario.spec().step_s,
            }
        },
    ))
}
