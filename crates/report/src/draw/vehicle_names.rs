//! Names of vehicles in figures.

use crumple_sim::scenario::{Driver, PlantKind, Scenario, VehicleSpec};

/// Returns one name per vehicle, front to rear: `leader (light)`, `ego (light)`, `follower (heavy, baseline)`. A name
/// states a plant other than the point mass, and the driver of a follower.
#[must_use]
pub fn vehicle_names(scenario: &Scenario) -> Vec<String> {
    let egos = scenario
        .vehicles()
        .iter()
        .filter(|vehicle| vehicle.driver == Driver::UnderTest)
        .count();
    let mut ego_number = 0;
    let mut names = Vec::new();
    for (index, vehicle) in scenario.vehicles().iter().enumerate() {
        let class = describe_build(vehicle);
        names.push(match vehicle.driver {
            Driver::UnderTest if egos == 1 => format!("ego ({class})"),
            Driver::UnderTest => {
                ego_number += 1;
                format!("ego {ego_number} ({class})")
            }
            _ if index == 0 => format!("leader ({class})"),
            _ => format!("follower ({class}, {})", vehicle.driver.name()),
        });
    }
    names
}

/// Describes class and plant of a vehicle.
fn describe_build(vehicle: &VehicleSpec) -> String {
    let class = vehicle.class.name();
    match vehicle.plant {
        PlantKind::MultiBody => format!("{class}, multi-body"),
        PlantKind::PointMass => class.to_owned(),
    }
}
