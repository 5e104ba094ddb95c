use super::super::fixtures::{
    affine_controller, assert_bounds, constant_controller, default_problem, point_box, point_form,
    symbol_form,
};
use super::super::follower::AccAebLaw;
use super::*;

const DEFAULT_POINT: [f64; 8] = [20.0, 20.0, 10.0, 10.0, 10.0, 0.0, 6.0, 0.0];
const LATCHED: Option<FollowerModel> = Some(FollowerModel::Latched { ttc_s: 2.0 });

fn unlimited_budget() -> OpBudget {
    OpBudget::new(WorkLimit::UNLIMITED)
}

fn extreme_law(yes: bool) -> FollowerLaw {
    FollowerLaw::AccAeb(AccAebLaw {
        ttc_s: if yes { 1e6 } else { 0.0 },
        time_headway_s: 0.0,
        standstill_gap_m: 0.0,
        gap_gain_per_s2: 0.0,
        speed_gain_per_s: 0.0,
        comfort_brake_mps2: 3.0,
        comfort_accel_mps2: 3.0,
        set_speed_mps: None,
        max_accel_mps2: 3.0,
    })
}

/// Propagation goes on until no vehicle moves and none is commanded to, even into a collision.
#[test]
fn moving_members_are_propagated() {
    let nobody_behind = [
        // It rolls on into a standing leader, braking too little or not at all.
        ([2.0, 20.0, 0.0, 5.0, 0.0], -0.1),
        ([2.0, 20.0, 0.0, 5.0, 0.0], 0.0),
        ([2.0, 20.0, 0.0, 0.0, 0.0], 3.0),
    ];
    for ([ahead, behind, leader, ego, follower], mps2) in nobody_behind {
        let controller = constant_controller(mps2);
        let ranges = point_box([ahead, behind, leader, ego, follower, 6.0, 6.0, 0.0]);
        let reached = reach(&ReachProblem {
            steps: 20,
            ..default_problem(&controller, ranges)
        });
        assert!(
            reached.surely_collides && reached.gaps_m[0] < 0.0,
            "{reached:?}"
        );
    }
    // It stands behind a standing leader, and the follower collides with it.
    let controller = constant_controller(-1.0);
    let ranges = point_box([5.0, 2.0, 0.0, 0.0, 5.0, 6.0, 0.0, 0.0]);
    for follower in [
        FollowerModel::Latched { ttc_s: 0.0 },
        FollowerModel::ByLaw(extreme_law(false)),
    ] {
        let reached = reach(&ReachProblem {
            steps: 20,
            follower: Some(follower),
            ..default_problem(&controller, ranges)
        });
        assert!(
            reached.surely_collides && reached.gaps_m[1] < 0.0,
            "{reached:?}"
        );
    }
}

/// Checks that a long standstill costs no more than a short one, and that observations stay constant after two steps.
#[test]
fn propagation_ends_once_all_vehicles_stand() {
    let controller = constant_controller(-1.0);
    let stands = default_problem(
        &controller,
        point_box([5.0, 20.0, 0.0, 0.0, 0.0, 6.0, 6.0, 0.0]),
    );
    for (follower, limit) in [(None, None), (None, Some(6.0))] {
        let scene = ReachProblem {
            steps: 500,
            follower,
            leader_brakes_at_most_mps2: limit,
            ..stands.clone()
        };
        let few = OpBudget::new(WorkLimit::from_operations(3_000_000));
        let (reached, tube) = analyze(&scene, &few, Some(ReachTube::new()));
        assert!(few.charge(0) && reached.undecided.is_none());
        let tube = tube.unwrap();
        assert!(tube.len() == 501 && tube[2..].iter().all(|seen| *seen == tube[2]));
    }
}

#[test]
fn the_firing_instant_has_its_own_symbol() {
    let (controller, work) = (constant_controller(0.0), unlimited_budget());
    let scene = ReachProblem {
        follower: LATCHED,
        ..default_problem(&controller, point_box(DEFAULT_POINT))
    };
    let onset = ReachAnalysis::new(&scene, &work, None)
        .latched_follower([2.0, 5.0])
        .onset;
    assert!(onset.terms().len() == SHARED_SYMBOLS && onset.terms()[BoxDimension::ALL.len()] > 0.0);
    assert_bounds(onset.range(), [2.0, 5.0], 1e-10);
}

#[test]
fn a_decision_has_the_stated_cost() {
    let controller = constant_controller(0.0);
    for (limit, symbols) in [(None, 0), (Some(6.0), 24)] {
        let scene = ReachProblem {
            steps: 36,
            decision_steps: 3,
            leader_brakes_at_most_mps2: limit,
            ..default_problem(&controller, point_box(DEFAULT_POINT))
        };
        let cost = OPS_PER_DECISION + OPS_PER_LEADER_SYMBOL * symbols + 3 * OPS_PER_STEP;
        let work = OpBudget::new(WorkLimit::from_operations(cost));
        let mut analysis = ReachAnalysis::new(&scene, &work, None);
        let set = analysis.observe(
            0,
            EgoSet::from_speed(point_form(10.0), SHARED_SYMBOLS),
            None,
        );
        assert!(analysis.decide(0, &set).is_some());
        assert!(work.charge(0) && !work.charge(1));
    }
}

