//! Results of a policy in everything that a round must not make worse.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::RetrainError;
use super::corpus::{Corpus, colliding_indices};
use super::plan::{NOMINAL_SEED, RetrainingPlan};
use super::regression_spaces::{RegressionSet, RegressionSpaceResult};
use crate::rl::TrafficUsefulness;
use crumple_sim::control::IntoSource;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::{
    PaperDistribution, Scenario, built_in_scenario, built_in_scenario_names,
};

/// Failures of a policy that decide on acceptance.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegressionResults {
    /// Scenarios of the paper, each with the estimator.
    pub paper: Vec<String>,
    /// Indices of random scenarios of the paper's distribution.
    pub nominal: Vec<u64>,
    /// Indices of the validation set.
    #[serde(alias = "kept_aside")]
    pub validation_set: Vec<u64>,
    /// Results in each regression space.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub regression: Vec<RegressionSpaceResult>,
    /// Usefulness in everyday traffic, if the preset selects checkpoints by it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub usefulness: Option<TrafficUsefulness>,
}

impl RegressionResults {
    pub(super) fn evaluate(
        policy: &Arc<Policy>,
        plan: &RetrainingPlan,
        kept_aside: &Corpus,
        regression: &RegressionSet,
    ) -> Result<Self, RetrainError> {
        let controller = Arc::clone(policy).into_source();
        let collided = |scenarios: &[Scenario], estimator| {
            colliding_indices(scenarios, &controller, estimator)
        };
        let names = built_in_scenario_names().map(|(name, _)| name);
        let scenarios: Vec<Scenario> = names
            .iter()
            .filter_map(|name| built_in_scenario(name))
            .collect();
        let mut paper = Vec::new();
        for estimator in [EstimatorKind::Kalman, EstimatorKind::Truth] {
            let collided = collided(&scenarios, estimator)?
                .into_iter()
                .filter_map(|index| names.get(index));
            paper.extend(collided.map(|name| format!("{name} ({})", estimator.name())));
        }
        let draws = PaperDistribution { seed: NOMINAL_SEED };
        let nominal = (0..plan.settings.nominal)
            .map(|index| draws.draw(index))
            .collect::<Result<Vec<_>, _>>()?;
        let nominal = collided(&nominal, plan.estimator())?
            .into_iter()
            .map(|place| place as u64)
            .collect();
        let indices: Vec<u64> = kept_aside.indices().collect();
        let aside = collided(&kept_aside.scenarios(&plan.spaces)?, plan.estimator())?;
        let kept_aside = aside
            .into_iter()
            .filter_map(|place| indices.get(place).copied())
            .collect();
        let (regression, usefulness) = regression.evaluate(&controller)?;
        Ok(Self {
            paper,
            nominal,
            validation_set: kept_aside,
            regression,
            usefulness,
        })
    }
}
