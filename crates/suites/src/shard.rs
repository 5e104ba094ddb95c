//! Shards of a suite, and their merge. A shard runs some pairs of a test and a controller. The folder of a shard holds
//! `shard.json` (suite, controllers and estimator) and `results.json` (results of its pairs).

use std::ops::{Deref, DerefMut, Range};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::rows::ControllerResultRow;
use super::run::{SuiteRunError, assemble, pair_count, run_pairs};
use super::{ControllerResult, InvalidSuite, SuiteResult, SuiteSpec, TestSuite};
use crumple_core::observer::{Observer, RunProgress, Stopped};
use crumple_store::run_folder::{CompletedRun, RunFolder, RunFolderError};
use crumple_store::shard::{MergeError, Mergeable, MergedShards, ShardId, Sharded, TooManyShards, open_shard};
use crumple_world::observation::EstimatorKind;
use crumple_world::sim::{NamedController, UnknownController};

/// Kind of the run folder in its `work.json`.
pub const SUITE_SHARD_KIND: &str = "shard of a suite";

/// Reason why a shard of a suite is not completed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteShardError {
    /// The folder cannot be used, or a file in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// More shards than pairs of a test and a controller.
    #[error(transparent)]
    Shards(#[from] TooManyShards),
    /// The controller has no identity.
    #[error("the controller `{0}` states no identity, so crumple cannot check that shards belong together")]
    NoIdentity(String),
    /// A controller was refused during the run.
    #[error(transparent)]
    Run(#[from] SuiteRunError),
    /// The observer stopped the shard.
    #[error("the suite was {0}")]
    Stopped(#[from] Stopped),
    /// A file cannot be encoded.
    #[error("cannot encode a file of a shard: {0}")]
    Encoding(String),
}

/// Reason why a recorded controller is not available.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UnavailableController {
    /// The name is unknown here, or names a program that may not be started.
    #[error("the recorded controller `{name}` is not available: {source}")]
    NotFound {
        /// Name of the controller.
        name: String,
        /// Reason of the lookup.
        source: Box<UnknownController>,
    },
    /// The name has another identity here.
    #[error(
        "the recorded controller `{name}` is not available: its identity is {recorded}, and here `{name}` has {found}"
    )]
    OtherIdentity {
        /// Name of the controller.
        name: String,
        /// Identity in the shards: SHA-256, in hexadecimal.
        recorded: String,
        /// Identity found here, or `none`.
        found: String,
    },
}

/// Configuration of a run of a suite that is divided into shards.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardedSuite {
    run: SuiteRun,
}

impl Sharded for ShardedSuite {
    const KIND: &'static str = SUITE_SHARD_KIND;
    const VERSION: u32 = 1;
    const RESULTS_FILE: &'static str = "results.json";
    const PARTS_NAME: &'static str = "pairs of a test and a controller";

    fn part_count(&self) -> u64 {
        pair_count(&self.run.suite, self.run.controllers.len())
    }

    fn differing_field(&self, other: &Self) -> Option<String> {
        let (own, other) = (&self.run, &other.run);
        let fields = [
            ("the version of crumple", own.crumple != other.crumple),
            ("the suite", own.suite != other.suite),
            ("the list of controllers", own.controllers != other.controllers),
            ("the estimator", own.estimator != other.estimator),
        ];
        fields.iter().find(|(_, differs)| *differs).map(|(name, _)| (*name).to_owned())
    }

    fn problem(&self) -> Option<String> {
        let InvalidSuite { field, problem } = TestSuite::new(self.run.suite.clone()).err()?;
        Some(format!("run.suite.{field}: {problem}"))
    }
}

impl Mergeable for ShardedSuite {
    type File = SuiteShardResults;
    type Results = Vec<ControllerResultRow>;

