//! Results of a policy in everything that a round must not make worse.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::RetrainError;
use super::corpus::{Corpus, colliding_indices};
use super::plan::{NOMINAL_SEED, RetrainingPlan};
use super::regression_spaces::{RegressionSet, RegressionSpaceResult};
use crate::rl::TrafficUsefulness;
use crumple_sim::control::{ControllerSource, IntoSource};
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
        validation_set: &Corpus,
        regression: &RegressionSet,
    ) -> Result<Self, RetrainError> {
        let controller = Arc::clone(policy).into_source();
        let draws = PaperDistribution { seed: NOMINAL_SEED };
        let nominal = (0..plan.settings.nominal)
            .map(|index| draws.draw(index))
            .collect::<Result<Vec<_>, _>>()?;
        let nominal = colliding_indices(&nominal, &controller, plan.estimator())?
            .into_iter()
            .map(|index| index as u64)
            .collect();
        let indices: Vec<u64> = validation_set.indices().collect();
        let validation_set = colliding_indices(
            &validation_set.scenarios(&plan.spaces)?,
            &controller,
            plan.estimator(),
        )?;
        let validation_set = validation_set
            .into_iter()
            .filter_map(|index| indices.get(index).copied())
            .collect();
        Ok(Self {
            paper: collisions_in_paper(&controller)?,
            nominal,
            validation_set,
            regression: regression.evaluate_spaces(&controller)?,
            usefulness: regression.evaluate_usefulness(&controller)?,
        })
    }
}

/// Names the scenarios of the paper that end in a collision, each with the estimator.
fn collisions_in_paper(
    controller: &Arc<dyn ControllerSource>,
) -> Result<Vec<String>, RetrainError> {
    let names = built_in_scenario_names().map(|(name, _)| name);
    let scenarios: Vec<Scenario> = names
        .iter()
        .filter_map(|name| built_in_scenario(name))
        .collect();
    let mut collisions = Vec::new();
    for estimator in [EstimatorKind::Kalman, EstimatorKind::Truth] {
        let indices = colliding_indices(&scenarios, controller, estimator)?;
        let colliding = indices.into_iter().filter_map(|index| names.get(index));
        collisions.extend(colliding.map(|name| format!("{name} ({})", estimator.name())));
    }
    Ok(collisions)
}
