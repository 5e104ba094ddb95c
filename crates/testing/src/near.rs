//! Spaces around a given scenario.

use std::path::Path;

use crumple_spaces::{
    Base, DistributionSpec, InvalidSpace, ParameterSpec, SPACE_VERSION, ScenarioSpace, SpaceSpec,
    UniformSpec,
};
use crumple_world::scenario::NoDriverFiles;
use crumple_world::scenario::{Driver, LeadProfile, Scenario};

/// Largest change of a number, as a share of it.
const SHARE: f64 = 0.25;

/// Returns the space in which friction, gaps, speeds, delays and the leader's script vary around a scenario. Parameters
/// that some point would make invalid stay fixed.
pub(super) fn space_near(scenario: &Scenario) -> Result<ScenarioSpace, InvalidSpace> {
    let mut fields = vec![(
        "environment.friction".to_owned(),
        "1",
        [scenario.spec().environment.friction; 2],
    )];
    fields[0].2[0] *= 1.0 - SHARE;
    let around = |value: f64| [value * (1.0 - SHARE), value * (1.0 + SHARE)];
    for (index, vehicle) in scenario.vehicles().iter().enumerate() {
        let mut add = |field: &str, unit, range| {
            fields.push((format!("vehicles[{index}].{field}"), unit, range))
        };
        add("speed_mps", "m/s", around(vehicle.speed_mps));
        if let Some(gap_m) = scenario.initial_gap_m(index) {
            add("gap_m", "m", around(gap_m));
        }
        if vehicle.driver == Driver::UnderTest {
            add(
                "reaction_delay_s",
                "s",
                [vehicle.reaction_delay_s, vehicle.reaction_delay_s + 0.3],
            );
        }
        let Driver::Profile(profile) = &vehicle.driver else {
            continue;
        };
        match profile {
            LeadProfile::Brake(brake) => {
                add("driver.brake.onset_s", "s", around(brake.onset_s));
                add("driver.brake.rate_mps2", "m/s²", around(brake.rate_mps2));
            }
            LeadProfile::RampBrake(brake) => add(
                "driver.ramp-brake.rate_mps2",
                "m/s²",
                around(brake.rate_mps2),
            ),
            LeadProfile::BrakeToSpeed(brake) => add(
                "driver.brake-to-speed.rate_mps2",
                "m/s²",
                around(brake.rate_mps2),
            ),
            LeadProfile::Pieces(_) => add("driver.pieces.scale", "1", around(1.0)),
            LeadProfile::ConstantSpeed | LeadProfile::Recorded(_) => {}
        }
    }
    let mut spec = SpaceSpec {
        version: SPACE_VERSION,
        name: format!("near-{}", scenario.spec().name),
        about: String::new(),
        base: Base::Inline(Box::new(scenario.spec().clone())),
        parameters: Vec::new(),
        dependence: None,
        exposure: None,
        observed: None,
    };
    let mut valid = Err(InvalidSpace::new(
        "parameters",
        "no number of the scenario can vary",
    ));
    for (field, unit, [low, high]) in fields {
        let name = field.replace(|letter: char| !letter.is_ascii_alphanumeric(), "_");
        let distribution = DistributionSpec::Uniform(UniformSpec { low, high });
        spec.parameters.push(ParameterSpec {
            name,
            field,
            unit: unit.to_owned(),
            nominal: None,
            distribution,
        });
        match ScenarioSpace::new(spec.clone(), Path::new(""), &NoDriverFiles) {
            Ok(space) => valid = Ok(space),
            Err(error) => {
                spec.parameters.pop();
                valid = valid.or(Err(error));
            }
        }
    }
    valid
}
