//! Shards of a suite: some of its pieces, each a test and a controller, and how they are put together.
//!
//! A folder holds `shard.json`, the suite itself, the controllers and the estimator, and `results.json`, what was found of its pieces.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::rows::TestedRow;
use super::run::{SuiteRunError, assembled, each, pieces};
use super::{Suite, SuiteResult, SuiteSpec, Tested};
use crate::shard::{self, MergeError, MissingShards, Parts, SHARD, Shard, TooManyShards};
use crate::work::{Finished, Work, WorkError};
use crumple_world::observation::EstimatorKind;
use crumple_world::sim::{NamedController, UnknownController};

/// What a folder of one is called in its `work.json`.
pub const SHARD_OF_A_SUITE: &str = "shard of a suite";

const RESULTS: &str = "results.json";
/// The version of these files.
const VERSION: u32 = 1;
const WHAT: &str = "pairs of a test and a controller";

/// Why a shard of a suite is not made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteShardError {
    /// The folder cannot be worked in, or something in it is damaged.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// There are more shards than tests and controllers.
    #[error(transparent)]
    Shards(#[from] TooManyShards),
    /// The controller cannot be told from others.
    #[error("the controller `{0}` states no identity: nobody could tell whether shards of it go together")]
    Unknown(String),
    /// A controller was refused on the way.
    #[error(transparent)]
    Run(#[from] SuiteRunError),
    /// A file cannot be encoded.
    #[error("cannot encode a file of a shard: {0}")]
    Encoding(String),
}

/// Reason why a controller that shards record cannot drive here.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UnavailableController {
    /// Its name stands for no controller here, or for a program that may not be started.
    #[error("the recorded controller `{name}` is not available: {source}")]
    NotFound {
        /// Its name.
        name: String,
        /// The reason.
        source: Box<UnknownController>,
    },
    /// Its name stands for another controller here.
    #[error(
        "the recorded controller `{name}` is not available: its identity is {recorded}, and here `{name}` has {found}"
    )]
    Other {
        /// Its name.
        name: String,
        /// The identity in the shards: SHA-256, in hexadecimal.
        recorded: String,
        /// The identity found, or `none`.
        found: String,
    },
}

/// The file `shard.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShardFile {
    version: u32,
    shard: Shard,
    run: SuiteRun,
}

/// Everything that decides a run of a suite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SuiteRun {
    crumple: String,
    suite: SuiteSpec,
    /// Names, and identities.
    controllers: Vec<(String, String)>,
    estimator: EstimatorKind,
}

/// The file `results.json`.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Results {
    tested: Vec<TestedRow>,
}

/// Makes a shard of a suite in `folder`, or goes on with it where `resume` says so. `done` hears how many of how many pieces there are.
///
/// # Errors
/// [`SuiteShardError`] if there are fewer pieces than shards, a controller states no identity, or the folder cannot be used.
pub fn run_shard(
    (suite, controllers, estimator): (&Suite, &[NamedController], EstimatorKind),
    shard: Shard,
    folder: &Path,
    resume: bool,
    done: &mut dyn FnMut(u64, u64),
) -> Result<u64, SuiteShardError> {
    let all = shard.range(pieces(suite, controllers.len()), WHAT)?;
    let count = all.end - all.start;
    let identified = |controller: &NamedController| {
        let identity = controller.kind.identity();
        let identity = identity.ok_or_else(|| SuiteShardError::Unknown(controller.name.clone()))?;
        Ok::<_, SuiteShardError>((controller.name.clone(), identity))
    };
    let run = SuiteRun {
        crumple: env!("CARGO_PKG_VERSION").to_owned(),
        suite: suite.spec().clone(),
        controllers: controllers.iter().map(identified).collect::<Result<_, _>>()?,
        estimator,
    };
    let configuration = json(&ShardFile { version: VERSION, shard, run })?;
    let work = shard::open_shard(folder, SHARD_OF_A_SUITE, &configuration, RESULTS, resume)?;
    if work.is_complete() {
        return Ok(count);
    }
    let mut results = resumed(&work)?;
    let known = results.tested.len() as u64;
    if known > count {
        return Err(WorkError::damaged(&work.path(RESULTS), "more than the shard has").into());
    }
    each(suite, controllers, estimator, all.start + known..all.end, &mut |tested| {
        results.tested.push(TestedRow::of(&tested).map_err(|error| SuiteShardError::Encoding(error.to_string()))?);
        done(results.tested.len() as u64, count);
        work.write(RESULTS, json(&results)?)?;
        Ok::<(), SuiteShardError>(())
    })?;
    work.finish()?;
    Ok(count)
}

fn resumed(work: &Work) -> Result<Results, WorkError> {
    let Some(bytes) = work.read(RESULTS)? else { return Ok(Results::default()) };
    serde_json::from_slice(&bytes).map_err(|error| WorkError::damaged(&work.path(RESULTS), error.to_string()))
}

