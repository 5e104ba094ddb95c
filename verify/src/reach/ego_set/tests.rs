use proptest::prelude::*;

use super::super::fixtures::{assert_bounds, point_form, symbol_form};
use super::*;

/// Returns the support of a set along a direction, relative to its middle: Σ |w · vector| over symbols, plus the rests.
fn support(members: &EgoSet, along: &[f64; 6]) -> f64 {
    let forms: Vec<&AffineForm> = members.forms().collect();
    let term = |symbol: usize| {
        forms
            .iter()
            .zip(along)
            .map(|(form, w)| form.terms().get(symbol).unwrap_or(&0.0) * w)
            .sum::<f64>()
            .abs()
    };
    let rests = forms
        .iter()
        .zip(along)
        .map(|(form, w)| form.rest() * w.abs())
        .sum::<f64>();
    (0..members.next_symbol).map(term).sum::<f64>() + rests
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// Compares supports from the same middle: no smaller, so all members remain, and hardly larger.
    #[test]
    fn order_reduction_keeps_all_members(
        decay in 0.9..1.1_f64,
        noise in prop::collection::vec(prop::array::uniform6(-1e-4..1e-4_f64), MAX_SYMBOLS + 10),
        along in prop::array::uniform6(-1.0..1.0_f64), is_followed: bool,
    ) {
        let forms: Vec<AffineForm> = (0..6)
            .map(|i| {
                let mut form = AffineForm::constant(Interval::point(i as f64));
                for (symbol, noise) in noise.iter().enumerate() {
                    let [distance, age] = [1.0, decay.powi(symbol as i32)];
                    let term = [distance * age, 0.1 * age, -0.01 * age][i % 3] + noise[i];
                    let own = AffineForm::symbol(SHARED_SYMBOLS + symbol, Interval::around_zero(1.0));
                    form.add_scaled(&own, Interval::point(term));
                }
                form
            })
            .collect();
        let [ego, follower] = [0, 3].map(|from| {
            let [distance, speed, acceleration] = [0, 1, 2].map(|i| forms[from + i].clone());
            VehicleState { distance, speed, acceleration }
        });
        let follower = is_followed.then_some(follower);
        let next_symbol = SHARED_SYMBOLS + MAX_SYMBOLS + 10;
        let all = EgoSet { mode: MotionMode::Moving, ego, follower, first_own_symbol: SHARED_SYMBOLS, next_symbol };
        let fewer = all.clone().reduce_order();
        prop_assert!(fewer.next_symbol <= SHARED_SYMBOLS + REDUCED_SYMBOLS);
        prop_assert_eq!(fewer.ego.speed.centre(), all.ego.speed.centre());
        let (before, after) = (support(&all, &along), support(&fewer, &along));
        prop_assert!(after >= before * (1.0 - 1e-12), "{before} {after}");
        let largest = support(&all, &[1.0; 6]);
        prop_assert!(after <= before + 0.05 * largest, "{before} {after}");
    }
}

/// Returns the ReLU's bounds of [l, h], given the floor.
fn relu_range([low, high]: [f64; 2], floor: f64) -> [f64; 2] {
    let least = low.max(floor);
    if least >= 0.0 {
        return [low, high];
    }
    if high <= 0.0 {
        [0.0; 2]
    } else {
        [low * high / (high - least), high]
    }
}

