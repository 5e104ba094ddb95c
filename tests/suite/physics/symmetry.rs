//! Symmetries: changes in time, space and number of vehicles that do not change the outcome.

use crumple_fuzzing::oracle::{check_same_impacts, is_grazing};
use crumple_fuzzing::{RunSetup, TestedController};
use crumple_sim::engine::SimulationResult;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{
    Driver, LeadProfile, RecordedSpeeds, Scenario, ScenarioSpec, VehicleClass, VehicleSpec,
};
use crumple_testing::generator::{DriverKind, ScenarioShape, make_scripted};
use proptest::prelude::*;

use super::trace_of;
use crate::generate::{
    any_after_collision, any_profile, any_scenario, any_scenario_of_shape, any_setup, make_average,
    simulate_traced, with_cases, without_learned_drivers, without_noise,
};

fn assert_same_impacts(
    before: &SimulationResult,
    after: &SimulationResult,
    shift: usize,
    shift_s: f64,
) -> Result<(), TestCaseError> {
    check_same_impacts(before, after, shift, shift_s).map_err(TestCaseError::fail)
}

/// Vehicles at one speed whose drivers keep it until the leader acts.
fn any_steady_scenario() -> impl Strategy<Value = Scenario> {
    let followers = prop::collection::vec((0..4_u8).prop_map(DriverKind::Controller), 1..4);
    let shape = (
        1..6_u8,
        followers,
        prop::sample::select(vec![0.01, 0.02, 0.05]),
    )
        .prop_map(|(leader, followers, step_s)| {
            let leader = [DriverKind::Profile(leader)];
            ScenarioShape {
                step_s,
                drivers: leader.into_iter().chain(followers).collect(),
            }
        });
    (
        shape.prop_flat_map(|shape| any_scenario_of_shape(&shape)),
        5.0..40.0_f64,
    )
        .prop_map(|(scenario, speed_mps)| {
            let steady = |spec: &mut ScenarioSpec| {
                for vehicle in &mut spec.vehicles {
                    (vehicle.speed_mps, vehicle.acceleration_noise_mps2) = (speed_mps, 0.0);
                    if let Driver::Profile(LeadProfile::Recorded(RecordedSpeeds {
                        speed_mps: recorded,
                        ..
                    })) = &mut vehicle.driver
                    {
                        recorded[0] = speed_mps;
                    }
                }
            };
            scenario.edited(steady).expect("still valid")
        })
}

/// Returns the largest difference of positions after `by_m` is added to those of the first result.
fn largest_shift_m(first: &SimulationResult, other: &SimulationResult, by_m: f64) -> f64 {
    let vehicles = trace_of(first)
        .vehicles
        .iter()
        .zip(&trace_of(other).vehicles);
    let pairs = vehicles.flat_map(|(first, other)| first.position_m.iter().zip(&other.position_m));
    // NaN is the largest.
    pairs
        .map(|(x, y)| (x + by_m - y).abs())
        .max_by(f64::total_cmp)
        .unwrap_or(0.0)
}

fn delay_profile(profile: &mut LeadProfile, by_s: f64) {
    let later = |times: &mut Vec<f64>| times.iter_mut().for_each(|time_s| *time_s += by_s);
    match profile {
        LeadProfile::ConstantSpeed => {}
        LeadProfile::Brake(brake) => brake.onset_s += by_s,
        LeadProfile::RampBrake(ramp) => ramp.onset_s += by_s,
        LeadProfile::BrakeToSpeed(brake) => brake.onset_s += by_s,
        LeadProfile::Pieces(pieces) => later(&mut pieces.from_s),
        LeadProfile::Recorded(recorded) => later(&mut recorded.time_s),
    }
}

