//! Fixtures for tests of several modules.

use super::form::AffineForm;
use super::{ControllerInput, InitialRanges, NeuralController, OBSERVATION_SIZE, ReachProblem};
use crate::interval::Interval;

pub(super) fn interval(low: f64, high: f64) -> Interval {
    Interval::new(low, high).unwrap()
}

pub(super) fn point_form(number: f64) -> AffineForm {
    AffineForm::constant(Interval::point(number))
}

pub(super) fn symbol_form(symbol: usize, low: f64, high: f64) -> AffineForm {
    AffineForm::symbol(symbol, interval(low, high))
}

/// Asserts that bounds enclose the expected ones by at most `slack`.
#[track_caller]
pub(super) fn assert_bounds(actual: Interval, [low, high]: [f64; 2], slack: f64) {
    let is_near = actual.low() >= low - slack && actual.high() <= high + slack;
    let holds = actual.low() <= low + slack * 1e-3 && actual.high() >= high - slack * 1e-3;
    assert!(is_near && holds, "{actual:?} for {low} to {high}");
}

pub(super) fn is_near(actual: f64, expected: f64, relative: f64) -> bool {
    (actual - expected).abs() <= relative * expected.abs()
}

pub(super) fn affine_input(weights: [f64; OBSERVATION_SIZE], constant: f64) -> ControllerInput {
    ControllerInput {
        coefficients: weights,
        constant,
        absent_value: None,
        offset: 0.0,
        scale: 1.0,
        low: -1e9,
        high: 1e9,
    }
}

/// Creates a controller without a network that commands an affine function of its observation.
pub(super) fn affine_controller(
    weights: [f64; OBSERVATION_SIZE],
    constant: f64,
) -> NeuralController {
    NeuralController {
        inputs: vec![affine_input(weights, constant)],
        layers: Vec::new(),
        output_index: 0,
        scale_mps2: 1.0,
        offset_mps2: 0.0,
        action_bounds_mps2: [-8.0, 3.0],
        is_clipped: false,
        empty_gap_m: 80.0,
        decision_interval_s: 0.1,
        source: None,
    }
}

pub(super) fn constant_controller(mps2: f64) -> NeuralController {
    affine_controller([0.0; OBSERVATION_SIZE], mps2)
}

pub(super) fn point_box(point: [f64; 8]) -> InitialRanges {
    let [
        ahead,
        behind,
        leader,
        ego,
        follower,
        leader_brake,
        follower_brake,
        onset,
    ] = point.map(Interval::point);
    InitialRanges {
        gap_ahead_m: ahead,
        gap_behind_m: behind,
        leader_speed_mps: leader,
        ego_speed_mps: ego,
        follower_speed_mps: follower,
        leader_brake_mps2: leader_brake,
        follower_brake_mps2: follower_brake,
        onset_steps: onset,
    }
}

/// Creates a problem of one second in steps of 0.1 s, with a decision at each, no follower, and exact observations.
pub(super) fn default_problem(
    controller: &NeuralController,
    ranges: InitialRanges,
) -> ReachProblem<'_> {
    ReachProblem {
        controller,
        ranges,
        follower: None,
        leader_brakes_at_most_mps2: None,
        observation_error: [0.0; OBSERVATION_SIZE],
        step_s: 0.1,
        steps: 10,
        decision_steps: 1,
        stop_when_undecided: false,
    }
}