fn egos_at_speed(speed: AffineForm) -> EgoSet {
    EgoSet::from_speed(speed, SHARED_SYMBOLS)
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// Checks moving and standing sets against the module's formulas, and that each member is in one of them.
    #[test]
    fn positions_after_a_decision_equal_the_closed_form(
        v0 in 0.0..6.0_f64, u0 in -9.0..4.0_f64, widths in prop::array::uniform2(0.01..2.0_f64), every in 1..8_u32,
        places in prop::collection::vec(prop::array::uniform2(0.0..=1.0_f64), 8),
    ) {
        let (h, [v1, u1]) = (0.1, [v0 + widths[0], u0 + widths[1]]);
        let (s, t) = (f64::from(every - 1) * h, f64::from(every) * h);
        let goal = symbol_form(1, u0, u1);
        let [moving, standing] = egos_at_speed(symbol_form(0, v0, v1)).after_decision(&goal, Interval::point(h), every);
        let limits = [v0 + u0 * s, v1 + u1 * s, v0 + u0 * t, v1 + u1 * t, u0, u1];
        prop_assume!(!limits.into_iter().any(|x: f64| x.abs() < 1e-6));
        prop_assert_eq!(moving.is_some(), v1 + u1 * s > 0.0 || u1 > 0.0);
        prop_assert_eq!(standing.is_some(), v0 + u0 * s <= 0.0 && u0 <= 0.0);
        let brake = (-u0).max(0.0);
        if let Some(moving) = &moving {
            let reversing = (-(v0 + u0 * t)).clamp(0.0, brake * h);
            let free = |v: f64, u: f64| v * t + 0.5 * u * t * t;
            assert_bounds(moving.ego.distance.range(), [free(v0, u0), free(v1, u1) + 0.5 * reversing * h], 1e-10);
            assert_bounds(moving.ego.speed.range(), relu_range([v0 + u0 * t, v1 + u1 * t], -brake * h), 1e-10);
            prop_assert_eq!(&moving.ego.acceleration, &goal);
            prop_assert_eq!(moving.mode, MotionMode::Moving);
        }
        if let Some(standing) = &standing {
            assert_bounds(standing.ego.distance.range(), [0.0, 0.5 * v1.min(brake * s) * s], 1e-10);
            prop_assert!(standing.ego.speed.is_zero() && standing.ego.acceleration.is_zero());
            prop_assert_eq!(standing.mode, MotionMode::Standing);
        }
        for [a, b] in places {
            let (v, u) = (v0 + a * widths[0], u0 + b * widths[1]);
            let stops = v + u * t < 0.0;
            let covered = if stops { v * v / (-2.0 * u) } else { v * t + 0.5 * u * t * t };
            let set = if v + u * s > 1e-9 { &moving } else { &standing };
            let ego = &set.as_ref().unwrap().ego;
            let is_in = |range: Interval, x: f64| range.low() - 1e-9 <= x && x <= range.high() + 1e-9;
            prop_assert!(is_in(ego.distance.range(), covered) && is_in(ego.speed.range(), (v + u * t).max(0.0)));
        }
    }

    #[test]
    fn positions_between_decisions_equal_the_closed_form(
        v0 in 0.1..6.0_f64, u0 in -9.0..4.0_f64, widths in prop::array::uniform2(0.01..2.0_f64), steps in 1..20_u32,
    ) {
        let [v1, u1] = [v0 + widths[0], u0 + widths[1]];
        let t = f64::from(steps) * 0.1;
        let goal = symbol_form(1, u0, u1);
        let after = egos_at_speed(symbol_form(0, v0, v1)).ego_after(&goal, Interval::point(0.1), steps);
        let VehicleState { distance, speed, acceleration } = after;
        let [least, most] = [v0 + u0 * t, v1 + u1 * t];
        prop_assume!(least.abs() > 1e-6 && most.abs() > 1e-6);
        let free = [v0 * t + 0.5 * u0 * t * t, v1 * t + 0.5 * u1 * t * t + 0.5 * (-least).max(0.0) * t];
        assert_bounds(distance.range(), if most < 0.0 { [0.0, 0.5 * v1 * t] } else { free }, 1e-9);
        assert_bounds(speed.range(), relu_range([least, most], f64::NEG_INFINITY), 1e-10);
        prop_assert_eq!(acceleration, goal);
    }

    /// The cost of a merged pair is the part of each outside their sum.
    #[test]
    fn a_pair_costs_the_excess_over_its_sum(
        p in prop::array::uniform6(-2.0..2.0_f64), q in prop::array::uniform6(-2.0..2.0_f64),
    ) {
        let size = |vector: &Generator| vector.iter().map(|number| number.abs()).sum::<f64>();
        let share = size(&p) / (size(&p) + size(&q));
        let cost: f64 = p.iter().zip(q).map(|(p, q)| 2.0 * (p - share * (p + q)).abs()).sum();
        let actual = GeneratorPair::new(&p, &q).cost();
        prop_assert!(cost * (1.0 - 1e-12) - 1e-13 <= actual && actual <= cost + 1e-13, "{actual} {cost}");
    }

    /// Symbols in proportion merge at no cost, for any sign, in the ego, the follower or both.
    #[test]
    fn proportional_symbols_merge_without_excess(
        factors in prop::collection::vec(prop_oneof![-3.0..-0.3_f64, 0.3..3.0_f64], 85),
        along in prop::array::uniform6(-1.0..1.0_f64), seed in 0..85_usize,
    ) {
        let mut all = egos_at_speed(point_form(10.0)).with_follower(Some(egos_at_speed(point_form(9.0)).ego));
        let pairs = factors.iter().enumerate().flat_map(|(place, &factor)| {
            let slope = place as f64 - 42.0;
            let ego = [1.0, 0.1 * slope, 0.2, 0.3, 0.01 * slope, 0.0];
            let alone = [0.0, 0.0, 0.0, 1.0, 0.1 * slope, -0.4];
            let set = if place % 2 == 0 { ego } else { alone };
            [set, set.map(|number| factor * number)]
        });
        let mut vectors: Vec<Generator> = pairs.collect();
        vectors.rotate_left(2 * seed);
        let vectors: Vec<Generator> = (0..170).map(|i| vectors[(i * 83) % 170]).collect();
        let follower = all.follower.as_mut().unwrap();
        let forms = [&mut all.ego.distance, &mut all.ego.speed, &mut all.ego.acceleration]
            .into_iter()
            .chain([&mut follower.distance, &mut follower.speed, &mut follower.acceleration]);
        for (i, form) in forms.enumerate() {
            form.replace_terms(SHARED_SYMBOLS, vectors.iter().map(|vector| vector[i]), 0.0);
        }
        all.next_symbol = SHARED_SYMBOLS + 170;
        let fewer = all.clone().reduce_order();
        prop_assert_eq!(fewer.next_symbol, SHARED_SYMBOLS + REDUCED_SYMBOLS);
        let (before, after) = (support(&all, &along), support(&fewer, &along));
        prop_assert!((after - before).abs() <= 1e-9 * before, "{before} {after}");
    }
}

