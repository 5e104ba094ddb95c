//! Collisions that are accepted as unavoidable cannot be avoided.

use crate::support;
use crate::support::{
    branches, certificate, follower_at, has_escape, one_ego_scene, pick_member, profiles, proofs,
    row_values, scenes, simulate_scene,
};
use crumple_verify::unavoidable::check_branch;
use crumple_verify::*;
use proptest::prelude::*;

prop_compose! {
    fn any_case(egos: usize)(scene in scenes(egos))(
        branch in branches(&scene), profiles in profiles(&scene), picks in prop::collection::vec(0.0..=1.0_f64, 32),
        corners in any::<bool>(), scene in Just(scene),
    ) -> (Scene, Branch, support::SceneMember, Vec<Vec<f64>>) {
        let mut picks = picks.into_iter().cycle();
        let member = pick_member(&scene, || { let p = picks.next().unwrap(); if corners { p.round() } else { p } });
        (scene, branch, member, profiles)
    }
}

/// Returns the weighted sum for a member, given by a number in [0, 1] per interval, with its rows and firing instant.
fn sum_m(
    scene: &Scene,
    branch: &Branch,
    picks: &[f64],
    profiles: &[Vec<f64>],
) -> (f64, Vec<(f64, f64, bool)>, u32) {
    let mut picks = picks.iter().cycle();
    let member = pick_member(scene, || *picks.next().unwrap());
    let run = simulate_scene(scene, &member, profiles);
    let rows = row_values(scene, &member, &run, branch);
    (
        rows.iter().map(|(y, value, _)| y * value).sum(),
        rows,
        run.fired,
    )
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(1500))]

    /// No member or profile has a smaller sum than the bound, not even the worst.
    #[test]
    fn no_profile_is_below_the_bound(
        (scene, branch, _, mut profiles) in (1..4_usize).prop_flat_map(any_case),
        mut picks in prop::collection::vec(0.0..=1.0_f64, 24),
    ) {
        let proved = check_branch(&scene, &branch, 3);
        let (sum, rows, fired) = sum_m(&scene, &branch, &picks, &profiles);
        if let (Ok(overlap_m), true) = (&proved, (branch.first..=branch.last).contains(&fired)) {
            let most_m = rows.iter().filter(|row| row.2).map(|row| row.1).fold(f64::NEG_INFINITY, f64::max);
            prop_assert!(most_m >= overlap_m - 1e-6, "overlap {most_m}, {overlap_m} proved");
        }
        let mut least_m = sum;
        for i in 0..picks.len() {
            let with = |end: f64| [&picks[..i], &[end], &picks[i + 1..]].concat();
            let [a, b] = [0.0, 1.0].map(|end| sum_m(&scene, &branch, &with(end), &profiles).0);
            picks[i] = if a < b { 0.0 } else { 1.0 };
            least_m = least_m.min(a).min(b);
        }
        for (i, ego) in scene.egos.iter().enumerate() {
            for j in 0..profiles[i].len() {
                let sums = [-ego.max_brake_mps2, ego.max_accel_mps2].map(|a| {
                    profiles[i][j] = a;
                    sum_m(&scene, &branch, &picks, &profiles).0
                });
                profiles[i][j] = if sums[0] < sums[1] { -ego.max_brake_mps2 } else { ego.max_accel_mps2 };
                least_m = least_m.min(sums[0]).min(sums[1]);
            }
        }
        match proved {
            Ok(overlap_m) => {
                let collision: f64 = rows.iter().filter(|row| row.2).map(|row| row.0).sum();
                prop_assert!(collision == 0.0 || least_m >= overlap_m * collision - 1e-6);
            }
            Err(Rejection::Unproved { branch: 3, sum_m }) => {
                prop_assert!(least_m >= sum_m - 1e-6, "{least_m} < {sum_m}");
            }
            Err(other) => prop_assert!(false, "{other}"),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { max_global_rejects: 1_000_000, ..crumple_cases::with_cases(6000) })]

    #[test]
    fn every_escape_satisfies_every_row((scene, branch, member, profiles) in (1..3_usize).prop_flat_map(any_case)) {
        let run = simulate_scene(&scene, &member, &profiles);
        prop_assume!(run.min_gap_m > 0.0);
        prop_assume!((branch.first..=branch.last).contains(&run.fired));
        for (_, value, _) in row_values(&scene, &member, &run, &branch) {
            prop_assert!(value <= 1e-9);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { max_global_rejects: 100_000, ..crumple_cases::with_cases(500) })]

    #[test]
    fn no_profile_escapes_an_accepted_proof(
        (scene, branches) in prop_oneof![3 => Just(1), 1 => Just(2)].prop_flat_map(proofs),
        picks in prop::collection::vec(0.0..=1.0_f64, 32),
    ) {
        let accepted = check(&certificate(Statement::Unavoidable(UnavoidableClaim { scene: scene.clone(), branches })));
        prop_assume!(accepted.is_ok());
        let mut picks = picks.into_iter().cycle();
        let member = pick_member(&scene, || picks.next().unwrap());
        let blocks = if scene.egos.len() == 1 { 6 } else { 3 };
        prop_assert!(!has_escape(&scene, &member, blocks));
    }
}

