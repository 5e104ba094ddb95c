//! Campaigns: a search for failures of a controller in a scenario space, with a specification and a budget.
//!
//! A campaign has a run folder:
//!
//! | file | content |
//! |---|---|
//! | `campaign.toml` | everything that decides the results; the summary contains its hash |
//! | `evaluations/part-*.csv.gz` | every evaluation, one row each |
//! | `counterexamples/*.toml` | distinct failures, shrunk, as scenario files |
//! | `counterexamples/originals/` | the same failures as they were found |
//! | `counterexamples/escapes/` | for avoidable failures: a scenario that avoids them |
//! | `counterexamples/expected.verdicts` | their recorded verdicts, in TOML |
//! | `summary.json`, `summary.txt` | results of each method |
//! | `evaluations.journal` | evaluations of a running campaign; survive `kill -9`; readable by the same build only |
//! | `work.json`, `work.lock` | manifest and lock (see [`crumple_store::run_folder`]) |
//!
//! The reference searches (uniform points and a Halton sequence) always run with the budget of the requested method, to
//! show if it is better than random. Results depend neither on the number of threads nor on interruptions.
//!
//! Apart from the state of the search itself, memory does not grow with the budget. Parts of 65 536 evaluations are
//! written to disk. Memory holds a few failures of each kind.

mod config;
mod failures;
mod findings;
mod first_failure;
mod journal;
mod objective;
mod reader;
mod resolved_config;
mod run;
mod summarise;
mod summary;
mod table;

pub use config::{CAMPAIGN_VERSION, Campaign, EvaluationLog, MAX_BUDGET, MAX_SEED, SearchSettings};
pub use failures::{FailureCandidate, FailureKind};
pub use first_failure::FirstFailure;
pub use objective::{SearchObjective, UnknownObjective};
pub use reader::{CampaignReader, MAX_READ_EVALUATIONS};
pub(in crate::falsify) use resolved_config::ResolvedConfig;
pub use run::{CampaignProgress, CampaignState, ExaminationStep, verify_journal};
pub use summary::{
    AllMethodsSummary, AvoidabilitySummary, CampaignReport, CampaignSummary, ConfirmationSummary,
    FailureKindSummary, FailuresByMethod, MethodSummary,
};

use std::ops::RangeInclusive;

use super::{InvalidPoints, Method};
use crumple_core::field_error::FieldError;
use crumple_core::observer::Stopped;
use crumple_measure::{RunVerdict, SpecificationError};
use crumple_sim::engine::{RefusedController, RunError};
use crumple_sim::scenario::InvalidField;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::RunFolderError;

/// One evaluation of a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct EvaluatedPoint {
    /// Number of the evaluation of its method, from 1.
    pub number: u64,
    /// Point in the unit cube.
    pub point: Vec<f64>,
    /// Values at the point, one per coordinate.
    pub values: Vec<f64>,
    /// Logarithm of the density under the space's distribution, relative to the uniform density.
    pub ln_likelihood: f64,
    /// Distance from the nominal scenario in the unit cube, from 0 to 1: mean distance over the parameters.
    pub distance_from_nominal: f64,
    /// Harm of the first collision; 0 unless the objective is [`SearchObjective::Harm`].
    pub harm: f64,
    /// Verdict of the simulation.
    pub verdict: RunVerdict,
}

/// An error of running or reading a campaign.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CampaignError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// The folder cannot be used as a run folder.
    #[error(transparent)]
    Work(#[from] RunFolderError),
    /// A scenario cannot be simulated with this controller.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A point of the space is not a valid scenario.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// The specification does not fit the simulations.
    #[error(transparent)]
    Specification(#[from] SpecificationError),
    /// The search method proposed no points, or points outside the unit cube.
    #[error("the search method `{method}` {problem}")]
    InvalidPoints {
        /// Name of the method.
        method: String,
        /// Problem of the points.
        problem: InvalidPoints,
    },
    /// A number is out of range.
    #[error(transparent)]
    OutOfRange(#[from] FieldError),
    /// No vehicle of the space is under test.
    #[error("the space `{0}` has no vehicle under test")]
    NoVehicleUnderTest(String),
    /// A controller is compared with itself.
    #[error(
        "the controller `{0}` is compared with itself: choose another controller to compare with"
    )]
    ComparedWithItself(String),
    /// A comparison has the same method twice.
    #[error("the search method `{}` is given twice", .0.name())]
    RepeatedMethod(Method),
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
    /// Checks that a number is in its range.
    ///
    /// # Errors
    /// [`CampaignError::OutOfRange`] if it is not.
    pub fn check_range(
        field: &'static str,
        found: u64,
        range: RangeInclusive<u64>,
    ) -> Result<(), Self> {
        if range.contains(&found) {
            Ok(())
        } else {
            let [least, most] = [range.start(), range.end()];
            let problem = format!("must be from {least} to {most}, found {found}");
            Err(Self::OutOfRange(FieldError::new(field, problem)))
        }
    }

    pub(crate) fn from_encoding_error(error: impl std::fmt::Display) -> Self {
        Self::Encoding(error.to_string())
    }
}
