use proptest::prelude::*;

use super::super::fixtures::{assert_bounds, interval, symbol_form};
use super::*;

const STEP_S: f64 = 0.1;

fn braking_vehicle(speeds: [f64; 2], rates: [f64; 2], onsets: [f64; 2]) -> BrakingVehicle {
    let form = |symbol, [low, high]: [f64; 2]| symbol_form(symbol, low, high);
    let onset_range = interval(onsets[0], onsets[1]);
    BrakingVehicle::new(form(0, speeds), form(1, rates), form(2, onsets), onset_range, Interval::point(STEP_S))
}

proptest! {
    #[test]
    fn all_have_stood_a_step_after_the_last_has_stopped(
        v in 0.0..30.0_f64, b in 0.5..9.0_f64, onset in 0.0..60.0_f64, widths in prop::array::uniform3(0.0..3.0_f64),
    ) {
        let braking = braking_vehicle([v, v + widths[0]], [b, b + widths[1]], [onset, onset + widths[2]]);
        let last = 1.0 + onset + widths[2] + (v + widths[0]) / (b * STEP_S);
        let has_stood = |k: f64| braking.has_stood(k as u32, Interval::point(STEP_S));
        prop_assume!((last - last.round()).abs() > 1e-6);
        prop_assert!(has_stood(last.ceil()) && has_stood(last.ceil() + 50.0));
        prop_assert!(!has_stood(last.floor()) && !has_stood((last / 2.0).floor()) && !has_stood(0.0));
    }

    #[test]
    fn one_vehicle_is_at_the_closed_form(v in 0.1..30.0_f64, b in 0.5..9.0_f64, onset in 0..40_u32, k in 0..120_u32) {
        let VehicleState { distance, speed, acceleration } =
            braking_vehicle([v; 2], [b; 2], [f64::from(onset); 2]).state_at(k, Interval::point(STEP_S));
        let [until, since] = [f64::from(k.min(onset)) * STEP_S, f64::from(k.saturating_sub(onset)) * STEP_S];
        let stops = v / b;
        prop_assume!((since - stops).abs() > 1e-6 && (since - STEP_S - stops).abs() > 1e-6);
        let moving = since.min(stops);
        let slack = 1e-11 * (1.0 + v) * (1.0 + v) * (2.0 + until + since) * (1.0 + b);
        assert_bounds(distance.range(), [v * until + v * moving - 0.5 * b * moving * moving; 2], slack);
        assert_bounds(speed.range(), [v - b * moving; 2], slack);
        // In the step in which it stops it may be observed at any braking.
        let most = if since > stops { 0.0 } else { -b };
        let expected = if since == 0.0 || since - STEP_S > stops { [0.0; 2] } else { [-b, most] };
        assert_bounds(acceleration.range(), expected, slack);
    }
}

/// A member that brakes for the whole step is observed at its rate; otherwise at any value.
#[test]
fn members_that_brake_in_the_whole_step_before_are_seen_to_brake() {
    let step = Interval::point(STEP_S);
    let braking = braking_vehicle([20.0, 21.0], [5.0, 6.0], [2.0, 5.0]);
    assert_eq!(braking.state_at(6, step).acceleration, braking.rate.scaled(Interval::point(-1.0)));
    assert_bounds(braking.state_at(5, step).acceleration.range(), [-6.0, 0.0], 1e-10);
    assert!(braking.state_at(2, step).acceleration.is_zero());
}

proptest! {
    /// Checks that one alternative is each member's acceleration. A single vehicle that brakes from an instant on has
    /// one, but for the step in which it stops.
    #[test]
    fn every_member_belongs_to_one_case(
        v in prop_oneof![1 => Just(0.0), 6 => 0.1..30.0_f64], b in 0.5..9.0_f64, from in 0.0..40.0_f64, k in 0..120_u32,
        widths in prop::array::uniform3(0.0..3.0_f64), places in prop::array::uniform3(0.0..=1.0_f64),
    ) {
        let at = |i: usize, low: f64| low + places[i] * widths[i];
        let (speed, rate, begins) = (at(0, v), at(1, b), at(2, from));
        let braking = braking_vehicle([v, v + widths[0]], [b, b + widths[1]], [from, from + widths[2]]);
        let share = (f64::from(k) - begins).clamp(0.0, 1.0);
        let a_step_ago = speed - rate * (f64::from(k) - 1.0 - begins).max(0.0) * STEP_S;
        prop_assume!(k > 0 && a_step_ago.abs() > 1e-9 || speed == 0.0);
        let seen = if a_step_ago > 0.0 { -rate * share } else { 0.0 };
        let all = braking.possible_accelerations(k, Interval::point(STEP_S));
        let holds = |form: &AffineForm| form.range().low() <= seen + 1e-9 && seen - 1e-9 <= form.range().high();
        prop_assert!(all.iter().any(holds), "{seen} {all:?}");
        prop_assert!(all.len() <= 3);
    }
}

#[test]
fn the_cases_are_complete() {
    let step = Interval::point(STEP_S);
    let mut braking = braking_vehicle([20.0, 21.0], [5.0, 6.0], [2.0, 5.5]);
    let ranges = |braking: &BrakingVehicle, k| {
        braking.possible_accelerations(k, step).iter().map(AffineForm::range).collect::<Vec<_>>()
    };
    assert_eq!(ranges(&braking, 1), [Interval::ZERO]);
    let three = ranges(&braking, 4);
    assert_eq!(three.len(), 3);
    assert_eq!(three[0], Interval::ZERO);
    assert_bounds(three[1], [-6.0, 0.0], 1e-10);
    assert_bounds(three[2], [-6.0, -5.0], 1e-10);
    assert_eq!(ranges(&braking, 7).len(), 1);
    braking.onset_step_error_m = Interval::ZERO;
    assert_eq!(ranges(&braking, 4).len(), 2);
}

#[test]
fn cases_begin_at_the_right_time() {
    let step = Interval::point(STEP_S);
    // Begins to brake at instant 2.5, and stands after 10 steps of braking: at 12.5.
    let braking = braking_vehicle([5.0; 2], [5.0; 2], [2.5; 2]);
    let seen = |k| {
        let all = braking.possible_accelerations(k, step);
        all.iter().map(|form| form.centre().round()).collect::<Vec<_>>()
    };
    for (k, expected) in [(2, &[0.0][..]), (3, &[-3.0]), (4, &[-5.0]), (12, &[-5.0]), (13, &[-5.0]), (14, &[0.0])] {
        assert_eq!(seen(k), expected, "at {k}");
    }
}
