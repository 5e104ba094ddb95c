//! Every member of an accepted avoidable claim avoids the collision.

use crate::support;
use crate::support::{
    SUBSTEPS, expand_to_substeps, follower_at, one_ego_scene, pick_member, scenes, simulate_scene,
};
use crumple_verify::*;
use proptest::prelude::*;

fn certificate(scene: &Scene, witness: Vec<Vec<ConstantPiece<f64>>>) -> Certificate {
    support::certificate(Statement::Avoidable(AvoidableClaim {
        scene: scene.clone(),
        witness,
        min_gap_m_at_least: None,
    }))
}

fn calm_scene() -> (Scene, Vec<Vec<ConstantPiece<f64>>>) {
    let point = Interval::point;
    let ego = |x: f64| SceneEgo {
        position_m: Interval::new(x - 0.5, x + 0.5).unwrap(),
        length_m: 2.0,
        speed_mps: Interval::new(19.9, 20.1).unwrap(),
        max_brake_mps2: 7.5,
        max_accel_mps2: 3.0,
    };
    let scene = Scene {
        step_s: 0.1,
        steps: 100,
        leader: SceneLeader {
            position_m: point(100.0),
            length_m: 2.0,
            speed_mps: point(20.0),
            acceleration_mps2: vec![
                ConstantPiece(10, point(0.0)),
                ConstantPiece(90, Interval::new(-4.1, -3.9).unwrap()),
            ],
        },
        egos: vec![ego(60.0), ego(40.0)],
        follower: Some(SceneFollower {
            position_m: point(10.0),
            speed_mps: point(20.0),
            brake_mps2: Interval::new(6.0, 6.5).unwrap(),
            ttc_s: 3.0,
            reaction_steps: 2,
        }),
    };
    (
        scene,
        vec![
            vec![ConstantPiece(15, 0.0), ConstantPiece(85, -4.0)],
            vec![
                ConstantPiece(10, 0.0),
                ConstantPiece(20, -2.0),
                ConstantPiece(70, -4.0),
            ],
        ],
    )
}

#[test]
fn a_calm_stop_is_accepted_and_each_fault_is_named() {
    let (scene, witness) = calm_scene();
    let Ok(ProvedClaim::Avoidable {
        min_gap_m,
        after_horizon,
        ..
    }) = check(&certificate(&scene, witness.clone()))
    else {
        panic!("{:?}", check(&certificate(&scene, witness)));
    };
    assert!(min_gap_m > 0.1, "{min_gap_m}");
    assert_eq!(
        after_horizon,
        SafetyAfterHorizon::ForAnyLeader,
        "all vehicles stand"
    );
    let faulty = |change: &dyn Fn(&mut AvoidableClaim)| {
        let mut certificate = certificate(&scene, witness.clone());
        if let Statement::Avoidable(claim) = &mut certificate.statement {
            change(claim);
        }
        check(&certificate).unwrap_err()
    };
    let stated = faulty(&|claim| claim.min_gap_m_at_least = Some(min_gap_m.next_up()));
    assert_eq!(
        stated,
        Rejection::GapTooSmall {
            stated_m: min_gap_m.next_up(),
            min_gap_m
        }
    );
    for stated_m in [f64::NAN, f64::INFINITY] {
        assert!(matches!(
            faulty(&|claim| claim.min_gap_m_at_least = Some(stated_m)),
            Rejection::GapTooSmall { .. }
        ));
    }
    let front = faulty(&|claim| claim.witness[0] = vec![ConstantPiece(100, 0.0)]);
    assert!(
        matches!(
            front,
            Rejection::MayCollide {
                front_vehicle: 0,
                ..
            }
        ),
        "{front}"
    );
    let rear = faulty(&|claim| claim.witness[1] = vec![ConstantPiece(100, -7.5)]);
    assert!(
        matches!(
            rear,
            Rejection::MayCollide {
                front_vehicle: 2,
                ..
            }
        ),
        "{rear}"
    );
    for a in [-7.6, 3.1, f64::NAN] {
        let beyond = faulty(&|claim| claim.witness[1][2].1 = a);
        assert!(beyond.to_string().contains("`witness[1][2]`"), "{beyond}");
    }
    assert!(
        faulty(&|claim| claim.witness[0][0].0 = 14)
            .to_string()
            .contains("`witness[0]`")
    );
    assert!(
        faulty(&|claim| drop(claim.witness.pop()))
            .to_string()
            .contains("`witness`")
    );
    let touching =
        faulty(&|claim| claim.scene.egos[0].position_m = Interval::new(60.0, 98.0).unwrap());
    assert!(
        matches!(
            touching,
            Rejection::MayCollide {
                front_vehicle: 0,
                step: 0,
                ..
            }
        ),
        "{touching}"
    );
}

