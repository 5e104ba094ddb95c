use proptest::prelude::*;

use super::*;
use crate::control::BuiltInController;
use crate::engine::{AfterCollision, RecordingLevel, Run, RunOptions, simulate, simulate_batch};
use crate::observation::EstimatorKind;
use crate::scenario::{Driver, LeadProfile, PlantKind, Scenario, built_in_scenario};

/// Sets brake pressures at once, without an anti-lock braking system.
fn ideal_brake(mut vehicle: MultiBody) -> MultiBody {
    vehicle.brake = BrakePressure::new(0.0, false);
    vehicle
}

/// `.ci/multi_body.py` wrote the data with the package of CommonRoad. `MULTI_BODY_REFERENCE` names other data.
#[test]
fn trajectories_equal_those_of_the_commonroad_package() {
    let mut largest_error = 0.0_f64;
    let text =
        std::env::var("MULTI_BODY_REFERENCE").map(|path| std::fs::read_to_string(path).unwrap());
    let text = text.unwrap_or_else(|_| include_str!("reference.csv").to_owned());
    let lines = text.lines();
    assert_eq!(lines.clone().count(), 100);
    for line in lines {
        let values: Vec<f64> = line
            .split(',')
            .map(|value| value.parse().unwrap())
            .collect();
        let mut vehicle = ideal_brake(MultiBody::new(
            BodyKind::ALL[values[0] as usize - 1],
            1.0,
            values[1],
        ));
        // The package starts without pitch, and not in equilibrium.
        (vehicle.state[PITCH], vehicle.state[BODY_Z]) = (0.0, 0.0);
        for (demand_mps2, expected) in values[2..7].iter().zip(values[7..].chunks(5)) {
            for _ in 0..400 {
                vehicle
                    .brake
                    .advance((-demand_mps2).max(0.0), [0.0; 2], 10.0, 1e-3);
                vehicle.integrate(*demand_mps2, 1e-3);
            }
            for (index, expected) in [POSITION, SPEED, PITCH, WHEEL[0], WHEEL[1]]
                .into_iter()
                .zip(expected)
            {
                let error = (vehicle.state[index] - expected).abs() / expected.abs().max(1e-3);
                largest_error = largest_error.max(error);
            }
        }
    }
    assert!(largest_error <= 1e-9, "{largest_error:e}");
    println!("largest relative error {largest_error:e}");
}

/// Returns the distance until a vehicle stops, or until the time is over, in metres.
fn braking_distance_m(
    mut vehicle: MultiBody,
    demand_mps2: f64,
    speed_mps: f64,
    steps: usize,
    dt_s: f64,
) -> f64 {
    let (mut position_m, mut speed_mps) = (0.0, speed_mps);
    for _ in 0..steps {
        let acceleration_mps2 = vehicle.respond(demand_mps2, speed_mps, dt_s);
        (position_m, speed_mps) =
            crate::engine::motion::advance(position_m, speed_mps, acceleration_mps2, dt_s);
        assert!(
            (speed_mps - vehicle.state[SPEED]).abs() < 1e-9,
            "{speed_mps} {}",
            vehicle.state[SPEED]
        );
    }
    position_m
}

#[test]
fn a_vehicle_in_equilibrium_keeps_its_speed_and_height() {
    for kind in BodyKind::ALL {
        for speed_mps in [0.0, 0.05, 1.0, 30.0] {
            let mut vehicle = MultiBody::new(kind, 1.0, speed_mps);
            let [pitch, height_m] = [vehicle.state[PITCH], vehicle.state[BODY_Z]];
            for _ in 0..100 {
                let now_mps = vehicle.state[SPEED];
                vehicle.respond(0.0, now_mps, 0.01);
            }
            assert!(
                (vehicle.state[SPEED] - speed_mps).abs() < 1e-3,
                "{kind:?} {:?}",
                vehicle.state
            );
            assert!(
                (vehicle.state[PITCH] - pitch).abs() < 1e-4
                    && (vehicle.state[BODY_Z] - height_m).abs() < 1e-4
            );
        }
    }
}

