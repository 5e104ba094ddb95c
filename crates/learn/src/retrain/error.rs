//! Errors of a retraining.

use crate::rl::TrainingError;
use crumple_core::observer::Stopped;
use crumple_search::falsify::campaign::CampaignError;
use crumple_search::worst_case::AttackError;
use crumple_sim::engine::RunError;
use crumple_sim::policy::PolicyError;
use crumple_sim::scenario::InvalidField;
use crumple_sim::scenario::file::ScenarioFileError;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::RunFolderError;

/// Reason why a retraining stops.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RetrainError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// The folder cannot be used, or a file in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// A counterexample cannot be read.
    #[error(transparent)]
    Counterexample(#[from] ScenarioFileError),
    /// Too few scenarios of the space are avoidable.
    #[error(
        "only {avoidable} collisions are avoidable in the first {draws} random scenarios of the space `{space}`, and \
         {wanted} are needed"
    )]
    TooFewAvoidable {
        /// Name of the space.
        space: String,
        /// Number of classified scenarios.
        draws: u64,
        /// Number of avoidable scenarios.
        avoidable: u64,
        /// Number of scenarios that are needed.
        wanted: u64,
    },
    /// Policy and preset disagree on observation or action, so the weights would have another meaning.
    #[error(
        "the policy `{policy}` and the training preset `{preset}` differ in {what}: use a preset that matches the \
         policy file"
    )]
    PolicyMismatch {
        /// The policy.
        policy: String,
        /// Name of the preset.
        preset: String,
        /// Difference between them.
        what: &'static str,
    },
    /// A search failed.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// A scenario cannot be attacked.
    #[error("the scenario `{scenario}` cannot be attacked: {error}")]
    Attack {
        /// Name of the scenario.
        scenario: String,
        /// Reason.
        error: Box<AttackError>,
    },
    /// A training failed.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// A scenario cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A random scenario is invalid.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// A policy cannot be read or written.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The observer stopped the retraining.
    #[error("the retraining was {0}")]
    Stopped(#[from] Stopped),
}
