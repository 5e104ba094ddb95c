//! Spaces in which a round must not make a policy worse.

use serde::{Deserialize, Serialize};
use std::sync::Arc;

use super::RetrainError;
use super::plan::{NOMINAL_SEED, REGRESSION_SEED, RetrainingPlan};
use crate::rl::{TrafficBenchmark, TrafficUsefulness, TrainingError, measure_usefulness};
use crumple_measure::UsefulnessMeasures;
use crumple_sim::control::{BuiltInController, ControllerSource, IntoSource};
use crumple_sim::engine::{RecordingLevel, Run, RunError, RunOptions, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use crumple_spaces::ScenarioSpace;

/// Significance level in a regression space, for collisions and for usefulness each.
pub const SIGNIFICANCE: f64 = 0.01;

/// Scenarios that are simulated together; limits memory, because each keeps its trace.
const BATCH_SIZE: usize = 100;

/// Results of a policy in random scenarios of a regression space.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegressionSpaceResult {
    /// Name of the space.
    pub space: String,
    /// Number of random scenarios.
    #[serde(alias = "draws")]
    pub sample_count: u64,
    /// Indices of the scenarios that ended in a collision.
    #[serde(alias = "contacts")]
    pub collisions: Vec<u64>,
    /// Indices of scenarios with a collision, with braking above 4 m/s² whose cause required less than 3 m/s², or with
    /// an ego vehicle that falls behind. Only in spaces in which `idm` is always useful: in an emergency such braking
    /// may be necessary.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "of_no_use")]
    pub not_useful: Option<Vec<u64>>,
}

/// Everything apart from the paper's scenarios and the validation set that a round must not make worse.
#[derive(Debug)]
pub(super) struct RegressionSet {
    spaces: Vec<RegressionSpace>,
    /// Everyday traffic and recorded drives, if the preset selects checkpoints by usefulness.
    traffic: Option<TrafficBenchmark>,
}

impl RegressionSet {
    pub(super) fn new(plan: &RetrainingPlan) -> Result<Self, RetrainError> {
        let spaces = plan
            .regression_spaces
            .iter()
            .map(|space| RegressionSpace::new(plan, space));
        let spaces = spaces.collect::<Result<Vec<_>, _>>()?;
        let is_checked = plan.training.evaluation.usefulness_draws > 0;
        let drives = plan.training.load_drives().map_err(TrainingError::from)?;
        let traffic = || {
            TrafficBenchmark::new(NOMINAL_SEED, plan.settings.nominal, plan.estimator())?
                .with_drives(drives)
        };
        Ok(Self {
            spaces,
            traffic: is_checked.then(traffic).transpose()?,
        })
    }

    pub(super) fn evaluate_spaces(
        &self,
        controller: &Arc<dyn ControllerSource>,
    ) -> Result<Vec<RegressionSpaceResult>, RetrainError> {
        self.spaces
            .iter()
            .map(|space| space.evaluate(controller))
            .collect()
    }

    /// Evaluates the usefulness in everyday traffic, if the preset selects checkpoints by it.
    pub(super) fn evaluate_usefulness(
        &self,
        controller: &Arc<dyn ControllerSource>,
    ) -> Result<Option<TrafficUsefulness>, RunError> {
        self.traffic
            .as_ref()
            .map(|traffic| traffic.evaluate(controller))
            .transpose()
    }
}

/// Random scenarios of a regression space.
#[derive(Debug)]
struct RegressionSpace {
    name: String,
    draws: Vec<Scenario>,
    estimator: EstimatorKind,
    /// True if `idm` is always useful in the space.
    checks_usefulness: bool,
}

impl RegressionSpace {
    fn new(plan: &RetrainingPlan, space: &ScenarioSpace) -> Result<Self, RetrainError> {
        let draws = (0..plan.settings.regression).map(|index| space.draw(REGRESSION_SEED, index));
        let mut drawn = Self {
            name: space.name().to_owned(),
            draws: draws.collect::<Result<_, _>>()?,
            estimator: plan.estimator(),
            checks_usefulness: true,
        };
        let of_idm = drawn.evaluate(&BuiltInController::Idm(Default::default()).into_source())?;
        drawn.checks_usefulness = of_idm
            .not_useful
            .is_some_and(|not_useful| not_useful.is_empty());
        Ok(drawn)
    }

