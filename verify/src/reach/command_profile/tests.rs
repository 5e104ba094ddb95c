use proptest::prelude::*;

use super::super::ego_set::SHARED_SYMBOLS;
use super::super::fixtures::{assert_bounds, point_form, symbol_form};
use super::*;

const STEP_S: f64 = 0.1;

fn state_with_speed(speed: AffineForm) -> VehicleState {
    VehicleState { speed, ..VehicleState::default() }
}

/// Returns distance and speed after one acceleration per step, without reversing.
fn simulate_rates(mut v: f64, rates: &[f64]) -> (f64, f64) {
    let mut x = 0.0;
    for &a in rates {
        let end = v + a * STEP_S;
        x += if end < 0.0 { if v > 0.0 { v * v / (-2.0 * a) } else { 0.0 } } else { 0.5 * (v + end) * STEP_S };
        v = end.max(0.0);
    }
    (x, v)
}

proptest! {
    /// Checks every member at each step, through stops and starts, and its observed acceleration at the next decision.
    #[test]
    fn every_member_is_where_the_set_has_it(
        v in prop_oneof![1 => Just(0.0), 4 => 0.0..3.0_f64], width in 0.0..0.5_f64, place in 0.0..=1.0_f64,
        rates in prop::collection::vec(prop_oneof![-7.5..3.0_f64, -0.5..0.5_f64], 1..8),
    ) {
        let step = Interval::point(STEP_S);
        let members = EgoSet::from_speed(symbol_form(0, v, v + width), SHARED_SYMBOLS);
        let steps = rates.len() as u32;
        let profile = CommandProfile::from_steps(&members.ego, steps, step, |j, _| point_form(rates[j as usize]));
        let start = v + place * width;
        for j in 0..=rates.len() {
            let ego = profile.ego_after(&members, step, j as u32);
            let (x, v) = simulate_rates(start, &rates[..j]);
            for (form, truth) in [(ego.distance, x), (ego.speed, v)] {
                let range = form.range();
                prop_assert!(range.low() <= truth + 1e-12 && truth - 1e-12 <= range.high(), "{truth} {range:?} at \
                    step {j}");
            }
        }
        let (x, end) = simulate_rates(start, &rates);
        let (_, before) = simulate_rates(start, &rates[..rates.len() - 1]);
        let last = rates[rates.len() - 1];
        let observed = if before == 0.0 && last <= 0.0 { 0.0 } else { last };
        let holds = |form: &AffineForm, x: f64| form.range().low() <= x + 1e-12 && x - 1e-12 <= form.range().high();
        let is_in = |next: &EgoSet| {
            let VehicleState { distance, speed, acceleration } = &next.ego;
            holds(distance, x) && holds(speed, end) && holds(acceleration, observed)
        };
        let next = profile.after_decision(&members, step, steps);
        prop_assert!(next.iter().flatten().any(is_in), "{x} {end} {observed} {next:?}");
        let acts = profile.accelerations_mps2();
        prop_assert!(rates.iter().all(|rate| acts.low() <= *rate && *rate <= acts.high()));
    }
}

/// Checks that a single member loses nothing, and never falls below the speed of one reversing step.
#[test]
fn one_moving_member_is_at_the_formula() {
    let step = Interval::point(STEP_S);
    let rates = [-1.0, 0.5, -2.0, 1.0];
    let profile =
        CommandProfile::from_steps(&state_with_speed(point_form(5.0)), 4, step, |j, _| point_form(rates[j as usize]));
    let members = EgoSet::from_speed(point_form(5.0), SHARED_SYMBOLS);
    let ego = profile.ego_after(&members, step, 4);
    let (x, v) = simulate_rates(5.0, &rates);
    assert_bounds(ego.distance.range(), [x; 2], 1e-12);
    assert_bounds(ego.speed.range(), [v; 2], 1e-12);
    assert!(profile.is_moving_throughout(&ego.speed));
    let stops = CommandProfile::from_steps(&state_with_speed(point_form(0.1)), 2, step, |j, _| {
        point_form([-3.0, 3.0][j as usize])
    });
    assert!(!stops.is_moving_throughout(&point_form(0.3)));
}

#[test]
fn a_standing_vehicle_without_a_command_stands() {
    let step = Interval::point(STEP_S);
    let of = |rates: [f64; 2]| {
        CommandProfile::from_steps(&state_with_speed(AffineForm::default()), 2, step, |j, _| {
            point_form(rates[j as usize])
        })
    };
    assert!(
        of([-1.0, 0.0]).is_standing_throughout(MotionMode::Standing)
            && !of([-1.0, 0.0]).is_standing_throughout(MotionMode::Moving)
    );
    assert!(!of([0.5, -1.0]).is_standing_throughout(MotionMode::Standing));
}

#[test]
fn a_restart_within_an_interval_is_recorded() {
    let step = Interval::point(STEP_S);
    let standing = EgoSet::from_speed(AffineForm::default(), SHARED_SYMBOLS);
    assert_eq!(standing.mode, MotionMode::Standing);
    for (rates, kinds) in [
        ([1.0, 0.5], [Some(MotionMode::Restarted), None]),
        ([1.0, -0.5], [Some(MotionMode::Restarted), None]),
        ([-1.0, 0.5], [Some(MotionMode::Restarted), None]),
        ([-1.0, -0.5], [Some(MotionMode::Standing), None]),
    ] {
        let profile = CommandProfile::from_steps(&standing.ego, 2, step, |j, _| point_form(rates[j as usize]));
        let next = profile.after_decision(&standing, step, 2);
        assert_eq!(next.each_ref().map(|members| members.as_ref().map(|members| members.mode)), kinds, "{rates:?}");
        assert_eq!(profile.is_standing_throughout(MotionMode::Standing), rates[0] < 0.0 && rates[1] < 0.0);
    }
}

/// Stopping in a step adds at most the reversed distance: half of b h for h.
#[test]
fn a_step_in_which_some_stop_is_bounded_by_the_reversing_members() {
    let (step, brake) = (Interval::point(STEP_S), 3.0);
    let profile =
        CommandProfile::from_steps(&state_with_speed(symbol_form(0, 0.1, 0.5)), 1, step, |_, _| point_form(-brake));
    let members = EgoSet::from_speed(symbol_form(0, 0.1, 0.5), SHARED_SYMBOLS);
    let VehicleState { distance, speed, .. } = profile.ego_after(&members, step, 1);
    let free = [0.1, 0.5].map(|v| v * STEP_S - 0.5 * brake * STEP_S * STEP_S);
    assert_bounds(distance.range(), [free[0], free[1] + 0.5 * 0.2 * STEP_S], 1e-12);
    // The line of the ReLU from -0.2 to 0.2 m/s: half of both, and a tenth.
    assert_bounds(speed.range(), [-0.1, 0.2], 1e-12);
}
