//! Gates on certificates.

use super::{GateInputs, GateRule, GateVerdict};
use crate::assessment::{AssessConfig, CertificateStatus};

pub(super) fn accepted(_config: &AssessConfig) -> GateRule<'static> {
    GateRule::new(
        "the checker accepts every certificate".to_owned(),
        None,
        check_certificates,
    )
}

fn check_certificates(inputs: &GateInputs<'_>) -> GateVerdict {
    let certificates: Vec<_> = inputs
        .results
        .proofs
        .certificates
        .iter()
        .filter(|proof| !matches!(proof.status, CertificateStatus::NothingShown { .. }))
        .collect();
    let all = certificates.len();
    let rejected: Vec<_> = certificates
        .iter()
        .filter(|proof| !proof.is_accepted())
        .collect();
    match rejected.first() {
        None => GateVerdict::new(all > 0, format!("{all} of {all} certificates are accepted")),
        Some(first) => GateVerdict::fails(format!(
            "{} of {all} are rejected; first: {}",
            rejected.len(),
            first.name
        )),
    }
}