proptest! {
    #![proptest_config(with_cases(256))]

    /// A leader that acts k steps later delays everything by k steps, and shifts it along the road accordingly.
    #[test]
    fn time_shift(scenario in any_steady_scenario(), steps in 1..150_usize, after_collision in any_after_collision()) {
        let spec = scenario.spec();
        let by_s = steps as f64 * spec.step_s;
        let later = scenario.edited(|spec| {
            spec.duration_s += by_s;
            if let Driver::Profile(profile) = &mut spec.vehicles[0].driver {
                delay_profile(profile, by_s);
            }
        }).expect("still valid");
        let options = RunSetup { after_collision, ..RunSetup::with_true_state() }.options(spec.step_s);
        let (now, then) = (simulate_traced(&scenario, &options), simulate_traced(&later, &options));
        prop_assume!(!is_grazing(&now) && !is_grazing(&then));
        assert_same_impacts(&now, &then, 0, by_s)?;
        let farther_m = by_s * spec.vehicles[0].speed_mps;
        for (now, then) in trace_of(&now).vehicles.iter().zip(&trace_of(&then).vehicles) {
            for k in 0..now.position_m.len() {
                let apart_m = now.position_m[k] + farther_m - then.position_m[k + steps];
                prop_assert!(apart_m.abs() < 1e-7, "{apart_m} m apart at sample {k}");
            }
        }
    }

    /// The position along the road changes nothing, including noise and estimates, unless a nanometre would: rounding
    /// decides when a controller at its threshold switches.
    #[test]
    fn spatial_shift(
        scenario in any_scenario(),
        setup in any_setup().prop_filter("rounds to single precision", |setup| !setup.is_learned()),
        shift_m in -1e4..1e4_f64,
    ) {
        let scenario = without_learned_drivers(&scenario);
        let options = setup.options(scenario.spec().step_s);
        let moved = |by_m: &dyn Fn(usize) -> f64| {
            let add = |(index, vehicle): (usize, &mut VehicleSpec)| vehicle.position_m += by_m(index);
            let moved = scenario.edited(|spec| spec.vehicles.iter_mut().enumerate().for_each(add)).unwrap();
            simulate_traced(&moved, &options)
        };
        let (here, nearby, there) = (moved(&|_| 0.0), moved(&|index| 1e-9 * index as f64), moved(&|_| shift_m));
        prop_assume!(!is_grazing(&here) && !is_grazing(&there));
        let is_sensitive = largest_shift_m(&here, &nearby, 0.0) >= 1e-6;
        prop_assume!(!is_sensitive);
        assert_same_impacts(&here, &there, 0, 0.0)?;
        let apart_m = largest_shift_m(&here, &there, shift_m);
        prop_assert!(apart_m < 1e-6, "{apart_m} m apart");
    }

    /// One more vehicle out of reach ahead of a scripted leader changes no bit. Without noise, whose streams depend on
    /// the vehicle's number.
    #[test]
    fn one_more_vehicle_far_ahead(
        scenario in any_scenario(),
        profile in (0..6_u8).prop_flat_map(any_profile),
        setup in any_setup(),
    ) {
        let alone = without_noise(&scenario).edited(|spec| {
            spec.vehicles[0].max_brake_mps2 = Some(9.0);
            make_scripted(&mut spec.vehicles[0], profile);
        }).unwrap();
        let far = VehicleSpec::new(VehicleClass::Light, 1e5, 50.0, Driver::Profile(LeadProfile::ConstantSpeed));
        let led = alone.edited(|spec| spec.vehicles.insert(0, far)).unwrap();
        let mut setup = RunSetup { estimator: EstimatorKind::Truth, ..setup };
        if let TestedController::BuiltIn(controller) = &mut setup.controller {
            make_average(controller);
        }
        let options = setup.options(alone.spec().step_s);
        let (alone, led) = (simulate_traced(&alone, &options), simulate_traced(&led, &options));
        assert_same_impacts(&alone, &led, 1, 0.0)?;
        prop_assert_eq!(&trace_of(&alone).vehicles[..], &trace_of(&led).vehicles[1..]);
        prop_assert_eq!(&alone.vehicles[1..], &led.vehicles[2..]);
    }

    /// Built-in drivers ignore the vehicle behind: one more vehicle out of reach behind changes no bit, including
    /// noise. Without sensor faults, after which the filters of both sides draw initial errors from one stream.
    #[test]
    fn one_more_vehicle_far_behind(
        scenario in any_scenario(),
        setup in any_setup().prop_filter("looks behind", |setup| setup.looks_ahead_only()),
    ) {
        let scenario = without_learned_drivers(&scenario);
        let scenario = scenario.edited(|spec| spec.sensors.faults = Default::default()).unwrap();
        let last_m = scenario.vehicles().last().unwrap().position_m;
        let far = VehicleSpec::new(
            VehicleClass::Heavy, last_m - 1e4, 0.0, Driver::Profile(LeadProfile::ConstantSpeed));
        let followed = scenario.edited(|spec| spec.vehicles.push(far)).unwrap();
        let options = setup.options(scenario.spec().step_s);
        let (alone, followed) = (simulate_traced(&scenario, &options), simulate_traced(&followed, &options));
        prop_assert_eq!(&alone.impacts, &followed.impacts);
        let vehicles = alone.vehicles.len();
        prop_assert_eq!(&trace_of(&alone).vehicles[..], &trace_of(&followed).vehicles[..vehicles]);
        prop_assert_eq!(&alone.vehicles[..], &followed.vehicles[..vehicles]);
    }
}

#[test]
fn scenarios_of_the_symmetry_tests_are_neither_all_safe_nor_all_fatal() {
    use proptest::strategy::ValueTree;
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let scenarios: [BoxedStrategy<Scenario>; 2] =
        [any_scenario().boxed(), any_steady_scenario().boxed()];
    for strategy in scenarios {
        let options = RunSetup::with_true_state().options(0.01);
        let collisions = (0..200)
            .map(|_| {
                simulate_traced(&strategy.new_tree(&mut runner).unwrap().current(), &options)
                    .impacts
                    .len()
            })
            .sum::<usize>();
        assert!(
            (20..180).contains(&collisions),
            "{collisions} of 200 collide"
        );
    }
}
