//! Random scenarios for the property tests, and how many of them to try.

mod driver;
mod options;

use crumple::scenario::{
    Driver, Environment, LeadProfile, SCENARIO_VERSION, Scenario, ScenarioSpec, Sensors, VehicleClass, VehicleSpec,
};
use crumple::sim::{Keep, Run, RunOptions, Simulated, simulate};
use proptest::prelude::*;

use driver::driver_of;
pub(crate) use driver::{Kind, any_controller, any_profile, kind};
pub(crate) use options::{Setup, any_after_contact, any_setup};

/// A configuration for `normal` cases, scaled by `PROPTEST_CASES` as every other one is.
pub(crate) fn cases(normal: u32) -> ProptestConfig {
    let config = ProptestConfig::default();
    let scaled = u64::from(normal) * u64::from(config.cases) / 256;
    ProptestConfig { cases: scaled.max(1) as u32, max_shrink_iters: 2000, ..config }
}

/// Runs a scenario with everything recorded.
pub(crate) fn traced(scenario: &Scenario, options: &RunOptions) -> Simulated {
    simulate(&Run::new(scenario, options.clone()).expect("fits"), Keep::Trace)
}

/// What runs must share to be simulated in one block: step, and who drives, front to rear.
#[derive(Debug, Clone)]
pub(crate) struct Shape {
    pub(crate) step_s: f64,
    pub(crate) drivers: Vec<Kind>,
}

/// Any shape: 2 to 6 vehicles driven by anything.
pub(crate) fn any_shape() -> impl Strategy<Value = Shape> {
    (prop::sample::select(vec![0.01, 0.02, 0.05, 0.1]), prop::collection::vec(kind(), 2..=6))
        .prop_map(|(step_s, drivers)| Shape { step_s, drivers })
}

/// Any valid scenario of up to 200 steps, with all that a file can say.
pub(crate) fn any_scenario() -> impl Strategy<Value = Scenario> {
    any_shape().prop_flat_map(|shape| scenario_of(&shape))
}

/// Any scenario without noise, reaction or actuator delays left as they are.
pub(crate) fn noise_free(scenario: &Scenario) -> Scenario {
    let quiet = |spec: &mut ScenarioSpec| spec.vehicles.iter_mut().for_each(|v| v.acceleration_noise_mps2 = 0.0);
    scenario.edited(quiet).expect("still valid")
}

/// Any scenario of a shape.
pub(crate) fn scenario_of(shape: &Shape) -> impl Strategy<Value = Scenario> + use<> {
    let step_s = shape.step_s;
    let vehicles: Vec<_> = shape.drivers.iter().map(|&kind| (vehicle(), driver_of(kind))).collect();
    let noise = (0.0..0.2_f64, 0.0..0.2_f64, prop_oneof![Just(0.0), Just(1.0), 0.0..0.5_f64]);
    let friction = prop_oneof![2 => Just(1.0), 1 => 0.05..1.0_f64];
    (vehicles, noise, friction, 1..=200_u32, 0..=i64::MAX as u64, -1e4..1e4_f64).prop_map(
        move |(vehicles, (position_noise_m, gap_noise_m, dropout), friction, steps, seed, position_m)| {
            let mut vehicles: Vec<_> = vehicles.into_iter().map(|(place, driver)| place.driven_by(driver)).collect();
            line_up(&mut vehicles, position_m);
            let spec = ScenarioSpec {
                version: SCENARIO_VERSION,
                name: "random".to_owned(),
                about: String::new(),
                duration_s: f64::from(steps) * step_s,
                step_s,
                seed,
                environment: Environment { friction },
                sensors: Sensors { position_noise_m, gap_noise_m, dropout },
                vehicles,
            };
            Scenario::new(spec).expect("valid by construction")
        },
    )
}

/// Turns each position, so far the gap ahead, into a place on the road behind `position_m`.
pub(crate) fn line_up(vehicles: &mut [VehicleSpec], mut position_m: f64) {
    for vehicle in vehicles {
        position_m -= vehicle.position_m;
        vehicle.position_m = position_m;
        position_m -= vehicle.length_m();
    }
}

/// A vehicle whose position is still the gap ahead of it.
#[derive(Debug, Clone)]
struct Place(VehicleSpec);

impl Place {
    fn driven_by(self, driver: Driver) -> VehicleSpec {
        let mut vehicle = VehicleSpec { driver, ..self.0 };
        if let Driver::Profile(profile) = vehicle.driver.clone() {
            script(&mut vehicle, profile);
        }
        vehicle
    }
}

/// Makes a vehicle follow a script that it is able to follow: strong enough, and without delay.
pub(crate) fn script(vehicle: &mut VehicleSpec, profile: LeadProfile) {
    let [lowest_mps2, highest_mps2] = profile.acceleration_range_mps2();
    if -lowest_mps2 > vehicle.max_brake_mps2() {
        vehicle.max_brake_mps2 = Some(-lowest_mps2);
    }
    if highest_mps2 > vehicle.max_accel_mps2() {
        vehicle.max_accel_mps2 = Some(highest_mps2);
    }
    (vehicle.reaction_delay_s, vehicle.actuator_delay_s, vehicle.actuator_lag_s) = (0.0, 0.0, 0.0);
    vehicle.jerk_limit_mps3 = None;
    vehicle.driver = Driver::Profile(profile);
}

fn vehicle() -> impl Strategy<Value = Place> {
    let gap_m = prop_oneof![1 => 0.01..2.0_f64, 3 => 2.0..40.0_f64];
    let speed_mps = prop_oneof![1 => Just(0.0), 1 => Just(25.0), 4 => 0.0..45.0_f64];
    let body = (
        prop::sample::select(VehicleClass::ALL.to_vec()),
        gap_m,
        speed_mps,
        prop::option::weighted(0.3, 0.5..30.0_f64),
        prop::option::weighted(0.3, 500.0..40_000.0_f64),
        prop::option::weighted(0.3, 2.0..12.0_f64),
        prop::option::weighted(0.3, 0.0..6.0_f64),
    );
    let delay_s = || prop_oneof![3 => Just(0.0), 1 => 0.0..0.5_f64];
    let noise_mps2 = prop_oneof![2 => Just(0.0), 1 => 0.0..1.0_f64];
    let response = (noise_mps2, delay_s(), delay_s(), delay_s(), prop::option::weighted(0.3, 1.0..50.0_f64));
    (body, response).prop_map(|(body, response)| {
        let (class, gap_m, speed_mps, length_m, mass_kg, max_brake_mps2, max_accel_mps2) = body;
        let (acceleration_noise_mps2, reaction_delay_s, actuator_delay_s, actuator_lag_s, jerk_limit_mps3) = response;
        Place(VehicleSpec {
            length_m,
            mass_kg,
            max_brake_mps2,
            max_accel_mps2,
            acceleration_noise_mps2,
            reaction_delay_s,
            actuator_lag_s,
            actuator_delay_s,
            jerk_limit_mps3,
            ..VehicleSpec::new(class, gap_m, speed_mps, Driver::Profile(LeadProfile::ConstantSpeed))
        })
    })
}
