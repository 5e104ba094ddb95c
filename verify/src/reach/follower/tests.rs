use proptest::prelude::*;

use super::super::fixtures::{assert_bounds, interval, point_form, symbol_form};
use super::*;

const IDM: IdmLaw = IdmLaw {
    desired_speed_mps: 30.0,
    time_headway_s: 1.5,
    standstill_gap_m: 2.0,
    accel_mps2: 1.4,
    comfortable_brake_mps2: 2.0,
    max_accel_mps2: 3.0,
};
const ACC: AccAebLaw = AccAebLaw {
    ttc_s: 2.0,
    time_headway_s: 1.2,
    standstill_gap_m: 2.5,
    gap_gain_per_s2: 0.3,
    speed_gain_per_s: 0.8,
    comfort_brake_mps2: 3.0,
    comfort_accel_mps2: 1.5,
    set_speed_mps: Some(25.0),
    max_accel_mps2: 2.5,
};

fn any_idm() -> impl Strategy<Value = IdmLaw> {
    (
        10.0..40.0_f64,
        0.0..3.0_f64,
        0.0..5.0_f64,
        0.3..3.0_f64,
        0.3..5.0_f64,
        0.0..4.0_f64,
    )
        .prop_map(
            |(
                desired_speed_mps,
                time_headway_s,
                standstill_gap_m,
                accel_mps2,
                comfortable_brake_mps2,
                max_accel_mps2,
            )| {
                IdmLaw {
                    desired_speed_mps,
                    time_headway_s,
                    standstill_gap_m,
                    accel_mps2,
                    comfortable_brake_mps2,
                    max_accel_mps2,
                }
            },
        )
}

fn any_acc() -> impl Strategy<Value = AccAebLaw> {
    let set_speed = prop::option::of(0.0..40.0_f64);
    (
        0.0..4.0_f64,
        0.0..3.0_f64,
        0.0..5.0_f64,
        [0.0..1.0_f64, 0.0..2.0_f64],
        0.0..5.0_f64,
        0.0..3.0_f64,
        0.0..4.0_f64,
        set_speed,
    )
        .prop_map(
            |(
                ttc_s,
                time_headway_s,
                standstill_gap_m,
                [gap_gain, speed_gain],
                brake,
                accel,
                most,
                set_speed,
            )| {
                AccAebLaw {
                    set_speed_mps: set_speed,
                    ttc_s,
                    time_headway_s,
                    standstill_gap_m,
                    gap_gain_per_s2: gap_gain,
                    speed_gain_per_s: speed_gain,
                    comfort_brake_mps2: brake,
                    comfort_accel_mps2: accel,
                    max_accel_mps2: most,
                }
            },
        )
}

/// Returns the `idm` command, and the magnitude of its terms.
fn idm_acceleration(law: &IdmLaw, [gap, v, w]: [f64; 3]) -> (f64, f64) {
    let dynamic = v * law.time_headway_s
        + v * (v - w) / (2.0 * (law.accel_mps2 * law.comfortable_brake_mps2).sqrt());
    let share = (law.standstill_gap_m + dynamic.max(0.0)) / gap.max(0.01);
    let fourth = (v / law.desired_speed_mps).powi(4);
    let size = 1.0 + fourth + (share + v * (v + w) / gap.max(0.01)).powi(2);
    (
        law.accel_mps2 * (1.0 - fourth - share * share),
        law.accel_mps2 * size,
    )
}

fn acc_acceleration(law: &AccAebLaw, [gap, v, w]: [f64; 3]) -> f64 {
    let follow = law.gap_gain_per_s2 * (gap - law.standstill_gap_m - law.time_headway_s * v);
    let limit = match law.set_speed_mps {
        Some(u) => law.speed_gain_per_s * (u - v),
        None if v - w < 2.0 => law.speed_gain_per_s * (w + 2.0 - v),
        None => 0.0,
    };
    let wanted = limit.min(follow + law.speed_gain_per_s * (w - v));
    wanted
        .max(-law.comfort_brake_mps2)
        .min(law.comfort_accel_mps2)
}

