//! What can be claimed with a certificate: kernels of shields, failure rates, and where a policy cannot fail; and what can
//! only be estimated, the probability of failures too rare to count.
//!
//! This side proposes; `crumple_verify` decides. No certificate is written that it has not accepted.

mod interval;
mod kernel;
pub mod rare;
mod rate;
mod rate_folder;
mod reach;

pub use interval::RateInterval;
pub use kernel::{kernel_certificate, shipped_kernels};
pub use rate::{InvalidRate, RateConfig, RateError, RatePlan, Tally};
pub use rate_folder::{RateCount, RateFolderError};
pub use reach::{BoxSpec, Doubts, InvalidBox, Partition, RangesSpec, ReachPlan, Shares};

use crumple_verify::{Certificate, Provenance, Statement};

/// A statement as a certificate of this program, with the assumptions it needs.
fn certificate(about: &str, statement: Statement) -> Certificate {
    Certificate {
        version: crumple_verify::certificate::VERSION,
        provenance: Provenance {
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            scenario: about.to_owned(),
            scenario_sha256: String::new(),
        },
        assumptions: statement.assumptions(),
        statement,
    }
}
