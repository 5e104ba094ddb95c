use proptest::prelude::*;

use super::super::BoxDimension;
use super::super::fixtures::{
    assert_bounds, constant_controller, default_problem, interval, point_box, symbol_form,
};
use super::super::propagate::ReachProblem;
use super::*;

const STEP_S: f64 = 0.1;

fn leader(speeds: [f64; 2], limit_mps2: f64, steps: u32, decision_steps: u32) -> LeaderModel {
    let controller = constant_controller(0.0);
    let mut ranges = point_box([20.0; 8]);
    ranges.leader_speed_mps = interval(speeds[0], speeds[1]);
    let scene = ReachProblem {
        leader_brakes_at_most_mps2: Some(limit_mps2),
        step_s: STEP_S,
        steps,
        decision_steps,
        ..default_problem(&controller, ranges)
    };
    let speed = AffineForm::symbol(
        BoxDimension::LeaderSpeedMps as usize,
        ranges.leader_speed_mps,
    );
    LeaderModel::new(
        &scene,
        [speed, AffineForm::default(), AffineForm::default()],
        Interval::point(STEP_S),
    )
}

fn relu_range([low, high]: [f64; 2]) -> [f64; 2] {
    if low >= 0.0 {
        [low, high]
    } else {
        [low * high / (high - low), high.max(0.0)]
    }
}

fn braking_motion(v: f64, b: f64, t: f64) -> (f64, f64) {
    if b * t <= v {
        (v * t - 0.5 * b * t * t, v - b * t)
    } else {
        (v * v / (2.0 * b), 0.0)
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// Checks that speed and distance have exactly the module's bounds, cut at standstill and at the shortest stopping
    /// distance.
    #[test]
    fn forms_contain_every_leader_within_the_limit(
        v0 in 0.5..30.0_f64, width in 0.1..5.0_f64, b in 0.5..9.0_f64, every in 1..8_u32, decisions in 1..12_u32,
        at in 0..110_u32,
    ) {
        // Includes instants after the end, without correlations.
        let (steps, k) = (every * decisions, at % (every * decisions + 4));
        let (v1, leader) = (v0 + width, leader([v0, v0 + width], b, steps, every));
        let VehicleState { distance, speed, acceleration } = leader.state_at(k, Interval::point(STEP_S));
        let t = f64::from(k) * STEP_S;
        if k == 0 {
            prop_assert!(distance.is_zero() && acceleration.is_zero());
            prop_assert_eq!(speed, symbol_form(BoxDimension::LeaderSpeedMps as usize, v0, v1));
            return Ok(());
        }
        assert_bounds(acceleration.range(), [-b, 0.0], 1e-10);
        let slack = 1e-11 * (1.0 + v1 + b * t) * (1.0 + t);
        assert_bounds(speed.range(), relu_range([v0 - b * t, v1]), slack);
        // One e for every whole block.
        let early = f64::from((k / every).min(decisions)) * b * (f64::from(every) * STEP_S).powi(2) / 8.0;
        let least = braking_motion(v0, b, t).0;
        let free = [v0 * t - 0.5 * b * t * t - early, v1 * t + early];
        let [low, high] = relu_range(free.map(|end| end - least));
        assert_bounds(distance.range(), [least + low, least + high], slack);
        // Three braking patterns: always, never, or from the middle on.
        let (stopping, later) = (braking_motion(v0, b, 0.5 * t), braking_motion(v1, b, 0.5 * t));
        let later = (0.5 * v1 * t + later.0, later.1);
        for (covered, then) in [braking_motion(v0, b, t), (v1 * t, v1), later, then_coast(stopping, t)] {
            prop_assert!(distance.range().low() - slack <= covered && covered <= distance.range().high() + slack);
            prop_assert!(speed.range().low() - slack <= then && then <= speed.range().high() + slack);
        }
        let symbols = leader.symbol_count();
        prop_assert_eq!(symbols, 2 * decisions as usize);
        prop_assert!(distance.terms().len().max(speed.terms().len()) <= SHARED_SYMBOLS + symbols);
        prop_assert!(!leader.has_stood(k, Interval::point(STEP_S)));
    }
}

fn then_coast((covered, speed): (f64, f64), t: f64) -> (f64, f64) {
    (covered + 0.5 * speed * t, speed)
}

#[test]
fn a_leader_that_stands_stays() {
    let leader = leader([0.0, 0.0], 6.0, 20, 2);
    for k in [0, 1, 2, 7, 20] {
        let VehicleState {
            distance,
            speed,
            acceleration,
        } = leader.state_at(k, Interval::point(STEP_S));
        assert!(distance.is_zero() && acceleration.is_zero() && speed.range().contains(0.0));
        assert!(leader.has_stood(k, Interval::point(STEP_S)));
    }
}

/// Blocks limit the number of symbols; inside one the acceleration is arbitrary.
#[test]
fn blocks_limit_the_number_of_symbols() {
    for (decisions, blocks) in [(200, 200), (201, 101), (400, 200), (401, 134)] {
        assert_eq!(
            leader([10.0, 11.0], 6.0, 3 * decisions, 3).symbol_count(),
            2 * blocks
        );
    }
    assert_eq!(leader([10.0, 11.0], 0.0, 300, 3).symbol_count(), 0);
}
