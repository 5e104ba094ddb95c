//! Shards of an assessment: each gathers some of the evidence, and the shards are merged.
//!
//! A shard folder holds `shard.json`, with the fingerprint of the assessment and the list of tasks, and
//! `evidence.json`. Until it is complete, its evidence is cached in the folder `evidence`.

use std::fs;
use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::cache::{CacheEntry, CacheError, EvidenceCache};
use super::evidence_tasks::evidence_tasks;
use super::gather_context::GatherContext;
use super::{AssessError, AssessmentPlan};
use crumple_core::digest::sha256;
use crumple_core::observer::{Observer, ProgressCounter, RunProgress};
use crumple_store::disk::DiskError;
use crumple_store::run_folder::{CompletedRun, RunFolderError};
use crumple_store::shard::{
    MergeError, Mergeable, MergedShards, MissingShards, ShardId, Sharded, TooManyShards, open_shard,
};
use crumple_world::scenario::file;

/// Kind of a shard folder in its `work.json`.
pub const ASSESSMENT_SHARD_KIND: &str = "shard of an assessment";

const EVIDENCE_FILE: &str = "evidence.json";
const CACHE_FOLDER: &str = "evidence";

/// An error of gathering a shard.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvidenceShardError {
    /// The folder cannot be used, or something in it is damaged.
    #[error(transparent)]
    Work(#[from] RunFolderError),
    /// There are more shards than tasks.
    #[error(transparent)]
    Shards(#[from] TooManyShards),
    /// A controller has no identity.
    #[error("the controller `{0}` states no identity, so crumple cannot store its evidence in a shard")]
    NoIdentity(String),
    /// Evidence cannot be gathered.
    #[error(transparent)]
    Assess(#[from] AssessError),
}

impl From<CacheError> for EvidenceShardError {
    fn from(error: CacheError) -> Self {
        Self::Assess(error.into())
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct ShardedAssessment {
    assessment: AssessmentFingerprint,
}

impl Sharded for ShardedAssessment {
    const KIND: &'static str = ASSESSMENT_SHARD_KIND;
    const VERSION: u32 = 1;
    const RESULTS_FILE: &'static str = EVIDENCE_FILE;
    const PARTS_NAME: &'static str = "pieces of evidence";

    fn part_count(&self) -> u64 {
        self.assessment.tasks.len() as u64
    }

    fn differing_field(&self, other: &Self) -> Option<String> {
        if self == other {
            return None;
        }
        Some(match self.assessment.program == other.assessment.program {
            true => "the configuration, or a file that it names,".to_owned(),
            false => "the build".to_owned(),
        })
    }
}

impl Mergeable for ShardedAssessment {
    type File = Vec<CacheEntry>;
    type Results = Vec<CacheEntry>;

    fn check(&self, kept: Vec<CacheEntry>, _: ShardId, _: &Range<u64>) -> Result<Vec<CacheEntry>, String> {
        match kept.iter().all(|one| one.is_intact(&self.assessment.program)) {
            true => Ok(kept),
            false => Err("the evidence is from another build".to_owned()),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AssessmentFingerprint {
    /// Digest of the executable; evidence of another one is not accepted.
    program: String,
    /// Digest of the configuration and all that it names.
    plan_sha256: String,
    /// All tasks, in the order in which they are divided.
    #[serde(rename = "pieces")]
    tasks: Vec<String>,
}

/// Gathers the evidence of a shard in `folder`, or resumes it. Returns the number of tasks. `program` is the digest of
/// the executable.
///
/// # Errors
/// [`EvidenceShardError`] if there are fewer tasks than shards, a controller has no identity, the folder cannot be
/// used, evidence cannot be gathered, or `observer` stops the shard.
pub fn gather_shard(
    plan: &AssessmentPlan,
    shard: ShardId,
    folder: &Path,
    program: &str,
    observer: &dyn Observer<RunProgress>,
) -> Result<u64, EvidenceShardError> {
    if let Some(unknown) = plan.first_without_identity() {
        return Err(EvidenceShardError::NoIdentity(unknown.name.clone()));
    }
    let all = evidence_tasks(plan)?;
    let range = shard.range(all.len() as u64, ShardedAssessment::PARTS_NAME)?;
    let own = all.get(range.start as usize..range.end as usize).unwrap_or_default();
    let assessment = AssessmentFingerprint {
        program: program.to_owned(),
        plan_sha256: plan_digest(plan)?,
        tasks: all.iter().map(|piece| piece.name.clone()).collect(),
    };
    let work = open_shard(&ShardedAssessment { assessment }, shard, folder, true)?;
    let under_way = folder.join(CACHE_FOLDER);
    if !work.is_complete() {
        let cache = EvidenceCache::open(&under_way, program, false)?;
        let gathering = GatherContext::new(plan, &cache, ProgressCounter::new(observer, None));
        own.iter().try_for_each(|piece| piece.gather(&gathering))?;
        let entries = serde_json::to_string(&cache.entries()?).map_err(CacheError::encoding)?;
        work.write(EVIDENCE_FILE, entries + "\n")?;
        work.finish()?;
    }
    // An earlier run may have stopped before this removal.
    match fs::remove_dir_all(&under_way) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(RunFolderError::from(DiskError::at(&under_way)(error)).into())
        }
        _ => Ok(own.len() as u64),
    }
}

/// Merged evidence of shards of one assessment.
#[derive(Debug)]
pub struct MergedEvidence(MergedShards<ShardedAssessment>);

impl MergedEvidence {
    /// Starts with one shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn new(folder: &Path, found: &CompletedRun) -> Result<Self, MergeError> {
        MergedShards::new(folder, found).map(Self)
    }

    /// Adds another shard. After an error nothing has changed.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or is not a shard of the same assessment.
    pub fn add_shard(&mut self, folder: &Path, found: &CompletedRun) -> Result<(), MergeError> {
        self.0.add_shard(folder, found)
    }

    /// Returns the tasks that no shard has gathered.
    #[must_use]
    pub fn missing_tasks(&self) -> Vec<String> {
        let pieces = &self.0.work().assessment.tasks;
        let of = |range: Range<u64>| pieces.get(range.start as usize..range.end as usize);
        self.0.missing_ranges().into_iter().filter_map(of).flatten().cloned().collect()
    }

    /// Returns the missing shards.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        self.0.missing_shards()
    }

    /// Returns the digest of the executable that gathered the evidence.
    #[must_use]
    pub fn program(&self) -> &str {
        &self.0.work().assessment.program
    }

    /// Writes the evidence to a cache folder, where an assessment finds it. Returns the number of pieces.
    ///
    /// # Errors
    /// [`CacheError`] if it cannot be written, or is in use.
    pub fn write_to_cache(&self, folder: &Path) -> Result<usize, CacheError> {
        let cache = EvidenceCache::open(folder, &self.0.work().assessment.program, false)?;
        self.0.results().flatten().map(|kept| cache.insert(kept)).sum()
    }
}

fn plan_digest(plan: &AssessmentPlan) -> Result<String, CacheError> {
    let spaces: Vec<_> = plan.rate_spaces.iter().chain(&plan.search_spaces).map(|named| named.text.as_str()).collect();
    let traffic = plan.file_scenarios.iter().map(|(path, scenario)| Ok((path, file::to_toml(scenario)?)));
    let traffic = traffic.collect::<Result<Vec<_>, toml::ser::Error>>().map_err(CacheError::encoding)?;
    let suites: Vec<_> = plan.suites.iter().map(|planned| &planned.content_id.sha256).collect();
    Ok(sha256(json!([plan.config, plan.identities(), spaces, traffic, suites]).to_string()))
}
