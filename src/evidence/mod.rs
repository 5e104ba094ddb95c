//! What can be claimed with a certificate: kernels of shields, failure rates, and where a policy cannot fail.
//!
//! This side proposes; `crumple_verify` decides. Nothing is written that it has not accepted.

mod kernel;
mod rate;
mod reach;

pub use kernel::{kernel_certificate, shipped_kernels};
pub use rate::{InvalidPlan, Plan, PlanDriver, RateError, Tally};
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
