use proptest::prelude::*;

use super::super::tests::EGO;
use super::*;

#[test]
fn follows_by_idm_without_a_braking_vehicle() {
    let mut driver = Predictive::start(&PredictiveSettings::default(), &EGO, 0);
    let idm = Idm::from(&IdmSettings::default());
    let neighbour = |gap_m| {
        Some(Neighbour {
            gap_m,
            speed_mps: 20.0,
            acceleration_mps2: 0.0,
        })
    };
    let observation = Observation {
        speed_mps: 20.0,
        acceleration_mps2: 0.0,
        ahead: neighbour(40.0),
        behind: neighbour(40.0),
    };
    for _ in 0..300 {
        assert_eq!(
            driver.decide(&observation).unwrap(),
            idm.desired_acceleration_mps2(&observation)
        );
    }
}

/// A follower that ignores a slower ego vehicle has nothing but an emergency brake; one that drives `idm` reacts.
#[test]
fn recognises_the_driver_behind() {
    let idm = Idm::from(&IdmSettings::default());
    for is_idm in [false, true] {
        let mut follower = Follower::new(0.5, &EGO);
        let (mut gap_m, mut behind_mps) = (20.0, 20.0);
        for step in 0..300 {
            let own_mps = 20.0 - 1.5 * 0.01 * f64::from(step);
            let demand_mps2 = idm.acceleration_mps2(behind_mps, Some([gap_m, own_mps]));
            let behind_mps2 = if is_idm { demand_mps2 } else { 0.0 };
            let behind = Neighbour {
                gap_m,
                speed_mps: behind_mps,
                acceleration_mps2: behind_mps2,
            };
            let observation = Observation {
                speed_mps: own_mps,
                acceleration_mps2: -1.5,
                ahead: None,
                behind: Some(behind),
            };
            follower.observe(&behind, &observation, 5.0);
            gap_m += (own_mps - behind_mps) * 0.01;
            behind_mps += behind_mps2 * 0.01;
        }
        let probability = follower.unaware_probability();
        assert!(
            if is_idm {
                probability < 0.01
            } else {
                probability > 0.99
            },
            "{is_idm}: {probability}"
        );
    }
}

/// A leader that has stopped braking still matters while the ego vehicle is faster.
#[test]
fn braking_of_the_leader_is_over_once_the_ego_vehicle_is_as_slow() {
    let mut leader = Leader::new([1.4, 4.2], EGO.step_s);
    let mut observe = |speed_mps, acceleration_mps2, own_mps| {
        let ahead = Neighbour {
            gap_m: 20.0,
            speed_mps,
            acceleration_mps2,
        };
        (0..200).for_each(|_| leader.observe(&ahead, own_mps));
        leader.severity()
    };
    assert_eq!(observe(20.0, 0.0, 20.0), 0.0);
    assert!(observe(12.0, -3.0, 16.0) > 0.5);
    assert!(observe(10.0, 0.0, 14.0) > 0.5);
    assert_eq!(observe(10.0, 0.0, 10.2), 0.0);
}

#[test]
fn learns_the_friction_from_braking_that_falls_short() {
    let mut friction = Friction::new(&EGO);
    let mut usable_mps2 = friction.usable_brake_mps2(&seen_alone(20.0, 0.0));
    assert_eq!(usable_mps2, EGO.max_brake_mps2);
    for step in 0..100 {
        friction.record(-7.5);
        usable_mps2 = friction.usable_brake_mps2(&seen_alone(20.0 - 0.03 * f64::from(step), -3.0));
    }
    assert!((usable_mps2 - 3.0).abs() < 0.3, "{usable_mps2}");
}

fn seen_alone(speed_mps: f64, acceleration_mps2: f64) -> Observation {
    Observation {
        speed_mps,
        acceleration_mps2,
        ahead: None,
        behind: None,
    }
}

fn neighbours() -> impl Strategy<Value = Option<Neighbour>> {
    prop::option::of((-5.0..200.0f64, 0.0..60.0f64, -12.0..6.0f64).prop_map(
        |(gap_m, speed_mps, acceleration_mps2)| Neighbour {
            gap_m,
            speed_mps,
            acceleration_mps2,
        },
    ))
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// The answer is within the limits of the vehicle for any observations.
    #[test]
    fn answers_are_finite_and_within_the_limits(
        all in prop::collection::vec((0.0..60.0f64, -12.0..6.0f64, neighbours(), neighbours()), 1..40),
    ) {
        let mut driver = Predictive::start(&PredictiveSettings::default(), &EGO, 0);
        for (speed_mps, acceleration_mps2, ahead, behind) in all {
            let answer_mps2 = driver.decide(&Observation { speed_mps, acceleration_mps2, ahead, behind }).unwrap();
            prop_assert!((-EGO.max_brake_mps2..=EGO.max_accel_mps2).contains(&answer_mps2), "{}", answer_mps2);
        }
    }

    /// The waking time satisfies its equation. With a limit of the closing speed, waking takes at least as long.
    #[test]
    fn the_waking_time_ends_when_the_emergency_brake_of_the_follower_fires(
        gap_m in 3.0..80.0f64, brake_mps2 in 1.0..6.0f64, max_closing_mps in 5.0..25.0f64,
    ) {
        let free_s = waking_time_s(gap_m, 0.0, brake_mps2, f64::INFINITY);
        let left_m = gap_m - 0.5 * brake_mps2 * free_s * free_s;
        prop_assert!((left_m - FIRING_TTC_S * brake_mps2 * free_s).abs() < 1e-9);
        prop_assert!(waking_time_s(gap_m, 0.0, brake_mps2, max_closing_mps) >= free_s - 1e-9);
    }
}