/// Without a follower the smallest gap is a closed form: here the parabola's vertex, inside a step.
#[test]
fn a_near_miss_inside_a_step_is_seen() {
    let scene = |gap_m: f64| one_ego_scene((1.0, 1), gap_m, [10.0, 12.0], [4.0, 0.0]);
    // The gap is gap - 2 t + 2 t², at least gap - 0.5.
    let witness = vec![vec![ConstantPiece(1, -4.0)]];
    let Ok(ProvedClaim::Avoidable { min_gap_m, .. }) =
        check(&certificate(&scene(0.51), witness.clone()))
    else {
        panic!("not accepted");
    };
    assert!((min_gap_m - 0.01).abs() < 1e-12);
    assert!(check(&certificate(&scene(0.5), witness)).is_err());
}

/// Two comparisons decide: stopping distance and gap, and the speeds.
#[test]
fn motion_afterwards_is_the_closed_form() {
    let afterwards = |gap_m: f64, leader_mps: f64, ego_mps: f64| {
        let scene = one_ego_scene((0.5, 2), gap_m, [leader_mps, ego_mps], [5.0, 0.0]);
        match check(&certificate(&scene, vec![vec![ConstantPiece(2, 0.0)]])) {
            Ok(ProvedClaim::Avoidable { after_horizon, .. }) => after_horizon,
            other => panic!("{other:?}"),
        }
    };
    // A second at equal speeds keeps the gap: v²/10 must be less.
    assert_eq!(
        afterwards(10.01, 10.0, 10.0),
        SafetyAfterHorizon::ForAnyLeader
    );
    assert_eq!(
        afterwards(9.99, 10.0, 10.0),
        SafetyAfterHorizon::UnlessLeaderBrakes
    );
    // 1 m/s faster, and 1 m further: v - u is 4 m/s, and 1.6 m are covered.
    assert_eq!(
        afterwards(1.61 + 4.0, 6.0, 10.0),
        SafetyAfterHorizon::UnlessLeaderBrakes
    );
    assert_eq!(
        afterwards(1.59 + 4.0, 6.0, 10.0),
        SafetyAfterHorizon::Unproved
    );
}

fn scene_with_witness(egos: usize) -> impl Strategy<Value = (Scene, Vec<Vec<ConstantPiece<f64>>>)> {
    (
        scenes(egos),
        prop::collection::vec((0.0..=1.0_f64, 0.0..=1.0_f64), egos),
    )
        .prop_map(|(scene, levels)| {
            let motion_of = |(ego, (first, then)): (&SceneEgo, (f64, f64))| {
                let a = |level: f64| {
                    let a = level * (ego.max_accel_mps2 + ego.max_brake_mps2) - ego.max_brake_mps2;
                    a.clamp(-ego.max_brake_mps2, ego.max_accel_mps2)
                };
                vec![
                    ConstantPiece(1, a(first)),
                    ConstantPiece(scene.steps - 1, a(then)),
                ]
            };
            let witness = scene.egos.iter().zip(levels).map(motion_of).collect();
            (scene, witness)
        })
}

