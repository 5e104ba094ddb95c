//! Failure counts for a claim about a rate: registered before the first run, counted in order, resumable.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use crumple_verify::rate::MAX_RUNS;
use crumple_verify::{Certificate, Registration};
use rayon::prelude::*;

use super::block::{CountedBlock, RunFingerprint};
use super::exposure::{FailureProbability, RatePerExposure, count_on_resamples};
use super::record::{CountRecord, CountTally, range_len};
use super::remote::{BlockSource, RemoteCountError};
use crumple_core::digest::sha256;
use crumple_core::field_error::FieldError;
use crumple_core::observer::{Observer, ProgressCounter, Quiet, RunProgress, Stopped};
use crumple_sim::engine::{
    NamedController, RecordingLevel, RefusedController, Run, RunError, RunOptions, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::InvalidField;
use crumple_spaces::{ScenarioSpace, file};
use crumple_store::study::existing_configuration;

/// Runs that are simulated together, rounded down to whole blocks, but at least one block.
const BATCH_SIZE: u64 = 1000;
const MIN_BLOCK_RUNS: u64 = 100;
/// Maximum number of blocks of a count of up to [`LARGE_COUNT_RUNS`].
const MAX_BLOCKS: u64 = 1000;
const LARGE_COUNT_RUNS: u64 = 100_000_000;
/// Maximum number of blocks of a larger count: the limit of certificates.
const MAX_LARGE_COUNT_BLOCKS: u64 = crumple_verify::rate::MAX_BLOCKS;

/// Progress of a count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CountProgress {
    /// Completed runs.
    pub runs: u64,
    /// Runs of them that failed.
    pub failures: u64,
    /// All runs of the plan.
    pub total: u64,
}

/// A registered count of one controller, or of two on the same scenarios.
#[derive(Clone)]
pub struct RatePlan {
    controllers: Vec<NamedController>,
    space: ScenarioSpace,
    seed: u64,
    estimator: EstimatorKind,
    /// Number of resamples of the episodes that the space was fitted to, and of runs in each.
    resampling: (u32, u32),
    record: CountRecord,
    /// Counts the blocks instead of this process.
    block_source: Option<Arc<dyn BlockSource>>,
}

const DEFAULT_RESAMPLING: (u32, u32) = (200, 500);

/// Configuration of a plan.
pub struct RateConfig {
    /// Controller whose failures are counted.
    pub controller: NamedController,
    /// Second controller, for a comparison.
    pub second_controller: Option<NamedController>,
    /// Space that scenarios are drawn from.
    pub space: ScenarioSpace,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Estimator of the vehicles under test.
    pub estimator: EstimatorKind,
    /// Number of runs.
    pub runs: u64,
    /// Confidence level of the claim, above 1/2.
    pub confidence: f64,
}

impl RateConfig {
    /// Configures a count of one controller with the Kalman filter, seed 0 and confidence level 0.99.
    #[must_use]
    pub fn new(controller: impl Into<NamedController>, space: ScenarioSpace, runs: u64) -> Self {
        Self {
            controller: controller.into(),
            second_controller: None,
            space,
            seed: 0,
            estimator: EstimatorKind::Kalman,
            runs,
            confidence: 0.99,
        }
    }

    fn controllers(&self) -> impl Iterator<Item = &NamedController> {
        std::iter::once(&self.controller).chain(&self.second_controller)
    }

