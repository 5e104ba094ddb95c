use proptest::prelude::*;

use super::super::fixtures::{assert_bounds, interval, symbol_form};
use super::*;

const STEP_S: f64 = 0.1;

fn braking_vehicle(speeds: [f64; 2], rates: [f64; 2], onsets: [f64; 2]) -> BrakingVehicle {
    let form = |symbol, [low, high]: [f64; 2]| symbol_form(symbol, low, high);
    let onset_range = interval(onsets[0], onsets[1]);
    BrakingVehicle::new(
        form(0, speeds),
        form(1, rates),
        form(2, onsets),
        onset_range,
        Interval::point(STEP_S),
    )
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn members_have_stood_one_step_after_the_last_stop(
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
    fn a_single_vehicle_moves_by_the_closed_form(
        v in 0.1..30.0_f64, b in 0.5..9.0_f64, onset in 0..40_u32, k in 0..120_u32,
    ) {
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
fn the_observed_acceleration_is_exact_after_a_full_step_of_braking() {
    let step = Interval::point(STEP_S);
    let braking = braking_vehicle([20.0, 21.0], [5.0, 6.0], [2.0, 5.0]);
    assert_eq!(
        braking.state_at(6, step).acceleration,
        braking.rate.scaled(Interval::point(-1.0))
    );
    assert_bounds(
        braking.state_at(5, step).acceleration.range(),
        [-6.0, 0.0],
        1e-10,
    );
    assert!(braking.state_at(2, step).acceleration.is_zero());
}
