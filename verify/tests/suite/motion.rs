//! Boxes of motion hold every member tightly.

use crate::support::{advance, contains, pick_member, profiles, rational, scenes, simulate_scene};
use crumple_verify::{Interval, motion};
use num_rational::BigRational;
use num_traits::{Signed, Zero};
use proptest::prelude::*;

fn rational_distance_and_speed(v: f64, a: f64, t: f64) -> (BigRational, BigRational) {
    let (v, a, t) = (rational(v), rational(a), rational(t));
    let end = &v + &a * &t;
    let two = rational(2.0);
    if end.is_negative() {
        (-(&v * &v) / (two * a), BigRational::zero())
    } else {
        (&v * &t + a * &t * &t / two, end)
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(2000))]

    #[test]
    fn motion_of_a_box_contains_its_members_tightly(
        v in 0.0..30.0_f64, dv in 0.0..3.0_f64, a in -9.0..3.0_f64, da in 0.0..3.0_f64, t in 0.0..4.0_f64,
        at in (0.0..=1.0_f64, 0.0..=1.0_f64),
    ) {
        let (speed, acceleration) = (Interval::new(v, v + dv).unwrap(), Interval::new(a, a + da).unwrap());
        let (covered, after) = motion::distance_and_speed_after(speed, acceleration, Interval::point(t));
        let (v_in, a_in) = (speed.high().min(v + at.0 * dv), acceleration.high().min(a + at.1 * da));
        let (distance, end) = rational_distance_and_speed(v_in, a_in, t);
        prop_assert!(contains(covered, &distance) && contains(after, &end));
        let [low, high] = [(v, a), (v + dv, a + da)].map(|(v, a)| advance([0.0, v], a, t));
        prop_assert!((covered.low() - low[0]).abs() < 1e-10 && (covered.high() - high[0]).abs() < 1e-10);
        prop_assert!((after.low() - low[1]).abs() < 1e-10 && (after.high() - high[1]).abs() < 1e-10);
    }

    /// Rounding must not select the wrong formula for speeds that reach zero near the end.
    #[test]
    fn a_stop_at_the_very_end_of_the_step(b in 1..80_u32, t in 1..50_u32, off in -3..=3_i32) {
        let (b, t) = (f64::from(b) / 10.0, f64::from(t) / 10.0);
        let v = (0..off.abs()).fold(b * t, |v, _| if off < 0 { v.next_down() } else { v.next_up() });
        let point = Interval::point;
        let (covered, after) = motion::distance_and_speed_after(point(v), point(-b), point(t));
        let (distance, end) = rational_distance_and_speed(v, -b, t);
        prop_assert!(contains(covered, &distance) && contains(after, &end));
        prop_assert!(covered.high() - covered.low() < 1e-10);
    }

    #[test]
    fn leader_and_follower_are_at_the_positions_of_the_scene(
        (scene, profiles) in scenes(1).prop_flat_map(|scene| (Just(scene.clone()), profiles(&scene))),
        picks in prop::collection::vec(0.0..=1.0_f64, 32), fires in 0..9_u32,
    ) {
        let mut picks = picks.into_iter().cycle();
        let member = pick_member(&scene, || picks.next().unwrap());
        let path = scene.leader_rear_m();
        prop_assert_eq!(path.len(), scene.steps as usize + 1);
        for (k, at) in simulate_scene(&scene, &member, &profiles).leader_rear_m.iter().enumerate() {
            prop_assert!(path[k].low() - 1e-9 <= *at && *at <= path[k].high() + 1e-9);
        }
        let (Some(follower), Some([x, v, b])) = (&scene.follower, member.follower) else { return Ok(()) };
        let mut state = [x, v];
        for k in 0..=scene.steps {
            let held = scene.follower_position_m(follower, fires, k);
            prop_assert!(held.low() - 1e-9 <= state[0] && state[0] <= held.high() + 1e-9);
            prop_assert!(scene.follower_position_m(follower, fires + 1, k).high() >= held.high() - 1e-9, "grows with \
                firing later");
            state = advance(state, if k >= fires + follower.reaction_steps { -b } else { 0.0 }, scene.step_s);
        }
    }
}

#[test]
fn a_vehicle_at_rest_stays_with_any_braking() {
    let (covered, speed) = motion::distance_and_speed_after(
        Interval::ZERO,
        Interval::point(-5.0),
        Interval::point(1.0),
    );
    assert!(covered.contains(0.0) && covered.high() < 1e-300 && covered.low() > -1e-300);
    assert!(speed.contains(0.0) && speed.high() < 1e-300);
}
