//! Plants and sensor faults: proofs refuse them, and replays with the multi-body plant.

use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_measure::Specification;
use crumple_search::confirmation::escape_survives;
use crumple_search::worst_case::{
    AvoidOptions, AvoidanceVerdict, SensorFailure, attack_sensors, avoid, covers_scenario,
};
use crumple_sim::engine::{NamedController, Run, RunOptions};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{
    Driver, LeadProfile, PlantKind, Scenario, ScenarioSpec, SensorFaults, VehicleClass,
    VehicleSpec, built_in_scenario,
};
use crumple_verify::Assumption;

fn find(controller: &str) -> NamedController {
    Controllers::default()
        .find(controller, std::path::Path::new(""))
        .unwrap()
}

#[test]
fn proofs_about_point_masses_are_about_no_other_plant() {
    let point_mass = built_in_scenario("paper-1").unwrap();
    let multi_body = point_mass.with_plant(PlantKind::MultiBody).unwrap();
    assert_eq!(
        multi_body.with_plant(PlantKind::PointMass).unwrap(),
        point_mass
    );
    let escape = avoid(
        &point_mass,
        AvoidOptions {
            certify_bound: true,
            ..AvoidOptions::default()
        },
    )
    .unwrap();
    let proof = escape.bound_certificate.unwrap();
    assert!(covers_scenario(&proof, &point_mass) && !covers_scenario(&proof, &multi_body));
    // The certificate and the output of the checker name the plant.
    assert!(proof.assumptions.contains(&Assumption::ExactMotion));
    assert!(
        Assumption::ExactMotion
            .to_string()
            .contains("plant `point-mass`")
    );
    let AvoidanceVerdict::Undecided(reason) =
        avoid(&multi_body, AvoidOptions::default()).unwrap().verdict
    else {
        panic!("the programs model no other plant")
    };
    assert!(reason.to_string().contains("`multi-body`"), "{reason}");
    let options = RunOptions::new(find("shield:idm").source).with_estimator(EstimatorKind::Truth);
    assert!(Run::new(&point_mass, options.clone()).is_ok());
    let refused = Run::new(&multi_body, options).err().unwrap();
    assert!(refused.to_string().contains("`multi-body`"), "{refused}");
}

/// Returns a vehicle under test that drives 25 m/s towards a standing vehicle.
fn towards_standing_vehicle(gap_m: f64) -> Scenario {
    let class = VehicleClass::Light;
    let standing = Driver::Profile(LeadProfile::ConstantSpeed);
    let vehicles = vec![
        VehicleSpec::new(class, gap_m + class.length_m(), 0.0, standing),
        VehicleSpec::new(class, 0.0, 25.0, Driver::UnderTest),
    ];
    Scenario::new(ScenarioSpec::new(
        "towards-standing-vehicle".to_owned(),
        8.0,
        vehicles,
    ))
    .unwrap()
}

/// Full braking from 25 m/s takes 41.7 m as a point mass and 47.7 m with the multi-body plant.
#[test]
fn the_demands_of_an_escape_go_through_the_actuator() {
    let full_braking = vec![vec![-7.5; 800]];
    let survives = |gap_m| escape_survives(&towards_standing_vehicle(gap_m), &full_braking);
    assert_eq!(
        [45.0, 47.5, 47.8].map(survives),
        [Some(false), Some(false), Some(true)]
    );
    // The programs find an escape at 45 m, and its mark says that it depends on the plant.
    let avoidance = avoid(&towards_standing_vehicle(45.0), AvoidOptions::default()).unwrap();
    let escape = avoidance
        .verdict
        .escape()
        .expect("a point mass stops within 41.7 m");
    assert_eq!(
        escape_survives(&towards_standing_vehicle(45.0), &escape.acceleration_mps2),
        Some(false)
    );
}

/// The mildest fault fails, and the next smaller size that was simulated does not.
#[test]
fn the_mildest_sensor_fault_fails_and_less_of_it_passes() {
    let scenario = towards_standing_vehicle(60.0);
    let options = RunOptions::new(find("acc-aeb").source);
    let attack = attack_sensors(&scenario, &options, &Quiet).unwrap();
    assert!(!attack.collides_without_fault);
    let mildest = attack
        .mildest(SensorFailure::Collision)
        .expect("latency of 2 s");
    let shares = attack
        .kinds
        .iter()
        .filter_map(|kind| kind.mildest(SensorFailure::Collision))
        .map(|fault| fault.share);
    assert_eq!(mildest.share, shares.fold(f64::INFINITY, f64::min));
    let latency = attack.kinds[0]
        .mildest(SensorFailure::Collision)
        .expect("2 s is too late");
    assert_eq!(
        latency.faults,
        SensorFaults {
            latency_s: latency.amount,
            ..SensorFaults::default()
        }
    );
    let less = SensorFaults {
        latency_s: latency.amount - 0.0002,
        ..SensorFaults::default()
    };
    let fails = |faults: &SensorFaults| collides_with(&scenario, &options, faults);
    assert!(
        fails(&latency.faults) && fails(&mildest.faults) && !fails(&less),
        "{latency:?}"
    );
}

fn collides_with(scenario: &Scenario, options: &RunOptions, faults: &SensorFaults) -> bool {
    let faulty = scenario
        .edited(|spec| spec.sensors.faults = faults.clone())
        .unwrap();
    Specification::NoCollision
        .evaluate_scenario(&faulty, options.clone())
        .unwrap()
        .is_violation()
}

/// A resolution of 7.8 m makes `idm` collide, and coarser ones of 8 m and more do not. Each printed size is a short
/// decimal number that itself causes the failure, and no smaller one of a coarser grid does.
#[test]
fn the_effect_of_a_sensor_fault_is_searched_where_it_is_not_monotone() {
    let scenario = built_in_scenario("paper-1").unwrap();
    let options = RunOptions::new(find("idm").source);
    let attack = attack_sensors(&scenario, &options, &Quiet).unwrap();
    let kind = |name: &str| {
        attack
            .kinds
            .iter()
            .find(|kind| kind.kind == name)
            .expect("a kind of fault")
    };
    let fails = |faults: &SensorFaults| collides_with(&scenario, &options, faults);
    let resolution = kind("resolution")
        .mildest(SensorFailure::Collision)
        .expect("7.8 m causes a collision");
    let of_size = |gap_resolution_m| SensorFaults {
        gap_resolution_m,
        ..SensorFaults::default()
    };
    assert!(
        resolution.amount <= 7.8 && fails(&of_size(7.8)),
        "{resolution:?}"
    );
    assert!(!fails(&of_size(8.5)), "the effect is not monotone");
    let smaller = (1..)
        .map(|step| 0.25 * f64::from(step))
        .take_while(|size| *size < resolution.amount);
    assert!(smaller.map(of_size).all(|faults| !fails(&faults)));
    for fault in attack
        .kinds
        .iter()
        .filter_map(|kind| kind.mildest(SensorFailure::Collision))
    {
        let printed = fault.amount.to_string();
        assert!(printed.len() <= 6 && fails(&fault.faults), "{fault:?}");
    }
    let range = kind("range")
        .mildest(SensorFailure::Collision)
        .expect("a vehicle must see its leader");
    let seen = |range_m: f64| SensorFaults {
        range_m: Some(range_m),
        ..SensorFaults::default()
    };
    assert!(
        fails(&seen(range.amount)) && !fails(&seen(range.amount + 0.01)),
        "{range:?}"
    );
    let late = kind("late detection");
    assert_eq!(
        (late.sizes.count, late.sizes.smallest, late.sizes.largest),
        (1000, 0.01, 10.0)
    );
}