/// Returns the smallest gap of a member after the horizon. The leader stops at once or holds its speed; the others
/// brake to a stop or to the slowest speed.
fn min_gap_after_horizon_m(
    scene: &Scene,
    profiles: &[Vec<f64>],
    afterwards: SafetyAfterHorizon,
    picks: &mut dyn FnMut() -> f64,
) -> f64 {
    const EXTRA_STEPS: u32 = 200;
    let stops = afterwards == SafetyAfterHorizon::ForAnyLeader;
    let mut longer = scene.clone();
    longer.steps += EXTRA_STEPS;
    longer.leader.acceleration_mps2.push(ConstantPiece(
        EXTRA_STEPS,
        Interval::point(if stops { -1000.0 } else { 0.0 }),
    ));
    let member = pick_member(&longer, picks);
    let ends = simulate_scene(scene, &member, profiles);
    let leader_mps = member.leader_mps2.iter().take(scene.steps as usize);
    let leader_mps = leader_mps.fold(member.leader[1], |v, a| (v + a * scene.step_s).max(0.0));
    let speeds: Vec<f64> = ends
        .egos
        .iter()
        .map(|path| path.last().unwrap()[1])
        .collect();
    let slowest_mps = if stops {
        0.0
    } else {
        speeds.iter().copied().fold(leader_mps, f64::min)
    };
    let dt = scene.step_s / SUBSTEPS as f64;
    let mut longer_profiles = profiles.to_vec();
    for ((profile, mut v), ego) in longer_profiles.iter_mut().zip(speeds).zip(&scene.egos) {
        for _ in 0..EXTRA_STEPS as usize * SUBSTEPS {
            let a = ((slowest_mps - v) / dt).max(-ego.max_brake_mps2);
            profile.push(a);
            v += a * dt;
        }
    }
    simulate_scene(&longer, &member, &longer_profiles).min_gap_m
}

proptest! {
    #![proptest_config(ProptestConfig { max_global_rejects: 100_000, ..crumple_cases::with_cases(4000) })]

    #[test]
    fn every_member_keeps_the_gap_that_was_proved(
        (scene, witness) in (1..3_usize).prop_flat_map(scene_with_witness),
        picks in prop::collection::vec(0.0..=1.0_f64, 64),
    ) {
        let accepted = check(&certificate(&scene, witness.clone()));
        let profiles = expand_to_substeps(&witness);
        let mut picks = picks.into_iter().cycle();
        let mut least_m = f64::INFINITY;
        for corner in 0..8 {
            let member = pick_member(&scene, || picks.next().map(|p| if corner < 4 { p.round() } else { p }).unwrap());
            least_m = least_m.min(simulate_scene(&scene, &member, &profiles).min_gap_m);
        }
        match accepted {
            Ok(ProvedClaim::Avoidable { min_gap_m, after_horizon, .. }) => {
                prop_assert!(min_gap_m <= least_m + 1e-9);
                if after_horizon != SafetyAfterHorizon::Unproved {
                    let mut pick = || picks.next().unwrap().round();
                    let kept_m = min_gap_after_horizon_m(&scene, &profiles, after_horizon, &mut pick);
                    // Braking ends with a substep, not at the target speed.
                    let late_m = 9.0 * (scene.step_s / SUBSTEPS as f64).powi(2);
                    prop_assert!(kept_m > -late_m, "{after_horizon}: {kept_m}");
                }
            }
            Ok(other) => prop_assert!(false, "{other}"),
            Err(Rejection::MayCollide { gap_m, .. }) => {
                // For a point the only loss is the bow inside a step: at most the larger acceleration over h² / 8.
                let is_point = scene.leader.position_m.low() == scene.leader.position_m.high();
                prop_assume!(is_point);
                let bow_m = 20.0 * scene.step_s * scene.step_s / 8.0;
                prop_assert!(least_m <= bow_m + 1e-9, "{least_m} is clear, yet only {gap_m} is proved");
            }
            Err(other) => prop_assert!(false, "{other}"),
        }
    }
}

/// Checks ten steps at constant speeds, in which only the follower limits the safety afterwards.
fn check_with_follower(
    gap_m: f64,
    mps: f64,
    ttc_s: f64,
    reaction_steps: u32,
) -> (f64, SafetyAfterHorizon) {
    let follower = SceneFollower {
        ttc_s,
        reaction_steps,
        ..follower_at(-2.0 - gap_m, mps)
    };
    let scene = Scene {
        follower: Some(follower),
        ..one_ego_scene((0.25, 8), 100.0, [10.0; 2], [5.0, 0.0])
    };
    match check(&certificate(&scene, vec![vec![ConstantPiece(8, 0.0)]])) {
        Ok(ProvedClaim::Avoidable {
            min_gap_m,
            after_horizon,
            ..
        }) => (min_gap_m, after_horizon),
        other => panic!("{other:?}"),
    }
}