#[test]
fn sets_that_are_too_wide_are_undecided() {
    let work = unlimited_budget();
    for (radius, of_wanted, goes_on) in [
        (39.0, 0.0, true),
        (41.0, 0.0, false),
        (39.0, 1.1, false),
        (30.0, 1.1, true),
    ] {
        let controller = affine_controller([0.0, 0.0, 0.0, of_wanted, 0.0, 0.0, 0.0, 0.0], 0.0);
        let scene = default_problem(&controller, point_box(DEFAULT_POINT));
        let mut analysis = ReachAnalysis::new(&scene, &work, None);
        let set = analysis.observe(
            0,
            EgoSet::from_speed(symbol_form(3, 50.0 - radius, 50.0 + radius), SHARED_SYMBOLS),
            None,
        );
        assert_eq!(analysis.decide(0, &set).is_some(), goes_on);
        assert_eq!(
            analysis.result.undecided,
            (!goes_on).then_some(Undecided::TooWide { step: 0 })
        );
    }
}

#[test]
fn a_follower_fires_where_its_guard_may_be_negative() {
    let (controller, work) = (constant_controller(0.0), unlimited_budget());
    let firing = |gap: [f64; 2], speeds: [f64; 2], wanted: f64| {
        let mut ranges = point_box(DEFAULT_POINT);
        ranges.gap_behind_m = Interval::new(gap[0], gap[1]).unwrap();
        ranges.follower_speed_mps = Interval::point(speeds[1]);
        let scene = ReachProblem {
            follower: LATCHED,
            decision_steps: 4,
            ..default_problem(&controller, ranges)
        };
        let analysis = ReachAnalysis::new(&scene, &work, None);
        let follower = analysis.latched_follower([100.0, 100.0]);
        analysis.firing_instants(
            8,
            &EgoSet::from_speed(point_form(speeds[0]), SHARED_SYMBOLS),
            &point_form(wanted),
            &follower,
        )
    };
    // The follower alone has driven for 0.8 s, and both are as fast.
    assert_eq!(firing([8.1, 9.0], [10.0; 2], 0.0), None);
    assert_eq!(
        firing([7.9, 9.0], [10.0; 2], 0.0),
        Some(BrakeFiring {
            instants: [8.0, 11.0],
            is_certain: false
        })
    );
    assert_eq!(firing([0.0, 0.0], [0.0; 2], 0.0), None);
    // Both stand at a gap of 0 or less.
    assert_eq!(
        firing([0.0, 1.0], [0.0; 2], 0.0),
        Some(BrakeFiring {
            instants: [8.0, 11.0],
            is_certain: false
        })
    );
    assert_eq!(
        firing([-1.0, -0.5], [0.0; 2], 0.0),
        Some(BrakeFiring {
            instants: [8.0, 8.0],
            is_certain: true
        })
    );
    // The ego brakes at 1 m/s² from 10 m/s, and the guard falls by 0.2 m/s and more: at 8.1 m it is 0.1 m at first.
    assert_eq!(
        firing([8.1, 8.1], [10.0; 2], -1.0),
        Some(BrakeFiring {
            instants: [9.0, 9.0],
            is_certain: true
        })
    );
    assert_eq!(
        firing([8.1, 9.9], [10.0; 2], -1.0),
        Some(BrakeFiring {
            instants: [9.0, 11.0],
            is_certain: false
        })
    );
}

/// The smaller gap at the ends of a step less m h²/8.
#[test]
fn the_gap_to_a_modelled_follower_is_bounded_in_each_step() {
    let (controller, work) = (constant_controller(0.0), unlimited_budget());
    let ranges = point_box([50.0, 10.0, 20.0, 15.0, 20.0, 0.0, 6.0, 0.0]);
    let law = Some(FollowerModel::ByLaw(extreme_law(true)));
    let scene = ReachProblem {
        follower: law,
        decision_steps: 3,
        ..default_problem(&controller, ranges)
    };
    let analysis = ReachAnalysis::new(&scene, &work, None);
    let at_rest = |speed| VehicleState {
        speed,
        ..VehicleState::default()
    };
    let members = EgoSet::from_speed(point_form(15.0), SHARED_SYMBOLS)
        .with_follower(Some(at_rest(point_form(20.0))));
    let follow = |mps2: f64| {
        analysis
            .advance_follower(&members, &point_form(mps2))
            .unwrap()
    };
    for (mps2, m) in [(1.0, 7.0), (-2.0, 6.0)] {
        let DrivenFollower {
            state: follower,
            min_gap_m: least_m,
        } = follow(mps2);
        let gap = 10.0 - 5.0 * 0.3 + 0.5 * (mps2 + 6.0) * 0.09;
        assert!(
            (least_m - (gap - m * 0.01 / 8.0)).abs() < 1e-10,
            "{least_m}"
        );
        assert_bounds(
            follower.distance.range(),
            [20.0 * 0.3 - 3.0 * 0.09; 2],
            1e-10,
        );
        assert_bounds(follower.speed.range(), [20.0 - 1.8; 2], 1e-10);
    }
}

