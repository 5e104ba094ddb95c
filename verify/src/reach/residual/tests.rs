use proptest::prelude::*;

use super::super::fixtures::{assert_bounds, point_form, symbol_form};
use super::*;

const BOUNDS_MPS2: [f64; 2] = [-7.5, 3.0];
const IDM: IdmLaw = IdmLaw {
    desired_speed_mps: 30.0,
    time_headway_s: 1.3,
    standstill_gap_m: 2.0,
    accel_mps2: 0.73,
    comfortable_brake_mps2: 1.67,
    max_accel_mps2: BOUNDS_MPS2[1],
};

fn residual_policy(dead_zone: f64) -> ResidualPolicy {
    ResidualPolicy { dead_zone, rate_per_s: 1000.0, idm: IDM }
}

/// Returns the command of the law, clipped to the bounds.
fn law_acceleration([gap, v, w]: [f64; 3]) -> f64 {
    let mean = (IDM.accel_mps2 * IDM.comfortable_brake_mps2).sqrt();
    let wants = IDM.standstill_gap_m + (v * IDM.time_headway_s + v * (v - w) / (2.0 * mean)).max(0.0);
    let (free, share) = ((v / IDM.desired_speed_mps).powi(4), wants / gap);
    (IDM.accel_mps2 * (1.0 - free - share * share)).clamp(BOUNDS_MPS2[0], BOUNDS_MPS2[1])
}

fn expected_acceleration(dead_zone: f64, action: f64, seen: [f64; 3]) -> f64 {
    let share = ((action.abs() - dead_zone) / (1.0 - dead_zone)).max(0.0);
    (1.0 - share) * law_acceleration(seen) + share * if action < 0.0 { BOUNDS_MPS2[0] } else { BOUNDS_MPS2[1] }
}

fn enclose_acceleration(residual: &ResidualPolicy, action: &AffineForm, [gap, v, w]: [AffineForm; 3]) -> AffineForm {
    let closing = v.clone().minus(&w);
    residual.acceleration(
        &Residual::new(residual, action, BOUNDS_MPS2),
        &LawInput::with_errors([gap, v, closing], [0.0; 3]),
    )
}

proptest! {
    /// One action and one input give the formula, but for the observation rounding of 10⁻⁹.
    #[test]
    fn of_one_action_it_is_the_formula(
        zone in 0.0..0.9_f64, action in -1.0..=1.0_f64, seen in (3.0..60.0_f64, 0.0..30.0_f64, 0.0..30.0_f64),
    ) {
        let (seen, residual) = ([seen.0, seen.1, seen.2], residual_policy(zone));
        let form = enclose_acceleration(&residual, &point_form(action), seen.map(point_form));
        assert_bounds(form.range(), [expected_acceleration(zone, action, seen); 2], 1e-5);
    }

    /// The enclosure of a box holds each member, and does not exceed the ranges of law and action.
    #[test]
    fn of_a_box_it_holds_every_member(
        zone in 0.0..0.9_f64, ends in prop::array::uniform2(-1.0..=1.0_f64), gap in 3.0..60.0_f64, v in 1.0..29.0_f64,
        w in 0.0..30.0_f64, widths in prop::array::uniform3(0.0..5.0_f64),
        places in prop::array::uniform4(0.0..=1.0_f64),
    ) {
        let ends = [ends[0].min(ends[1]), ends[0].max(ends[1])];
        let from = [[gap, gap + widths[0]], [v, v + widths[1]], [w, w + widths[2]]];
        let forms = std::array::from_fn(|i| symbol_form(i, from[i][0], from[i][1]));
        let form = enclose_acceleration(&residual_policy(zone), &symbol_form(3, ends[0], ends[1]), forms);
        let at = |[low, high]: [f64; 2], place: f64| low + place * (high - low);
        let seen = std::array::from_fn(|i| at(from[i], places[i]));
        let truth = expected_acceleration(zone, at(ends, places[3]), seen);
        let value = form.centre() + form.terms().iter().zip(places).map(|(t, p)| t * (2.0 * p - 1.0)).sum::<f64>();
        prop_assert!((truth - value).abs() <= form.rest() + 1e-9, "{truth} {value} {form:?}");
        prop_assert!(form.radius() < 12.0, "{form:?}");
    }
}

