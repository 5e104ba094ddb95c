//! Shards of an assessment: some of its pieces of evidence each, and how the evidence is put together.
//!
//! A folder holds `shard.json`, what the evidence is of and which pieces there are, and `evidence.json`, what was gathered. While it is
//! gathered it is kept in the folder `evidence`, as that of a report is.

use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::pieces::pieces;
use super::store::{Kept, Store, StoreError};
use super::work::Work as Gathering;
use super::{AssessError, AssessmentPlan};
use crumple_search::disk::DiskError;
use crumple_search::shard::{MergeError, MissingShards, Parts, Shard, TooManyShards, open_shard, read_shard};
use crumple_search::work::{Finished, WorkError};
use crumple_world::digest::sha256;
use crumple_world::scenario::file;

/// What a folder of one is called in its `work.json`.
pub const SHARD_OF_AN_ASSESSMENT: &str = "shard of an assessment";

const EVIDENCE: &str = "evidence.json";
/// Where evidence is kept until all of a shard is there.
const UNDER_WAY: &str = "evidence";
/// The version of these files.
const VERSION: u32 = 1;
const WHAT: &str = "pieces of evidence";

/// Why a shard of an assessment is not made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvidenceShardError {
    /// The folder cannot be worked in, or something in it is damaged.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// There are more shards than pieces of evidence.
    #[error(transparent)]
    Shards(#[from] TooManyShards),
    /// A controller cannot be told from others.
    #[error("the controller `{0}` states no identity, so that nothing of it is kept")]
    Unknown(String),
    /// Evidence cannot be gathered.
    #[error(transparent)]
    Assess(#[from] AssessError),
}

impl From<StoreError> for EvidenceShardError {
    fn from(error: StoreError) -> Self {
        Self::Assess(error.into())
    }
}

/// The file `shard.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShardFile {
    version: u32,
    shard: Shard,
    assessment: Whole,
}

/// What evidence is of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Whole {
    /// Digest of the executable: evidence of another is none for it.
    program: String,
    /// Digest of the configuration and all that it names.
    plan_sha256: String,
    /// All pieces, in the order in which they are divided.
    pieces: Vec<String>,
}

/// Gathers the evidence of a shard in `folder`, or goes on with it. Says how many pieces it has.
///
/// # Errors
/// [`EvidenceShardError`] if there are fewer pieces than shards, a controller states no identity, the folder cannot be used, or evidence
/// not be gathered.
pub fn gather_shard(
    plan: &AssessmentPlan,
    (shard, folder, program): (Shard, &Path, &str),
    told: &(dyn Fn(u64) + Sync),
) -> Result<u64, EvidenceShardError> {
    if let Some(unknown) = plan.without_identity() {
        return Err(EvidenceShardError::Unknown(unknown.name.clone()));
    }
    let all = pieces(plan)?;
    let range = shard.range(all.len() as u64, WHAT)?;
    let own = all.get(range.start as usize..range.end as usize).unwrap_or_default();
    let assessment = Whole {
        program: program.to_owned(),
        plan_sha256: digest(plan)?,
        pieces: all.iter().map(|piece| piece.name.clone()).collect(),
    };
    let configuration = text(&ShardFile { version: VERSION, shard, assessment })?;
    let work = open_shard(folder, SHARD_OF_AN_ASSESSMENT, &configuration, EVIDENCE, true)?;
    let under_way = folder.join(UNDER_WAY);
    if !work.is_complete() {
        let store = Store::open(&under_way, program, false)?;
        let told = |done| {
            told(done);
            std::ops::ControlFlow::Continue(())
        };
        let gathering = Gathering::new(&store, &told).with(&plan.controllers);
        own.iter().try_for_each(|piece| piece.gather(&gathering))?;
        work.write(EVIDENCE, text(&store.kept()?)?)?;
        work.finish()?;
    }
    // It may have ended before that.
    match fs::remove_dir_all(&under_way) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(WorkError::from(DiskError::at(&under_way)(error)).into())
        }
        _ => Ok(own.len() as u64),
    }
}

