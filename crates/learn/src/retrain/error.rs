//! Why a retraining stops.

use crate::rl::TrainingError;
use crumple_core::observer::Stopped;
use crumple_search::falsify::campaign::CampaignError;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::RunFolderError;
use crumple_world::policy::PolicyError;
use crumple_world::scenario::InvalidField;
use crumple_world::sim::RunError;

/// Why a retraining stops.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RetrainError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// The folder cannot be worked in, or something in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// The folder holds another retraining.
    #[error("{0}")]
    Folder(String),
    /// Hardly anything in the space can be avoided.
    #[error(
        "of the first {draws} draws of the space `{space}` only {avoidable} could be avoided, and {wanted} are needed"
    )]
    TooFewAvoidable {
        /// Name of the space.
        space: String,
        /// Draws that were classed.
        draws: u64,
        /// Those that could be avoided.
        avoidable: u64,
        /// How many were needed.
        wanted: u64,
    },
    /// The policy sees or acts otherwise than the preset says: its weights would mean something else.
    #[error(
        "the policy `{policy}` and the training preset `{preset}` differ in {what}: use a preset that says what the policy file does"
    )]
    PolicyMismatch {
        /// The policy.
        policy: String,
        /// Name of the preset.
        preset: String,
        /// In what they differ.
        what: &'static str,
    },
    /// A search failed.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// A training failed.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// A scenario cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A draw is no scenario.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// A policy cannot be read or written.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The observer stopped the retraining.
    #[error("the retraining was {0}")]
    Stopped(#[from] Stopped),
    /// A file cannot be encoded.
    #[error("cannot encode a file of the retraining: {0}")]
    Encoding(String),
}

impl RetrainError {
    pub(super) fn encoding(error: impl std::fmt::Display) -> Self {
        Self::Encoding(error.to_string())
    }
}
