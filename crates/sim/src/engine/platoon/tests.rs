use proptest::prelude::*;

use super::*;

fn platoon(vehicles: &[(f64, f64, f64, f64)]) -> PlatoonState {
    PlatoonState {
        motion: vehicles
            .iter()
            .map(|&(position_m, speed_mps, acceleration_mps2, _)| Motion {
                position_m,
                speed_mps,
                acceleration_mps2,
            })
            .collect(),
        length_m: vec![2.0; vehicles.len()],
        mass_kg: vehicles.iter().map(|v| v.3).collect(),
        lane: LaneState::with_all(vehicles.len()),
        locked_to_front: vec![false; vehicles.len()],
        min_gap_m: vec![f64::INFINITY; vehicles.len()],
    }
}

#[test]
fn a_chain_of_impacts_in_one_step_keeps_momentum_and_order() {
    // The rear vehicle hits the middle one (gap 1 m at 10 m/s), and both then hit the front one (gap 0.5 m).
    let mut platoon = platoon(&[
        (10.0, 0.0, 0.0, 1000.0),
        (7.5, 0.0, 0.0, 1000.0),
        (4.5, 10.0, 0.0, 2000.0),
    ]);
    let mut impacts = Vec::new();
    let done_s = platoon.advance(0.0, 0.5, AfterCollision::Continue, &mut impacts);
    assert_eq!(done_s, 0.5);
    assert_eq!(impacts.len(), 2);
    assert!((impacts[0].collision.time_s - 0.1).abs() < 1e-12);
    assert!((impacts[0].common_speed_mps - 20.0 / 3.0).abs() < 1e-12);
    assert!((impacts[1].collision.time_s - (0.1 + 0.5 / (20.0 / 3.0))).abs() < 1e-12);
    assert_eq!(
        (impacts[1].first_involved, impacts[1].last_involved),
        (0, 2)
    );
    for motion in &platoon.motion {
        assert!(
            (motion.speed_mps - 5.0).abs() < 1e-12,
            "20 000 kg m/s over 4000 kg"
        );
    }
    assert!((impacts[1].delta_v_mps(0) - 5.0).abs() < 1e-12);
    assert!((impacts[1].delta_v_mps(2) - (20.0 / 3.0 - 5.0)).abs() < 1e-12);
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn collision_free_advance_equals_the_full_one(
        line in prop::collection::vec((0.0..4.0_f64, 0.0..40.0_f64, -9.0..4.0_f64), 1..10),
        dt_s in 1e-3..0.2_f64,
    ) {
        let mut front_m = 0.0;
        let vehicles = line.into_iter().map(|(gap_m, speed_mps, acceleration_mps2)| {
            front_m -= 2.0 + gap_m;
            (front_m, speed_mps, acceleration_mps2, 1000.0)
        });
        let mut long = platoon(&vehicles.collect::<Vec<_>>());
        let mut short = long.clone();
        if short.advance_collision_free(dt_s) {
            prop_assert_eq!(long.next_collision(None, dt_s), None);
            long.advance_and_track_gaps(None, dt_s);
        }
        prop_assert_eq!(&short.motion, &long.motion);
        prop_assert_eq!(&short.min_gap_m, &long.min_gap_m);
    }
}

#[test]
fn locked_vehicles_brake_with_their_summed_force() {
    let mut platoon = platoon(&[(2.0, 10.0, 0.0, 1000.0), (0.0, 10.0, -4.0, 3000.0)]);
    platoon.locked_to_front[1] = true;
    platoon.share_acceleration();
    platoon.advance(0.0, 1.0, AfterCollision::Continue, &mut Vec::new());
    assert!((platoon.motion[0].speed_mps - 7.0).abs() < 1e-12);
    assert!(platoon.gap_m(1).unwrap().abs() < 1e-12);
}
