//! Comparisons with closed forms, a simulation, and affine networks.

use super::*;
use crate::reach::{LinearLayer, NetworkFileFormat, NetworkLayer};
use proptest::prelude::*;

fn point(value: f64) -> Interval {
    Interval::point(value)
}

fn is_near(found: Interval, [low, high]: [f64; 2], off: f64) -> bool {
    (found.low() - low).abs() <= off && (found.high() - high).abs() <= off
}

/// Advances distance, speed and γ by a period with a Runge-Kutta method.
fn simulate_period(state: [f64; 3], a: f64) -> [f64; 3] {
    const PARTS: u32 = 10;
    let h = 0.1 / f64::from(PARTS);
    let rate = |[_, v, gamma]: [f64; 3]| [v, gamma, -2.0 * gamma + 2.0 * a - 1e-4 * v * v];
    let plus = |state: [f64; 3], by: f64, rate: [f64; 3]| std::array::from_fn(|i| state[i] + by * rate[i]);
    (0..PARTS).fold(state, |state, _| {
        let first = rate(state);
        let second = rate(plus(state, h / 2.0, first));
        let third = rate(plus(state, h / 2.0, second));
        let fourth = rate(plus(state, h, third));
        std::array::from_fn(|i| state[i] + h / 6.0 * (first[i] + 2.0 * (second[i] + third[i]) + fourth[i]))
    })
}

proptest! {
    /// Checks both ends of all bounds of a period against the formulas, and that the simulation lies between them.
    #[test]
    fn a_period_is_as_its_closed_forms_say(v in 5.0..35.0_f64, gamma in -15.0..15.0_f64, a in -15.0..15.0_f64) {
        let gamma_form = AffineForm::constant(point(gamma));
        let car = CarState { gamma: gamma_form, ..CarState::from_speed(AffineForm::constant(point(v))) };
        let (after, meanwhile) = car.advance(&AffineForm::constant(point(a)), &PeriodCoefficients::new(), 0).unwrap();
        let forcing = [2.0 * a - 1e-4 * (v + 2.0).powi(2), 2.0 * a - 1e-4 * (v - 2.0).powi(2)];
        let gammas = [gamma.min(forcing[0] / 2.0), gamma.max(forcing[1] / 2.0)];
        prop_assert!(is_near(meanwhile.forcing, forcing, 1e-9) && is_near(meanwhile.gamma, gammas, 1e-9));
        // v² changes by the difference of speeds times their sum.
        let [slower, faster] = [(0.1 * gammas[0]).min(0.0), (0.1 * gammas[1]).max(0.0)];
        let sum = 2.0 * v + faster;
        let w = [faster, slower].map(|since| 2.0 * a - 1e-4 * (v * v + since * sum));
        let decay = (-0.2_f64).exp();
        let of_speed = (1.0 - decay) / 2.0;
        let half_of_speed = (0.1 - of_speed) / 2.0;
        let of_way = (0.005 - half_of_speed) / 2.0;
        let exact = simulate_period([0.0, v, gamma], a);
        for (form, base, of_w, exact) in [
            (after.distance, 0.1 * v + half_of_speed * gamma, of_way, exact[0]),
            (after.speed, v + of_speed * gamma, half_of_speed, exact[1]),
            (after.gamma, decay * gamma, of_speed, exact[2]),
        ] {
            let range = form.range();
            prop_assert!(is_near(range, w.map(|w| base + of_w * w), 1e-9), "{range:?} {base} {of_w} {w:?}");
            prop_assert!(range.low() - 1e-9 <= exact && exact <= range.high() + 1e-9, "{range:?} {exact}");
        }
    }
}

/// The assumed 2 m/s in a tenth of a second must not be reached, to the last bit of either end.
#[test]
fn a_speed_that_may_reach_the_trial_bound_is_undecided() {
    let (period, still) = (PeriodCoefficients::new(), AffineForm::default());
    for sign in [1.0, -1.0] {
        let mut seen = [0; 3];
        // A form is slightly wider than its parts.
        for ulps in (-20_000..=20_i64).step_by(2) {
            let gamma = f64::from_bits(20.0_f64.to_bits().wrapping_add_signed(ulps));
            let gamma = Interval::new(gamma.min(0.0), gamma).map(|up| if sign > 0.0 { up } else { -up }).unwrap();
            let gamma = AffineForm::constant(gamma);
            let car = CarState { gamma, ..CarState::from_speed(AffineForm::constant(point(30.0))) };
            let before = car.speed.range();
            let within = before + period.time.hull(Interval::ZERO) * car.gamma.range();
            let tried = before + Interval::around_zero(SPEED_ENCLOSURE_RADIUS_MPS);
            let order = if sign > 0.0 {
                within.high().partial_cmp(&tried.high())
            } else {
                tried.low().partial_cmp(&within.low())
            };
            let is_inside = order == Some(std::cmp::Ordering::Less);
            assert_eq!(car.advance(&still, &period, 0).is_some(), is_inside, "{sign} {ulps}");
            seen[(order.unwrap() as i8 + 1) as usize] += 1;
        }
        assert!(seen.iter().all(|&count| count > 0), "inside, touching and beyond: {seen:?}");
    }
    let anywhere = CarState { speed: AffineForm::entire(), ..CarState::from_speed(AffineForm::default()) };
    assert!(anywhere.advance(&still, &period, 0).is_none());
}