#[test]
fn the_braking_distance_is_that_of_the_package_at_any_step() {
    let bmw = || ideal_brake(MultiBody::new(BodyKind::Bmw320i, 1.0, 25.0));
    let distance_m = braking_distance_m(bmw(), -7.5, 25.0, 300, 0.01);
    // The package by the method of Runge and Kutta with 1 ms, without lateral forces: 43.0252 m.
    assert!((distance_m - 43.0252).abs() < 0.005, "{distance_m}");
    for kind in BodyKind::ALL {
        let stop_m = |steps, dt_s| {
            braking_distance_m(MultiBody::new(kind, 1.0, 25.0), -6.0, 25.0, steps, dt_s)
        };
        let (coarse_m, fine_m) = (stop_m(800, 0.01), stop_m(8000, 0.001));
        assert!(
            (coarse_m - fine_m).abs() < 0.002,
            "{kind:?} {coarse_m} {fine_m}"
        );
        // 52.1 m at once, and the distance covered while the pressure rises.
        assert!((52.0..70.0).contains(&coarse_m), "{kind:?} {coarse_m}");
    }
}

#[test]
fn the_anti_lock_system_keeps_the_wheels_turning() {
    for (kind, friction) in BodyKind::ALL
        .into_iter()
        .flat_map(|kind| [0.3, 0.6, 1.0].map(|friction| (kind, friction)))
    {
        let mut locked = MultiBody::new(kind, friction, 25.0);
        locked.brake = BrakePressure::new(locked.body.brake.lag_s, false);
        let controlled = MultiBody::new(kind, friction, 25.0);
        let [locked_m, controlled_m] =
            [locked, controlled].map(|v| braking_distance_m(v, -12.0, 25.0, 3000, 0.01));
        let ideal_m = 25.0 * 25.0 / (2.0 * friction * body_params(kind).tyre.p_dx1 * GRAVITY_MPS2);
        println!(
            "{kind:?} {friction}: locked {locked_m:.1} m, ABS {controlled_m:.1} m, ideal {ideal_m:.1} m"
        );
        assert!(
            controlled_m < locked_m && controlled_m > ideal_m,
            "{kind:?} {friction}"
        );
    }
}

/// Below 0.1 m/s the wheels roll without slip; the tyres limit the braking there, too.
#[test]
fn friction_limits_the_braking_of_a_rolling_vehicle() {
    for kind in BodyKind::ALL {
        let stop_m = |friction| {
            braking_distance_m(MultiBody::new(kind, friction, 0.09), -7.5, 0.09, 300, 0.01)
        };
        let peak_mps2 = body_params(kind).tyre.p_dx1 * 0.1 * GRAVITY_MPS2;
        assert!(
            stop_m(0.1) >= 0.09 * 0.09 / (2.0 * peak_mps2) && stop_m(0.1) > stop_m(1.0),
            "{kind:?}"
        );
    }
}

/// Returns the speed after `seconds` under a demand.
fn drive_mps(vehicle: &mut MultiBody, demand_mps2: f64, seconds: f64, dt_s: f64) -> f64 {
    for _ in 0..(seconds / dt_s).round() as usize {
        let speed_mps = vehicle.state[SPEED];
        vehicle.respond(demand_mps2, speed_mps, dt_s);
    }
    vehicle.state[SPEED]
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(64))]

    /// The wheels take up to a tenth of the demand.
    #[test]
    fn a_vehicle_drives_off_stops_and_drives_off_again(
        kind in prop::sample::select(BodyKind::ALL.to_vec()), demand_mps2 in 0.3..3.0_f64, brake_mps2 in 0.5..6.0_f64,
        dt_s in prop::sample::select(vec![0.001, 0.01, 0.02, 0.1]),
    ) {
        let mut vehicle = MultiBody::new(kind, 1.0, 0.0);
        for start in ["first", "second"] {
            let speed_mps = drive_mps(&mut vehicle, demand_mps2, 4.0, dt_s);
            let share = speed_mps / (4.0 * demand_mps2);
            // The air brakes of the lorry release within a second.
            let least = if start == "first" { 0.9 } else { 0.6 };
            prop_assert!((least..=1.01).contains(&share), "{kind:?}, {start} start: {speed_mps} m/s");
            let rolls_mps = vehicle.state[WHEEL[0]] * vehicle.body.wheel_radius_m;
            prop_assert!((rolls_mps / speed_mps - 1.0).abs() < 0.05, "{rolls_mps} {speed_mps}");
            prop_assert_eq!(drive_mps(&mut vehicle, -brake_mps2, 40.0, dt_s), 0.0);
        }
    }
}