/// Checks the smaller gap at the decisions less m (D h)²/8, with the largest possible m.
#[test]
fn gaps_are_bounded_between_decisions() {
    let (controller, work) = (constant_controller(0.0), unlimited_budget());
    let mut ranges = point_box(DEFAULT_POINT);
    ranges.follower_brake_mps2 = Interval::new(5.0, 6.0).unwrap();
    let scene = ReachProblem {
        follower: LATCHED,
        decision_steps: 4,
        ..default_problem(&controller, ranges)
    };
    for (speed, acts, [ahead, behind]) in [
        (10.0, [-3.0, 2.0], [3.0, 8.0]),
        // It moves throughout, and so brakes throughout; or may have stopped.
        (10.0, [-3.0, -1.0], [3.0, 5.0]),
        (0.0, [-3.0, -1.0], [3.0, 6.0]),
        (10.0, [1.0, 2.0], [0.0, 8.0]),
        // It brakes harder than the follower.
        (10.0, [-9.0, -8.0], [9.0, 0.0]),
    ] {
        let mut analysis = ReachAnalysis::new(&scene, &work, None);
        let follower = analysis.latched_follower([2.0, 2.0]);
        let set = analysis.observe(
            0,
            EgoSet::from_speed(point_form(speed), SHARED_SYMBOLS),
            Some(&follower),
        );
        let now = StateSet {
            gaps: [point_form(7.0), point_form(4.0)],
            ..set
        };
        let before = [point_form(6.0), point_form(5.0)];
        let acts = AffineForm::constant(Interval::new(acts[0], acts[1]).unwrap());
        assert!(!analysis.record_gaps(0, &before, &now, &acts, Some(&follower), None));
        let expected = [6.0 - ahead * 0.02, 4.0 - behind * 0.02];
        for (actual, expected) in analysis.result.gaps_m.into_iter().zip(expected) {
            assert!((actual - expected).abs() < 1e-12, "{actual} {expected}");
        }
        assert_eq!(analysis.result.undecided, None);
    }
}

/// A gap of exactly 0 is undecided, no sure collision.
#[test]
fn a_gap_of_zero_is_undecided_and_no_certain_collision() {
    let (controller, work) = (constant_controller(0.0), unlimited_budget());
    let scene = default_problem(&controller, point_box([0.0; 8]));
    let mut analysis = ReachAnalysis::new(&scene, &work, None);
    let set = analysis.observe(
        0,
        EgoSet::from_speed(AffineForm::default(), SHARED_SYMBOLS),
        None,
    );
    let before = set.gaps.clone();
    assert!(!analysis.record_gaps(3, &before, &set, &AffineForm::default(), None, None));
    assert!(matches!(
        analysis.result.undecided,
        Some(Undecided::MayCollide {
            pair: 0,
            step: 3,
            gap_m: -1e-300..=0.0
        })
    ));
}

#[test]
fn too_many_windows_are_undecided() {
    let (controller, work) = (constant_controller(0.0), unlimited_budget());
    for (counts, goes_on) in [
        (&[MAX_WINDOWS][..], true),
        (&[MAX_WINDOWS + 1], false),
        (&[MAX_WINDOWS, 1], false),
    ] {
        let scene = ReachProblem {
            follower: LATCHED,
            ..default_problem(&controller, point_box(DEFAULT_POINT))
        };
        let mut analysis = ReachAnalysis::new(&scene, &work, None);
        let windows = |count: usize| {
            (0..count as u32)
                .map(|i| FiringWindow::new(1000 * i))
                .collect()
        };
        let all = counts
            .iter()
            .map(|&count| analysis.propagate_fired(windows(count)))
            .collect::<Option<Vec<bool>>>();
        assert_eq!(all.is_some(), goes_on);
        assert_eq!(
            matches!(
                analysis.result.undecided,
                Some(Undecided::TooManySets { .. })
            ),
            !goes_on
        );
    }
}

#[test]
fn too_many_firing_intervals_are_undecided() {
    let controller = constant_controller(0.0);
    let mut ranges = point_box([1e3, 2.0, 10.0, 10.0, 11.0, 0.0, 1.0, 0.0]);
    ranges.gap_behind_m = Interval::new(1.9, 3.0).unwrap();
    let most = MAX_INTERVALS as u32;
    // The steps are so short that hardly anything changes, and that many intervals merge into few windows.
    let problem_of = |steps| ReachProblem {
        step_s: 1e-5,
        steps,
        follower: LATCHED,
        stop_when_undecided: true,
        ..default_problem(&controller, ranges)
    };
    assert_eq!(
        reach(&problem_of(most + 1)).undecided,
        Some(Undecided::TooManySets { step: most })
    );
    assert_eq!(reach(&problem_of(most)).undecided, None);
}