/// Without stops and speed rows the bound is tight: the best profile attains it.
#[test]
fn the_bound_is_attained() {
    let scene = standing_leader(1.0);
    let proved = |front: MultiplierRows| {
        check_branch(
            &scene,
            &Branch {
                last: 10,
                front,
                ..Branch::default()
            },
            0,
        )
    };
    // 20 t - 4 t² - 1 at t = 0.1, and the mean of that at 0.1 and 0.2.
    assert!((proved(vec![(1, 1.0)]).unwrap() - 0.96).abs() < 1e-12);
    assert!((proved(vec![(1, 5.0), (2, 5.0)]).unwrap() - (0.96 + 2.84) / 2.0).abs() < 1e-12);
    // A change of sign of q needs a follower: ahead of 1 m at 0.1 s, behind 0 m at 0.2 s.
    assert!(
        matches!(proved(vec![(0, 1.0)]), Err(Rejection::Unproved { branch: 0, sum_m }) if sum_m + 1.0 < 1e-12)
    );
}

/// Returns a car at 20 m/s behind a standing one; it can brake at 8 m/s² and accelerate at 3 m/s².
fn standing_leader(gap_m: f64) -> Scene {
    one_ego_scene((0.1, 10), gap_m, [0.0, 20.0], [8.0, 3.0])
}

