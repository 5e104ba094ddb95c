//! Random scenarios with an emergency.

use crumple_verify::{ConstantPiece, Scene};
use crumple_world::control::{AebSettings, BuiltInController};
use crumple_world::random::derived_seed;
use crumple_world::scenario::{
    Brake, Driver, Environment, LeadProfile, PiecewiseAcceleration, Scenario, ScenarioSpec,
    VehicleClass, VehicleSpec,
};

use crate::generate::scenario_spec;

/// Numbers between 0 and 1 that depend on a seed alone.
pub(crate) struct Dice(pub(crate) u64);

impl Dice {
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = derived_seed(self.0, 1);
        low + (high - low) * (self.0 >> 10) as f64 / (1_u64 << 53) as f64
    }

    fn one_in(&mut self, times: f64) -> bool {
        self.between(0.0, times) < 1.0
    }
}

pub(crate) fn random_scenario(seed: u64) -> Scenario {
    let dice = &mut Dice(seed);
    let class = |dice: &mut Dice| {
        if dice.one_in(2.0) {
            VehicleClass::Heavy
        } else {
            VehicleClass::Light
        }
    };
    let speed_mps = dice.between(10.0, 40.0);
    let brake = Brake {
        onset_s: dice.between(0.0, 2.0),
        rate_mps2: dice.between(1.0, 9.0),
    };
    let mut leader = VehicleSpec::new(
        class(dice),
        0.0,
        speed_mps + dice.between(-5.0, 5.0),
        Driver::Profile(LeadProfile::Brake(brake)),
    );
    leader.max_brake_mps2 = Some(9.0);
    let mut vehicles = vec![leader];
    let egos = if dice.one_in(6.0) { 2 } else { 1 };
    for _ in 0..egos {
        let mut ego =
            VehicleSpec::new(class(dice), dice.between(2.0, 80.0), 0.0, Driver::UnderTest);
        ego.speed_mps = speed_mps + dice.between(-3.0, 3.0);
        if dice.one_in(4.0) {
            ego.reaction_delay_s = dice.between(0.0, 0.4);
        }
        vehicles.push(ego);
    }
    if !dice.one_in(8.0) {
        let aeb = AebSettings {
            ttc_s: dice.between(0.8, 2.0),
        };
        let driver = Driver::Controller(BuiltInController::Baseline(aeb));
        let mut follower = VehicleSpec::new(class(dice), dice.between(2.0, 80.0), 0.0, driver);
        follower.speed_mps = speed_mps + dice.between(-3.0, 3.0);
        if dice.one_in(2.0) {
            follower.reaction_delay_s = dice.between(0.0, 0.8);
        }
        vehicles.push(follower);
    }
    let friction = if dice.one_in(2.0) {
        1.0
    } else {
        dice.between(0.25, 1.0)
    };
    let name = format!("random-{seed}");
    scenario_from_gaps(ScenarioSpec {
        environment: Environment { friction },
        ..scenario_spec(&name, 0.01, 15.0, vehicles)
    })
}

pub(crate) fn small_scenario(seed: u64) -> Scenario {
    let dice = &mut Dice(seed + 1_000_000);
    let brake = Brake {
        onset_s: 0.0,
        rate_mps2: dice.between(4.0, 9.0),
    };
    let mut leader = VehicleSpec::new(
        VehicleClass::Light,
        0.0,
        12.0,
        Driver::Profile(LeadProfile::Brake(brake)),
    );
    leader.max_brake_mps2 = Some(9.0);
    let ego_mps = dice.between(12.0, 20.0);
    let ego = VehicleSpec::new(
        VehicleClass::Light,
        dice.between(4.0, 25.0),
        ego_mps,
        Driver::UnderTest,
    );
    let driver = Driver::Controller(BuiltInController::Baseline(AebSettings::default()));
    let follower = VehicleSpec::new(
        VehicleClass::Heavy,
        dice.between(3.0, 12.0),
        ego_mps + dice.between(0.0, 4.0),
        driver,
    );
    scenario_from_gaps(scenario_spec(
        &format!("small-{seed}"),
        0.1,
        3.0,
        vec![leader, ego, follower],
    ))
}