/// A brake that has fired and whose reaction is over stops the vehicle; any other brake may never fire.
#[test]
fn after_the_horizon_a_follower_stops_only_if_it_brakes() {
    use SafetyAfterHorizon::{ForAnyLeader, UnlessLeaderBrakes, Unproved};
    let followed_afterwards = |gap_m, mps, ttc_s, reaction_steps| {
        check_with_follower(gap_m, mps, ttc_s, reaction_steps).1
    };
    // It never fires: only a slower follower stays behind while no vehicle brakes; equal speed fails by rounding.
    for (mps, expected) in [
        (9.0, UnlessLeaderBrakes),
        (10.0, Unproved),
        (11.0, Unproved),
    ] {
        for reaction_steps in [0, 3, u32::MAX] {
            assert_eq!(
                followed_afterwards(1000.0, mps, 0.0, reaction_steps),
                expected,
                "{mps} {reaction_steps}"
            );
        }
    }
    // It fires at once; at 12 m/s it stops after 12 m, from 4 m nearer than at the start if it coasts throughout.
    assert_eq!(followed_afterwards(16.01, 12.0, 100.0, 8), ForAnyLeader);
    assert_eq!(
        followed_afterwards(15.99, 12.0, 100.0, 8),
        UnlessLeaderBrakes
    );
    assert_eq!(followed_afterwards(16.01, 12.0, 100.0, 9), Unproved);
    assert_eq!(followed_afterwards(16.01, 12.0, 100.0, u32::MAX), Unproved);
    // It has braked for the last two steps: 0.75 m less were covered and 9 m/s are left, which take 6.75 m.
    assert_eq!(
        followed_afterwards(4.0 - 0.75 + 6.76, 12.0, 100.0, 6),
        ForAnyLeader
    );
    assert_eq!(
        followed_afterwards(4.0 - 0.75 + 6.74, 12.0, 100.0, 6),
        UnlessLeaderBrakes
    );
}

/// The follower may begin to brake anywhere in a step: a gap may be smaller by b h²/8 than at both ends.
#[test]
fn the_curvature_of_a_gap_includes_the_followers_braking() {
    for (gap_m, mps) in [(5.0, 9.0), (5.0, 10.0), (1.0, 9.5)] {
        let (min_gap_m, _) = check_with_follower(gap_m, mps, 0.0, 0);
        let expected = gap_m - 6.0 * 0.0625 / 8.0;
        assert!(
            min_gap_m <= expected && expected - min_gap_m < 1e-12,
            "{mps}: {min_gap_m} {expected}"
        );
    }
}

/// A bound of subnormal gaps may round to zero, which is a collision.
#[test]
fn a_proved_gap_is_positive() {
    let (mut touching, mut clear) = (0, 0);
    for ulps in 0..60 {
        let (mut scene, _) = calm_scene();
        (scene.steps, scene.follower) = (1, None);
        scene.leader.position_m = Interval::point(f64::from_bits(ulps));
        (scene.leader.length_m, scene.leader.speed_mps) = (0.0, Interval::ZERO);
        scene.leader.acceleration_mps2 = vec![ConstantPiece(1, Interval::ZERO)];
        scene.egos.truncate(1);
        (scene.egos[0].position_m, scene.egos[0].speed_mps) = (Interval::ZERO, Interval::ZERO);
        match check(&certificate(&scene, vec![vec![ConstantPiece(1, 0.0)]])) {
            Ok(ProvedClaim::Avoidable { min_gap_m, .. }) => {
                clear += 1;
                assert!(
                    min_gap_m > 0.0 && min_gap_m <= f64::from_bits(ulps),
                    "{ulps}: {min_gap_m}"
                );
            }
            Err(Rejection::MayCollide {
                front_vehicle: 0,
                step: 0,
                gap_m,
            }) => {
                touching += 1;
                assert!(gap_m <= 0.0, "{ulps}: {gap_m}");
            }
            other => panic!("{ulps}: {other:?}"),
        }
    }
    assert!(touching > 0 && clear > 0, "{touching} {clear}");
}
