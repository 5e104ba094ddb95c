//! Forges thousands of certificates. None is accepted for more than the genuine one shows. `FORGERIES` is the number of
//! attempts, a fifth of which leave the certificate unchanged.

mod changes;
pub(crate) mod genuine;
mod pools;
pub(crate) mod rates;
pub(crate) mod sets;
mod two_sided;

/// Closed loops that the tests of the simulator simulate, too.
#[allow(dead_code, reason = "attacks change no leader")]
#[path = "../../crates/sim/tests/two_sided/closed_loop.rs"]
mod closed_loop;

use std::collections::BTreeMap;

use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_evidence::{BlockSelection, Rerun, RerunError, check_binding, check_covers_scenario};
use crumple_sim::scenario::Scenario;
use crumple_verify::{Certificate, ProvedClaim, Statement, WorkLimit, check_with};
use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;
use rayon::prelude::*;

use genuine::{KIND_COUNT, genuine_certificates, implies};

/// A genuine certificate, with the data for checking it.
#[derive(Debug, Clone)]
pub(crate) struct GenuineCertificate {
    certificate: Certificate,
    policy: Option<Vec<u8>>,
    scenario: Option<Scenario>,
    /// Claim that the checker shows.
    shown: ProvedClaim,
}

/// A forged certificate, as a file.
#[derive(Debug, Clone)]
pub(crate) struct ForgedCertificate {
    pub(crate) change: String,
    text: String,
    policy: Option<Vec<u8>>,
}

/// Verdict of the oracle about a forged certificate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    Refused,
    /// Accepted, and the original implies the claim.
    Implied,
    /// Accepted with a complete proof, about another subject than the original, or of version 1 without a subject.
    OtherSubject,
    /// Accepted, with a claim about the original's subject that the original does not show.
    Forgery,
}

/// Returns a certificate with a changed statement.
pub(crate) fn change_statement(
    genuine: &Certificate,
    change: impl FnOnce(&mut Statement),
) -> Certificate {
    let mut forged = genuine.clone();
    change(&mut forged.statement);
    forged
}

impl GenuineCertificate {
    /// Checks a genuine certificate, and takes it as the origin of forgeries.
    pub(crate) fn new(
        certificate: Certificate,
        policy: Option<Vec<u8>>,
        scenario: Option<Scenario>,
    ) -> Self {
        let bytes = policy.as_deref();
        check_binding(&certificate, bytes, Controllers::default()).expect("bound");
        let shown = check_with(&certificate, bytes, WorkLimit::default()).expect("accepted");
        Self {
            certificate,
            policy,
            scenario,
            shown,
        }
    }

    /// Returns the verdict about a forged certificate, with counts counted again.
    pub(crate) fn verdict(&self, forged: &ForgedCertificate) -> Verdict {
        let Some((claimed, accepted)) = accepted_claim(forged) else {
            return Verdict::Refused;
        };
        if self.implies(&claimed, &accepted) {
            Verdict::Implied
        } else if self.is_subject_of(&claimed, forged.policy.as_deref()) {
            Verdict::Forgery
        } else {
            Verdict::OtherSubject
        }
    }

    /// Returns true if a claim follows from the certificate and from what the checker shows for it. `accepted` is what
    /// the checker shows for the claim.
    fn implies(&self, claimed: &Certificate, accepted: &ProvedClaim) -> bool {
        let original = &self.certificate;
        // Version 1 names no subject.
        let is_of_it = claimed.is_first_version() || is_of_same_subject(original, claimed);
        has_all_assumptions(original, claimed)
            && is_of_it
            && match &claimed.statement {
                Statement::Invariant(claim) => sets::is_true(claim, accepted, &self.shown),
                Statement::TwoSided(claim) => two_sided::is_true(claim),
                other => implies(&original.statement, &self.shown, other),
            }
    }

    /// Returns true if an accepted claim is about the certificate's subject.
    fn is_subject_of(&self, claimed: &Certificate, policy: Option<&[u8]>) -> bool {
        if !claimed.is_first_version() {
            return is_of_same_subject(&self.certificate, claimed);
        }
        // A certificate of version 1 is about explicit numbers, all of which the checker verifies; only omissions could
        // mislead.
        let is_about =
            |scenario: &Scenario| check_covers_scenario(claimed, scenario, policy).is_ok();
        !has_all_assumptions(&self.certificate, claimed)
            && self.scenario.as_ref().is_some_and(is_about)
    }
}

/// Returns a forged certificate that every check accepts, with what the checker shows for it.
fn accepted_claim(forged: &ForgedCertificate) -> Option<(Certificate, ProvedClaim)> {
    let certificate = Certificate::from_json(&forged.text).ok()?;
    let policy = forged.policy.as_deref();
    // Cheapest check first.
    check_binding(&certificate, policy, Controllers::default()).ok()?;
    let accepted = check_with(&certificate, policy, WorkLimit::from_billions(50)).ok()?;
    let recount = Rerun::new(&certificate, &[], Controllers::default())
        .and_then(|rerun| rerun.confirm(BlockSelection::All, &Quiet));
    match recount {
        Ok(_) | Err(RerunError::NothingCounted(_)) => Some((certificate, accepted)),
        Err(_) => None,
    }
}

fn has_all_assumptions(original: &Certificate, claimed: &Certificate) -> bool {
    original
        .assumptions
        .iter()
        .all(|assumption| claimed.assumptions.contains(assumption))
}

/// Returns true if two certificates of version 2 have the same subject: the same texts, and the same policy.
fn is_of_same_subject(first: &Certificate, other: &Certificate) -> bool {
    let policy = |certificate: &Certificate| {
        certificate
            .policy_reference()
            .map(|(_, digest)| digest.to_owned())
    };
    first.provenance.scenario_text == other.provenance.scenario_text
        && first.provenance.box_text == other.provenance.box_text
        && policy(first) == policy(other)
}

/// Returns the number of attempts.
fn forgery_count() -> u64 {
    std::env::var("FORGERIES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(1000)
}

#[test]
fn no_forgery_is_accepted_for_more_than_the_genuine_certificate_shows() {
    let wanted = forgery_count();
    let begin = std::time::Instant::now();
    let genuine = genuine_certificates();
    let kinds: std::collections::BTreeSet<_> = genuine
        .iter()
        .map(|genuine| genuine.certificate.statement.name())
        .collect();
    assert_eq!(kinds.len(), KIND_COUNT, "{kinds:?}");
    let tried = (0..wanted).into_par_iter().map(|index| {
        let which = index as usize % genuine.len();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(index);
        let forged = genuine[which].forge(&genuine, &mut random);
        let kind = genuine[which].certificate.statement.name();
        // The result may equal the original or another genuine certificate.
        let read = Certificate::from_json(&forged.text).ok();
        if genuine.iter().any(|genuine| {
            Some(&genuine.certificate) == read.as_ref() && genuine.policy == forged.policy
        }) {
            return (kind, None);
        }
        let verdict = genuine[which].verdict(&forged);
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