/// Builds a scenario in which positions are still gaps ahead.
fn scenario_from_gaps(mut spec: ScenarioSpec) -> Scenario {
    let mut rear_bumper_m = 0.0;
    for vehicle in &mut spec.vehicles {
        vehicle.position_m = rear_bumper_m - vehicle.position_m;
        rear_bumper_m = vehicle.position_m - vehicle.length_m();
    }
    Scenario::new(spec).expect("valid by construction")
}

/// Scripts a vehicle, within its limits.
pub(crate) fn with_pieces(
    scenario: &Scenario,
    vehicle: usize,
    from_s: Vec<f64>,
    accel_mps2: Vec<f64>,
) -> Scenario {
    let script = Driver::Profile(LeadProfile::Pieces(PiecewiseAcceleration {
        from_s,
        accel_mps2,
    }));
    scenario
        .edited(|spec| spec.vehicles[vehicle].driver = script)
        .expect("within the limits")
}

/// Returns the scenario that the scene of a certificate describes, with a profile for each ego if there are any; `None`
/// if no scenario file can describe it.
pub(crate) fn scenario_of_scene(
    scene: &Scene,
    witness: &[Vec<ConstantPiece<f64>>],
) -> Option<Scenario> {
    let pieces = |runs: Vec<(u32, f64)>| {
        let mut step = 0;
        let (mut from_s, mut accel_mps2) = (Vec::new(), Vec::new());
        for (steps, value) in runs {
            from_s.push(f64::from(step) * scene.step_s);
            accel_mps2.push(value);
            step += steps;
        }
        Driver::Profile(LeadProfile::Pieces(PiecewiseAcceleration {
            from_s,
            accel_mps2,
        }))
    };
    let script = scene
        .leader
        .acceleration_mps2
        .iter()
        .map(|ConstantPiece(steps, value)| (*steps, value.low()))
        .collect();
    let (position_m, speed_mps) = (scene.leader.position_m.low(), scene.leader.speed_mps.low());
    let mut leader = VehicleSpec::new(VehicleClass::Light, position_m, speed_mps, pieces(script));
    (
        leader.length_m,
        leader.max_brake_mps2,
        leader.max_accel_mps2,
    ) = (Some(scene.leader.length_m), Some(30.0), Some(30.0));
    let mut vehicles = vec![leader];
    for (index, ego) in scene.egos.iter().enumerate() {
        let runs = witness.get(index).map(|runs| {
            runs.iter()
                .map(|ConstantPiece(steps, value)| (*steps, *value))
                .collect()
        });
        let driver = runs.map_or(Driver::UnderTest, pieces);
        let mut vehicle = VehicleSpec::new(
            VehicleClass::Light,
            ego.position_m.low(),
            ego.speed_mps.low(),
            driver,
        );
        vehicle.length_m = Some(ego.length_m);
        (vehicle.max_brake_mps2, vehicle.max_accel_mps2) =
            (Some(ego.max_brake_mps2), Some(ego.max_accel_mps2));
        vehicles.push(vehicle);
    }
    if let Some(follower) = &scene.follower {
        let driver = Driver::Controller(BuiltInController::Baseline(AebSettings {
            ttc_s: follower.ttc_s,
        }));
        let (position_m, speed_mps) = (follower.position_m.low(), follower.speed_mps.low());
        let mut vehicle = VehicleSpec::new(VehicleClass::Light, position_m, speed_mps, driver);
        vehicle.max_brake_mps2 = Some(follower.brake_mps2.low());
        vehicle.reaction_delay_s = f64::from(follower.reaction_steps) * scene.step_s;
        vehicles.push(vehicle);
    }
    let duration_s = f64::from(scene.steps) * scene.step_s;
    Scenario::new(scenario_spec("mutant", scene.step_s, duration_s, vehicles)).ok()
}
