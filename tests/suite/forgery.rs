//! Forges thousands of certificates. None is accepted for more than the genuine one shows. `FORGERIES` is the number of
//! attempts, a fifth of which leave the certificate unchanged.

mod changes;

use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_evidence::{
    BlockSelection, BoxSpec, RateConfig, RatePlan, ReachPlan, Rerun, RerunError, check_binding,
    check_covers_scenario, shipped_kernels,
};
use crumple_search::worst_case::{AvoidOptions, AvoidanceVerdict, avoid, certify};
use crumple_sim::control::{BuiltInController, IntoSource};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::{Scenario, built_in_scenario};
use crumple_spaces::built_in_space;
use crumple_verify::{Certificate, ProvedClaim, Statement, WorkLimit, check_with};
use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

use crate::networks::find_source;
use changes::{ForgedCertificate, GenuineCertificate, forge};

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
        && match (&original.statement, &claimed.statement, shown) {
            (
                Statement::Avoidable(one),
                Statement::Avoidable(other),
                ProvedClaim::Avoidable {
                    min_gap_m: smallest_gap_m,
                    ..
                },
            ) => {
                one.scene == other.scene
                    && other.min_gap_m_at_least.unwrap_or(0.0) <= *smallest_gap_m
            }
            (Statement::Unavoidable(one), Statement::Unavoidable(other), _) => {
                one.scene == other.scene
            }
            (
                Statement::GapBound(one),
                Statement::GapBound(other),
                ProvedClaim::GapBound { gap_m, .. },
            ) => one.scene == other.scene && other.gap_m >= *gap_m,
            (Statement::Kernel(one), Statement::Kernel(other), _) => {
                // The theorem holds for every step and margin.
                let (step_s, margin_m) = (one.step_s.clone(), one.margin_m.clone());
                *one == crumple_verify::KernelClaim {
                    step_s,
                    margin_m,
                    ..other.clone()
                }
            }
            // The checker derives the rate from the repeated counts.
            (Statement::Rate(one), Statement::Rate(other), _) => {
                (&one.registration, one.failures) == (&other.registration, other.failures)
            }
            (Statement::Comparison(one), Statement::Comparison(other), _) => {
                let counts = |claim: &crumple_verify::ComparisonClaim| {
                    (claim.only_first_failed, claim.only_second_failed)
                };
                one.registration == other.registration && counts(one) == counts(other)
            }
            (
                Statement::Reach(one),
                Statement::Reach(other),
                ProvedClaim::Reach {
                    verified_share,
                    falsified_share,
                    min_gap_m: smallest_gap_m,
                    ..
                },
            ) => {
                // A leader within a limit is within any larger one.
                let leads = match (
                    one.leader_brakes_at_most_mps2,
                    other.leader_brakes_at_most_mps2,
                ) {
                    (None, None) => true,
                    (Some(one), Some(other)) => other <= one,
                    _ => false,
                };
                leads
                    && (one.ranges, one.steps, one.step_s, one.follower_ttc_s)
                        == (
                            other.ranges,
                            other.steps,
                            other.step_s,
                            other.follower_ttc_s,
                        )
                    && one.follower_law == other.follower_law
                    && one.policy_sha256 == other.policy_sha256
                    && one
                        .observation_error
                        .iter()
                        .zip(&other.observation_error)
                        .all(|(one, other)| one >= other)
                    && other.verified_share_at_least <= *verified_share + 1e-9
                    && other.falsified_share_at_least <= *falsified_share + 1e-9
                    && other.min_gap_m_at_least <= *smallest_gap_m
            }
            _ => false,
        }
}

fn avoidability_certificate(scenario: &Scenario) -> GenuineCertificate {
    let certificate = match avoid(scenario, AvoidOptions::default())
        .expect("options fit")
        .verdict
    {
        AvoidanceVerdict::Avoidable(escape) => certify(scenario, &escape).expect("accepted"),
        AvoidanceVerdict::Unavoidable(certificate) => *certificate,
        AvoidanceVerdict::Undecided(reason) => panic!("{reason}"),
    };
    GenuineCertificate {
        certificate,
        policy: None,
        scenario: Some(scenario.clone()),
    }
}

