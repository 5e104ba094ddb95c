//! Checks what crumple claims to have proved.
pub mod certificate;
pub mod claim;
pub mod interval;

pub use certificate::{
    Assumption, Avoidable, Branch, Certificate, ParseError, Provenance, Rows, Statement, Unavoidable,
};
pub use claim::{Ego, Follower, Held, Leader, Scene};
pub use interval::Interval;

/// What has been proved.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Accepted {
    /// With the stated profile nobody touches.
    Avoidable {
        /// No gap is ever smaller, in metres.
        smallest_gap_m: f64,
    },
    /// Whatever the egos do, somebody touches.
    Unavoidable {
        /// Any profile would make two vehicles overlap by at least this, in metres; infinite if every branch is empty.
        overlap_m: f64,
    },
}

/// Why a certificate proves nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Rejection {
    /// Not built yet.
    #[error("the check is not built yet")]
    Unbuilt,
}

/// Checks a certificate.
///
/// # Errors
/// [`Rejection`] if it does not prove what it states.
pub fn check(_certificate: &Certificate) -> Result<Accepted, Rejection> {
    Err(Rejection::Unbuilt)
}
