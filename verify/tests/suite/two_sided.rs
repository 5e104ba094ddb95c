//! Claims about a vehicle between leader and follower.

use crumple_verify::two_sided::*;
use crumple_verify::{
    Certificate, ConstantPiece, ProvedClaim, Rejection, Statement, TwoSidedClaim, check,
};

use crate::support::certificate;

/// An ego vehicle at 20 m/s that brakes at 6 m/s², between a leader that may brake at 3 m/s² and a follower whose brake
/// has fired.
fn braking_claim() -> TwoSidedClaim {
    let neighbour = |gap_m: f64| {
        Some(ObservedNeighbour {
            gap_m,
            speed_mps: 20.0,
        })
    };
    TwoSidedClaim {
        follower: Some(CoveredFollowers {
            brakes_when: FollowerCue::TtcBelowS(1.4),
            reaction_s: 0.1,
            brake_mps2: 6.0,
            drift_mps2: 0.3,
        }),
        leader_brakes_at_most_mps2: 3.0,
        ego: TwoSidedEgo {
            step_s: 0.01,
            brake_mps2: 8.0,
            accel_mps2: 2.0,
            noise_mps2: 0.0,
            delay_steps: 0,
        },
        observation_error: ObservationErrors::default(),
        start: Some(TwoSidedStart {
            ego_speed_mps: 20.0,
            leader: neighbour(10.0),
            follower: neighbour(3.0),
            phase: KnownPhase::BrakesWithinS(0.1),
            plan: TwoSidedPlan {
                commands: vec![ConstantPiece(500, -6.0)],
                after_firing: None,
            },
        }),
    }
}

fn start(claim: &mut TwoSidedClaim) -> &mut TwoSidedStart {
    claim.start.as_mut().unwrap()
}

fn checked(claim: TwoSidedClaim) -> Result<ProvedClaim, Rejection> {
    let mut certificate: Certificate = certificate(Statement::TwoSided(Box::new(claim)));
    certificate.version = crumple_verify::certificate::VERSION;
    certificate.provenance = crumple_verify::CertificateProvenance {
        crumple: certificate.provenance.crumple,
        ..Default::default()
    };
    check(&certificate)
}

fn check_changed(change: impl FnOnce(&mut TwoSidedClaim)) -> Result<ProvedClaim, Rejection> {
    let mut claim = braking_claim();
    change(&mut claim);
    checked(claim)
}

/// The text names the class of followers before anything else.
#[test]
fn a_plan_that_brakes_is_accepted_and_its_class_comes_first() {
    let accepted = check_changed(|_| {}).unwrap().to_string();
    assert!(
        accepted.starts_with(
            "two-sided: with a follower that brakes at 6 m/s² or more within 0.1 s once"
        ),
        "{accepted}"
    );
    let filter = check_changed(|claim| claim.start = None)
        .unwrap()
        .to_string();
    assert!(filter.contains("a filter with these constants"), "{filter}");
}

/// With a follower at the same speed, the gap behind closes by the speed that the follower keeps longer: (6 + 0.3) 0.1
/// m/s for 20/6 s, and a little more. So 2.1 m are too few, and 3 m enough.
#[test]
fn a_gap_that_the_follower_closes_is_rejected() {
    let with_gap =
        |gap_m: f64| check_changed(|claim| start(claim).follower.as_mut().unwrap().gap_m = gap_m);
    assert!(with_gap(3.0).is_ok());
    assert!(
        matches!(
            with_gap(2.1),
            Err(Rejection::MayCollide {
                front_vehicle: 1,
                ..
            })
        ),
        "{:?}",
        with_gap(2.1)
    );
}

/// The leader covers 20²/2c, and the ego vehicle 20²/12: with 10 m, c may be up to 8.57 m/s².
#[test]
fn a_level_is_accepted_exactly_up_to_the_one_of_the_gap() {
    let with_level = |level: f64| check_changed(|claim| claim.leader_brakes_at_most_mps2 = level);
    assert!(with_level(8.5).is_ok());
    assert!(matches!(
        with_level(8.6),
        Err(Rejection::MayCollide {
            front_vehicle: 0,
            ..
        })
    ));
}