fn gap_bound_certificate(scenario: &Scenario) -> GenuineCertificate {
    let options = AvoidOptions {
        certify_bound: true,
        ..AvoidOptions::default()
    };
    let certificate = avoid(scenario, options)
        .expect("options fit")
        .bound_certificate
        .expect("a bound");
    GenuineCertificate {
        certificate: *certificate,
        policy: None,
        scenario: Some(scenario.clone()),
    }
}

fn rate_certificate(controller: &str, against: Option<&str>, runs: u64) -> GenuineCertificate {
    let find =
        |name: &str| NamedController::from(BuiltInController::from_name(name).expect("built in"));
    let plan = RatePlan::new(RateConfig {
        second_controller: against.map(find),
        seed: 5,
        estimator: EstimatorKind::Truth,
        ..RateConfig::new(
            find(controller),
            built_in_space("paper").expect("built in"),
            runs,
        )
    })
    .expect("a plan");
    let mut tally = plan.empty_tally();
    while tally.runs < runs {
        plan.count_batch(&mut tally).expect("runs");
    }
    GenuineCertificate {
        certificate: plan.certificate(&tally),
        policy: None,
        scenario: None,
    }
}

fn reach_certificate(controller: impl IntoSource, of_leader: &str) -> GenuineCertificate {
    let text = format!(
        "version = 1\nscenario = \"paper-2\"\n{of_leader}[ranges]\ngap_ahead_m = {{ low = 15.9, high = 16.1 }}"
    );
    let spec = BoxSpec::from_toml(&text, Path::new("box")).expect("a box");
    let plan = ReachPlan::new(controller, &spec).expect("a plan");
    let certificate = plan.partition(1, &Quiet).expect("cut").certificate;
    GenuineCertificate {
        certificate,
        policy: Some(plan.policy_bytes().to_vec()),
        scenario: built_in_scenario("paper-2"),
    }
}

/// Returns at least one certificate of every kind, two of most.
fn genuine_certificates() -> Vec<GenuineCertificate> {
    let paper = built_in_scenario("paper-1").expect("built in");
    let close = paper
        .edited(|spec| spec.vehicles[1].speed_mps = 60.0)
        .expect("valid");
    let noisy = paper
        .edited(|spec| spec.vehicles[0].acceleration_noise_mps2 = 0.05)
        .expect("valid");
    let mut all = vec![
        avoidability_certificate(&paper),
        avoidability_certificate(&close),
        avoidability_certificate(&noisy),
    ];
    all.extend([
        gap_bound_certificate(&paper),
        gap_bound_certificate(&built_in_scenario("paper-2").expect("built in")),
    ]);
    all.extend([
        rate_certificate("idm", None, 200),
        rate_certificate("idm", Some("baseline"), 150),
    ]);
    all.extend([
        reach_certificate(Policy::reference(), ""),
        reach_certificate(Policy::retrained(), ""),
    ]);
    all.push(reach_certificate(find_source("leaky-40-clip.onnx"), ""));
    // One is verified, and one is falsified by a leader within the limit.
    all.extend([0.02, 7.5].map(|limit| {
        reach_certificate(
            Policy::reference(),
            &format!("leader_brakes_at_most_mps2 = {limit}\n"),
        )
    }));
    all.extend(["idm", "acc-aeb"].map(|law| {
        reach_certificate(
            Policy::reference(),
            &format!("follower_drives = \"{law}\"\n"),
        )
    }));
    let kernel = |(_, certificate)| GenuineCertificate {
        certificate,
        policy: None,
        scenario: None,
    };
    all.extend(shipped_kernels().into_iter().take(2).map(kernel));
    all
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
    assert_eq!(kinds.len(), 7, "of every kind: {kinds:?}");
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
