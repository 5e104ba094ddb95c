//! Results of the paper, and those of further controllers.

use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{
    AfterCollision, Outcome, RecordingLevel, Run, RunOptions, SimulationResult, simulate,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Scenario, built_in_scenario};

const PAPER_SCENARIOS: [&str; 3] = ["paper-1", "paper-2", "paper-3"];

fn scenario(name: &str) -> Scenario {
    built_in_scenario(name).expect("built in")
}

fn options(controller: &str, estimator: EstimatorKind) -> RunOptions {
    RunOptions::new(BuiltInController::from_name(controller).expect("built in"))
        .with_estimator(estimator)
}

fn run(scenario: &Scenario, options: RunOptions) -> SimulationResult {
    simulate(
        &Run::new(scenario, options).expect("fits"),
        RecordingLevel::Summary,
    )
}

fn run_with_truth(name: &str, controller: &str) -> SimulationResult {
    run(&scenario(name), options(controller, EstimatorKind::Truth))
}

fn assert_near(actual: f64, expected: f64, tolerance: f64, what: &str) {
    assert!(
        (actual - expected).abs() <= tolerance,
        "{what}: {actual}, expected {expected} ± {tolerance}"
    );
}

fn assert_hit_from_behind(
    name: &str,
    time_s: f64,
    [ego_mps, follower_mps]: [f64; 2],
) -> SimulationResult {
    let result = run_with_truth(name, "baseline");
    let collision = result.outcome.collision().expect("a rear collision");
    assert_eq!((collision.front_vehicle, collision.rear_vehicle), (1, 2));
    assert_near(collision.time_s, time_s, 0.02, "time of the collision");
    assert_near(collision.front_speed_mps, ego_mps, 0.1, "speed of the ego");
    assert_near(
        collision.rear_speed_mps,
        follower_mps,
        0.1,
        "speed of the follower",
    );
    result
}

/// Scenario 1: the ego brakes in time for the leader and the heavy follower hits it, at 17.5 against 7.4 m/s.
#[test]
fn the_baseline_is_hit_from_behind_by_a_heavy_follower() {
    let result = assert_hit_from_behind("paper-1", 5.50, [7.4, 17.5]);
    assert_near(
        result.vehicles[1].min_gap_m.unwrap(),
        4.34,
        0.05,
        "smallest front gap",
    );
}

/// Scenario 2: a light follower hits it, at 14.6 against 6.3 m/s.
#[test]
fn the_baseline_is_hit_from_behind_by_a_light_follower() {
    let result = assert_hit_from_behind("paper-2", 5.64, [6.3, 14.6]);
    assert!(
        result.vehicles[1].min_gap_m.unwrap() > 0.0,
        "no collision in front"
    );
}

/// Scenario 3: the first two of three middle vehicles collide first, then a counted pile-up follows.
#[test]
fn three_middle_vehicles_pile_up() {
    let first = run_with_truth("paper-3", "baseline").outcome;
    let collision = first.collision().expect("a collision");
    assert_eq!((collision.front_vehicle, collision.rear_vehicle), (1, 2));
    assert_near(collision.time_s, 5.64, 0.02, "time of the first collision");
    let going_on =
        options("baseline", EstimatorKind::Truth).with_after_collision(AfterCollision::Continue);
    let pile_up = run(&scenario("paper-3"), going_on);
    assert_eq!(
        pile_up.outcome, first,
        "going on does not change the first collision"
    );
    assert!(pile_up.impacts.len() > 1, "it grows: {:?}", pile_up.impacts);
    assert_eq!(
        pile_up.vehicles_involved(),
        5,
        "the heavy one pushes the others into the leader"
    );
    assert!(
        pile_up
            .impacts
            .windows(2)
            .all(|pair| pair[0].collision.time_s <= pair[1].collision.time_s)
    );
    let heaviest = pile_up
        .impacts
        .iter()
        .map(|impact| impact.delta_v_mps(3))
        .fold(0.0, f64::max);
    assert!(
        heaviest > 5.0,
        "the truck pushes the last of them hard: {heaviest} m/s"
    );
}

/// Two trivial controllers avoid all three collisions, with the Kalman filter too.
#[test]
fn trivial_controllers_avoid_all_three() {
    for name in PAPER_SCENARIOS {
        for controller in ["match-leader", "constant-brake"] {
            for estimator in [EstimatorKind::Truth, EstimatorKind::Kalman] {
                let result = run(&scenario(name), options(controller, estimator));
                assert_eq!(
                    result.outcome,
                    Outcome::NoCollision,
                    "{name} {controller} {estimator:?}"
                );
            }
        }
    }
}

