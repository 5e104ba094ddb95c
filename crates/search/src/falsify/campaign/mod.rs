//! Campaigns: a space, a controller and a specification, and a search for failures with a budget.
//!
//! A campaign has a folder:
//!
//! | file | what it holds |
//! |---|---|
//! | `campaign.toml` | everything that decides the results; its hash names the campaign in the summary |
//! | `evaluations/part-*.csv.gz` | every evaluation, one row each |
//! | `counterexamples/*.toml` | distinct failures, shrunk, as scenario files; `originals/` has them as they were found, `escapes/` how those that are avoidable could have been |
//! | `counterexamples/expected.verdicts` | the recorded verdict of each of them, in TOML |
//! | `summary.json`, `summary.txt` | what was found, by which method after how many evaluations |
//! | `evaluations.journal` | only while the campaign runs: what is lost by no `kill -9`, for the build that wrote it |
//! | `work.json`, `work.lock` | what all of these are (see [`crumple_store::work`]); locked by the process that works there |
//!
//! The reference searches, uniform points and a Halton sequence, always run with the same budget as the method asked for: a search
//! that does no better than random must say so. Results depend neither on the number of threads nor on interruptions.
//!
//! Memory does not grow with the budget beyond what is kept of the search itself: evaluations go to disk, 65 536 at a time,
//! and of failures a few of each kind and those on the front of severity and likelihood are remembered.

mod config;
mod coverage;
mod encoded;
mod failures;
mod findings;
mod front;
mod journal;
mod merge;
mod objective;
mod planning;
mod reader;
mod regions;
mod resolved_config;
mod run;
mod shard;
mod summarise;
mod summary;
mod table;

pub use config::{CAMPAIGN_VERSION, Campaign, CampaignOptions, EvaluationLog, Sharding};
pub use coverage::CoveragePercentages;
pub(in crate::falsify) use encoded::verdict as encoded_verdict;
pub use failures::{FailureCandidate, FailureKind};
pub use front::FrontPoint;
pub use merge::MergedCampaign;
pub use objective::{SearchObjective, UnknownObjective};
pub use reader::{CampaignReader, MAX_READ_EVALUATIONS};
pub use regions::Region;
pub(in crate::falsify) use resolved_config::ResolvedConfig;
pub use run::{CAMPAIGN_KIND, CampaignProgress, verify_journal};
pub use shard::{CAMPAIGN_SHARD_KIND, ShardSummary};
pub use summary::{
    AvoidabilitySummary, CampaignSummary, CoverageSummary, FailureKindSummary, FailuresByMethod, MethodSummary,
};

use crumple_core::observer::Stopped;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::RunFolderError;
use crumple_world::measure::{RunVerdict, SpecificationError};
use crumple_world::scenario::InvalidField;
use crumple_world::sim::{RefusedController, RunError};

/// One evaluation of a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct EvaluatedPoint {
    /// Which one of its method, from 1.
    pub number: u64,
    /// Where in the unit cube.
    pub point: Vec<f64>,
    /// The values there, one a coordinate.
    pub values: Vec<f64>,
    /// Logarithm of the distribution's density there, relative to one that is even over the ranges.
    pub ln_likelihood: f64,
    /// Distance from nominal in the unit cube, from 0 to 1: mean over the parameters.
    pub distance_from_nominal: f64,
    /// What the run was worth.
    pub verdict: RunVerdict,
}

/// Why a campaign stops.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CampaignError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// The folder holds another campaign.
    #[error("{0}")]
    Folder(String),
    /// The folder cannot be worked in.
    #[error(transparent)]
    Work(#[from] RunFolderError),
    /// A scenario cannot be run with this controller.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A point of the space is no scenario.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// The specification does not fit the runs.
    #[error(transparent)]
    Specification(#[from] SpecificationError),
    /// The controller cannot be told from others, so nothing that was done with it can be gone on with.
    #[error(
        "the controller `{0}` states no identity: a campaign with it cannot be resumed; begin it anew, without --resume, in another --out"
    )]
    NoIdentity(String),
    /// The same, where it would be several machines that go on.
    #[error("the controller `{0}` states no identity: nobody could tell whether shards of it go together")]
    NoIdentityInShards(String),
    /// The method of a divided campaign is not built in.
    #[error("the search method `{0}` is not built in: its campaign cannot be divided into shards")]
    CustomMethodInShards(String),
    /// The search method proposed no points, or points outside the unit cube.
    #[error("the search method `{0}` must propose points of the unit cube, at least one each time")]
    InvalidPoints(String),
    /// There are more shards than evaluations.
    #[error(transparent)]
    Shards(#[from] crumple_store::shard::TooManyShards),
    /// No vehicle of the space is under test.
    #[error("the space `{0}` has no vehicle under test")]
    NoVehicleUnderTest(String),
    /// A controller is set against itself.
    #[error("`{0}` is set against itself: what the one fails the other fails as well")]
    ComparedWithItself(String),
    /// A controller contradicted itself, or cannot be started any more.
    #[error(transparent)]
    Refused(#[from] RefusedController),
    /// The observer stopped the campaign.
    #[error("the campaign was {0}")]
    Stopped(#[from] Stopped),
    /// A file cannot be encoded or decoded.
    #[error("cannot encode or decode a file of the campaign: {0}")]
    Encoding(String),
}

impl CampaignError {
    pub(crate) fn from_encoding_error(error: impl std::fmt::Display) -> Self {
        Self::Encoding(error.to_string())
    }
}
