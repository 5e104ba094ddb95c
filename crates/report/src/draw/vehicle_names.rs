//! Names of vehicles in figures.

use crumple_sim::scenario::{Driver, Scenario, VehicleSpec};

/// Returns one name per vehicle, front to rear: `leader (light)`, `ego (light)`, `follower (heavy)`.
#[must_use]
pub fn vehicle_names(scenario: &Scenario) -> Vec<String> {
    let is_ego = |vehicle: &&VehicleSpec| vehicle.driver == Driver::UnderTest;
    let alone = scenario.vehicles().iter().filter(is_ego).count() == 1;
    let mut egos = 0;
    let name = |(index, vehicle): (usize, &VehicleSpec)| {
        let class = vehicle.class.name();
        match vehicle.driver {
            Driver::UnderTest if alone => format!("ego ({class})"),
            Driver::UnderTest => {
                egos += 1;
                format!("ego {egos} ({class})")
            }
            _ if index == 0 => format!("leader ({class})"),
            _ => format!("follower ({class})"),
        }
    };
    scenario.vehicles().iter().enumerate().map(name).collect()
}