fn affine_controller(of_speed: f64, a: f64) -> NeuralController {
    let layer = LinearLayer { inputs: 5, outputs: 1, weights: vec![0.0, 0.0, of_speed, 0.0, 0.0], biases: vec![a] };
    NeuralController {
        inputs: expected_inputs().to_vec(),
        layers: vec![NetworkLayer::Linear(layer)],
        output_index: 0,
        scale_mps2: 1.0,
        offset_mps2: 0.0,
        action_bounds_mps2: [-CLIP_LIMIT, CLIP_LIMIT],
        is_clipped: true,
        residual_over: None,
        empty_gap_m: 80.0,
        decision_interval_s: PERIOD_S,
        source: Some(NetworkFileSource { format: NetworkFileFormat::Onnx, sha256: "0".repeat(64) }),
    }
}

fn bound_point(controller: &NeuralController, distance_m: f64) -> CruiseBounds {
    bound_cell(controller, point(distance_m), &OpBudget::new(WorkLimit::UNLIMITED)).unwrap()
}

/// The own car brakes harder than the lead car: nearest at the start, apart from the allowance between decisions.
#[test]
fn between_decisions_the_margin_falls_by_no_more_than_its_bend_allows() {
    for a in [-3.0, -4.5, -7.0] {
        let forcing = |a: f64, v: f64| 2.0 * a - 1e-4 * v * v;
        let of_lead = (forcing(-2.0, 30.0) / 2.0).max(0.0);
        let least_of_ego = forcing(a, 32.2);
        let bend = of_lead - least_of_ego / 2.0 - 1.4 * least_of_ego;
        let expected = 95.0 - 10.0 - 1.4 * 30.2 - bend * 0.01 / 8.0;
        let margin_m = bound_point(&affine_controller(0.0, a), 95.0).margin_m;
        assert!((margin_m - expected).abs() < 1e-6, "{a}: {margin_m} {expected}");
    }
}

/// The remainder of a period has its own symbol: bounds follow as the network spreads or contracts the speeds.
#[test]
fn an_affine_network_is_bounded_as_it_drives() {
    for (of_speed, a) in [(0.0, -3.0), (0.0, 1.0), (0.25, -7.5), (-0.5, 15.0)] {
        let at_end = |x_ego: f64, v_ego: f64| {
            let advance = |state: [f64; 3], _| simulate_period(state, of_speed * state[1] + a);
            (0..PERIODS).fold([x_ego, v_ego, 0.0], advance)[0]
        };
        let exact = [at_end(10.0, 30.0), at_end(11.0, 30.2)];
        let CruiseBounds { x_ego_m: [low, high], .. } = bound_point(&affine_controller(of_speed, a), 95.0);
        let wide = exact[1] - exact[0];
        assert!(low <= exact[0] && exact[1] <= high, "{low} {high} {exact:?}");
        assert!(high - low <= 1.05 * wide, "{low} {high} {exact:?}");
    }
}

/// Acceleration grows with speed until it exceeds the assumed change; the fastest member determines the time.
#[test]
fn the_time_at_which_bounds_are_too_wide_is_reported() {
    for at_start in [12.0, 16.0] {
        let controller = affine_controller(1.0, at_start - 30.2);
        let (mut fastest, mut periods) = ([0.0, 30.2, 0.0_f64], 0);
        while fastest[2].max(fastest[1] - 30.2 + at_start - 0.5e-4 * fastest[1] * fastest[1]) < 20.0 {
            fastest = simulate_period(fastest, fastest[1] - 30.2 + at_start);
            periods += 1;
        }
        assert!(periods > 1, "{periods}");
        let given_up = bound_cell(&controller, point(95.0), &OpBudget::new(WorkLimit::UNLIMITED));
        assert_eq!(given_up, Err(CruiseBoundsError::TooWide(f64::from(periods) * 0.1)));
    }
}

#[test]
fn the_width_of_where_it_ends_is_rounded_up() {
    assert_eq!(CruiseBounds { margin_m: 0.0, x_ego_m: [10.0, 12.5] }.x_ego_width_m(), 2.5_f64.next_up());
}
