//! Estimation of the failure rate of a controller in a scenario space.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::splitting::{LimitState, RandomInputs};
use super::{RareEstimate, SplittingConfig, SplittingLevels};
use crate::exposure::{FailureProbability, RatePerExposure, estimate_on_resamples};
use crumple_core::observer::{ProgressCounter, Stopped};
use crumple_measure::{Specification, SpecificationError};
use crumple_search::StudySubject;
use crumple_sim::engine::{
    NamedController, RefusedController, Run, RunError, RunOptions, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{InvalidField, Scenario};
use crumple_spaces::ScenarioSpace;
use crumple_store::run_folder::RunFolderError;

/// An estimate of the failure rate of a controller in a space, for failures that are too rare to count. The margin of a
/// run is its robustness. For collisions that is the smallest gap between any vehicles, in metres, and negative after a
/// collision.
pub struct RarePlan {
    /// Controller under test.
    pub controller: NamedController,
    /// Space that scenarios are drawn from.
    pub space: ScenarioSpace,
    /// Estimator of the vehicles under test.
    pub estimator: EstimatorKind,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Specification that must hold.
    pub specification: Specification,
    /// Effort of the estimate.
    pub effort: SplittingConfig,
    /// Number of resamples of the episodes that the space was fitted to. They do not affect the estimate, only the
    /// interval of the rates per hour.
    pub resamples: u32,
}

/// Effort in a space that is fitted to a resample: the spread over resamples matters, not the single estimate.
const RESAMPLE_EFFORT: SplittingConfig = SplittingConfig {
    samples: 100,
    repetition_count: 5,
};

/// Reason why an estimate fails.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RareError {
    /// The space gave an invalid scenario.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// A controller cannot drive the scenario.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The controller contradicted itself, or can no longer be started.
    #[error(transparent)]
    Refused(#[from] RefusedController),
    /// The specification cannot be evaluated.
    #[error(transparent)]
    Specification(#[from] SpecificationError),
    /// The space cannot be written.
    #[error("the space cannot be written as TOML: {0}")]
    Space(#[from] toml::ser::Error),
    /// The folder cannot be used, or a file in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// The observer stopped the estimate.
    #[error("the estimate was {0}")]
    Stopped(#[from] Stopped),
}

/// An estimate with its configuration. Not a certificate: see [the module](super).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RareReport {
    /// Version of the format: 1.
    pub version: u32,
    /// Always false: an estimate proves no bound.
    pub certified: bool,
    /// Controller, estimator, space, specification and seed.
    #[serde(flatten)]
    pub subject: StudySubject,
    /// Description of a failure.
    pub failure: String,
    /// Effort of the estimate.
    #[serde(flatten)]
    pub effort: SplittingConfig,
    /// Estimate of the failure rate.
    #[serde(flatten)]
    pub estimate: RareEstimate,
    /// Rates per hour and per 1000 km, if the space states its exposure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "exposed")]
    pub exposure: Option<RatePerExposure>,
}

impl LimitState for RarePlan {
    type Error = RareError;

    fn dimension(&self) -> usize {
        self.space.dimension()
    }

    fn margins(&self, states: &[RandomInputs]) -> Result<Vec<f64>, RareError> {
        let scenarios = states
            .par_iter()
            .map(|state| self.scenario(state))
            .collect::<Result<Vec<_>, InvalidField>>()?;
        let specification = &self.specification;
        let options = RunOptions::new(self.controller.source.clone())
            .with_estimator(self.estimator)
            .with_after_collision(specification.after_collision());
        let runs = scenarios
            .iter()
            .map(|scenario| Run::new(scenario, options.clone()))
            .collect::<Result<Vec<_>, _>>()?;
        let margins = simulate_batch(&runs, specification.recording_level(), |index, result| {
            runs.get(index).map(|run| {
                specification
                    .evaluate(run, &result)
                    .map(|verdict| verdict.robustness)
            })
        });
        let margins = margins.into_iter().flatten().collect::<Result<_, _>>()?;
        self.controller.ensure_trusted()?;
        Ok(margins)
    }
}

impl RarePlan {
    pub(super) fn scenario(&self, state: &RandomInputs) -> Result<Scenario, InvalidField> {
        let uniform: Vec<f64> = state.normal.iter().map(|&x| normal_cdf(x)).collect();
        let seed = state.noise.first().map_or(0, |share| share.seed);
        let scenario = self
            .space
            .scenario_at_with_seed(&self.space.quantile(&uniform), seed)?;
        Ok(scenario.with_noise_shares(&state.noise))
    }

    /// Returns the rates per exposure, if the space states it. `estimate_in` estimates in another space.
    pub(super) fn rate_per_exposure(
        &self,
        estimate: &RareEstimate,
        resamples: u32,
        estimate_in: &mut dyn FnMut(&ScenarioSpace, u64) -> Result<RareEstimate, RareError>,
    ) -> Result<Option<RatePerExposure>, RareError> {
        if self.space.spec().exposure.is_none() {
            return Ok(None);
        }
        let resamples = estimate_on_resamples(&self.space, self.seed, resamples, estimate_in)?;
        Ok(RatePerExposure::new(
            &self.space,
            FailureProbability::Estimated(estimate),
            resamples.as_ref(),
        ))
    }

    pub(super) fn estimate_in_space(
        &self,
        space: &ScenarioSpace,
        seed: u64,
        counter: &ProgressCounter<'_>,
    ) -> Result<RareEstimate, RareError> {
        let plan = Self {
            controller: self.controller.clone(),
            space: space.clone(),
            specification: self.specification.clone(),
            seed,
            effort: RESAMPLE_EFFORT,
            ..*self
        };
        SplittingLevels::run_pilots(&plan, plan.effort, seed, counter)?.estimate(&plan, counter)
    }

    /// Returns the report of an estimate, without rates per hour.
    pub(super) fn report(&self, estimate: RareEstimate) -> Result<RareReport, RareError> {
        let subject = StudySubject::new(
            &self.controller,
            self.estimator,
            self.specification.to_string(),
            self.seed,
            &self.space,
        )?;
        let report = RareReport {
            version: 1,
            certified: false,
            subject,
            failure: self.failure_description(),
            effort: self.effort,
            estimate,
            exposure: None,
        };
        Ok(report.with_gaps())
    }

    pub(super) fn failure_description(&self) -> String {
        match &self.specification {
            Specification::NoCollision => self.controller.failure_description().to_owned(),
            other => format!("`{other}` {VIOLATED_SUFFIX}"),
        }
    }
}

const VIOLATED_SUFFIX: &str = "is violated";

impl RareReport {
    /// True if collisions are the failure, so that margins are gaps. Margins of other specifications have no known
    /// unit.
    #[must_use]
    pub fn is_collision_failure(&self) -> bool {
        !self.failure.ends_with(VIOLATED_SUFFIX)
    }

    /// Copies the margins to the gaps if collisions are the failure.
    pub(super) fn with_gaps(mut self) -> Self {
        let is_gap = self.is_collision_failure();
        self.estimate
            .levels
            .iter_mut()
            .for_each(|level| level.smallest_gap_m = is_gap.then_some(level.margin));
        self
    }
}

/// Returns the standard normal distribution function, whose upper end has steps of 10⁻¹⁶.
fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}
