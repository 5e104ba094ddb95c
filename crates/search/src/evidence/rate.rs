//! Counting failures for a claim about their rate: registered before the first run, counted in order, resumable.

use std::collections::BTreeMap;
use std::ops::{ControlFlow, Range};

use crumple_verify::rate::{MOST_RUNS, tail_at_most};
use crumple_verify::{Certificate, Comparison, Rate, Registration, Statement};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use statrs::distribution::{Beta, ContinuousCDF};

use super::block::{CountedBlock, Ending};
use crate::worst_case::certificate_about;
use crumple_world::digest::sha256;
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::InvalidField;
use crumple_world::scenario::space::{Space, file};
use crumple_world::sim::{NamedController, RecordingLevel, Run, RunError, RunOptions, simulate_batch};

/// Runs that are drawn and simulated together, or some more.
const TOGETHER: u64 = 1000;
/// A block of runs that has a hash is no shorter than this...
const SHORTEST_BLOCK: u64 = 100;
/// ... and there are no more than this.
const MOST_BLOCKS: u64 = 1000;

/// What is to be counted: one controller, or two on the same draws.
pub struct RatePlan {
    drivers: Vec<NamedController>,
    space: Space,
    /// The space as a file.
    space_text: String,
    seed: u64,
    estimator: EstimatorKind,
    registration: Registration,
    block_runs: u64,
}

/// What a plan is made of.
pub struct RateConfig {
    /// The controller; a second one to compare it with.
    pub controllers: (NamedController, Option<NamedController>),
    /// What runs are drawn from.
    pub space: Space,
    /// Seed of all draws.
    pub seed: u64,
    /// What the vehicles under test look through.
    pub estimator: EstimatorKind,
    /// How many runs.
    pub runs: u64,
    /// Confidence of the claim, above 1/2.
    pub confidence: f64,
}

/// Why nothing can be claimed whatever is counted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InvalidRate {
    /// Number of runs.
    #[error("runs: must be from 1 to {MOST_RUNS}, found {found}")]
    Runs {
        /// What was asked for.
        found: u64,
    },
    /// A controller that cannot be told from others.
    #[error("the controller `{controller}` states no identity: nothing can be claimed of it")]
    NoIdentity {
        /// The controller.
        controller: String,
    },
    /// A space without anybody whose failures could be counted.
    #[error("the space `{space}` has no vehicle under test")]
    NobodyUnderTest {
        /// The space.
        space: String,
    },
    /// Confidence.
    #[error("confidence: must be above 0.5 and below 1, found {found}")]
    Confidence {
        /// What was asked for.
        found: f64,
    },
    /// The space cannot be written down.
    #[error("the space cannot be written as TOML: {0}")]
    Space(#[from] toml::ser::Error),
    /// The space has no middle.
    #[error("the space: {0}")]
    Nominal(#[from] InvalidField),
}

/// Why a run of a plan cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RateError {
    /// The space drew something invalid.
    #[error("draw {index}: {source}")]
    Draw {
        /// Which draw.
        index: u64,
        /// What is wrong.
        source: InvalidField,
    },
    /// A controller cannot drive the draw.
    #[error("draw {index}: {source}")]
    Run {
        /// Which draw.
        index: u64,
        /// Why.
        source: RunError,
    },
    /// Whoever was asked whether to go on ended it.
    #[error("the count was broken off")]
    BrokenOff,
}

/// What has been counted so far. A run fails if vehicles touch, or if its controller fails.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tally {
    /// Digest of the registration this belongs to.
    pub registration_sha256: String,
    /// Runs made.
    pub runs: u64,
    /// Runs in which the controller failed; of two, both.
    pub failures: u64,
    /// Of two controllers: runs in which only the first failed.
    pub only_first_failed: u64,
    /// Runs in which only the second failed.
    pub only_second_failed: u64,
    /// The blocks that these runs make, in order.
    pub blocks: Vec<CountedBlock>,
}