#[test]
fn a_standing_vehicle_stays_or_restarts() {
    let step = Interval::point(0.1);
    let after =
        |wanted: &AffineForm| egos_at_speed(AffineForm::default()).after_decision(wanted, step, 3);
    let [stands, none] = after(&symbol_form(1, -2.0, -1.0));
    let stands = stands.unwrap();
    assert!(
        none.is_none()
            && stands.mode == MotionMode::Standing
            && stands.ego.distance.is_zero()
            && stands.ego.speed.is_zero()
    );
    let [starts, none] = after(&symbol_form(1, 1.0, 2.0));
    let starts = starts.unwrap();
    assert!(none.is_none() && starts.mode == MotionMode::Restarted);
    assert_bounds(starts.ego.distance.range(), [0.045, 0.09], 1e-12);
    assert_bounds(starts.ego.speed.range(), [0.3, 0.6], 1e-12);
    let moved =
        |wanted: &AffineForm| egos_at_speed(AffineForm::default()).ego_after(wanted, step, 2);
    let stays = moved(&symbol_form(1, -2.0, -1.0));
    assert!(stays.distance.is_zero() && stays.speed.is_zero() && stays.acceleration.is_zero());
    assert_bounds(
        moved(&symbol_form(1, 1.0, 2.0)).distance.range(),
        [0.02, 0.04],
        1e-12,
    );
}

