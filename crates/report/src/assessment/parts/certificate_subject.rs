//! The subject of a certificate, decided by hashes, and descriptions of statements.

use crumple_verify::{Certificate, ClaimSubject, Interval, ReachClaim, Registration, Statement};

use super::CertificateSubject;
use crate::assessment::AssessmentPlan;
use crate::assessment::claims::{AssuranceClaim, ContentId, Domain, Property, Subject};
use crate::assessment::plan::NamedSpace;
use crumple_core::digest::sha256;
use crumple_core::markdown::prose_name;
use crumple_evidence::{check_covers_scenario, checker_file};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Scenario, built_in_scenario, built_in_scenario_names};

pub(super) fn describe_statement(
    plan: &AssessmentPlan,
    name: &str,
    certificate: &Certificate,
    policy: Option<&[u8]>,
) -> String {
    match certificate.statement.subject() {
        ClaimSubject::Runs(registration) => describe_runs(registration),
        ClaimSubject::InitialStates(reach) => {
            let ranges = describe_ranges(reach).join(", ");
            let states = initial_states_id(plan, name, (certificate, reach), policy);
            format!("{}: {ranges}", states.name)
        }
        ClaimSubject::AnyVehicles => "vehicles of these classes, dry road".to_owned(),
        ClaimSubject::AnyNeighbours => "a vehicle between leader and follower".to_owned(),
        ClaimSubject::Scene { .. } | ClaimSubject::Region(_) => {
            prose_name(&certificate.provenance.scenario)
        }
    }
}

fn describe_runs(registration: &Registration) -> String {
    let controller = entry(registration, "controller");
    let controllers = match registration.configuration.get("against") {
        None => controller.to_owned(),
        Some(second) => format!("{controller} against {second}"),
    };
    let controllers = prose_name(&controllers);
    let runs = registration.runs;
    let space = prose_name(entry(registration, "space"));
    format!("{controllers} in {runs} runs of space `{space}`")
}

/// Returns an entry of the configuration of registered runs; empty if it is absent.
fn entry<'a>(registration: &'a Registration, key: &str) -> &'a str {
    let value = registration.configuration.get(key);
    value.map_or("", String::as_str)
}

fn describe_ranges(reach: &ReachClaim) -> Vec<String> {
    let ranges = &reach.ranges;
    let mut descriptions = vec![
        describe_range("gap ahead", ranges.gap_ahead_m, "m"),
        describe_range("gap behind", ranges.gap_behind_m, "m"),
        describe_range("leader", ranges.leader_speed_mps, "m/s"),
        describe_range("ego", ranges.ego_speed_mps, "m/s"),
        describe_range("follower", ranges.follower_speed_mps, "m/s"),
    ];
    // Braking rate and onset have no meaning if the leader's acceleration is arbitrary.
    if reach.leader_brakes_at_most_mps2.is_none() {
        descriptions.push(describe_range(
            "leader brakes at",
            ranges.leader_brake_mps2,
            "m/s²",
        ));
        let onset_s =
            [ranges.onset_steps.low(), ranges.onset_steps.high()].map(|steps| steps * reach.step_s);
        descriptions.push(describe_numbers("from", onset_s, "s"));
    }
    descriptions.push(describe_range(
        "follower brakes at",
        ranges.follower_brake_mps2,
        "m/s²",
    ));
    if let Some(limit_mps2) = reach.leader_brakes_at_most_mps2 {
        descriptions.push(format!("any braking of the leader up to {limit_mps2} m/s²"));
    }
    descriptions
}

fn describe_range(name: &str, range: Interval, unit: &str) -> String {
    describe_numbers(name, [range.low(), range.high()], unit)
}

fn describe_numbers(name: &str, [low, high]: [f64; 2], unit: &str) -> String {
    match low == high {
        true => format!("{name} {low} {unit}"),
        false => format!("{name} {low} to {high} {unit}"),
    }
}

pub(super) fn certificate_subject(
    plan: &AssessmentPlan,
    name: &str,
    certificate: &Certificate,
    policy: Option<&[u8]>,
) -> CertificateSubject {
    match certificate.statement.subject() {
        ClaimSubject::Runs(registration) => match registered_claim(plan, registration) {
            Ok(claim) => CertificateSubject::Claim(Box::new(claim)),
            Err(reason) => CertificateSubject::Unrelated { reason },
        },
        ClaimSubject::InitialStates(reach) => match find_proved_controller(plan, reach) {
            Some(subject) => CertificateSubject::Claim(Box::new(AssuranceClaim {
                subject,
                property: Property::NoCollision,
                domain: Domain::Box {
                    around: initial_states_id(plan, name, (certificate, reach), policy),
                },
            })),
            None => CertificateSubject::Unrelated {
                reason: "its policy is not among the controllers".to_owned(),
            },
        },
        ClaimSubject::AnyVehicles => CertificateSubject::Kernel,
        ClaimSubject::AnyNeighbours | ClaimSubject::Scene { .. } | ClaimSubject::Region(_) => {
            CertificateSubject::NoController
        }
    }
}

