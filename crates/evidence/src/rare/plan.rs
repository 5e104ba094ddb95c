//! Splitting for a controller in a space.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::splitting::{LimitState, RandomInputs};
use super::{Pilot, RareEstimate, RareMethod, SplittingConfig};
use crate::exposure::{FailureProbability, RatePerExposure, ResampleShard, estimate_on_resamples};
use crumple_core::digest::sha256;
use crumple_core::observer::{ProgressCounter, Stopped};
use crumple_store::run_folder::RunFolderError;
use crumple_store::shard::{MergeError, TooManyShards};
use crumple_world::measure::{Specification, SpecificationError};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::InvalidField;
use crumple_world::scenario::space::{ScenarioSpace, file};
use crumple_world::sim::{NamedController, RefusedController, Run, RunError, RunOptions, simulate_batch};

/// How often a controller fails in a space: what `verify rate` counts, for failures too rare to count.
///
/// The margin of a run is its robustness: of contacts the smallest gap between any two vehicles, in metres, and below 0 if vehicles touch.
pub struct RarePlan {
    /// What is put under test.
    pub controller: NamedController,
    /// What runs are drawn from.
    pub space: ScenarioSpace,
    /// What the vehicles under test look through.
    pub estimator: EstimatorKind,
    /// Seed of everything.
    pub seed: u64,
    /// What must hold.
    pub specification: Specification,
    /// How failures are climbed to.
    pub method: RareMethod,
    /// How much work goes into it.
    pub effort: SplittingConfig,
}

/// Effort of an estimate in a space fitted to a resample: what these spread is what is looked for.
const RESAMPLE_EFFORT: SplittingConfig = SplittingConfig { samples: 100, repetitions: 5 };