/// Shards of one run of a suite.
#[derive(Debug)]
pub struct MergedSuite {
    run: SuiteRun,
    suite: Suite,
    /// Of pieces.
    parts: Parts<Vec<TestedRow>>,
}

impl MergedSuite {
    /// Begins with a shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn of(folder: &Path, found: &Finished) -> Result<Self, MergeError> {
        let file = read(found)?;
        let invalid = |(field, problem)| found.damaged(SHARD, format!("run.suite.{field}: {problem}"));
        let suite = Suite::new(file.run.suite.clone()).map_err(invalid)?;
        let mut merged = Self { run: file.run, suite, parts: Parts::of(folder) };
        merged.take(folder, found)?;
        Ok(merged)
    }

    /// Takes in another shard. After an error it is as it was.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or does not go with the others.
    pub fn take(&mut self, folder: &Path, found: &Finished) -> Result<(), MergeError> {
        let ShardFile { shard, run, .. } = read(found)?;
        if run != self.run {
            let fields = [
                ("the version of crumple", run.crumple != self.run.crumple),
                ("the suite", run.suite != self.run.suite),
                ("the list of controllers", run.controllers != self.run.controllers),
            ];
            let field = fields.iter().find(|(_, differs)| *differs).map_or("the estimator", |(name, _)| *name);
            return Err(self.parts.foreign(folder, field.to_owned()));
        }
        let range = shard.range(self.pieces(), WHAT).map_err(|error| found.damaged(SHARD, error))?;
        let results: Results =
            serde_json::from_str(&found.read(RESULTS)?).map_err(|error| found.unreadable(RESULTS, &error))?;
        let names = self.run.controllers.iter().map(|(name, _)| name).cycle();
        let places = names.skip((range.start % self.run.controllers.len().max(1) as u64) as usize);
        let is_of = results.tested.iter().zip(places).all(|(tested, name)| tested.controller == *name);
        if results.tested.len() as u64 != range.end - range.start || !is_of {
            return Err(found.damaged(RESULTS, format!("not what shard {shard} of that suite comes to")).into());
        }
        for row in &results.tested {
            row.clone().read().map_err(|problem| found.damaged(RESULTS, problem))?;
        }
        self.parts.place(folder, shard, range, results.tested)
    }

    fn pieces(&self) -> u64 {
        pieces(&self.suite, self.run.controllers.len())
    }

    /// Tests that no shard has run, each with its controller, in words.
    #[must_use]
    pub fn missing(&self) -> Vec<String> {
        let tests = self.suite.spec().clauses.iter().flat_map(|clause| &clause.tests);
        let named = tests.flat_map(|test| self.run.controllers.iter().map(move |(name, _)| (&test.name, name)));
        let missing = self.parts.missing(self.pieces());
        let is_missing = |index: u64| missing.iter().any(|range| range.contains(&index));
        let named = (0..).zip(named).filter(|(index, _)| is_missing(*index));
        named.map(|(_, (test, controller))| format!("{test} ({controller})")).collect()
    }

    /// Which shards are missing.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        self.parts.missing_shards()
    }

    /// Looks the recorded controllers up by their names, whose relative paths start at `folder`. Only a controller with the
    /// recorded identity is available.
    pub fn controllers(&self, folder: &Path) -> impl Iterator<Item = Result<NamedController, UnavailableController>> {
        self.run.controllers.iter().map(move |(name, recorded)| {
            let found = NamedController::find(name, folder)
                .map_err(|source| UnavailableController::NotFound { name: name.clone(), source: Box::new(source) })?;
            match found.kind.identity() {
                Some(identity) if identity == *recorded => Ok(NamedController { name: name.clone(), ..found }),
                other => Err(UnavailableController::Other {
                    name: name.clone(),
                    recorded: recorded.clone(),
                    found: other.unwrap_or_else(|| "none".to_owned()),
                }),
            }
        })
    }

    /// What the suite found, the same as by one machine; none while tests are missing.
    #[must_use]
    pub fn result(&self) -> Option<SuiteResult> {
        let rows = self.parts.contents().flatten().cloned();
        // All of them were read once already.
        let tested: Vec<Tested> = rows.filter_map(|row| row.read().ok()).collect();
        let is_complete = tested.len() as u64 == self.pieces();
        is_complete.then(|| assembled(&self.suite, self.run.estimator, self.run.controllers.len(), tested))
    }
}

fn read(found: &Finished) -> Result<ShardFile, WorkError> {
    shard::read_shard(found, VERSION)
}

fn json(value: &impl Serialize) -> Result<String, SuiteShardError> {
    Ok(serde_json::to_string(value).map_err(|error| SuiteShardError::Encoding(error.to_string()))? + "\n")
}