/// Returns the unshielded policy or network of a certificate, with the true state. A shield would make it another
/// controller.
fn find_proved_controller(plan: &AssessmentPlan, reach: &ReachClaim) -> Option<Subject> {
    let index = plan.controllers.iter().position(|controller| {
        checker_file(&controller.source)
            .ok()
            .flatten()
            .is_some_and(|file| sha256(file) == reach.policy_sha256)
    })?;
    plan.claim_subject(index, EstimatorKind::Truth)
}

/// Returns the identifier of the box: the statement without policy and result. The certificate's own label is not
/// trusted: the name is a scenario of the report whose initial state lies in the box, or else the certificate's name.
fn initial_states_id(
    plan: &AssessmentPlan,
    certificate_name: &str,
    (certificate, reach): (&Certificate, &ReachClaim),
    policy: Option<&[u8]>,
) -> ContentId {
    let mut content = format!(
        "{:?} {:?} {:?} {:?} {:?}",
        reach.step_s, reach.steps, reach.follower_ttc_s, reach.observation_error, reach.ranges
    );
    if let Some(limit_mps2) = reach.leader_brakes_at_most_mps2 {
        content += &format!(" leader within {limit_mps2:?}");
    }
    if let Some(law) = &reach.follower_law {
        content += &format!(" follower {law:?}");
    }
    let horizon_s = reach.step_s * f64::from(reach.steps);
    let around = match scenario_inside(plan, certificate, policy) {
        Some(scenario) => format!("around `{}`", prose_name(&scenario.spec().name)),
        None => format!("of certificate `{certificate_name}`"),
    };
    let any_braking = if reach.leader_brakes_at_most_mps2.is_some() {
        ", for any braking of the leader,"
    } else {
        ""
    };
    ContentId {
        name: format!("the box of initial states {around}{any_braking} for {horizon_s} s"),
        sha256: sha256(&content),
    }
}

/// Returns the first built-in scenario, or scenario of a file, whose initial state lies in the box of a certificate.
fn scenario_inside(
    plan: &AssessmentPlan,
    certificate: &Certificate,
    policy: Option<&[u8]>,
) -> Option<Scenario> {
    let built_in = built_in_scenario_names()
        .into_iter()
        .filter_map(|(name, _)| built_in_scenario(name));
    let of_files = plan
        .file_scenarios
        .iter()
        .map(|(_, scenario)| scenario.clone());
    built_in
        .chain(of_files)
        .find(|scenario| check_covers_scenario(certificate, scenario, policy).is_ok())
}

fn find_space<'a>(plan: &'a AssessmentPlan, registration: &Registration) -> Option<&'a NamedSpace> {
    let sha256 = registration.configuration.get("space_sha256")?;
    plan.rate_spaces
        .iter()
        .find(|named| named.content_id.sha256 == *sha256)
}

/// True if other vehicles may collide in the runs of a rate. The rate counts them, but they are no evidence here.
pub(super) fn includes_others(plan: &AssessmentPlan, statement: &Statement) -> bool {
    match statement {
        Statement::Rate(rate) => {
            find_space(plan, &rate.registration).is_some_and(NamedSpace::can_others_collide)
        }
        _ => false,
    }
}

/// Returns the claim of a registration with the hashes of this report's controllers and space, and the same release.
/// The error is the reason why there is none.
fn registered_claim(
    plan: &AssessmentPlan,
    registration: &Registration,
) -> Result<AssuranceClaim, String> {
    let release = entry(registration, "crumple");
    if release != env!("CARGO_PKG_VERSION") {
        return Err(format!("crumple {release} counted its runs"));
    }
    let named = find_space(plan, registration).ok_or_else(|| {
        let space = prose_name(entry(registration, "space"));
        format!("its space `{space}` is not among `distributions`")
    })?;
    let estimator = EstimatorKind::ALL
        .into_iter()
        .find(|kind| kind.name() == entry(registration, "estimator"))
        .ok_or("it names no known estimator")?;
    let subject = registered_subject(plan, registration, "controller", estimator)?;
    let property = match registration.configuration.get("against") {
        None => Property::FailureRate,
        Some(_) if named.can_others_collide() => {
            return Err("it counts collisions of vehicles that are not under test".to_owned());
        }
        Some(_) => Property::FailsLessOften {
            than: registered_subject(plan, registration, "against", estimator)?.controller,
        },
    };
    Ok(AssuranceClaim {
        subject,
        property,
        domain: Domain::Space {
            space: named.content_id.clone(),
        },
    })
}

/// Returns the controller that an entry of a registration names, if it defines a failure in the same way.
fn registered_subject(
    plan: &AssessmentPlan,
    registration: &Registration,
    key: &str,
    estimator: EstimatorKind,
) -> Result<Subject, String> {
    let identity = entry(registration, &format!("{key}_sha256"));
    let failure = entry(registration, "failure");
    plan.controllers
        .iter()
        .position(|controller| controller.source.identity().as_deref() == Some(identity))
        .filter(|&index| {
            plan.controllers.get(index).is_some_and(|controller| {
                failure == controller.failure_description()
                    || failure == "vehicles touch, or a controller fails"
            })
        })
        .and_then(|index| plan.claim_subject(index, estimator))
        .ok_or_else(|| {
            let name = prose_name(entry(registration, key));
            format!("its `{name}` is not among the controllers")
        })
}
