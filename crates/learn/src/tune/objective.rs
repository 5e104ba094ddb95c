//! Objective of a tuning: collisions in scenario spaces, and usability in everyday traffic.

use serde::{Deserialize, Serialize};

use super::TuneError;
use crate::rl::{TrafficBenchmark, TrafficUsefulness};
use crumple_sim::control::{BuiltInController, IntoSource};
use crumple_sim::engine::{RecordingLevel, Run, RunError, RunOptions, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use crumple_spaces::ScenarioSpace;

/// Number that a tuning minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TuningObjective {
    /// The weighted mean of the collision shares in the spaces, plus a penalty in the spaces `traffic` and `everyday`.
    ///
    /// - In `traffic`: the share of drives with a collision, that with hard unnecessary braking (above 4 m/s² where
    ///   less than 3 m/s² was justified), and that in which the vehicle falls behind.
    /// - In `everyday`: the share of drives with one of these faults or any unnecessary braking, if `idm` has none.
    /// - In recorded drives ([`TuningPlan::drives`](super::TuningPlan::drives)), if there are any: the same share as in
    ///   `everyday`, where only collisions that count against the controller do.
    /// - Half the excess over the limits of comfort and time gap: 1.2 times the RMS of acceleration (in `traffic`) and
    ///   jerk of `idm` (the excess is relative; jerk also in recorded drives), and a mean time gap in `traffic` from
    ///   1.2 to 2.1 s (the excess is in seconds).
    Both,
    /// The weighted mean of the collision shares in the spaces.
    Safety,
}

/// A scenario space, and its weight in the objective.
#[derive(Debug, Clone)]
pub struct TuningSpace {
    /// The space.
    pub space: ScenarioSpace,
    /// Weight relative to the other spaces, from 1e-6 to 1e6.
    pub weight: f64,
}

/// Results of a controller in a set of scenarios.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerScore {
    /// The controller, as on the command line.
    pub controller: String,
    /// The objective; smallest is best.
    pub objective: f64,
    /// Number of collisions in each space, in their order.
    pub collisions: Vec<u64>,
    /// Usefulness in `traffic`, `everyday` and recorded drives; none if it was not simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traffic: Option<TrafficUsefulness>,
}

/// A set of random scenarios, equal for all controllers.
#[derive(Debug)]
pub(super) struct ScoringSet {
    objective: TuningObjective,
    estimator: EstimatorKind,
    /// Scenarios and weight of each space.
    spaces: Vec<(Vec<Scenario>, f64)>,
    traffic: Option<TrafficBenchmark>,
}

impl ScoringSet {
    /// Samples the first `runs` scenarios of each space. `traffic` measures usefulness.
    pub(super) fn new(
        (objective, spaces): (TuningObjective, &[TuningSpace]),
        (seed, runs): (u64, u64),
        estimator: EstimatorKind,
        traffic: Option<TrafficBenchmark>,
    ) -> Result<Self, TuneError> {
        let mut samples = Vec::new();
        for TuningSpace { space, weight } in spaces {
            let scenarios = (0..runs)
                .map(|index| space.draw(seed, index))
                .collect::<Result<_, _>>()?;
            samples.push((scenarios, *weight));
        }
        Ok(Self {
            objective,
            estimator,
            spaces: samples,
            traffic,
        })
    }

    /// Simulates a controller in all scenarios.
    pub(super) fn score(
        &self,
        controller: &BuiltInController,
    ) -> Result<ControllerScore, RunError> {
        let options = RunOptions::new(controller.clone()).with_estimator(self.estimator);
        let mut collisions = Vec::new();
        let mut share = 0.0;
        let mut total_weight = 0.0;
        for (scenarios, weight) in &self.spaces {
            let runs = scenarios
                .iter()
                .map(|scenario| Run::new(scenario, options.clone()))
                .collect::<Result<Vec<_>, _>>()?;
            let collided = simulate_batch(&runs, RecordingLevel::Summary, |_, result| {
                result.outcome.collision().is_some()
            });
            let count = collided.into_iter().filter(|&collided| collided).count() as u64;
            collisions.push(count);
            share += weight * count as f64 / runs.len().max(1) as f64;
            total_weight += weight;
        }
        let traffic = self
            .traffic
            .as_ref()
            .map(|traffic| traffic.evaluate(&controller.clone().into_source()))
            .transpose()?;
        let penalty = match (self.objective, &traffic) {
            (TuningObjective::Both, Some(usefulness)) => usefulness.penalty(),
            _ => 0.0,
        };
        Ok(ControllerScore {
            controller: controller.to_arg(),
            objective: share / total_weight + penalty,
            collisions,
            traffic,
        })
    }
}