#[test]
fn a_vehicle_has_not_moved_at_the_decision() {
    let mut members = egos_at_speed(symbol_form(0, 3.0, 4.0));
    members.ego.acceleration = point_form(2.0);
    let seen = members.ego_after(&point_form(-1.0), Interval::point(0.1), 0);
    assert!(
        seen.distance.is_zero() && seen.acceleration.is_zero() && seen.speed == members.ego.speed
    );
}

#[test]
fn a_stopped_set_has_no_moving_members() {
    let step = Interval::point(0.1);
    let kinds = |speed: AffineForm, wanted: AffineForm| {
        egos_at_speed(speed)
            .after_decision(&wanted, step, 3)
            .map(|set| set.map(|set| set.mode))
    };
    assert_eq!(
        kinds(point_form(0.1), point_form(-2.0)),
        [None, Some(MotionMode::Standing)]
    );
    assert_eq!(
        kinds(point_form(0.5), point_form(-2.0)),
        [Some(MotionMode::Moving), None]
    );
    // Bounds that hold only reversing members.
    assert_eq!(
        kinds(symbol_form(0, -1.0, -0.5), AffineForm::default()),
        [None, Some(MotionMode::Standing)]
    );
}

#[test]
fn the_number_of_symbols_is_limited() {
    for (count, expected) in [
        (MAX_SYMBOLS, MAX_SYMBOLS),
        (MAX_SYMBOLS + 1, REDUCED_SYMBOLS),
    ] {
        let mut speed = point_form(10.0);
        speed.replace_terms(SHARED_SYMBOLS, (0..count).map(|i| 1.0 + i as f64), 0.0);
        let mut members = egos_at_speed(point_form(10.0));
        members.next_symbol = SHARED_SYMBOLS + count;
        let next = members.with_ego_in_mode(
            MotionMode::Restarted,
            VehicleState {
                speed,
                ..VehicleState::default()
            },
        );
        assert!(
            next.mode == MotionMode::Restarted
                && next.next_symbol.abs_diff(SHARED_SYMBOLS + expected) <= 1,
            "{}",
            next.next_symbol
        );
    }
}

/// The first distance or speed that is not 0 becomes positive.
#[test]
fn opposite_generators_are_normalised_to_one() {
    let cases = [
        [1.0, -2.0, 3.0, -4.0, 5.0, -6.0],
        [0.0, 2.0, -3.0, -4.0, 5.0, -6.0],
        [0.0, 0.0, -3.0, 4.0, -5.0, -6.0],
        [0.0, 0.0, -3.0, 0.0, 5.0, -6.0],
        [0.0, 0.0, -3.0, 0.0, 0.0, -6.0],
    ];
    for vector in cases {
        assert_eq!(normalize_sign(vector), vector);
    }
    for vector in &cases[..4] {
        assert_eq!(normalize_sign(vector.map(|number| -number)), *vector);
    }
}

#[test]
fn the_direction_key_is_the_share_of_the_speed() {
    for (vector, expected) in [
        ([1.0, 0.0, 9.0, 9.0, 9.0, 9.0], 0.0),
        ([3.0, 1.0, 9.0, 9.0, 9.0, 9.0], 0.25),
        ([3.0, -1.0, 9.0, 9.0, 9.0, 9.0], -0.25),
        ([0.0, 2.0, 9.0, 9.0, 9.0, 9.0], 1.0),
        ([0.0, 0.0, 9.0, 3.0, 1.0, 9.0], 3.25),
        ([0.0, 0.0, 9.0, 0.0, 2.0, 9.0], 4.0),
        ([0.0, 0.0, 9.0, 2.0, 0.0, 9.0], 3.0),
        ([0.0, 0.0, 9.0, 0.0, 0.0, 9.0], 0.0),
    ] {
        assert_eq!(direction_key(&vector), expected, "{vector:?}");
    }
}