/// Shards of one assessment.
#[derive(Debug)]
pub struct MergedEvidence {
    whole: Whole,
    /// Of pieces.
    parts: Parts<Vec<Kept>>,
}

impl MergedEvidence {
    /// Begins with a shard.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read.
    pub fn of(folder: &Path, found: &Finished) -> Result<Self, MergeError> {
        let (file, _) = read(found)?;
        let mut merged = Self { whole: file.assessment, parts: Parts::of(folder) };
        merged.take(folder, found)?;
        Ok(merged)
    }

    /// Takes in another shard. After an error it is as it was.
    ///
    /// # Errors
    /// [`MergeError`] if it cannot be read, or does not go with the others.
    pub fn take(&mut self, folder: &Path, found: &Finished) -> Result<(), MergeError> {
        let (ShardFile { shard, assessment, .. }, kept) = read(found)?;
        if assessment != self.whole {
            let field = match assessment.program == self.whole.program {
                true => "the configuration, or something that it names,",
                false => "the build",
            };
            return Err(self.parts.foreign(folder, field.to_owned()));
        }
        let all = self.whole.pieces.len() as u64;
        let range = shard.range(all, WHAT).map_err(|error| found.damaged("shard.json", error))?;
        if !kept.iter().all(|one| one.is_sound(&assessment.program)) {
            return Err(found.damaged(EVIDENCE, "not evidence of that build").into());
        }
        self.parts.place(folder, shard, range, kept)
    }

    /// Pieces that no shard has gathered.
    #[must_use]
    pub fn missing(&self) -> Vec<String> {
        let missing = self.parts.missing(self.whole.pieces.len() as u64);
        let of = |range: std::ops::Range<u64>| self.whole.pieces.get(range.start as usize..range.end as usize);
        missing.into_iter().filter_map(of).flatten().cloned().collect()
    }

    /// Which shards are missing.
    #[must_use]
    pub fn missing_shards(&self) -> MissingShards {
        self.parts.missing_shards()
    }

    /// The build that the evidence is of.
    #[must_use]
    pub fn program(&self) -> &str {
        &self.whole.program
    }

    /// Puts the evidence into a folder of evidence, where an assessment finds it. How many pieces there are.
    ///
    /// # Errors
    /// [`StoreError`] if it cannot be written, or is in use.
    pub fn write_in(&self, folder: &Path) -> Result<usize, StoreError> {
        let store = Store::open(folder, &self.whole.program, false)?;
        let all = self.parts.contents().flatten();
        all.map(|kept| store.keep(kept)).sum()
    }
}

fn read(found: &Finished) -> Result<(ShardFile, Vec<Kept>), WorkError> {
    let file: ShardFile = read_shard(found, VERSION)?;
    let kept = serde_json::from_str(&found.read(EVIDENCE)?).map_err(|error| found.unreadable(EVIDENCE, &error))?;
    Ok((file, kept))
}

/// Of all that decides the evidence.
fn digest(plan: &AssessmentPlan) -> Result<String, StoreError> {
    let spaces: Vec<_> = plan.distributions.iter().chain(&plan.spaces).map(|named| named.text.as_str()).collect();
    let traffic = plan.traffic.iter().map(|(path, scenario)| Ok((path, file::to_toml(scenario)?)));
    let traffic = traffic.collect::<Result<Vec<_>, toml::ser::Error>>().map_err(StoreError::encoding)?;
    let suites: Vec<_> = plan.suites.iter().map(|planned| &planned.known.sha256).collect();
    Ok(sha256(json!([plan.config, plan.identities(), spaces, traffic, suites]).to_string()))
}

fn text(value: &impl Serialize) -> Result<String, StoreError> {
    Ok(serde_json::to_string(value).map_err(StoreError::encoding)? + "\n")
}