fn law_input(gap: AffineForm, speed: AffineForm, ahead: &AffineForm) -> LawInput {
    let closing = speed.clone().minus(ahead);
    LawInput {
        gap,
        speed,
        closing,
    }
}

fn point([gap, v, w]: [f64; 3]) -> LawInput {
    law_input(point_form(gap), point_form(v), &point_form(w))
}

const BRAKE: [f64; 2] = [7.0, 9.0];

fn law_follower<'a>(
    law: &'a FollowerLaw,
    brake: AffineForm,
    start_gap: &'a AffineForm,
) -> LawFollower<'a> {
    LawFollower {
        law,
        brake,
        start_gap,
        step: Interval::point(0.1),
    }
}

fn plain_of(law: &IdmLaw, seen: &LawInput) -> Interval {
    law.desired_acceleration_interval(
        seen.gap.range(),
        seen.speed.range().max(Interval::ZERO),
        seen.closing.range(),
    )
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// For one input both evaluations of `idm` are tight.
    #[test]
    fn idm_for_one_observation_is_its_formula(
        law in any_idm(), gap in prop_oneof![0.02..0.5_f64, 0.5..60.0_f64], v in 0.0..40.0_f64, w in 0.0..40.0_f64,
    ) {
        let (expected, size) = idm_acceleration(&law, [gap, v, w]);
        let seen = point([gap, v, w]);
        assert_bounds(plain_of(&law, &seen), [expected; 2], 1e-12 * size);
        assert_bounds(law.desired_acceleration(&seen, &point_form(8.0)).range(), [expected; 2], 1e-11 * size);
        let (expected, size) = idm_acceleration(&law, [0.004, v, w]);
        assert_bounds(plain_of(&law, &point([0.004, v, w])), [expected; 2], 1e-12 * size);
    }

    /// The `idm` enclosure of a box of inputs is the narrower of form and interval, and a form keeps its symbols.
    #[test]
    fn idm_returns_the_narrower_of_form_and_interval(
        low in 0.02..30.0_f64, widths in prop::array::uniform3(prop_oneof![0.01..0.3_f64, 0.3..8.0_f64]),
        v in 0.5..25.0_f64, w in 0.0..25.0_f64, places in prop::array::uniform3(0.0..=1.0_f64),
    ) {
        let (law, start_gap) = (FollowerLaw::Idm(IDM), AffineForm::default());
        let behind = law_follower(&law, point_form(8.0), &start_gap);
        let box_of = [low, v, w].into_iter().zip(widths);
        let ends: Vec<[f64; 2]> = box_of.map(|(low, width)| [low, low + width]).collect();
        let forms: Vec<_> = ends.iter().enumerate().map(|(i, &[low, high])| symbol_form(i, low, high)).collect();
        let seen = law_input(forms[0].clone(), forms[1].clone(), &forms[2]);
        let actual = behind.acceleration(&seen);
        let wanted = IDM.desired_acceleration(&seen, &behind.brake);
        let form = clamp_to_limits(&wanted, &behind.brake, IDM.max_accel_mps2).range();
        let plain = plain_of(&IDM, &seen).max(Interval::point(-8.0)).min(Interval::point(3.0));
        let width = |range: Interval| range.high() - range.low();
        let narrower = width(form).min(width(plain));
        prop_assert!(width(actual.range()) <= narrower * (1.0 + 1e-9) + 1e-9, "{actual:?} {form:?} {plain:?}");
        if width(form) < 0.999 * width(plain) {
            prop_assert!(actual.terms().iter().any(|&term| term != 0.0), "{actual:?} {plain:?}");
        }
        let at: Vec<f64> = ends.iter().zip(places).map(|([low, high], place)| low + place * (high - low)).collect();
        let true_one = idm_acceleration(&IDM, [at[0], at[1], at[2]]).0.clamp(-8.0, 3.0);
        let range = actual.range();
        prop_assert!(range.low() <= true_one + 1e-9 && true_one - 1e-9 <= range.high(), "{true_one} {range:?}");
    }

    /// For one input `acc-aeb` brakes fully for a gap below θ times the closing speed, and follows its formula
    /// otherwise.
    #[test]
    fn acc_aeb_for_one_observation_is_its_formula(
        law in any_acc(), gap in 0.0..60.0_f64, v in 0.0..40.0_f64, w in 0.0..40.0_f64,
    ) {
        let guard = gap - law.ttc_s * (v - w);
        prop_assume!(guard.abs() > 1e-9);
        let wanted = if guard < 0.0 { f64::NEG_INFINITY } else { acc_acceleration(&law, [gap, v, w]) };
        let expected = wanted.max(-8.0).min(law.max_accel_mps2);
        let (law, start_gap) = (FollowerLaw::AccAeb(law), AffineForm::default());
        let actual = law_follower(&law, point_form(8.0), &start_gap).acceleration(&point([gap, v, w]));
        assert_bounds(actual.range(), [expected; 2], 1e-12 * 200.0);
        let observed = [gap, v, w].map(point_form);
        let range = law.command_range(&observed, interval(-8.0, 9.0));
        assert_bounds(range.max(Interval::point(-8.0)), [expected; 2], 1e-12 * 200.0);
    }

    /// Without a set speed `acc-aeb` does not accelerate at 5 m/s more than the leader, whatever the gap.
    #[test]
    fn without_a_set_speed_the_leader_bounds_the_speed(
        law in any_acc(), v in 5.0..40.0_f64, width in 0.0..2.0_f64, faster in 0.0..1.0_f64,
    ) {
        let law = FollowerLaw::AccAeb(AccAebLaw { set_speed_mps: None, ..law });
        let own = interval(v + faster, v + width + faster);
        let observed = [interval(1.0, 1e9), own, interval(0.0, v - 2.0)].map(AffineForm::constant);
        prop_assert!(law.command_range(&observed, interval(-8.0, 9.0)).high() <= 0.0);
    }
}