    fn evaluate(
        &self,
        controller: &Arc<dyn ControllerSource>,
    ) -> Result<RegressionSpaceResult, RetrainError> {
        let options = RunOptions::new(controller.clone()).with_estimator(self.estimator);
        let level = if self.checks_usefulness {
            RecordingLevel::Trace
        } else {
            RecordingLevel::Summary
        };
        let mut collisions = Vec::new();
        let mut not_useful = Vec::new();
        for (block, draws) in self.draws.chunks(BATCH_SIZE).enumerate() {
            let runs = draws
                .iter()
                .map(|scenario| Run::new(scenario, options.clone()))
                .collect::<Result<Vec<_>, _>>()?;
            let outcomes = simulate_batch(&runs, level, |_, result| {
                let collided = result.outcome.collision().is_some();
                (
                    collided,
                    collided || measure_usefulness(&result).is_some_and(is_not_useful),
                )
            });
            for (index, (collided, is_useless)) in outcomes.into_iter().enumerate() {
                let index = (block * BATCH_SIZE + index) as u64;
                collisions.extend(collided.then_some(index));
                not_useful.extend(is_useless.then_some(index));
            }
        }
        Ok(RegressionSpaceResult {
            space: self.name.clone(),
            sample_count: self.draws.len() as u64,
            collisions,
            not_useful: self.checks_usefulness.then_some(not_useful),
        })
    }
}

fn is_not_useful(measures: UsefulnessMeasures) -> bool {
    !measures.hard.is_empty()
        || measures
            .following
            .is_some_and(|following| following.fell_behind)
}

#[cfg(test)]
mod tests {
    use crumple_sim::scenario::NoDriverFiles;
    use std::path::Path;
    use std::sync::Arc;

    use super::super::corpus::Corpus;
    use super::super::plan::{VALIDATION_SET_SEED, training_preset};
    use super::super::test_set::witnesses;
    use super::super::{
        Acceptance, FailureChange, RegressionResults, RejectionReason, RetrainingSettings,
        decide_acceptance,
    };
    use super::*;
    use crumple_search::falsify::Method;
    use crumple_sim::policy::Policy;
    use crumple_spaces::{BUILT_IN_SPACES, built_in_space, file};

    /// Standing vehicle 40 to 120 m ahead of an ego vehicle at 10 to 80 km/h, without a follower.
    const QUEUE: &str = include_str!("queue.toml");

    /// Built-in policy `retrained` of an earlier release.
    const RUNS_INTO_STANDING: &[u8] = include_bytes!("runs-into-standing.safetensors");

    /// Retraining on standing vehicles must not trade them for emergencies, in which `policy` collides.
    #[test]
    fn standing_vehicles_are_not_traded_for_emergencies() {
        let first = Arc::new(Policy::from_bytes(RUNS_INTO_STANDING).unwrap());
        let plan = RetrainingPlan {
            initial_policy: Arc::clone(&first),
            initial_policy_name: "retrained".to_owned(),
            spaces: file::from_toml(QUEUE, Path::new("queue.toml"), &NoDriverFiles)
                .unwrap()
                .into(),
            attacked: Vec::new(),
            regression_spaces: BUILT_IN_SPACES
                .iter()
                .filter_map(|(name, ..)| built_in_space(name))
                .collect(),
            training: training_preset().unwrap(),
            method: Method::Uniform,
            seed: 0,
            settings: RetrainingSettings {
                nominal: 20,
                regression: 60,
                ..RetrainingSettings::DEFAULT
            },
        };
        let mut kept_aside = Corpus::empty(&plan.spaces, VALIDATION_SET_SEED).unwrap();
        while kept_aside.avoidable < 60 {
            kept_aside
                .classify_next(&plan.spaces, 60, &witnesses(&[]), plan.estimator(), |_| {})
                .unwrap();
        }
        let regression = RegressionSet::new(&plan).unwrap();
        let results_of = |policy: Arc<Policy>| {
            RegressionResults::evaluate(&policy, &plan, &kept_aside, &regression).unwrap()
        };
        let (before, after) = (results_of(first), results_of(Policy::reference()));
        let collisions = [&before, &after].map(|results| results.validation_set.len());
        assert!(collisions[1] < collisions[0], "{collisions:?}");
        let without = |standing: &RegressionResults| RegressionResults {
            regression: Vec::new(),
            ..standing.clone()
        };
        let in_cases = FailureChange::default();
        let standing_alone = {
            let [before, after] = [&before, &after].map(without);
            decide_acceptance(&before, &before, &after, &in_cases)
        };
        assert_eq!(standing_alone, Acceptance::Accepted);
        let Acceptance::Rejected { objections } =
            decide_acceptance(&before, &before, &after, &in_cases)
        else {
            panic!("accepted")
        };
        let is_of_high_risk = objections.iter().any(|reason| match reason {
            RejectionReason::MoreCollisions { space, .. } => space == "high-risk",
            _ => false,
        });
        assert!(is_of_high_risk, "{objections:?}");
        let traffic = before
            .regression
            .iter()
            .find(|results_of| results_of.space == "traffic")
            .unwrap();
        assert!(
            traffic.not_useful.as_ref().unwrap().len() > 30,
            "it is of no use in traffic"
        );
    }
}