/// Why a run cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RareError {
    /// The space made something invalid.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// A controller cannot drive the scenario.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The controller contradicted itself, or cannot be started any more.
    #[error(transparent)]
    Refused(#[from] RefusedController),
    /// The run cannot be judged.
    #[error(transparent)]
    Specification(#[from] SpecificationError),
    /// The space cannot be written down.
    #[error("the space cannot be written as TOML: {0}")]
    Space(#[from] toml::ser::Error),
    /// The estimate cannot be written down.
    #[error("the estimate cannot be written as JSON: {0}")]
    Estimate(#[from] serde_json::Error),
    /// The folder cannot be worked in, or something in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// Shards do not go together, or with their space.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// There are more shards than repetitions.
    #[error(transparent)]
    Shards(#[from] TooManyShards),
    /// What was estimated earlier cannot be told to be of the same controller.
    #[error("the controller `{0}` states no identity: begin anew, without --resume, in another --out")]
    NoIdentity(String),
    /// The observer stopped the estimate.
    #[error("the estimate was {0}")]
    Stopped(#[from] Stopped),
}

/// An estimate with all that decided it. No certificate: see [the module](super).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RareReport {
    /// Version of the format: 1.
    pub version: u32,
    /// Version of crumple.
    pub crumple: String,
    /// Always false: an estimate bounds nothing.
    pub certified: bool,
    /// What was put under test.
    pub controller: String,
    /// Hash of the policy, if that is what it is.
    pub policy_sha256: Option<String>,
    /// Whether it says of itself that it is not deterministic: the same estimate may come out otherwise.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub nondeterministic: bool,
    /// What it looked through.
    pub estimator: EstimatorKind,
    /// Name of the space.
    pub space: String,
    /// SHA-256 of the space as TOML, its base scenario spelled out.
    pub space_sha256: String,
    /// What counts as a failure.
    pub failure: String,
    /// Seed of everything.
    pub seed: u64,
    /// How failures were climbed to.
    #[serde(default)]
    pub method: RareMethod,
    /// How much work went into it.
    #[serde(flatten)]
    pub effort: SplittingConfig,
    /// What came of it.
    #[serde(flatten)]
    pub estimate: RareEstimate,
    /// What that is per hour and per 1000 km, where the space says in how much driving it was seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "exposed")]
    pub exposure: Option<RatePerExposure>,
}

/// All that decides an estimate and that its report says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RareRecord {
    pub(super) crumple: String,
    pub(super) controller: String,
    pub(super) controller_sha256: Option<String>,
    policy_sha256: Option<String>,
    nondeterministic: bool,
    pub(super) estimator: EstimatorKind,
    space: String,
    pub(super) space_sha256: String,
    pub(super) failure: String,
    pub(super) seed: u64,
    pub(super) method: RareMethod,
    pub(super) effort: SplittingConfig,
}

impl LimitState for RarePlan {
    type Error = RareError;

    fn dimension(&self) -> usize {
        self.space.dimension()
    }

    fn margins(&self, states: &[RandomInputs]) -> Result<Vec<f64>, RareError> {
        let scenario = |state: &RandomInputs| {
            let uniform: Vec<f64> = state.normal.iter().map(|&x| normal_cdf(x)).collect();
            self.space.scenario_at_with_seed(&self.space.quantile(&uniform), state.noise_seed)
        };
        let scenarios = states.par_iter().map(scenario).collect::<Result<Vec<_>, _>>()?;
        let specification = &self.specification;
        let options = RunOptions::new(self.controller.kind.clone())
            .with_estimator(self.estimator)
            .with_after_contact(specification.after_contact());
        let runs =
            scenarios.iter().map(|scenario| Run::new(scenario, options.clone())).collect::<Result<Vec<_>, _>>()?;
        let margins = simulate_batch(&runs, specification.recording_level(), |index, result| {
            runs.get(index).map(|run| specification.judge(run, &result).map(|verdict| verdict.robustness))
        });
        let margins = margins.into_iter().flatten().collect::<Result<_, _>>()?;
        self.controller.ensure_trusted()?;
        Ok(margins)
    }
}

impl RarePlan {
    /// What an estimate comes to per hour, where the space says in how much driving its episodes were seen. `again` estimates in another space.
    pub(super) fn rate_per_exposure(
        &self,
        estimate: &RareEstimate,
        resamples: u32,
        again: &mut dyn FnMut(&ScenarioSpace, u64) -> Result<RareEstimate, RareError>,
    ) -> Result<Option<RatePerExposure>, RareError> {
        if self.space.spec().exposure.is_none() {
            return Ok(None);
        }
        let resamples = estimate_on_resamples(&self.space, self.seed, resamples, again)?;
        Ok(RatePerExposure::new(&self.space, FailureProbability::Estimated(estimate), resamples.as_ref()))
    }

    /// The estimates in some of the resamples, as far as spaces could be fitted to them.
    pub(super) fn estimate_resamples(
        &self,
        resamples: u32,
        own: Range<u64>,
        again: &mut dyn FnMut(&ScenarioSpace, u64) -> Result<RareEstimate, RareError>,
    ) -> Result<Vec<RareEstimate>, RareError> {
        if own.is_empty() {
            return Ok(Vec::new());
        }
        let (mut part, none) = (ResampleShard::new(own), RareEstimate::empty());
        let mut again = |space: &ScenarioSpace, seed: u64| part.next(none.clone(), || again(space, seed));
        // Why nothing can be resampled is said by who puts the parts together.
        let _ = estimate_on_resamples(&self.space, self.seed, resamples, &mut again)?;
        Ok(part.into_results())
    }

    /// An estimate in another space, with less effort.
    pub(super) fn estimate_in_space(
        &self,
        space: &ScenarioSpace,
        seed: u64,
        counter: &ProgressCounter<'_>,
    ) -> Result<RareEstimate, RareError> {
        let (controller, specification) = (self.controller.clone(), self.specification.clone());
        let other = Self { controller, space: space.clone(), specification, seed, effort: RESAMPLE_EFFORT, ..*self };
        Pilot::run(&other, other.method, other.effort, seed, counter)?.estimate(&other, counter)
    }

    /// All that decides the estimate, but the space's text.
    pub(super) fn record(&self) -> Result<RareRecord, RareError> {
        Ok(RareRecord {
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            controller: self.controller.name.clone(),
            controller_sha256: self.controller.kind.identity(),
            policy_sha256: self.controller.policy().map(|policy| policy.digest()),
            nondeterministic: !self.controller.kind.is_deterministic(),
            estimator: self.estimator,
            space: self.space.name().to_owned(),
            space_sha256: sha256(file::to_toml(&self.space)?),
            failure: match &self.specification {
                Specification::NoContact => self.controller.failure_description().to_owned(),
                other => format!("`{other}` {VIOLATED_SUFFIX}"),
            },
            seed: self.seed,
            method: self.method,
            effort: self.effort,
        })
    }
}

impl RareRecord {
    /// The report of an estimate.
    pub(super) fn report(&self, estimate: RareEstimate) -> RareReport {
        let record = self.clone();
        RareReport {
            version: 1,
            crumple: record.crumple,
            certified: false,
            controller: record.controller,
            policy_sha256: record.policy_sha256,
            nondeterministic: record.nondeterministic,
            estimator: record.estimator,
            space: record.space,
            space_sha256: record.space_sha256,
            failure: record.failure,
            seed: record.seed,
            method: record.method,
            effort: record.effort,
            estimate,
            exposure: None,
        }
        .with_gaps()
    }
}

/// How what counts as a failure ends, where it is another rule than that no vehicles touch.
const VIOLATED_SUFFIX: &str = "is violated";

impl RareReport {
    /// Whether vehicles that touch are what fails, so that margins are gaps. What any other rule leaves is in no unit that is known here.
    #[must_use]
    pub fn is_contact_failure(&self) -> bool {
        !self.failure.ends_with(VIOLATED_SUFFIX)
    }

    /// Margins are called gaps where they are, and nowhere else.
    pub(super) fn with_gaps(mut self) -> Self {
        let is_gap = self.is_contact_failure();
        self.estimate.levels.iter_mut().for_each(|level| level.smallest_gap_m = is_gap.then_some(level.margin));
        self
    }
}

/// The share of the standard normal distribution below `x`. Its upper end has steps of 10⁻¹⁶.
fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}