/// A gap that may be below a centimetre gives the range from full braking to A.
#[test]
fn idm_is_unbounded_where_the_gap_may_be_zero() {
    let brake = symbol_form(6, BRAKE[0], BRAKE[1]);
    for low in [-1.0, 0.0, 0.01] {
        let seen = law_input(
            symbol_form(0, low, 30.0),
            point_form(10.0),
            &point_form(10.0),
        );
        assert_bounds(
            IDM.desired_acceleration(&seen, &brake).range(),
            [-BRAKE[1], IDM.accel_mps2],
            1e-10,
        );
    }
}

/// If the emergency brake may fire, the range is from full braking to the command without it.
#[test]
fn where_the_emergency_brake_may_fire_any_braking_is_possible() {
    let (law, start_gap) = (
        FollowerLaw::AccAeb(AccAebLaw { ttc_s: 5.0, ..ACC }),
        AffineForm::default(),
    );
    let behind = law_follower(&law, symbol_form(6, BRAKE[0], BRAKE[1]), &start_gap);
    // Closing at 1 m/s, it fires below 5 m.
    let at = |low: f64, high: f64| {
        behind
            .acceleration(&law_input(
                symbol_form(0, low, high),
                point_form(20.0),
                &point_form(19.0),
            ))
            .range()
    };
    assert_bounds(
        at(4.0, 30.0),
        [-BRAKE[1], acc_acceleration(&ACC, [30.0, 20.0, 19.0])],
        1e-9,
    );
    assert_bounds(at(2.0, 4.9), [-BRAKE[1], -BRAKE[0]], 1e-9);
    let follows = [29.0, 30.0].map(|gap| acc_acceleration(&ACC, [gap, 20.0, 19.0]));
    assert_bounds(at(29.0, 30.0), follows, 1e-9);
    let stands = LawInput {
        gap: AffineForm::default(),
        speed: AffineForm::default(),
        closing: AffineForm::default(),
    };
    let expected = acc_acceleration(&ACC, [0.0; 3]);
    assert_bounds(behind.acceleration(&stands).range(), [expected; 2], 1e-9);
}