#[test]
fn constants_outside_the_theorem_and_parts_that_do_not_belong_together_are_rejected() {
    type Change = fn(&mut TwoSidedClaim);
    let changes: [(&str, Change); 13] = [
        ("ego.step_s", |claim| claim.ego.step_s = 0.0),
        ("ego.brake_mps2", |claim| claim.ego.brake_mps2 = -1.0),
        ("ego.noise_mps2", |claim| claim.ego.noise_mps2 = 8.0),
        // Each firing would be checked until the command after it takes effect.
        ("ego.delay_steps", |claim| claim.ego.delay_steps = u32::MAX),
        ("leader_brakes_at_most_mps2", |claim| {
            claim.leader_brakes_at_most_mps2 = 0.0
        }),
        ("observation_error", |claim| {
            claim.observation_error.gap_ahead_m = -1.0
        }),
        ("follower.brakes_when", |claim| {
            if let Some(class) = &mut claim.follower {
                class.brakes_when = FollowerCue::TtcBelowS(0.01);
            }
        }),
        ("follower", |claim| {
            if let Some(class) = &mut claim.follower {
                class.reaction_s = -0.1;
            }
        }),
        ("start.follower", |claim| claim.follower = None),
        ("start", |claim| start(claim).ego_speed_mps = -1.0),
        ("start.plan", |claim| start(claim).plan.commands[0].1 = -9.0),
        ("start.plan", |claim| {
            start(claim).plan.commands[0].0 = u32::MAX
        }),
        ("after_firing", |claim| {
            start(claim).plan.after_firing = Some(PlanAfterFiring {
                accel_mps2: 0.0,
                steps: vec![ConstantPiece(1, 1)],
            });
        }),
    ];
    for (expected, change) in changes {
        match check_changed(change) {
            Err(Rejection::Invalid { field, .. }) => assert_eq!(field, expected),
            other => panic!("{expected}: {other:?}"),
        }
    }
}

/// A follower that reacts brakes `reaction_s` after the ego vehicle, and later if the ego vehicle brakes later.
#[test]
fn a_follower_that_reacts_needs_braking_that_it_notices() {
    let with_first = |command: f64| {
        check_changed(|claim| {
            if let Some(class) = &mut claim.follower {
                class.brakes_when = FollowerCue::EgoBrakes;
            }
            let start = start(claim);
            start.phase = KnownPhase::Waiting;
            start.plan.commands = vec![ConstantPiece(100, command), ConstantPiece(500, -6.0)];
        })
    };
    assert!(with_first(-6.0).is_ok());
    // Braking at 1.2 m/s² for a second is not noticed: the follower gains 1.5 m/s.
    assert!(matches!(
        with_first(-1.2),
        Err(Rejection::MayCollide {
            front_vehicle: 1,
            ..
        })
    ));
}

/// The ego vehicle comes to a stop within a step of 1 s, and brakes too little to be noticed. The follower notices it
/// when it stands, at the end of the step.
#[test]
fn a_vehicle_that_comes_to_a_stop_is_noticed_when_it_stands() {
    let with_gap = |gap_m: f64| {
        check_changed(|claim| {
            claim.ego.step_s = 1.0;
            claim.follower = Some(CoveredFollowers {
                brakes_when: FollowerCue::EgoBrakes,
                reaction_s: 0.5,
                brake_mps2: 8.0,
                drift_mps2: 0.0,
            });
            *start(claim) = TwoSidedStart {
                ego_speed_mps: 0.6,
                leader: None,
                follower: Some(ObservedNeighbour {
                    gap_m,
                    speed_mps: 20.0,
                }),
                phase: KnownPhase::Waiting,
                plan: TwoSidedPlan {
                    commands: vec![ConstantPiece(1, -0.61)],
                    after_firing: None,
                },
            };
        })
    };
    // 30 m in 1.5 s, and 25 m to brake. The ego vehicle drives 0.3 m, and 2 m must remain.
    assert!(with_gap(56.8).is_ok());
    assert!(with_gap(56.6).is_err());
}
