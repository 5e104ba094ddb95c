//! Binding of a version 2 statement to its subject.
//!
//! The certificate holds the texts of scenario, box and space, and their hash is checked here. `crumple check` compares
//! the numbers of the statement with the texts. A rate states its space and program twice; both must agree. Fields that
//! do not belong to a kind of statement are rejected, so that no part of a certificate stays unchecked.

use crate::canonical::{is_sha256, sha256};
use crate::certificate::{Assumption, Certificate, CertificateProvenance, Statement};
use crate::invariant::NetworkReference;
use crate::rate::Registration;
use crate::reach::controller_file_name;
use crate::{Rejection, rate};

/// Entries of every registration, and those of a second controller.
const REQUIRED_ENTRIES: [&str; 9] = [
    "controller",
    "controller_sha256",
    "crumple",
    "estimator",
    "failure",
    "horizon_s",
    "seed",
    "space",
    "space_sha256",
];
const COMPARISON_ENTRIES: [&str; 2] = ["against", "against_sha256"];
const POLICY_ENTRIES: [&str; 2] = ["controller_policy_sha256", "against_policy_sha256"];

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
    match &certificate.statement {
        Statement::Kernel(_) => check_no_source(
            provenance,
            "must be absent: a kernel does not belong to a scenario",
        ),
        Statement::Reach(claim) => {
            check_source(provenance)?;
            if provenance.box_text.is_none() {
                return Err(Rejection::invalid("provenance.box_text", "is missing"));
            }
            check_policy_file_name(
                &claim.policy_file,
                &claim.policy_sha256,
                claim.source.is_some(),
            )
        }
        Statement::Invariant(claim) => {
            check_source(provenance)?;
            if provenance.box_text.is_none() {
                return Err(Rejection::invalid("provenance.box_text", "is missing"));
            }
            let check = |of: &NetworkReference| {
                check_policy_file_name(&of.policy_file, &of.policy_sha256, of.source.is_some())
            };
            claim.network().map_or(Ok(()), check)
        }
        Statement::Rate(claim) => {
            check_space(provenance, &claim.registration, false)?;
            rate::check_rate_blocks(claim)
        }
        Statement::Comparison(claim) => {
            check_space(provenance, &claim.registration, true)?;
            rate::check_comparison_blocks(claim)
        }
        _ => check_source(provenance),
    }
}

/// Checks that the name of a network file follows from its digest.
fn check_policy_file_name(
    file: &str,
    digest: &str,
    is_from_outside: bool,
) -> Result<(), Rejection> {
    if is_sha256(digest) && file == controller_file_name(digest, is_from_outside) {
        Ok(())
    } else {
        Err(Rejection::invalid(
            "policy_file",
            "is not named after `policy_sha256`",
        ))
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

/// Checks that the registration names the space of the provenance and has only known entries.
fn check_space(
    provenance: &CertificateProvenance,
    registration: &Registration,
    two: bool,
) -> Result<(), Rejection> {
    check_source(provenance)?;
    if provenance.box_text.is_some() {
        return Err(Rejection::invalid(
            "provenance.box_text",
            "must be absent: runs are drawn from a space",
        ));
    }
    let place = |key: &str| format!("registration.configuration.{key}");
    let entries = &registration.configuration;
    let needed = || {
        REQUIRED_ENTRIES
            .iter()
            .chain(COMPARISON_ENTRIES.iter().filter(|_| two))
    };
    if let Some(key) = needed().find(|key| entries.get(**key).is_none_or(String::is_empty)) {
        return Err(Rejection::invalid(place(key), "is missing"));
    }
    let may_be = |key: &str| {
        needed()
            .chain(POLICY_ENTRIES.iter().take(if two { 2 } else { 1 }))
            .any(|known| *known == key)
    };
    if let Some(key) = entries.keys().find(|key| !may_be(key)) {
        return Err(Rejection::invalid(place(key), "is not known"));
    }
    if let Some((key, _)) = entries
        .iter()
        .find(|(key, value)| key.ends_with("_sha256") && !is_sha256(value))
    {
        return Err(Rejection::invalid(place(key), "is not a SHA-256"));
    }
    if entries
        .get("seed")
        .is_none_or(|seed| seed.parse::<u64>().map(|read| read.to_string()).as_ref() != Ok(seed))
    {
        return Err(Rejection::invalid(place("seed"), "must be a whole number"));
    }
    let is_positive = |text: &String| {
        text.parse::<f64>()
            .is_ok_and(|value| value > 0.0 && value.is_finite())
    };
    if !entries.get("horizon_s").is_some_and(is_positive) {
        return Err(Rejection::invalid(
            place("horizon_s"),
            "must be a positive number",
        ));
    }
    let doubled = [
        ("crumple", &provenance.crumple, "differs from `provenance`"),
        (
            "space",
            &provenance.scenario,
            "differs from `provenance.scenario`",
        ),
        (
            "space_sha256",
            &provenance.scenario_sha256,
            "differs from `provenance.scenario_sha256`",
        ),
    ];
    match doubled
        .into_iter()
        .find(|(key, value, _)| entries.get(*key) != Some(*value))
    {
        Some((key, _, problem)) => Err(Rejection::invalid(place(key), problem)),
        None => Ok(()),
    }
}