/// A vehicle that may have stopped may have held no acceleration; a standing one does not reverse.
#[test]
fn the_observed_acceleration_contains_every_possible_one() {
    let step = Interval::point(0.1);
    let at = |speed: AffineForm| VehicleState {
        speed,
        ..VehicleState::default()
    };
    let (moves, may_stand, stands) = (
        at(symbol_form(0, 5.0, 6.0)),
        at(symbol_form(0, 0.0, 6.0)),
        at(AffineForm::default()),
    );
    let [brakes, either, starts] =
        [[-2.0, -1.0], [-2.0, 1.0], [0.5, 1.0]].map(|[low, high]| symbol_form(1, low, high));
    for wanted in [&brakes, &either, &starts] {
        assert_eq!(step_follower(&moves, wanted, step).acceleration, *wanted);
    }
    assert_eq!(
        step_follower(&may_stand, &starts, step).acceleration,
        starts
    );
    assert_bounds(
        step_follower(&may_stand, &brakes, step)
            .acceleration
            .range(),
        [-2.0, 0.0],
        1e-10,
    );
    assert_bounds(
        step_follower(&may_stand, &either, step)
            .acceleration
            .range(),
        [-2.0, 1.0],
        1e-10,
    );
    assert!(step_follower(&stands, &brakes, step).acceleration.is_zero());
    assert_eq!(step_follower(&stands, &starts, step).acceleration, starts);
    // The chord of max(0, u) from -2 to 1 has the slope 1/3.
    assert_bounds(
        step_follower(&stands, &either, step).acceleration.range(),
        [-2.0 / 3.0, 1.0],
        1e-10,
    );
}

#[test]
fn a_step_of_a_modelled_follower_is_the_closed_form() {
    let (law, start_gap) = (FollowerLaw::AccAeb(ACC), point_form(20.0));
    let behind = law_follower(&law, point_form(8.0), &start_gap);
    let at = |distance, speed| VehicleState {
        distance: point_form(distance),
        speed: point_form(speed),
        ..VehicleState::default()
    };
    let (own, ego) = (at(7.0, 15.0), at(9.0, 14.0));
    let asked = behind.acceleration_behind(&ego, &own);
    let later = behind.advance(&own, &asked);
    let u = acc_acceleration(&ACC, [22.0, 15.0, 14.0]);
    assert_bounds(asked.range(), [u; 2], 1e-8);
    assert_bounds(later.distance.range(), [7.0 + 1.5 + 0.005 * u; 2], 1e-8);
    assert_bounds(later.speed.range(), [15.0 + 0.1 * u; 2], 1e-8);
}