/// Within the dead zone only the law counts and keeps its correlations; at full action only the bound.
#[test]
fn the_dead_zone_gives_the_base_controller_and_the_end_the_bound() {
    let seen = [symbol_form(0, 20.0, 20.1), symbol_form(1, 14.0, 14.1), point_form(15.0)];
    let calm = enclose_acceleration(&residual_policy(0.4), &symbol_form(3, -0.39, 0.39), seen.clone());
    assert!(calm.terms()[..2].iter().all(|&term| term != 0.0) && calm.terms().get(3).is_none_or(|&term| term == 0.0));
    assert_bounds(calm.range(), [law_acceleration([20.0, 14.1, 15.0]), law_acceleration([20.1, 14.0, 15.0])], 1e-2);
    for (action, bound_mps2) in [(-1.0, BOUNDS_MPS2[0]), (1.0, BOUNDS_MPS2[1])] {
        assert_bounds(
            enclose_acceleration(&residual_policy(0.4), &point_form(action), seen.clone()).range(),
            [bound_mps2; 2],
            1e-9,
        );
    }
}

/// The gap may be near zero, so the interval replaces the form.
#[test]
fn arbitrary_actions_stay_within_the_bounds() {
    let seen = [symbol_form(0, -1.0, 30.0), point_form(10.0), point_form(10.0)];
    let range = enclose_acceleration(&residual_policy(0.3), &symbol_form(3, -1.0, 1.0), seen).range();
    assert!(range.low() >= -7.5 - 1e-9 && range.high() <= 3.0 + 1e-9, "{range:?}");
}

#[test]
fn numbers_outside_the_ranges_of_the_simulator_are_refused() {
    let of = |dead_zone, rate_per_s, idm| ResidualPolicy { dead_zone, rate_per_s, idm }.check();
    for (zone, rate) in [(0.0, 0.1), (0.99, 1000.0)] {
        assert_eq!(of(zone, rate, IDM), Ok(()));
    }
    let wrong = [
        (of(-0.1, 1.0, IDM), "dead_zone: -0.1"),
        (of(f64::NAN, 1.0, IDM), "dead_zone: NaN"),
        (of(0.5, 0.09, IDM), "rate_per_s: 0.09"),
        (of(0.5, 1.0, IdmLaw { desired_speed_mps: 0.0, ..IDM }), "desired_speed_mps: 0"),
        (of(0.5, 1.0, IdmLaw { time_headway_s: -1.0, ..IDM }), "time_headway_s: -1"),
        (of(0.5, 1.0, IdmLaw { standstill_gap_m: 101.0, ..IDM }), "standstill_gap_m: 101"),
        (of(0.5, 1.0, IdmLaw { accel_mps2: 0.0, ..IDM }), "accel_mps2: 0"),
        (of(0.5, 1.0, IdmLaw { comfortable_brake_mps2: f64::INFINITY, ..IDM }), "comfortable_brake_mps2: inf"),
    ];
    for (found, text) in wrong {
        assert!(found.clone().is_err_and(|error| error.starts_with(text)), "{found:?}");
    }
}

#[test]
fn a_step_is_enough_where_it_is_as_long_as_from_one_end_to_the_other() {
    let at = |rate_per_s| ResidualPolicy { rate_per_s, ..residual_policy(0.4) };
    assert!(
        at(200.0).is_complete_in_one_step(0.01)
            && at(1000.0).is_complete_in_one_step(0.01)
            && at(4.0).is_complete_in_one_step(0.5)
    );
    assert!(!at(199.0).is_complete_in_one_step(0.01) && !at(4.0).is_complete_in_one_step(0.49));
}

#[test]
fn rounding_is_allowed_for() {
    let largest_mps2 = 7.5;
    // A law at its bound, with an action that changes nothing of it, or everything.
    for (gap, action) in [(1e9, 1.0), (0.001, -1.0)] {
        let form = enclose_acceleration(
            &residual_policy(0.4),
            &point_form(action),
            [point_form(gap), point_form(0.0), point_form(0.0)],
        );
        assert!((REL_ROUNDING_ERROR * largest_mps2..1e-12).contains(&form.radius()), "{form:?}");
    }
}

#[test]
fn a_difference_of_speeds_is_off_by_both() {
    assert_eq!(law_input_errors(&[0.5, 9.0, 0.25, 2.0, 9.0, 9.0, 9.0, 9.0]), [0.5, 2.0, 2.25]);
}