/// Ahead at 0.1 s, behind at 0.2 s: q = (0.2 - t)⁺ y2 - (0.1 - t)⁺ y1 with y1 = 3, y2 = 1 changes sign at 0.05 s.
#[test]
fn a_change_of_sign_inside_a_step_is_integrated_exactly() {
    let follower = follower_at(-2.0, 0.0);
    let scene = Scene {
        follower: Some(follower),
        ..standing_leader(1.0)
    };
    let branch = Branch {
        last: 10,
        front: vec![(2, 1.0)],
        rear: vec![(1, 3.0)],
        ..Branch::default()
    };
    // Constant: -1 from the leader, 3 (-2 + 2) from the follower; x0 = 0; v0 (0.2 - 0.3) = -2. ∫ min(-8 q, 3 q): q from
    // -0.1 to 0.1 over 0.1 s, then from 0.1 to 0: -(8 + 3) 0.05 · 0.1 / 2 - 8 · 0.1 · 0.1 / 2.
    let expected_m = -1.0 - 2.0 - 11.0 * 0.0025 - 0.04;
    match check_branch(&scene, &branch, 0) {
        Err(Rejection::Unproved { sum_m, .. }) => {
            assert!((sum_m - expected_m).abs() < 1e-12, "{sum_m} {expected_m}")
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn certificates_that_prove_anything_are_refused() {
    let follower = follower_at(-9.0, 20.0);
    let sound = |scene: Scene| UnavoidableClaim {
        branches: match scene.follower {
            None => vec![Branch {
                last: 10,
                front: vec![(1, 1.0)],
                ..Branch::default()
            }],
            Some(_) => [(0, 0), (1, 4), (5, 10)]
                .map(|(first, last)| Branch {
                    first,
                    last,
                    front: vec![(1, 1.0), (2, 1.0)],
                    ..Branch::default()
                })
                .into(),
        },
        scene,
    };
    let result = |change: &dyn Fn(&mut UnavoidableClaim), follower: Option<&SceneFollower>| {
        let mut claim = sound(Scene {
            follower: follower.cloned(),
            ..standing_leader(1.0)
        });
        change(&mut claim);
        check(&certificate(Statement::Unavoidable(claim)))
    };
    assert!(result(&|_| {}, None).is_ok());
    let refused = |expected: &str, change: &dyn Fn(&mut UnavoidableClaim)| {
        let message = result(change, Some(&follower)).unwrap_err().to_string();
        assert!(
            message.contains(expected),
            "{message} instead of {expected}"
        );
    };
    assert!(result(&|_| {}, Some(&follower)).is_ok());
    // Branches that leave an instant out, overlap, or go beyond the end.
    refused("`branches[1]`", &|claim| claim.branches[1].first = 2);
    refused("`branches[2]`", &|claim| claim.branches[1].last = 3);
    refused("`branches[2]`", &|claim| claim.branches[1].last = 5);
    refused("`branches[1]`", &|claim| drop(claim.branches.remove(1)));
    refused("must end", &|claim| drop(claim.branches.pop()));
    refused("must end", &|claim| claim.branches.clear());
    refused("must end", &|claim| claim.branches[2].last = 9);
    refused("`branches[2]`", &|claim| claim.branches[2].last = 11);
    refused("`branches[2]`", &|claim| claim.branches[2].last = u32::MAX);
    refused("`branches[1]`", &|claim| {
        (claim.branches[1].first, claim.branches[1].last) = (4, 1)
    });
    refused("front[1]", &|claim| claim.branches[1].front[1].0 = 1);
    refused("front[1]", &|claim| claim.branches[1].front[1].0 = 0);
    refused("front[1]", &|claim| claim.branches[1].front[1].0 = 11);
    for y in [-1e-300, f64::NAN, f64::INFINITY] {
        refused("branches[2].front[1]", &|claim| {
            claim.branches[2].front[1].1 = y
        });
        refused("branches[0].fired", &|claim| claim.branches[0].fired = y);
        refused("branches[0].rear[0]", &|claim| {
            claim.branches[0].rear = vec![(3, y)]
        });
        refused("branches[0].speed[0][0]", &|claim| {
            claim.branches[0].speed = vec![vec![(3, y)]]
        });
    }
    refused("branches[1].unfired[0]", &|claim| {
        claim.branches[1].unfired = vec![(1, 1.0)]
    });
    refused("branches[1].fired", &|claim| claim.branches[1].fired = 1.0);
    refused("branches[3].fired", &|claim| {
        claim.branches[2].last = 9;
        claim.branches.push(Branch {
            first: 10,
            last: 10,
            fired: 1.0,
            ..Branch::default()
        });
    });
    refused("branches[0].between", &|claim| {
        claim.branches[0].between = vec![vec![]]
    });
    refused("branches[0].speed", &|claim| {
        claim.branches[0].speed = vec![vec![], vec![]]
    });
    refused("`branches[0]` is not proved", &|claim| {
        claim.branches[0].front[1].1 = 1e308
    });
    refused("is not proved", &|claim| {
        claim.scene.leader.position_m = Interval::new(-1.7e308, 1.7e308).unwrap()
    });
    refused("is not proved", &|claim| {
        claim.scene.egos[0].max_brake_mps2 = 1e308
    });
    for change in [
        (&|claim: &mut UnavoidableClaim| claim.branches[0].rear = vec![(1, 0.0)])
            as &dyn Fn(&mut UnavoidableClaim),
        &|claim| claim.branches[0].unfired = vec![(0, 0.0)],
        &|claim| claim.branches[0].fired = 1.0,
    ] {
        assert!(matches!(
            result(change, None),
            Err(Rejection::Invalid { .. })
        ));
    }
    refused("`steps`", &|claim| claim.scene.steps = 0);
    refused("`steps`", &|claim| claim.scene.steps = u32::MAX);
    for h in [0.0, -0.1, f64::NAN, f64::INFINITY] {
        refused("`step_s`", &|claim| claim.scene.step_s = h);
    }
    refused("`egos`", &|claim| claim.scene.egos.clear());
    refused("egos[0].speed_mps", &|claim| {
        claim.scene.egos[0].speed_mps = Interval::new(-1.0, 20.0).unwrap()
    });
    refused("egos[0].max_brake_mps2", &|claim| {
        claim.scene.egos[0].max_brake_mps2 = -8.0
    });
    refused("egos[0].max_accel_mps2", &|claim| {
        claim.scene.egos[0].max_accel_mps2 = f64::NAN
    });
    refused("leader.acceleration_mps2", &|claim| {
        claim.scene.leader.acceleration_mps2[0].0 = 9
    });
    refused("leader.speed_mps", &|claim| {
        claim.scene.leader.speed_mps = Interval::point(f64::NAN)
    });
    refused("follower.ttc_s", &|claim| {
        claim.scene.follower.as_mut().unwrap().ttc_s = f64::NAN
    });
}

#[test]
fn collision_at_the_start_is_unavoidable() {
    let scene = standing_leader(-0.5);
    let branch = Branch {
        last: 10,
        front: vec![(0, 2.0)],
        ..Branch::default()
    };
    assert!((check_branch(&scene, &branch, 0).unwrap() - 0.5).abs() < 1e-12);
}

/// Returns a car at 20 m/s that stops after 25 m and 2.5 s, the end of the scene, behind a standing one.
fn stopping_scene(gap_m: f64, follower: Option<SceneFollower>) -> Scene {
    let mut scene = Scene {
        step_s: 0.5,
        steps: 5,
        follower,
        ..standing_leader(gap_m)
    };
    scene.leader.acceleration_mps2[0].0 = 5;
    scene
}

/// Returns the row that full braking satisfies least: that of the end.
fn final_branch(first: u32) -> Branch {
    Branch {
        first,
        last: 5,
        front: vec![(5, 2.0)],
        ..Branch::default()
    }
}

fn gap_bound(scene: &Scene, branches: &[Branch], gap_m: f64) -> Result<ProvedClaim, Rejection> {
    let claim = GapBoundClaim {
        scene: scene.clone(),
        gap_m,
        branches: branches.to_vec(),
    };
    check(&certificate(Statement::GapBound(claim)))
}

#[test]
fn the_largest_unkept_gap_is_that_of_full_braking() {
    let with = |gap_m: f64, stated_m: f64| {
        gap_bound(&stopping_scene(gap_m, None), &[final_branch(0)], stated_m)
    };
    let Ok(ProvedClaim::GapBound { gap_m, horizon_s }) = with(30.0, 5.5) else {
        panic!("{:?}", with(30.0, 5.5))
    };
    assert!(
        gap_m >= 5.0 && gap_m - 5.0 < 1e-12 && horizon_s == 2.5,
        "{gap_m} {horizon_s}"
    );
    assert_eq!(
        with(30.0, gap_m),
        Ok(ProvedClaim::GapBound { gap_m, horizon_s })
    );
    let stated_m = gap_m.next_down();
    assert_eq!(
        with(30.0, stated_m),
        Err(Rejection::GapBound { stated_m, gap_m })
    );
    let text = with(30.0, 4.0).unwrap_err().to_string();
    assert_eq!(text, format!("`gap_m` is 4, and only {gap_m} m is proved"));
    assert_eq!(
        with(20.0, 0.0),
        Ok(ProvedClaim::GapBound {
            gap_m: 0.0,
            horizon_s
        })
    );
    for stated_m in [-1e-300, -5.0, f64::NAN, f64::INFINITY] {
        let text = with(30.0, stated_m).unwrap_err().to_string();
        assert_eq!(text, "`gap_m` must be 0 or more", "{stated_m}");
    }
    let speed = vec![vec![(5, 1.0)]];
    for nothing in [
        Branch {
            last: 5,
            ..Branch::default()
        },
        Branch {
            last: 5,
            speed,
            ..Branch::default()
        },
    ] {
        let refused = gap_bound(&stopping_scene(30.0, None), &[nothing], 1e9);
        assert!(
            matches!(refused, Err(Rejection::Unproved { branch: 0, sum_m }) if sum_m < 0.0),
            "{refused:?}"
        );
    }
}

/// The standing follower never brakes: a branch in which it does is empty.
#[test]
fn an_empty_branch_does_not_change_the_overlap() {
    let follower = follower_at(-50.0, 0.0);
    let fires = |k: u32| Branch {
        first: k,
        last: k,
        fired: 1.0,
        ..Branch::default()
    };
    let branches: Vec<Branch> = (0..5).map(fires).chain([final_branch(5)]).collect();
    let scene = |gap_m: f64| stopping_scene(gap_m, Some(follower.clone()));
    assert_eq!(
        check_branch(&scene(20.0), &branches[3], 3),
        Ok(f64::INFINITY)
    );
    match gap_bound(&scene(30.0), &branches, 5.5) {
        Ok(ProvedClaim::GapBound { gap_m, .. }) => assert!((gap_m - 5.0).abs() < 1e-12, "{gap_m}"),
        other => panic!("{other:?}"),
    }
    match check(&certificate(Statement::Unavoidable(UnavoidableClaim {
        scene: scene(20.0),
        branches,
    }))) {
        Ok(ProvedClaim::Unavoidable {
            overlap_m,
            horizon_s,
        }) => {
            assert!(
                overlap_m <= 5.0 && 5.0 - overlap_m < 1e-12 && horizon_s == 2.5,
                "{overlap_m} {horizon_s}"
            );
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_branch_alone_lies_within_the_instants_too() {
    let piece = |first, last| {
        check_branch(
            &stopping_scene(20.0, None),
            &Branch {
                first,
                last,
                ..final_branch(0)
            },
            7,
        )
    };
    assert!(piece(0, 5).is_ok() && piece(5, 5).is_ok());
    for (first, last) in [(3, 2), (0, 6), (6, 6), (6, 5)] {
        assert_eq!(
            piece(first, last),
            Err(Rejection::Tiling { branch: 7 }),
            "{first} {last}"
        );
    }
}

/// A quotient of subnormal numbers may round to zero although the sum does not.
#[test]
fn a_proved_overlap_is_positive() {
    let mut proved = 0;
    for (ulps, y) in (1..12).flat_map(|ulps| (1..40).map(move |y| (ulps, y))) {
        let mut scene = stopping_scene(0.0, None);
        scene.leader.position_m = Interval::point(-f64::from_bits(ulps));
        (scene.leader.length_m, scene.egos[0].speed_mps) = (0.0, Interval::ZERO);
        let branch = Branch {
            last: 5,
            front: vec![(0, f64::from(y))],
            ..Branch::default()
        };
        match check_branch(&scene, &branch, 0) {
            Ok(overlap_m) => {
                proved += 1;
                assert!(
                    overlap_m > 0.0 && overlap_m <= f64::from_bits(ulps),
                    "{ulps} {y}: {overlap_m}"
                );
            }
            Err(rejection) => assert!(
                matches!(rejection, Rejection::Unproved { branch: 0, .. }),
                "{rejection}"
            ),
        }
    }
    assert!(proved > 100, "{proved}");
}

#[test]
fn work_is_counted_for_every_instant_and_vehicle() {
    let follower = follower_at(-50.0, 0.0);
    for (egos, follower, vehicles) in [
        (1, None, 2),
        (1, Some(follower.clone()), 3),
        (3, Some(follower), 5),
    ] {
        let mut scene = stopping_scene(20.0, follower);
        scene.egos = vec![scene.egos[0].clone(); egos];
        let (witness, min_gap_m_at_least) = (vec![vec![ConstantPiece(5, 0.0)]; egos], None);
        let branches = vec![final_branch(0)];
        for statement in [
            Statement::Avoidable(AvoidableClaim {
                scene: scene.clone(),
                witness,
                min_gap_m_at_least,
            }),
            Statement::Unavoidable(UnavoidableClaim {
                scene: scene.clone(),
                branches: branches.clone(),
            }),
            Statement::GapBound(GapBoundClaim {
                scene,
                gap_m: 0.0,
                branches,
            }),
        ] {
            let claim = certificate(statement);
            let (needed, name) = (6 * vehicles * 400, claim.statement.name());
            let is_too_much = |operations: u64| {
                let checked = check_with(&claim, None, WorkLimit::from_operations(operations));
                matches!(checked, Err(Rejection::BudgetExceeded { .. }))
            };
            assert!(
                !is_too_much(needed) && is_too_much(needed - 1),
                "{name}: {vehicles}"
            );
        }
    }
}
