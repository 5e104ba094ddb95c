//! Gates on certificates.

use super::{GateInputs, GateMetric, GateRule, GateVerdict};
use crate::assessment::{AssessConfig, CertificateStatus};

pub(super) fn accepted(_config: &AssessConfig) -> GateRule<'static> {
    GateRule::new(
        "the checker accepts every certificate".to_owned(),
        GateMetric::none_of("rejected certificates"),
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
    let verdict = match rejected.first() {
        None => GateVerdict::new(
            all > 0,
            format!("{all} of {all} files in `certificates` are accepted"),
        ),
        Some(first) => GateVerdict::fails(format!(
            "{} of {all} certificates are rejected; first: {}",
            rejected.len(),
            first.name
        )),
    };
    verdict.with_value(rejected.len() as f64)
}
