//! Claims with certificates: safety kernels of shields, failure rates, and boxes of initial states in which a policy
//! cannot fail. [`rare`] estimates rare failure rates without a certificate; [`fit`] fits scenario spaces to recorded
//! episodes.
//!
//! `crumple_verify` checks certificates independently. [`RatePlan`] writes only certificates that it accepts.

mod binding;
mod block;
mod certificate_report;
mod count_report;
mod count_study;
mod drive_report;
mod drive_search;
pub mod drives;
#[cfg(test)]
mod drives_tests;
pub mod exposure;
pub mod fit;
#[cfg(test)]
mod fixtures;
mod initial_set;
mod invariant;
mod kernel;
mod method_comparison;
mod paired;
mod planning;
mod pool;
pub mod rare;
mod rate;
mod reach;
mod record;
mod recorded_drive;
mod remote;
mod replay_report;
mod rerun;
mod script;
mod two_sided;

pub use binding::{
    BindingError, ScenarioMismatch, check_binding, check_covers_scenario, count_omitted_vehicles,
};
pub use block::CountedBlock;
pub use certificate_report::{
    CertificateReport, CountsStatus, UncheckedCertificate, report_json, report_text, unchecked_json,
};
pub use count_report::CountReport;
pub use count_study::{CERTIFICATE_FILE, CountResult, CountState, RateFolderError};
pub use crumple_core::interval::RateInterval;
pub use drive_report::{DriveComfort, DriveReport, EventRate};
pub use drive_search::{DriveFailure, DriveSearch, DriveSearchError};
pub use invariant::{
    Defeat, InvariantOptions, InvariantPlan, InvariantProgress, InvariantReport, InvariantSet,
    InvariantSpec, InvariantStage,
};
pub use kernel::{kernel_certificate, shipped_kernels};
pub use method_comparison::{MAX_SEEDS, MethodComparison, MethodPair, MethodRuns, PairedTest};
pub use paired::DiscordantPairs;
pub use planning::{SampleSizeError, required_runs};
pub use pool::{PoolCheck, PoolError, PoolReport, RejectedPool};
pub use rate::{CountProgress, InvalidRate, RateConfig, RateError, RatePlan};
pub use reach::{
    BoxSpec, InvalidBox, MAX_BOXES, Partition, RangesSpec, ReachPlan, ReachReport, UndecidedCounts,
    VolumeShares, checker_file,
};
pub use record::{CountRecord, CountTally};
pub use remote::{BlockSource, CountedBlocks, RemoteCountError};
pub use replay_report::{DriveOfRecording, ReplayReport};
pub use rerun::{BlockSelection, Confirmation, Rerun, RerunError};
pub use two_sided::{
    NoTwoSidedCertificate, ScenarioFollower, describe_followers, filter_certificate,
    initial_state_certificate, plan_certificate,
};

use crumple_verify::{Certificate, Statement};

use crumple_search::worst_case::build_certificate;

fn certificate_without_scenario(statement: Statement) -> Certificate {
    build_certificate(String::new(), None, None, statement)
}
