//! Forges thousands of certificates. None is accepted for more than the genuine one shows. `FORGERIES` is the number of
//! attempts, a fifth of which leave the certificate unchanged.

mod changes;
mod genuine;

use std::collections::BTreeMap;

use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_evidence::{BlockSelection, Rerun, RerunError, check_binding, check_covers_scenario};
use crumple_sim::scenario::Scenario;
use crumple_verify::{Certificate, ProvedClaim, WorkLimit, check_with};
use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;
use rayon::prelude::*;

use changes::{ForgedCertificate, GenuineCertificate, forge};
use genuine::{KIND_COUNT, genuine_certificates, implies};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Refused,
    /// Accepted, and the original implies the claim.
    Implied,
    /// Accepted with a complete proof, about another subject than the original, or of version 1 without a subject.
    OtherSubject,
    /// Accepted, with a claim about the original's subject that the original does not show.
    Forgery,
}

/// Returns the verdict about a forged certificate, with counts counted again.
fn forgery_verdict(
    genuine: &GenuineCertificate,
    shown: &ProvedClaim,
    forged: &ForgedCertificate,
) -> Verdict {
    let Ok(certificate) = Certificate::from_json(&forged.text) else {
        return Verdict::Refused;
    };
    let policy = forged.policy.as_deref();
    // Cheapest check first.
    if check_binding(&certificate, policy, Controllers::default()).is_err() {
        return Verdict::Refused;
    }
    let Ok(_) = check_with(&certificate, policy, WorkLimit::from_billions(50)) else {
        return Verdict::Refused;
    };
    match Rerun::new(&certificate, &[], Controllers::default())
        .and_then(|rerun| rerun.confirm(BlockSelection::All, &Quiet))
    {
        Ok(_) | Err(RerunError::NothingCounted(_)) => {}
        Err(_) => return Verdict::Refused,
    }
    if is_implied(&genuine.certificate, shown, &certificate) {
        return Verdict::Implied;
    }
    // A certificate of version 1 is about explicit numbers, all of which the checker verifies; only omissions could
    // mislead.
    let is_of_it = if certificate.is_first_version() {
        let is_about =
            |scenario: &Scenario| check_covers_scenario(&certificate, scenario, policy).is_ok();
        !has_all_assumptions(&genuine.certificate, &certificate)
            && genuine.scenario.as_ref().is_some_and(is_about)
    } else {
        is_of_same_subject(&genuine.certificate, &certificate)
    };
    if is_of_it {
        Verdict::Forgery
    } else {
        Verdict::OtherSubject
    }
}

fn has_all_assumptions(original: &Certificate, claimed: &Certificate) -> bool {
    original
        .assumptions
        .iter()
        .all(|assumption| claimed.assumptions.contains(assumption))
}

/// Returns true if two certificates of version 2 have the same subject: the same texts, and the same policy.
fn is_of_same_subject(one: &Certificate, other: &Certificate) -> bool {
    let policy = |certificate: &Certificate| {
        certificate
            .policy_reference()
            .map(|(_, digest)| digest.to_owned())
    };
    one.provenance.scenario_text == other.provenance.scenario_text
        && one.provenance.box_text == other.provenance.box_text
        && policy(one) == policy(other)
}

/// Returns true if a claim follows from a certificate and from what the checker shows for it.
fn is_implied(original: &Certificate, shown: &ProvedClaim, claimed: &Certificate) -> bool {
    // Version 1 names no subject.
    let is_of_it = claimed.is_first_version() || is_of_same_subject(original, claimed);
    has_all_assumptions(original, claimed)
        && is_of_it
        && implies(&original.statement, shown, &claimed.statement)
}

#[test]
fn no_forgery_is_accepted_for_more_than_the_genuine_certificate_shows() {
    let wanted: u64 = std::env::var("FORGERIES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(1000);
    let begin = std::time::Instant::now();
    let genuine = genuine_certificates();
    let shown: Vec<ProvedClaim> = genuine
        .iter()
        .map(|one| {
            check_binding(
                &one.certificate,
                one.policy.as_deref(),
                Controllers::default(),
            )
            .expect("bound");
            check_with(
                &one.certificate,
                one.policy.as_deref(),
                WorkLimit::default(),
            )
            .expect("accepted")
        })
        .collect();
    let kinds: std::collections::BTreeSet<_> = genuine
        .iter()
        .map(|one| one.certificate.statement.name())
        .collect();
    assert_eq!(kinds.len(), KIND_COUNT, "{kinds:?}");
    let tried = (0..wanted).into_par_iter().map(|index| {
        let which = index as usize % genuine.len();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(index);
        let forged = forge(&genuine[which], &genuine, &mut random);
        let kind = genuine[which].certificate.statement.name();
        // The result may equal the original or another genuine certificate.
        let read = Certificate::from_json(&forged.text).ok();
        if genuine
            .iter()
            .any(|one| Some(&one.certificate) == read.as_ref() && one.policy == forged.policy)
        {
            return (kind, None);
        }
        let verdict = forgery_verdict(&genuine[which], &shown[which], &forged);
        assert_ne!(
            verdict,
            Verdict::Forgery,
            "{index}: {kind}: {}: {}",
            forged.change,
            forged.text
        );
        (kind, Some(verdict))
    });
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    for (kind, verdict) in tried.collect::<Vec<_>>() {
        *counts.entry(format!("{kind}: {verdict:?}")).or_default() += 1;
    }
    let changed: u64 = counts
        .iter()
        .filter(|(name, _)| !name.ends_with("None"))
        .map(|(_, count)| count)
        .sum();
    println!(
        "{changed} changed ones in {:.1} s: {counts:?}",
        begin.elapsed().as_secs_f64()
    );
    let refused: u64 = counts
        .iter()
        .filter(|(name, _)| name.ends_with("Refused)"))
        .map(|(_, count)| count)
        .sum();
    assert!(refused > wanted / 2, "{counts:?}");
}