    fn check(
        &self,
        results: SuiteShardResults,
        shard: ShardId,
        own: &Range<u64>,
    ) -> Result<Vec<ControllerResultRow>, String> {
        let names = self.run.controllers.iter().map(|(name, _)| name).cycle();
        let places = names.skip((own.start % self.run.controllers.len().max(1) as u64) as usize);
        let is_of = results.rows.iter().zip(places).all(|(tested, name)| tested.controller == *name);
        if results.rows.len() as u64 != own.end - own.start || !is_of {
            return Err(format!("inconsistent with shard {shard} of that suite"));
        }
        results.rows.iter().try_for_each(|row| row.clone().decode().map(drop))?;
        Ok(results.rows)
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SuiteRun {
    crumple: String,
    suite: SuiteSpec,
    controllers: Vec<(String, String)>,
    estimator: EstimatorKind,
}

/// Content of the file `results.json`.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuiteShardResults {
    #[serde(rename = "tested")]
    rows: Vec<ControllerResultRow>,
}

/// Runs a shard of a suite in `folder`, or continues it with `resume`. Returns the number of its pairs.
///
/// # Errors
/// [`SuiteShardError`] if there are fewer pairs than shards, a controller has no identity, the folder cannot be used,
/// or `observer` stops the shard.
pub fn run_shard(
    suite: &TestSuite,
    controllers: &[NamedController],
    estimator: EstimatorKind,
    shard: ShardId,
    folder: &Path,
    resume: bool,
    observer: &dyn Observer<RunProgress>,
) -> Result<u64, SuiteShardError> {
    let all = shard.range(pair_count(suite.spec(), controllers.len()), ShardedSuite::PARTS_NAME)?;
    let count = all.end - all.start;
    let identified = |controller: &NamedController| {
        let identity = controller.kind.identity();
        let identity = identity.ok_or_else(|| SuiteShardError::NoIdentity(controller.name.clone()))?;
        Ok::<_, SuiteShardError>((controller.name.clone(), identity))
    };
    let run = SuiteRun {
        crumple: env!("CARGO_PKG_VERSION").to_owned(),
        suite: suite.spec().clone(),
        controllers: controllers.iter().map(identified).collect::<Result<_, _>>()?,
        estimator,
    };
    let work = open_shard(&ShardedSuite { run }, shard, folder, resume)?;
    if work.is_complete() {
        return Ok(count);
    }
    let mut results = read_results(&work)?;
    let known = results.rows.len() as u64;
    if known > count {
        let place = work.path(ShardedSuite::RESULTS_FILE);
        return Err(RunFolderError::damaged(&place, "has more results than the shard").into());
    }
    run_pairs(suite, controllers, estimator, all.start + known..all.end, &mut |tested| {
        let row = ControllerResultRow::encode(&tested);
        results.rows.push(row.map_err(|error| SuiteShardError::Encoding(error.to_string()))?);
        work.write(ShardedSuite::RESULTS_FILE, to_json(&results)?)?;
        let done = results.rows.len() as u64;
        Ok::<(), SuiteShardError>(observer.notify(&RunProgress { done, total: Some(count) })?)
    })?;
    work.finish()?;
    Ok(count)
}

fn read_results(work: &RunFolder) -> Result<SuiteShardResults, RunFolderError> {
    let Some(bytes) = work.read(ShardedSuite::RESULTS_FILE)? else { return Ok(SuiteShardResults::default()) };
    serde_json::from_slice(&bytes)
        .map_err(|error| RunFolderError::damaged(&work.path(ShardedSuite::RESULTS_FILE), error.to_string()))
}

/// Shards of one run of a suite, for merging.
#[derive(Debug)]
pub struct MergedSuite(MergedShards<ShardedSuite>);

impl Deref for MergedSuite {
    type Target = MergedShards<ShardedSuite>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl DerefMut for MergedSuite {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

impl MergedSuite {
    /// Starts with the first shard.
    ///
    /// # Errors
    /// [`MergeError`] if the shard cannot be read.
    pub fn new(folder: &Path, found: &CompletedRun) -> Result<Self, MergeError> {
        MergedShards::new(folder, found).map(Self)
    }

    /// Lists the tests that no shard has run, each with its controller.
    #[must_use]
    pub fn missing_tests(&self) -> Vec<String> {
        let tests = self.work().run.suite.clauses.iter().flat_map(|clause| &clause.tests);
        let named = tests.flat_map(|test| self.work().run.controllers.iter().map(move |(name, _)| (&test.name, name)));
        let missing = self.missing_ranges();
        let is_missing = |index: u64| missing.iter().any(|range| range.contains(&index));
        let named = (0..).zip(named).filter(|(index, _)| is_missing(*index));
        named.map(|(_, (test, controller))| format!("{test} ({controller})")).collect()
    }

    /// Finds the recorded controllers by name; relative paths start at `folder`. A controller with another identity is
    /// an error.
    pub fn controllers(&self, folder: &Path) -> impl Iterator<Item = Result<NamedController, UnavailableController>> {
        self.work().run.controllers.iter().map(move |(name, recorded)| {
            let found = NamedController::find(name, folder)
                .map_err(|source| UnavailableController::NotFound { name: name.clone(), source: Box::new(source) })?;
            match found.kind.identity() {
                Some(identity) if identity == *recorded => Ok(NamedController { name: name.clone(), ..found }),
                other => Err(UnavailableController::OtherIdentity {
                    name: name.clone(),
                    recorded: recorded.clone(),
                    found: other.unwrap_or_else(|| "none".to_owned()),
                }),
            }
        })
    }

    /// Returns the result of the suite, identical to that of an undivided run; `None` while tests are missing.
    #[must_use]
    pub fn result(&self) -> Option<SuiteResult> {
        let rows = self.results().flatten().cloned();
        // Rows were decoded once in `check`, so none is dropped here.
        let tested: Vec<ControllerResult> = rows.filter_map(|row| row.decode().ok()).collect();
        let (run, is_complete) = (&self.work().run, tested.len() as u64 == self.work().part_count());
        is_complete.then(|| assemble(&run.suite, run.estimator, run.controllers.len(), tested))
    }
}

fn to_json(value: &impl Serialize) -> Result<String, SuiteShardError> {
    Ok(serde_json::to_string(value).map_err(|error| SuiteShardError::Encoding(error.to_string()))? + "\n")
}