impl RatePlan {
    /// Fixes what is to be counted.
    ///
    /// # Errors
    /// [`InvalidRate`] if no claim could come of it.
    pub fn new(parts: RateConfig) -> Result<Self, InvalidRate> {
        let RateConfig { controllers, space, seed, estimator, runs, confidence } = parts;
        if !(1..=MOST_RUNS).contains(&runs) {
            return Err(InvalidRate::Runs { found: runs });
        }
        if !(confidence > 0.5 && confidence < 1.0) {
            return Err(InvalidRate::Confidence { found: confidence });
        }
        // A nominal scenario that is none says so when the first run is drawn.
        if space.scenario(&space.nominal()).is_ok_and(|nominal| !nominal.has_vehicle_under_test()) {
            return Err(InvalidRate::NobodyUnderTest { space: space.name().to_owned() });
        }
        let drivers: Vec<NamedController> = std::iter::once(controllers.0).chain(controllers.1).collect();
        if let Some(unknown) = drivers.iter().find(|driver| driver.kind.identity().is_none()) {
            return Err(InvalidRate::NoIdentity { controller: unknown.name.clone() });
        }
        let space_text = file::to_toml(&space)?;
        let horizon_s = space.scenario(&space.nominal())?.spec().duration_s;
        let failure = drivers.iter().map(NamedController::failure).max().unwrap_or_default();
        let mut configuration = BTreeMap::from([
            ("crumple".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("estimator".to_owned(), estimator.name().to_owned()),
            ("failure".to_owned(), failure.to_owned()),
            ("horizon_s".to_owned(), horizon_s.to_string()),
            ("seed".to_owned(), seed.to_string()),
            ("space".to_owned(), space.name().to_owned()),
            ("space_sha256".to_owned(), sha256(&space_text)),
        ]);
        for (place, driver) in ["controller", "against"].into_iter().zip(&drivers) {
            configuration.insert(place.to_owned(), driver.name.clone());
            if let Some(identity) = driver.kind.identity() {
                configuration.insert(format!("{place}_sha256"), identity);
            }
            if let Some(policy) = driver.policy() {
                configuration.insert(format!("{place}_policy_sha256"), policy.digest());
            }
        }
        let block_runs = runs.div_ceil(MOST_BLOCKS).max(SHORTEST_BLOCK);
        let registration = Registration { configuration, runs, confidence, block_runs: Some(block_runs) };
        Ok(Self { drivers, space, space_text, seed, estimator, registration, block_runs })
    }

    /// What must be on record before the first run.
    #[must_use]
    pub fn registration(&self) -> &Registration {
        &self.registration
    }

    /// Nothing counted yet.
    #[must_use]
    pub fn tally(&self) -> Tally {
        Tally { registration_sha256: self.registration.digest(), ..Tally::default() }
    }

    /// Makes the next runs, some blocks of them, and adds them to `tally`; nothing once all are made.
    ///
    /// # Errors
    /// [`RateError`] names the draw that could not be run; `tally` is then as it was.
    pub fn count_block(&self, tally: &mut Tally) -> Result<(), RateError> {
        self.count_block_until(tally, &mut || ControlFlow::Continue(()))
    }

    /// The same as long as `go_on` says so, which is asked after every thousand runs. Who ends it may have ended runs halfway: what came
    /// of these does not count.
    ///
    /// # Errors
    /// As [`Self::count_block`], and [`RateError::BrokenOff`]; `tally` is then as it was.
    pub fn count_block_until(
        &self,
        tally: &mut Tally,
        go_on: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<(), RateError> {
        let together = self.block_runs * (TOGETHER / self.block_runs).max(1);
        let end = (tally.runs + together).min(self.registration.runs);
        let counted = self.count(tally.runs..end, go_on)?;
        tally.runs = end;
        for block in counted {
            tally.failures += block.failures;
            tally.only_first_failed += block.only_first_failed;
            tally.only_second_failed += block.only_second_failed;
            tally.blocks.push(block);
        }
        Ok(())
    }

    /// Whether what was counted before is whole blocks that add up.
    #[must_use]
    pub(super) fn is_sound(&self, tally: &Tally) -> bool {
        let sum = |of: fn(&CountedBlock) -> u64| tally.blocks.iter().map(of).fold(0, u64::saturating_add);
        let whole = tally.runs == self.registration.runs || tally.runs.is_multiple_of(self.block_runs);
        whole
            && tally.runs <= self.registration.runs
            && tally.blocks.len() as u64 == tally.runs.div_ceil(self.block_runs)
            && sum(|block| block.failures) == tally.failures
            && sum(|block| block.only_first_failed) == tally.only_first_failed
            && sum(|block| block.only_second_failed) == tally.only_second_failed
    }

    /// Whether it is of one controller.
    pub(super) fn is_of_one(&self) -> bool {
        self.drivers.len() == 1
    }

    /// How many blocks there are.
    #[must_use]
    pub fn blocks(&self) -> u64 {
        self.registration.runs.div_ceil(self.block_runs)
    }

    /// The runs of a block.
    #[must_use]
    pub fn runs_of(&self, block: u64) -> Range<u64> {
        let at = |block: u64| block.saturating_mul(self.block_runs).min(self.registration.runs);
        at(block)..at(block.saturating_add(1))
    }

    /// Makes the runs of a block, whatever was made before.
    ///
    /// # Errors
    /// [`RateError`] names the draw that could not be run.
    pub fn count_again(&self, block: u64) -> Result<CountedBlock, RateError> {
        Ok(self.count(self.runs_of(block), &mut || ControlFlow::Continue(()))?.pop().unwrap_or_default())
    }

    /// Makes runs, which begin where a block begins: a count for each block.
    fn count(
        &self,
        runs: Range<u64>,
        go_on: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Vec<CountedBlock>, RateError> {
        let indices: Vec<u64> = runs.collect();
        let mut endings: Vec<Vec<Ending>> = self.drivers.iter().map(|_| Vec::with_capacity(indices.len())).collect();
        for some in indices.chunks(TOGETHER as usize) {
            for (all, mut more) in endings.iter_mut().zip(self.endings(some)?) {
                all.append(&mut more);
            }
            if go_on().is_break() {
                return Err(RateError::BrokenOff);
            }
        }
        let registered = self.registration.digest();
        let places: Vec<usize> = (0..indices.len()).collect();
        let counted = places.chunks(self.block_runs as usize).map(|places| {
            let first = places.first().and_then(|&place| indices.get(place)).copied().unwrap_or_default();
            let of_run = |&place: &usize| endings.iter().filter_map(|of| of.get(place)).collect::<Vec<&Ending>>();
            CountedBlock::of(&registered, first, places.iter().map(of_run))
        });
        Ok(counted.collect())
    }

    /// How runs end, of each controller.
    fn endings(&self, indices: &[u64]) -> Result<Vec<Vec<Ending>>, RateError> {
        let draw = |&index: &u64| self.space.draw(self.seed, index).map_err(|source| RateError::Draw { index, source });
        let scenarios = indices.par_iter().map(draw).collect::<Result<Vec<_>, _>>()?;
        let endings = |driver: &NamedController| {
            let options = RunOptions::new(driver.kind.clone()).with_estimator(self.estimator);
            let runs = scenarios.iter().zip(indices).map(|(scenario, &index)| {
                Run::new(scenario, options.clone()).map_err(|source| RateError::Run { index, source })
            });
            let runs = runs.collect::<Result<Vec<_>, _>>()?;
            Ok(simulate_batch(&runs, RecordingLevel::Summary, |_, result| Ending::of(&result)))
        };
        self.drivers.iter().map(endings).collect()
    }

    /// What a full tally shows. For one controller the lowest rate that is accepted, to nine digits.
    #[must_use]
    pub fn certificate(&self, tally: &Tally) -> Certificate {
        let registration = self.registration.clone();
        let registration_sha256 = registration.digest();
        let statement = if self.drivers.len() == 2 {
            Statement::Comparison(Comparison {
                registration,
                registration_sha256,
                only_first_failed: tally.only_first_failed,
                only_second_failed: tally.only_second_failed,
                blocks: tally
                    .blocks
                    .iter()
                    .map(|block| ([block.only_first_failed, block.only_second_failed], block.sha256.clone()))
                    .collect(),
            })
        } else {
            let rate_at_most = upper_bound(tally.failures, registration.runs, registration.confidence);
            let blocks = tally.blocks.iter().map(|block| (block.failures, block.sha256.clone())).collect();
            Statement::Rate(Rate { registration, registration_sha256, failures: tally.failures, rate_at_most, blocks })
        };
        let (name, text) = (self.space.name().to_owned(), self.space_text.clone());
        certificate_about(name, Some(text), None, statement)
    }
}

/// A rate that the checker accepts, little above the bound of Clopper and Pearson; 1 if there is none below.
fn upper_bound(failures: u64, runs: u64, confidence: f64) -> f64 {
    let (k, n) = (failures as f64, runs as f64);
    let quantile = Beta::new(k + 1.0, n - k).map_or(1.0, |beta| beta.inverse_cdf(confidence));
    // The quantile is approximate: step up until the outward-rounded tail agrees.
    let candidates = (0..40).map(|doubling| quantile * (1.0 + 1e-10 * f64::from(2_u32.pow(doubling.min(30)))));
    candidates
        .take_while(|rate| *rate > 0.0 && *rate < 1.0)
        .find(|&rate| tail_at_most(failures, runs, rate) <= 1.0 - confidence)
        .unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_verify::{Accepted, check};
    use crumple_world::control::ControllerSpec;
    use crumple_world::scenario::space::built_in_space;

    fn plan(controller: &str, against: Option<&str>, runs: u64) -> RatePlan {
        let contender = |name: &str| NamedController::from(ControllerSpec::named(name).unwrap());
        RatePlan::new(RateConfig {
            controllers: (contender(controller), against.map(contender)),
            space: built_in_space("paper").unwrap(),
            seed: 3,
            estimator: EstimatorKind::Truth,
            runs,
            confidence: 0.99,
        })
        .unwrap()
    }

    fn counted(plan: &RatePlan) -> Tally {
        let mut tally = plan.tally();
        while tally.runs < plan.registration().runs {
            plan.count_block(&mut tally).unwrap();
        }
        tally
    }

    #[test]
    fn bounds_are_accepted_and_hardly_above_the_closed_form() {
        for (failures, runs, confidence) in
            [(0, 1000, 0.99), (3, 1000, 0.999), (0, 138_149, 1.0 - 1e-6), (999, 1000, 0.9)]
        {
            let bound = upper_bound(failures, runs, confidence);
            assert!(tail_at_most(failures, runs, bound) <= 1.0 - confidence);
            assert!(tail_at_most(failures, runs, bound * (1.0 - 1e-6)) > 1.0 - confidence, "{failures} {runs} {bound}");
        }
        assert!(upper_bound(0, 138_149, 1.0 - 1e-6) <= 1e-4);
        assert!(upper_bound(0, 138_148, 1.0 - 1e-6) > 1e-4);
        assert_eq!(upper_bound(10, 10, 0.99), 1.0);
    }

    #[test]
    fn a_rate_and_a_comparison_are_counted_and_accepted() {
        let rate = plan("idm", None, 1500);
        let tally = counted(&rate);
        assert_eq!((tally.runs, tally.failures), (1500, 0));
        let accepted = check(&rate.certificate(&tally)).unwrap();
        assert!(matches!(accepted, Accepted::Rate { at_most, .. } if at_most < 0.0031), "{accepted:?}");

        let comparison = plan("idm", Some("baseline"), 500);
        let tally = counted(&comparison);
        assert_eq!((tally.only_first_failed, tally.only_second_failed), (0, 500));
        assert!(matches!(check(&comparison.certificate(&tally)), Ok(Accepted::FailsLessOften { .. })));
        let turned = plan("baseline", Some("idm"), 500);
        assert!(check(&turned.certificate(&counted(&turned))).is_err());
    }

    #[test]
    fn a_registration_says_everything_that_decides_the_count() {
        let digests: std::collections::HashSet<_> = [
            plan("match-leader", None, 10),
            plan("policy", None, 10),
            plan("idm", Some("policy"), 10),
            plan("idm", None, 11),
        ]
        .map(|plan| plan.registration().digest())
        .into();
        assert_eq!(digests.len(), 4);
        assert!(plan("policy", None, 10).registration().configuration.contains_key("controller_policy_sha256"));
    }
}