/// The demand turns the wheels, too, as in the package: expected speeds are those of the package's vehicles 1 to 3 from
/// 5 m/s after 4 s at a demand of 1 m/s², divided by the demanded change.
#[test]
fn a_demand_changes_the_speed_as_in_the_commonroad_package() {
    for (kind, expected) in BodyKind::ALL
        .into_iter()
        .zip([0.954_84, 0.949_55, 0.962_19])
    {
        let mut vehicle = MultiBody::new(kind, 1.0, 5.0);
        let share = (drive_mps(&mut vehicle, 1.0, 4.0, 1e-3) - 5.0) / 4.0;
        assert!((share - expected).abs() < 2e-4, "{kind:?} {share}");
    }
}

/// The scenario of a bug report: at rest, 500 m behind a leader of 20 m/s.
#[test]
fn idm_drives_off_as_a_point_mass_does() {
    let mut spec = paper_scenario(0).spec().clone();
    (spec.duration_s, spec.seed) = (20.0, 0);
    spec.vehicles.truncate(2);
    let [leader, ego] = spec.vehicles.as_mut_slice() else {
        panic!("two vehicles")
    };
    (leader.position_m, leader.speed_mps, leader.driver) =
        (500.0, 20.0, Driver::Profile(LeadProfile::ConstantSpeed));
    (ego.position_m, ego.speed_mps) = (0.0, 0.0);
    let final_mps = |body: Option<BodyKind>| {
        let mut spec = spec.clone();
        let ego = &mut spec.vehicles[1];
        (ego.plant, ego.body) = (
            body.map_or(PlantKind::PointMass, |_| PlantKind::MultiBody),
            body,
        );
        let options = RunOptions::new(BuiltInController::from_name("idm").unwrap())
            .with_estimator(EstimatorKind::Truth);
        let run = Run::new(&Scenario::new(spec).unwrap(), options).unwrap();
        *simulate(&run, RecordingLevel::Trace)
            .trace
            .unwrap()
            .vehicles[1]
            .speed_mps
            .last()
            .unwrap()
    };
    let point_mass_mps = final_mps(None);
    assert!((point_mass_mps - 14.5).abs() < 0.05, "{point_mass_mps}");
    for kind in BodyKind::ALL {
        let speed_mps = final_mps(Some(kind));
        // The engine also turns the wheels: up to 5 % of the mass.
        assert!(
            (0.94..=1.0).contains(&(speed_mps / point_mass_mps)),
            "{kind:?} {speed_mps}"
        );
    }
}

fn paper_scenario(index: usize) -> Scenario {
    let multi_body = |spec: &mut crate::scenario::ScenarioSpec| {
        for vehicle in spec.vehicles.iter_mut().skip(1) {
            vehicle.plant = PlantKind::MultiBody;
        }
        spec.vehicles[1].acceleration_noise_mps2 = if index == 2 { 0.3 } else { 0.0 };
    };
    built_in_scenario(&format!("paper-{}", index + 1))
        .unwrap()
        .edited(multi_body)
        .unwrap()
}

#[test]
fn the_engines_agree_in_runs_with_collisions() {
    let runs: Vec<Run> = ["baseline", "idm"]
        .into_iter()
        .flat_map(|name| (0..3).map(move |index| (name, index)))
        .map(|(name, index)| {
            let options = RunOptions::new(BuiltInController::from_name(name).unwrap())
                .with_estimator(EstimatorKind::Truth)
                .with_after_collision(AfterCollision::Continue);
            Run::new(&paper_scenario(index), options).unwrap()
        })
        .collect();
    let batch = simulate_batch(&runs, RecordingLevel::Trace, |_, simulated| simulated);
    assert!(batch.iter().any(|result| !result.impacts.is_empty()));
    for (run, batch) in runs.iter().zip(batch) {
        assert_eq!(simulate(run, RecordingLevel::Trace), batch);
    }
}

#[test]
fn plants_of_scripted_vehicles_and_bodies_of_point_masses_are_refused() {
    let paper = built_in_scenario("paper-1").unwrap();
    let scripted = paper
        .edited(|spec| spec.vehicles[0].plant = PlantKind::MultiBody)
        .unwrap_err();
    assert!(
        scripted.to_string().contains("vehicles[0].plant"),
        "{scripted}"
    );
    let point_mass = paper
        .edited(|spec| spec.vehicles[1].body = Some(BodyKind::Bmw320i))
        .unwrap_err();
    assert!(
        point_mass.to_string().contains("vehicles[1].body"),
        "{point_mass}"
    );
}
