//! Binding of a version 2 statement to its subject.
//!
//! The certificate holds the texts of scenario, box and space, and their hash is checked here. `crumple check` compares
//! the numbers of the statement with the texts. A rate states its space and program twice; both must agree. Fields that
//! do not belong to a kind of statement are rejected, so that no part of a certificate stays unchecked.

use crate::ClaimSubject;
use crate::assumption::Assumption;
use crate::canonical::sha256;
use crate::certificate::{Certificate, CertificateProvenance};
use crate::rejection::Rejection;

/// Checks all that version 2 adds.
pub(crate) fn check(certificate: &Certificate) -> Result<(), Rejection> {
    let provenance = &certificate.provenance;
    let mut order = certificate.statement.assumptions();
    order.extend(
        certificate
            .assumptions
            .contains(&Assumption::NoiseOfSeed)
            .then_some(Assumption::NoiseOfSeed),
    );
    if certificate.assumptions != order {
        return Err(Rejection::invalid(
            "assumptions",
            "are not in the order of their definition",
        ));
    }
    let claim = certificate.statement.claim();
    check_texts(provenance, claim.subject())?;
    claim.check_fields(provenance)
}

/// Checks that the certificate contains the texts that its subject needs.
fn check_texts(
    provenance: &CertificateProvenance,
    subject: ClaimSubject<'_>,
) -> Result<(), Rejection> {
    let box_problem = match subject {
        ClaimSubject::AnyVehicles => {
            return check_no_source(
                provenance,
                "must be absent: a kernel does not belong to a scenario",
            );
        }
        ClaimSubject::AnyNeighbours => {
            return check_no_source(provenance, "must be absent: the statement has all numbers");
        }
        ClaimSubject::Scene { .. } => None,
        ClaimSubject::InitialStates(_) | ClaimSubject::Region(_) => {
            provenance.box_text.is_none().then_some("is missing")
        }
        ClaimSubject::Runs(_) => {
            let has_box = provenance.box_text.is_some();
            has_box.then_some("must be absent: runs are drawn from a space")
        }
    };
    check_source(provenance)?;
    match box_problem {
        Some(problem) => Err(Rejection::invalid("provenance.box_text", problem)),
        None => Ok(()),
    }
}

fn check_no_source(
    provenance: &CertificateProvenance,
    problem: &'static str,
) -> Result<(), Rejection> {
    let CertificateProvenance {
        scenario,
        scenario_sha256,
        scenario_text,
        box_text,
        ..
    } = provenance;
    let given = [
        ("provenance.scenario", !scenario.is_empty()),
        ("provenance.scenario_sha256", !scenario_sha256.is_empty()),
        ("provenance.scenario_text", scenario_text.is_some()),
        ("provenance.box_text", box_text.is_some()),
    ];
    match given.into_iter().find(|(_, is_given)| *is_given) {
        Some((field, _)) => Err(Rejection::invalid(field, problem)),
        None => Ok(()),
    }
}

fn check_source(provenance: &CertificateProvenance) -> Result<(), Rejection> {
    if provenance.scenario.is_empty() {
        return Err(Rejection::invalid("provenance.scenario", "is missing"));
    }
    let text = provenance.scenario_text.as_ref();
    let text = text.ok_or_else(|| Rejection::invalid("provenance.scenario_text", "is missing"))?;
    if provenance.scenario_sha256 != sha256(text) {
        return Err(Rejection::invalid(
            "provenance.scenario_sha256",
            "is not the digest of `scenario_text`",
        ));
    }
    Ok(())
}
