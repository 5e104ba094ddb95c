//! Certificates to forge, and the claims that each kind implies.

use std::path::Path;

use crumple_core::observer::Quiet;
use crumple_evidence::{
    BoxSpec, InvariantOptions, InvariantPlan, InvariantSpec, RateConfig, RatePlan, ReachPlan,
    shipped_kernels,
};
use crumple_search::worst_case::{AvoidOptions, AvoidanceVerdict, avoid, certify};
use crumple_sim::control::{BuiltInController, IntoSource};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_sim::scenario::{Scenario, built_in_scenario};
use crumple_spaces::built_in_space;
use crumple_verify::invariant::MotionModel;
use crumple_verify::{ComparisonClaim, KernelClaim, ProvedClaim, ReachClaim, Statement};

use super::GenuineCertificate;
use crate::networks::find_source;

/// Number of kinds among the genuine certificates.
pub(super) const KIND_COUNT: usize = 9;

/// Returns true if a statement and what the checker shows for it imply the statement `other` about the same subject.
pub(super) fn implies(original: &Statement, shown: &ProvedClaim, other: &Statement) -> bool {
    match (original, other, shown) {
        (
            Statement::Avoidable(one),
            Statement::Avoidable(other),
            ProvedClaim::Avoidable {
                min_gap_m: smallest_gap_m,
                ..
            },
        ) => one.scene == other.scene && other.min_gap_m_at_least.unwrap_or(0.0) <= *smallest_gap_m,
        (Statement::Unavoidable(one), Statement::Unavoidable(other), _) => one.scene == other.scene,
        (
            Statement::GapBound(one),
            Statement::GapBound(other),
            ProvedClaim::GapBound { gap_m, .. },
        ) => one.scene == other.scene && other.gap_m >= *gap_m,
        (Statement::Kernel(one), Statement::Kernel(other), _) => {
            // The theorem holds for every step and margin.
            let (step_s, margin_m) = (one.step_s.clone(), one.margin_m.clone());
            *one == KernelClaim {
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
            let counts =
                |claim: &ComparisonClaim| (claim.only_first_failed, claim.only_second_failed);
            one.registration == other.registration && counts(one) == counts(other)
        }
        (Statement::Reach(one), Statement::Reach(other), shown) => reach_implies(one, shown, other),
        _ => false,
    }
}

fn reach_implies(original: &ReachClaim, shown: &ProvedClaim, other: &ReachClaim) -> bool {
    let ProvedClaim::Reach {
        verified_share,
        falsified_share,
        min_gap_m,
        ..
    } = shown
    else {
        return false;
    };
    // A leader within a limit is within any larger one.
    let covers_leader = match (
        original.leader_brakes_at_most_mps2,
        other.leader_brakes_at_most_mps2,
    ) {
        (None, None) => true,
        (Some(limit_mps2), Some(other_mps2)) => other_mps2 <= limit_mps2,
        _ => false,
    };
    let mut errors = original
        .observation_error
        .iter()
        .zip(&other.observation_error);
    let is_same_run = (original.ranges, original.steps, original.step_s)
        == (other.ranges, other.steps, other.step_s)
        && original.follower_ttc_s == other.follower_ttc_s
        && original.follower_law == other.follower_law
        && original.policy_sha256 == other.policy_sha256;
    covers_leader
        && is_same_run
        && errors.all(|(original, other)| original >= other)
        && other.verified_share_at_least <= *verified_share + 1e-9
        && other.falsified_share_at_least <= *falsified_share + 1e-9
        && other.min_gap_m_at_least <= *min_gap_m
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
    GenuineCertificate::new(certificate, None, Some(scenario.clone()))
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
    GenuineCertificate::new(*certificate, None, Some(scenario.clone()))
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
    GenuineCertificate::new(plan.certificate(&tally), None, None)
}

fn reach_certificate(controller: impl IntoSource, of_leader: &str) -> GenuineCertificate {
    let text = format!(
        "version = 1\nscenario = \"paper-2\"\n{of_leader}[ranges]\ngap_ahead_m = {{ low = 15.9, high = 16.1 }}"
    );
    let spec = BoxSpec::from_toml(&text, Path::new("box")).expect("a box");
    let plan = ReachPlan::new(controller, &spec).expect("a plan");
    let certificate = plan.partition(1, &Quiet).expect("cut").certificate;
    GenuineCertificate::new(
        certificate,
        Some(plan.policy_bytes().to_vec()),
        built_in_scenario("paper-2"),
    )
}

/// Returns the certificate of a small invariant set of `idm`.
pub(crate) fn set_certificate() -> GenuineCertificate {
    let spec = InvariantSpec {
        version: 1,
        scenario: "paper-1".to_owned(),
        motion: MotionModel::Absolute,
        leader_mps2: [-7.5, 3.0],
        observation_error: [1e-9; 3],
        region_gap_m: 100.0,
        ends_beyond_gap_m: None,
        region_own_mps: [0.0, 6.0],
        region_leader_mps: [0.0, 6.0],
        controller: None,
    };
    let options = InvariantOptions {
        cells: 16,
        splits: 1,
        smallest_gap_m: 0.0,
    };
    let idm = BuiltInController::from_name("idm").expect("built in");
    let scenario = built_in_scenario("paper-1").expect("built in");
    let plan = InvariantPlan::new(idm, &scenario, spec).expect("a plan");
    let set = plan
        .search(options, &Quiet)
        .expect("a search")
        .expect("a set");
    let genuine = GenuineCertificate::new(set.certificate, None, Some(scenario));
    assert!(
        matches!(genuine.shown, ProvedClaim::Invariant { min_gap_m, .. } if min_gap_m > 0.0),
        "{}",
        genuine.shown
    );
    genuine
}

/// Returns at least one certificate of each kind, two of most.
pub(super) fn genuine_certificates() -> Vec<GenuineCertificate> {
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
    let kernel = |(_, certificate)| GenuineCertificate::new(certificate, None, None);
    all.extend(shipped_kernels().into_iter().take(2).map(kernel));
    all.push(set_certificate());
    all.extend(super::two_sided::certificates());
    all
}
