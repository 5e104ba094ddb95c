//! The subject of a certificate, decided by hashes, and descriptions of statements.

use crumple_verify::reach::InitialRanges;
use crumple_verify::{Certificate, ClaimSubject, ReachClaim, Registration, Statement};

use super::CertificateSubject;
use crate::assessment::AssessmentPlan;
use crate::assessment::claims::{AssuranceClaim, ContentId, Domain, Property};
use crate::assessment::plan::NamedSpace;
use crumple_core::digest::sha256;
use crumple_evidence::{check_covers_scenario, checker_file};
use crumple_sim::engine::NamedController;
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
        ClaimSubject::Scene { .. } | ClaimSubject::Region(_) => {
            certificate.provenance.scenario.clone()
        }
    }
}

fn describe_runs(registration: &Registration) -> String {
    let entry = |key: &str| {
        let value = registration.configuration.get(key);
        value.map_or("", String::as_str)
    };
    let controllers = match registration.configuration.get("against") {
        None => entry("controller").to_owned(),
        Some(second) => format!("{} against {second}", entry("controller")),
    };
    let runs = registration.runs;
    format!("{controllers} in {runs} runs of space `{}`", entry("space"))
}

fn describe_ranges(reach: &ReachClaim) -> Vec<String> {
    let InitialRanges {
        gap_ahead_m,
        gap_behind_m,
        leader_speed_mps,
        ego_speed_mps,
        ..
    } = reach.ranges;
    let InitialRanges {
        follower_speed_mps,
        leader_brake_mps2,
        follower_brake_mps2,
        onset_steps,
        ..
    } = reach.ranges;
    let in_seconds = |steps: f64| steps * reach.step_s;
    let all = [
        ("gap ahead", "m", (gap_ahead_m.low(), gap_ahead_m.high())),
        ("gap behind", "m", (gap_behind_m.low(), gap_behind_m.high())),
        (
            "leader",
            "m/s",
            (leader_speed_mps.low(), leader_speed_mps.high()),
        ),
        ("ego", "m/s", (ego_speed_mps.low(), ego_speed_mps.high())),
        (
            "follower",
            "m/s",
            (follower_speed_mps.low(), follower_speed_mps.high()),
        ),
        (
            "leader brakes at",
            "m/s²",
            (leader_brake_mps2.low(), leader_brake_mps2.high()),
        ),
        (
            "from",
            "s",
            (
                in_seconds(onset_steps.low()),
                in_seconds(onset_steps.high()),
            ),
        ),
        (
            "follower brakes at",
            "m/s²",
            (follower_brake_mps2.low(), follower_brake_mps2.high()),
        ),
    ];
    let led = reach.leader_brakes_at_most_mps2;
    // Braking rate and onset have no meaning if the leader's acceleration is arbitrary.
    let has_meaning = |(name, ..): &(&str, &str, (f64, f64))| {
        led.is_none() || !["leader brakes at", "from"].contains(name)
    };
    let words = all
        .into_iter()
        .filter(has_meaning)
        .map(|(name, unit, (low, high))| match low == high {
            true => format!("{name} {low} {unit}"),
            false => format!("{name} {low} to {high} {unit}"),
        });
    words
        .chain(led.map(|limit_mps2| format!("any braking of the leader up to {limit_mps2} m/s²")))
        .collect()
}

pub(super) fn certificate_subject(
    plan: &AssessmentPlan,
    name: &str,
    certificate: &Certificate,
    policy: Option<&[u8]>,
) -> CertificateSubject {
    match certificate.statement.subject() {
        ClaimSubject::Runs(registration) => registered_subject(plan, registration),
        // The unshielded policy or network with the true state: a shield would make it another controller.
        ClaimSubject::InitialStates(reach) => {
            let digest = |one: &NamedController| Some(sha256(checker_file(&one.source).ok()??));
            let is_it = |one: &NamedController| {
                digest(one).as_deref() == Some(reach.policy_sha256.as_str())
            };
            let place = plan.controllers.iter().position(is_it);
            match place.and_then(|place| plan.claim_subject(place, EstimatorKind::Truth)) {
                Some(subject) => CertificateSubject::Claim(Box::new(AssuranceClaim {
                    subject,
                    property: Property::NoContact,
                    domain: Domain::Box {
                        around: initial_states_id(plan, name, (certificate, reach), policy),
                    },
                })),
                None => CertificateSubject::Unrelated {
                    reason: "its policy is not among the controllers".to_owned(),
                },
            }
        }
        ClaimSubject::AnyVehicles => CertificateSubject::Kernel,
        ClaimSubject::Scene { .. } | ClaimSubject::Region(_) => CertificateSubject::NoController,
    }
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
    let is_inside =
        |scenario: &Scenario| check_covers_scenario(certificate, scenario, policy).is_ok();
    let built_in = built_in_scenario_names()
        .iter()
        .filter_map(|(name, _)| built_in_scenario(name))
        .find(is_inside);
    let inside = built_in.or_else(|| {
        plan.file_scenarios
            .iter()
            .map(|(_, scenario)| scenario)
            .find(|one| is_inside(one))
            .cloned()
    });
    let around = match inside {
        Some(scenario) => format!("around `{}`", scenario.spec().name),
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
fn registered_subject(plan: &AssessmentPlan, registration: &Registration) -> CertificateSubject {
    let foreign = |reason: String| CertificateSubject::Unrelated { reason };
    let of = |key: &str| {
        registration
            .configuration
            .get(key)
            .map_or("", String::as_str)
    };
    if of("crumple") != env!("CARGO_PKG_VERSION") {
        return foreign(format!("crumple {} counted its runs", of("crumple")));
    }
    let Some(named) = find_space(plan, registration) else {
        return foreign(format!(
            "its space `{}` is not among `distributions`",
            of("space")
        ));
    };
    let Some(&estimator) = EstimatorKind::ALL
        .iter()
        .find(|one| one.name() == of("estimator"))
    else {
        return foreign("it names no known estimator".to_owned());
    };
    let find = |place: &str| {
        let identity = of(&format!("{place}_sha256"));
        let is_it = |one: &NamedController| one.source.identity().as_deref() == Some(identity);
        // Both must define a failure alike.
        let place = plan.controllers.iter().position(is_it)?;
        let counts = plan.controllers.get(place).is_some_and(|one| {
            [
                one.failure_description(),
                "vehicles touch, or a controller fails",
            ]
            .contains(&of("failure"))
        });
        plan.claim_subject(place, estimator).filter(|_| counts)
    };
    let Some(subject) = find("controller") else {
        return foreign(format!(
            "its `{}` is not among the controllers",
            of("controller")
        ));
    };
    let domain = Domain::Space {
        space: named.content_id.clone(),
    };
    let property = match registration.configuration.get("against") {
        None => Property::FailureRate,
        Some(_) if named.can_others_collide() => {
            return foreign("it counts collisions of vehicles that are not under test".to_owned());
        }
        Some(other) => match find("against") {
            Some(than) => Property::FailsLessOften {
                than: than.controller,
            },
            None => return foreign(format!("its `{other}` is not among the controllers")),
        },
    };
    CertificateSubject::Claim(Box::new(AssuranceClaim {
        subject,
        property,
        domain,
    }))
}