#[test]
fn follower_models_with_invalid_numbers_are_refused() {
    assert!(
        FollowerLaw::Idm(IDM).validate().is_ok() && FollowerLaw::AccAeb(ACC).validate().is_ok()
    );
    let idm = |change: fn(&mut IdmLaw, f64), number| {
        let mut law = IDM;
        change(&mut law, number);
        FollowerLaw::Idm(law).validate().is_ok()
    };
    let divisors: [fn(&mut IdmLaw, f64); 3] = [
        |law, x| law.desired_speed_mps = x,
        |law, x| law.accel_mps2 = x,
        |law, x| law.comfortable_brake_mps2 = x,
    ];
    let others: [fn(&mut IdmLaw, f64); 3] = [
        |law, x| law.time_headway_s = x,
        |law, x| law.standstill_gap_m = x,
        |law, x| law.max_accel_mps2 = x,
    ];
    for (changes, zero_is_fit) in [(divisors, false), (others, true)] {
        for change in changes {
            assert!([1e-3, 7.0].into_iter().all(|number| idm(change, number)));
            assert_eq!(idm(change, 0.0), zero_is_fit);
            assert!(
                ![-1.0, f64::INFINITY, f64::NAN]
                    .into_iter()
                    .any(|number| idm(change, number))
            );
        }
    }
    let acc = |change: fn(&mut AccAebLaw, f64), number| {
        let mut law = ACC;
        change(&mut law, number);
        FollowerLaw::AccAeb(law).validate().is_ok()
    };
    let all: [fn(&mut AccAebLaw, f64); 9] = [
        |law, x| law.set_speed_mps = Some(x),
        |law, x| law.ttc_s = x,
        |law, x| law.time_headway_s = x,
        |law, x| law.standstill_gap_m = x,
        |law, x| law.gap_gain_per_s2 = x,
        |law, x| law.speed_gain_per_s = x,
        |law, x| law.comfort_brake_mps2 = x,
        |law, x| law.comfort_accel_mps2 = x,
        |law, x| law.max_accel_mps2 = x,
    ];
    for change in all {
        assert!([0.0, 7.0].into_iter().all(|number| acc(change, number)));
        assert!(
            ![-1.0, f64::INFINITY, f64::NAN]
                .into_iter()
                .any(|number| acc(change, number))
        );
    }
}

#[test]
fn a_follower_model_bounds_the_acceleration() {
    assert_eq!(
        [FollowerLaw::Idm(IDM), FollowerLaw::AccAeb(ACC)].map(|law| law.max_accel_mps2()),
        [3.0, 2.5]
    );
}

#[test]
fn a_follower_model_is_printed_with_all_numbers() {
    let idm = IdmLaw {
        desired_speed_mps: 30.0,
        time_headway_s: 1.5,
        standstill_gap_m: 2.0,
        accel_mps2: 0.75,
        comfortable_brake_mps2: 1.625,
        max_accel_mps2: 3.0,
    };
    let of_idm = "drives idm towards 30 m/s with a time headway of 1.5 s, 2 m at standstill, 0.75 and 1.625 m/s²";
    assert_eq!(FollowerLaw::Idm(idm).to_string(), of_idm);
    let acc = AccAebLaw {
        ttc_s: 1.4,
        time_headway_s: 1.25,
        standstill_gap_m: 3.0,
        gap_gain_per_s2: 0.25,
        speed_gain_per_s: 0.5,
        comfort_brake_mps2: 3.5,
        comfort_accel_mps2: 2.0,
        set_speed_mps: None,
        max_accel_mps2: 2.5,
    };
    let of_acc = |limit: &str| {
        format!(
            "drives acc-aeb with a time headway of 1.25 s, 3 m at standstill, gains 0.25 and 0.5, from -3.5 to 2 \
             m/s², {limit}, and full braking while its time to collision is below 1.4 s"
        )
    };
    let without = of_acc("no acceleration while it is more than 2 m/s faster than its leader");
    assert_eq!(FollowerLaw::AccAeb(acc).to_string(), without);
    let with = AccAebLaw {
        set_speed_mps: Some(12.5),
        ..acc
    };
    assert_eq!(
        FollowerLaw::AccAeb(with).to_string(),
        of_acc("a set speed of 12.5 m/s")
    );
}

#[test]
fn idm_on_an_open_road_has_only_the_speed_term() {
    let seen = LawInput::new(point_form(1e9), point_form(6.0), point_form(6.0));
    let wanted = IDM.desired_acceleration(&seen, &point_form(8.0)).range();
    assert_bounds(
        wanted,
        [IDM.accel_mps2 * (1.0 - (6.0 / IDM.desired_speed_mps).powi(4)); 2],
        1e-6,
    );
}
