//! Properties of every built-in controller for any observation.

use crumple_measure::ttc_s;
use crumple_world::control::{
    AebSettings, Baseline, BuiltIn, BuiltInController, Controller, ControllerSource, Ego, Role,
};
use crumple_world::observation::{Neighbour, Observation};
use proptest::prelude::*;

use crate::generate::{any_controller, with_cases};

prop_compose! {
    fn any_ego()(max_brake_mps2 in 0.1..30.0_f64, max_accel_mps2 in 0.0..30.0_f64, length_m in 0.1..100.0_f64,
                 step_s in 1e-4..1.0_f64) -> Ego {
        Ego { vehicle: 1, max_brake_mps2, max_accel_mps2, length_m, step_s }
    }
}

/// Any observation, including diverged estimates such as negative gaps and impossible accelerations.
fn any_observation() -> impl Strategy<Value = Observation> {
    let neighbour = || {
        let seen = (-10.0..500.0_f64, 0.0..110.0_f64, -100.0..100.0_f64).prop_map(
            |(gap_m, speed_mps, acceleration_mps2)| Neighbour {
                gap_m,
                speed_mps,
                acceleration_mps2,
            },
        );
        prop::option::weighted(0.9, seen)
    };
    (0.0..110.0_f64, -100.0..100.0_f64, neighbour(), neighbour()).prop_map(
        |(speed_mps, acceleration_mps2, ahead, behind)| Observation {
            speed_mps,
            acceleration_mps2,
            ahead,
            behind,
        },
    )
}

proptest! {
    #![proptest_config(with_cases(1024))]

    #[test]
    fn commands_are_finite(
        spec in any_controller(),
        ego in any_ego(),
        seen in prop::collection::vec(any_observation(), 1..20),
    ) {
        let mut controller = spec.start(&ego, 0).unwrap();
        for seen in &seen {
            let command = controller.decide(seen).unwrap();
            prop_assert!(command.is_finite(), "{} commands {command} for {seen:?}", spec.name());
        }
    }

    /// The baseline has two commands, and brakes from the first time to collision below its threshold on.
    #[test]
    fn the_baseline_brakes_from_the_first_ttc_below_its_threshold(
        threshold_s in 0.0..4.0_f64,
        ego in any_ego(),
        seen in prop::collection::vec(any_observation(), 1..30),
    ) {
        let mut baseline = Baseline::start(&AebSettings { ttc_s: threshold_s }, &ego, 0);
        let mut braking = false;
        for seen in seen.iter().filter(|seen| seen.ahead.is_none_or(|ahead| ahead.gap_m > 0.0)) {
            let closing_s = seen.ahead.and_then(|ahead| ttc_s(ahead.gap_m, seen.speed_mps - ahead.speed_mps));
            braking |= closing_s.is_some_and(|closing_s| closing_s < threshold_s);
            prop_assert_eq!(baseline.decide(seen), Ok(if braking { -ego.max_brake_mps2 } else { 0.0 }));
        }
    }

    /// Controllers that do not observe the follower.
    #[test]
    fn built_in_controllers_look_ahead_only(
        spec in any_controller()
            .prop_filter("looks behind", |spec| !spec.observes_follower()),
        ego in any_ego(),
        seen in prop::collection::vec(any_observation(), 1..10),
    ) {
        let [mut looking, mut blind] = [0; 2].map(|_| spec.start(&ego, 0).unwrap());
        for seen in seen {
            prop_assert_eq!(looking.decide(&seen), blind.decide(&Observation { behind: None, ..seen }));
        }
    }
}

/// A new rule-based controller is generated too, with its settings.
#[test]
fn every_rule_is_generated() {
    for rule in BuiltInController::all()
        .into_iter()
        .filter(|spec| spec.role() <= Role::Reference)
    {
        assert!(
            crumple_testing::generator::CONTROLLERS.contains(&rule),
            "{}",
            rule.name()
        );
    }
}