    fn check(&self) -> Result<(), InvalidRate> {
        if !(1..=MAX_RUNS).contains(&self.runs) {
            let problem = format!("must be from 1 to {MAX_RUNS}, found {}", self.runs);
            return Err(InvalidRate::OutOfRange(FieldError::new("runs", problem)));
        }
        if !(self.confidence > 0.5 && self.confidence < 1.0) {
            let problem = format!("must be above 0.5 and below 1, found {}", self.confidence);
            return Err(InvalidRate::OutOfRange(FieldError::new(
                "confidence",
                problem,
            )));
        }
        let space = &self.space;
        if space
            .scenario(&space.nominal())
            .is_ok_and(|nominal| !nominal.has_vehicle_under_test())
        {
            return Err(InvalidRate::NoVehicleUnderTest {
                space: space.name().to_owned(),
            });
        }
        let identities: Vec<_> = self
            .controllers()
            .map(|controller| controller.source.identity())
            .collect();
        if let [Some(first), Some(second)] = identities.as_slice()
            && first == second
        {
            return Err(InvalidRate::ComparedWithItself {
                controller: self.controller.name.clone(),
            });
        }
        let mut controllers = self.controllers();
        match controllers.find(|controller| controller.source.identity().is_none()) {
            Some(unknown) => Err(InvalidRate::NoIdentity {
                controller: unknown.name.clone(),
            }),
            None => Ok(()),
        }
    }