/// An emergency brake without a latch chatters (it brakes and releases repeatedly) and barely avoids a collision in
/// scenario 2.
#[test]
fn the_unlatched_baseline_chatters_and_scrapes_through_scenario_2() {
    let scenario = scenario("paper-2");
    let run = Run::new(
        &scenario,
        options("baseline-unlatched", EstimatorKind::Truth),
    )
    .unwrap();
    let result = simulate(&run, RecordingLevel::Trace);
    assert_eq!(result.outcome, Outcome::NoCollision);
    let closest = result.vehicles[1].min_gap_m.unwrap();
    assert!(
        (0.0..0.1).contains(&closest),
        "scrapes through: {closest} m"
    );
    let ego = &result.trace.as_ref().unwrap().vehicles[1].acceleration_mps2;
    let releases = ego
        .windows(2)
        .filter(|pair| pair[0] == -7.5 && pair[1] == 0.0)
        .count();
    assert!(releases > 10, "chatters: lets go {releases} times");
}

/// For every controller, both estimators and both behaviours after a collision, a step of 1 ms instead of 10 ms changes
/// no verdict, and no collision by more than 1 ms.
#[test]
fn the_integration_step_decides_nothing() {
    for name in PAPER_SCENARIOS {
        for controller in BuiltInController::all() {
            for estimator in [EstimatorKind::Truth, EstimatorKind::Kalman] {
                for after_collision in [AfterCollision::Stop, AfterCollision::Continue] {
                    let options =
                        options(controller.name(), estimator).with_after_collision(after_collision);
                    let [coarse, fine] = [0.01, 0.001]
                        .map(|dt_s| run(&scenario(name), options.clone().with_dt_s(dt_s)).impacts);
                    let what = format!(
                        "{name} {} {estimator:?} {after_collision:?}",
                        controller.name()
                    );
                    assert_eq!(coarse.len(), fine.len(), "{what}");
                    for (coarse, fine) in coarse.iter().zip(&fine) {
                        assert_eq!(
                            coarse.collision.rear_vehicle, fine.collision.rear_vehicle,
                            "{what}"
                        );
                        // This brake is released and fires again, each time at a decision.
                        let tolerance_s = if controller.name() == "emergency-brake" {
                            0.02
                        } else {
                            1e-3
                        };
                        assert_near(
                            coarse.collision.time_s,
                            fine.collision.time_s,
                            tolerance_s,
                            &what,
                        );
                    }
                }
            }
        }
    }
}

/// Scenario 1 from the paper's text alone: explicit Euler at 10 µs, with a decision every 10 ms.
#[test]
fn an_independent_simulation_of_scenario_1_agrees() {
    const DT: f64 = 1e-5;
    let (mut x, mut v) = ([36.0, 18.0, 0.0], [25.0_f64; 3]);
    let (length, strongest) = ([2.0, 2.0, 15.0], [3.0, 7.5, 6.0]);
    let mut braking = [false; 3];
    let mut smallest_front_gap = f64::INFINITY;
    let mut collision_s = None;
    for k in 0..1_500_000 {
        if k % 1000 == 0 {
            braking[0] |= k >= 100_000;
            for i in [1, 2] {
                let gap = x[i - 1] - length[i - 1] - x[i];
                braking[i] |= v[i] > v[i - 1] && gap / (v[i] - v[i - 1]) < 1.4;
            }
        }
        for i in 0..3 {
            x[i] += v[i] * DT;
            if braking[i] {
                v[i] = (v[i] - strongest[i] * DT).max(0.0);
            }
        }
        smallest_front_gap = f64::min(smallest_front_gap, x[0] - length[0] - x[1]);
        if x[1] - length[1] - x[2] <= 0.0 {
            collision_s = Some((k + 1) as f64 * DT);
            break;
        }
    }
    let result = run_with_truth("paper-1", "baseline");
    assert_near(
        result.outcome.collision().unwrap().time_s,
        collision_s.expect("a collision"),
        1e-3,
        "time of the collision",
    );
    assert_near(
        result.vehicles[1].min_gap_m.unwrap(),
        smallest_front_gap,
        1e-3,
        "smallest front gap",
    );
}
