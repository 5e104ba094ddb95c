//! Scenarios with any number of vehicles and any duration.

use crumple_world::scenario::{Driver, Scenario, built_in_scenario};

/// Returns paper-1 with this number of vehicles under test, at its spacing, and another duration.
pub fn platoon(vehicles: usize, duration_s: f64) -> Scenario {
    let paper_1 = built_in_scenario("paper-1").expect("built in");
    let line = paper_1.edited(|spec| {
        let ego = spec.vehicles[1].clone();
        let (front_m, spacing_m) = (spec.vehicles[0].position_m, spec.vehicles[0].position_m - ego.position_m);
        spec.vehicles.truncate(1);
        for index in 1..vehicles {
            let position_m = front_m - spacing_m * index as f64;
            spec.vehicles.push(crumple_world::scenario::VehicleSpec {
                position_m,
                driver: Driver::UnderTest,
                ..ego.clone()
            });
        }
        spec.duration_s = duration_s;
    });
    line.expect("valid")
}