    /// Returns the registered facts about the count: controllers, space and settings.
    fn registered_facts(&self, space_text: &str) -> Result<BTreeMap<String, String>, InvalidRate> {
        let space = &self.space;
        let horizon_s = space.scenario(&space.nominal())?.spec().duration_s;
        let failure = self
            .controllers()
            .map(NamedController::failure_description)
            .max()
            .unwrap_or_default();
        let mut facts = BTreeMap::from([
            ("crumple".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("estimator".to_owned(), self.estimator.name().to_owned()),
            ("failure".to_owned(), failure.to_owned()),
            ("horizon_s".to_owned(), horizon_s.to_string()),
            ("seed".to_owned(), self.seed.to_string()),
            ("space".to_owned(), space.name().to_owned()),
            ("space_sha256".to_owned(), sha256(space_text)),
        ]);
        for (role, controller) in ["controller", "against"]
            .into_iter()
            .zip(self.controllers())
        {
            facts.insert(role.to_owned(), controller.name.clone());
            if let Some(identity) = controller.source.identity() {
                facts.insert(format!("{role}_sha256"), identity);
            }
            if let Some(policy) = controller.policy() {
                facts.insert(format!("{role}_policy_sha256"), policy.digest());
            }
        }
        Ok(facts)
    }

    fn block_runs(&self) -> u64 {
        let blocks = if self.runs > LARGE_COUNT_RUNS {
            MAX_LARGE_COUNT_BLOCKS
        } else {
            MAX_BLOCKS
        };
        self.runs.div_ceil(blocks).max(MIN_BLOCK_RUNS)
    }
}

/// Reason why a configuration allows no claim.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InvalidRate {
    /// The number of runs or the confidence level is out of range.
    #[error(transparent)]
    OutOfRange(#[from] FieldError),
    /// A controller has no identity.
    #[error(
        "the controller `{controller}` states no identity, so no claim about it is possible: a controller file may \
         name its `files`"
    )]
    NoIdentity {
        /// Name of the controller.
        controller: String,
    },
    /// A controller is compared with itself.
    #[error(
        "the controller `{controller}` is compared with itself: choose another controller to compare with"
    )]
    ComparedWithItself {
        /// Name of the controller.
        controller: String,
    },
    /// The space has no vehicle under test.
    #[error("the space `{space}` has no vehicle under test")]
    NoVehicleUnderTest {
        /// Name of the space.
        space: String,
    },
    /// The space cannot be written down.
    #[error("the space cannot be written as TOML: {0}")]
    Space(#[from] toml::ser::Error),
    /// The nominal scenario of the space is invalid.
    #[error("the space: {0}")]
    Nominal(#[from] InvalidField),
}

/// Reason why runs of a plan cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RateError {
    /// The space gave an invalid scenario.
    #[error("random scenario {index}: {source}")]
    Draw {
        /// Index of the run.
        index: u64,
        /// Problem of the scenario.
        source: InvalidField,
    },
    /// A controller cannot drive in the scenario.
    #[error("random scenario {index}: {source}")]
    Run {
        /// Index of the run.
        index: u64,
        /// Problem of the controller.
        source: RunError,
    },
    /// A controller contradicted itself, or can no longer be started.
    #[error(transparent)]
    Refused(#[from] RefusedController),
    /// The source of counted blocks has none, or unsuitable ones.
    #[error(transparent)]
    Remote(#[from] RemoteCountError),
    /// The observer stopped the count.
    #[error("the count was {0}")]
    Stopped(#[from] Stopped),
}

impl RatePlan {
    /// Creates a plan.
    ///
    /// # Errors
    /// [`InvalidRate`] if the configuration allows no claim.
    ///
    /// ```
    /// use crumple_core::observer::Quiet;
    /// use crumple_evidence::{RateConfig, RatePlan};
    /// use crumple_sim::control::BuiltInController;
    /// use crumple_sim::observation::EstimatorKind;
    /// use crumple_spaces::built_in_space;
    /// use crumple_store::study::Study;
    ///
    /// let plan = RatePlan::new(RateConfig {
    ///     seed: 1,
    ///     estimator: EstimatorKind::Truth,
    ///     confidence: 0.9,
    ///     ..RateConfig::new(BuiltInController::from_name("idm").unwrap(), built_in_space("paper").unwrap(), 300)
    /// })
    /// .unwrap();
    /// let folder = tempfile::tempdir().unwrap();
    /// let counted = plan.run(folder.path(), false, &Quiet).unwrap();
    /// println!("{}", crumple_verify::check(&counted.certificate.unwrap()).unwrap());
    /// ```
    pub fn new(config: RateConfig) -> Result<Self, InvalidRate> {
        config.check()?;
        let space_text = file::to_identity_toml(&config.space)?;
        let registration = Registration {
            configuration: config.registered_facts(&space_text)?,
            runs: config.runs,
            confidence: config.confidence,
            block_runs: Some(config.block_runs()),
        };
        Ok(Self {
            controllers: std::iter::once(config.controller)
                .chain(config.second_controller)
                .collect(),
            space: config.space,
            seed: config.seed,
            estimator: config.estimator,
            resampling: DEFAULT_RESAMPLING,
            record: CountRecord {
                registration,
                space_text,
            },
            block_source: None,
        })
    }

    /// Takes counted blocks from a source, such as other machines, instead of simulating them here.
    #[must_use]
    pub fn with_block_source(self, source: Arc<dyn BlockSource>) -> Self {
        Self {
            block_source: Some(source),
            ..self
        }
    }

    /// Sets the number of resamples of the episodes, and of runs in each. They do not affect the count and are not
    /// registered.
    #[must_use]
    pub fn with_resampling(self, resamples: u32, runs_each: u32) -> Self {
        Self {
            resampling: (resamples, runs_each),
            ..self
        }
    }

    /// Returns the number of resamples, and of runs in each; `None` if no rate per hour can be stated: for two
    /// controllers, and for a space without exposure.
    #[must_use]
    pub fn resampling(&self) -> Option<(u32, u32)> {
        (self.has_single_controller() && self.space.spec().exposure.is_some())
            .then_some(self.resampling)
    }

    /// Returns the data that must be on record before the first run.
    #[must_use]
    pub fn registration(&self) -> &Registration {
        &self.record.registration
    }

    /// Returns the registration and the text of the space.
    #[must_use]
    pub fn record(&self) -> &CountRecord {
        &self.record
    }

    /// Returns a tally without runs.
    #[must_use]
    pub fn empty_tally(&self) -> CountTally {
        self.record.empty_tally()
    }

    /// Simulates the next batch of blocks and adds it to `tally`, if any are left.
    ///
    /// # Errors
    /// [`RateError`] names the failed run; `tally` is then unchanged.
    pub fn count_batch(&self, tally: &mut CountTally) -> Result<(), RateError> {
        self.count_batch_observed(tally, &Quiet)
    }

    /// Counts like [`Self::count_batch`]. After every thousand runs, `observer` receives the counts that `tally` had
    /// before this call.
    ///
    /// # Errors
    /// [`RateError`] names the failed run, or is [`RateError::Stopped`]; `tally` is then unchanged.
    pub(super) fn count_batch_observed(
        &self,
        tally: &mut CountTally,
        observer: &dyn Observer<CountProgress>,
    ) -> Result<(), RateError> {
        let so_far = self.progress(tally);
        let first = tally.blocks.len() as u64;
        let keep_going = || observer.notify(&so_far);
        let counted = match &self.block_source {
            Some(source) => {
                keep_going()?;
                source.next_blocks(self, first)?
            }
            None => {
                let together = (BATCH_SIZE / self.record.block_runs()).max(1);
                let blocks = first..first.saturating_add(together).min(self.block_count());
                self.count_runs(self.seed, self.record.run_range(blocks), &keep_going)?
            }
        };
        for (index, block) in (first..).zip(counted) {
            tally.add_block(range_len(&self.run_range(index)), block);
        }
        Ok(())
    }

    /// Counts blocks, independently of earlier counts, for another process that [takes](Self::with_block_source) them.
    ///
    /// # Errors
    /// [`RateError`] names the failed run, or is [`RateError::Stopped`].
    pub fn count_blocks(
        &self,
        blocks: Range<u64>,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<Vec<CountedBlock>, RateError> {
        let counter = ProgressCounter::new(observer, None);
        self.count_runs(self.seed, self.record.run_range(blocks), &|| {
            counter.add(BATCH_SIZE)
        })
    }

    pub(super) fn progress(&self, tally: &CountTally) -> CountProgress {
        CountProgress {
            runs: tally.runs,
            failures: tally.failed_runs(),
            total: self.registration().runs,
        }
    }

    pub(super) fn has_single_controller(&self) -> bool {
        self.controllers.len() == 1
    }

    /// Returns the number of blocks.
    #[must_use]
    pub fn block_count(&self) -> u64 {
        self.record.block_count()
    }

    /// Returns the runs of a block.
    #[must_use]
    pub fn run_range(&self, block: u64) -> Range<u64> {
        self.record.run_range(block..block.saturating_add(1))
    }

    /// Counts the runs of a block, independently of earlier counts.
    ///
    /// # Errors
    /// [`RateError`] names the failed run.
    pub fn recount_block(&self, block: u64) -> Result<CountedBlock, RateError> {
        self.recount_block_of_seed(self.seed, block)
    }

    /// Counts the runs of a block as [`Self::recount_block`], with another seed.
    pub(super) fn recount_block_of_seed(
        &self,
        seed: u64,
        block: u64,
    ) -> Result<CountedBlock, RateError> {
        let mut counted = self.count_runs(seed, self.run_range(block), &|| Ok(()))?;
        Ok(counted.pop().unwrap_or_default())
    }

    /// Registers the release that made a finished count of this plan in a folder, if there is one: its files stay
    /// valid.
    #[must_use]
    pub fn with_release_of(self, folder: &Path) -> Self {
        let existing = existing_configuration(&self, folder);
        let registration =
            existing.and_then(|text| serde_json::from_str::<Registration>(&text).ok());
        match registration {
            Some(registration) => self.registered_as(&registration),
            None => self,
        }
    }

    /// Registers the release of another registration as the one that counts.
    pub(super) fn registered_as(mut self, registration: &Registration) -> Self {
        let release = registration.configuration.get("crumple");
        let facts = &mut self.record.registration.configuration;
        facts.insert("crumple".to_owned(), release.cloned().unwrap_or_default());
        self
    }

    /// Returns the registration with another seed.
    pub(super) fn registration_of_seed(&self, seed: u64) -> Registration {
        let mut registration = self.registration().clone();
        registration
            .configuration
            .insert("seed".to_owned(), seed.to_string());
        registration
    }

    /// Counts runs of a seed, the first of which starts a block, and returns the counts of each block. Calls
    /// `keep_going` after every thousand runs.
    fn count_runs(
        &self,
        seed: u64,
        runs: Range<u64>,
        keep_going: &dyn Fn() -> Result<(), Stopped>,
    ) -> Result<Vec<CountedBlock>, RateError> {
        let indices: Vec<u64> = runs.collect();
        let mut endings: Vec<Vec<RunFingerprint>> = self
            .controllers
            .iter()
            .map(|_| Vec::with_capacity(indices.len()))
            .collect();
        for batch in indices.chunks(BATCH_SIZE as usize) {
            for (all, mut more) in
                endings
                    .iter_mut()
                    .zip(self.simulate_fingerprints(&self.space, seed, batch)?)
            {
                all.append(&mut more);
            }
            keep_going()?;
        }
        let registered = self.registration_of_seed(seed).digest();
        let block_runs = self.record.block_runs() as usize;
        let blocks = indices.chunks(block_runs).enumerate();
        let counted = blocks.map(|(block, block_indices)| {
            let first = block_indices.first().copied().unwrap_or_default();
            let start = block * block_runs;
            let fingerprints = (start..start + block_indices.len()).map(|run| {
                let of_controllers = endings.iter().filter_map(|endings| endings.get(run));
                of_controllers.collect::<Vec<&RunFingerprint>>()
            });
            CountedBlock::from_runs(&registered, first, fingerprints)
        });
        Ok(counted.collect())
    }

    /// Returns failures per hour and per 1000 km if the space states its exposure, with data uncertainty from
    /// [resamples](Self::with_resampling).
    ///
    /// # Errors
    /// [`RateError`] names the failed run, or is [`RateError::Stopped`].
    pub fn rate_per_exposure(
        &self,
        tally: &CountTally,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<Option<RatePerExposure>, RateError> {
        let counter = ProgressCounter::new(observer, None);
        let Some(resampling) = self.resampling() else {
            return Ok(None);
        };
        let resamples = count_on_resamples(
            &self.space,
            self.seed,
            resampling.0,
            resampling.1,
            &mut |space, seed, runs| self.count_failures(space, seed, runs, &counter),
        )?;
        let probability = FailureProbability::Counted {
            failures: tally.failures,
            unknown: 0,
            runs: tally.runs,
        };
        Ok(RatePerExposure::new(
            &self.space,
            probability,
            resamples.as_ref(),
        ))
    }

    fn count_failures(
        &self,
        space: &ScenarioSpace,
        seed: u64,
        runs: u64,
        counter: &ProgressCounter<'_>,
    ) -> Result<u64, RateError> {
        let indices: Vec<u64> = (0..runs).collect();
        let mut failed = 0;
        for batch in indices.chunks(BATCH_SIZE as usize) {
            let endings = self.simulate_fingerprints(space, seed, batch)?;
            failed += endings
                .iter()
                .flatten()
                .filter(|ending| ending.is_failure())
                .count() as u64;
            counter.add(batch.len() as u64)?;
        }
        Ok(failed)
    }

    fn simulate_fingerprints(
        &self,
        space: &ScenarioSpace,
        seed: u64,
        indices: &[u64],
    ) -> Result<Vec<Vec<RunFingerprint>>, RateError> {
        let scenarios = indices
            .par_iter()
            .map(|&index| {
                let scenario = space.draw(seed, index);
                scenario.map_err(|source| RateError::Draw { index, source })
            })
            .collect::<Result<Vec<_>, _>>()?;
        let fingerprints = self
            .controllers
            .iter()
            .map(|controller| {
                let options =
                    RunOptions::new(controller.source.clone()).with_estimator(self.estimator);
                let runs = scenarios.iter().zip(indices).map(|(scenario, &index)| {
                    Run::new(scenario, options.clone())
                        .map_err(|source| RateError::Run { index, source })
                });
                let runs = runs.collect::<Result<Vec<_>, _>>()?;
                Ok(simulate_batch(
                    &runs,
                    RecordingLevel::Summary,
                    |_, result| RunFingerprint::new(&result),
                ))
            })
            .collect::<Result<Vec<_>, RateError>>()?;
        self.controllers
            .iter()
            .try_for_each(NamedController::ensure_trusted)?;
        Ok(fingerprints)
    }

    /// Builds the certificate of a complete tally. For one controller it states the lowest accepted rate, to nine
    /// digits.
    #[must_use]
    pub fn certificate(&self, tally: &CountTally) -> Certificate {
        self.record.certificate(tally)
    }
}

#[cfg(test)]
mod tests;
