//! Spaces around a given scenario.

use std::path::Path;

use crumple_sim::scenario::NoDriverFiles;
use crumple_sim::scenario::{Driver, LeadProfile, Scenario};
use crumple_spaces::{
    Base, DistributionSpec, InvalidSpace, ParameterSpec, SPACE_VERSION, ScenarioSpace, SpaceSpec,
    UniformSpec,
};

/// Largest change of a number, as a share of it.
const SHARE: f64 = 0.25;

/// Returns the space in which friction, gaps, speeds, delays and the leader's script vary around a scenario. Parameters
/// that some point would make invalid stay fixed.
pub(super) fn space_near(scenario: &Scenario) -> Result<ScenarioSpace, InvalidSpace> {
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
    for VariedField {
        field,
        unit,
        range: [low, high],
    } in varied_fields(scenario)
    {
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

/// A number of a scenario that varies.
struct VariedField {
    field: String,
    unit: &'static str,
    range: [f64; 2],
}

fn varied_fields(scenario: &Scenario) -> Vec<VariedField> {
    let friction = scenario.spec().environment.friction;
    let mut fields = vec![VariedField {
        field: "environment.friction".to_owned(),
        unit: "1",
        range: [friction * (1.0 - SHARE), friction],
    }];
    for (index, vehicle) in scenario.vehicles().iter().enumerate() {
        let mut vehicle_fields = vec![("speed_mps", "m/s", around(vehicle.speed_mps))];
        if let Some(gap_m) = scenario.initial_gap_m(index) {
            vehicle_fields.push(("gap_m", "m", around(gap_m)));
        }
        match &vehicle.driver {
            Driver::UnderTest => {
                let delay_s = vehicle.reaction_delay_s;
                vehicle_fields.push(("reaction_delay_s", "s", [delay_s, delay_s + 0.3]));
            }
            Driver::Profile(profile) => vehicle_fields.extend(script_fields(profile)),
            _ => {}
        }
        fields.extend(
            vehicle_fields
                .into_iter()
                .map(|(field, unit, range)| VariedField {
                    field: format!("vehicles[{index}].{field}"),
                    unit,
                    range,
                }),
        );
    }
    fields
}

/// Returns field, unit and range of each number of a script that varies.
fn script_fields(profile: &LeadProfile) -> Vec<(&'static str, &'static str, [f64; 2])> {
    match profile {
        LeadProfile::Brake(brake) => vec![
            ("driver.brake.onset_s", "s", around(brake.onset_s)),
            ("driver.brake.rate_mps2", "m/s²", around(brake.rate_mps2)),
        ],
        LeadProfile::RampBrake(brake) => {
            let range = around(brake.rate_mps2);
            vec![("driver.ramp-brake.rate_mps2", "m/s²", range)]
        }
        LeadProfile::BrakeToSpeed(brake) => {
            let range = around(brake.rate_mps2);
            vec![("driver.brake-to-speed.rate_mps2", "m/s²", range)]
        }
        LeadProfile::Pieces(_) => vec![("driver.pieces.scale", "1", around(1.0))],
        LeadProfile::ConstantSpeed | LeadProfile::Recorded(_) => Vec::new(),
    }
}

fn around(value: f64) -> [f64; 2] {
    [value * (1.0 - SHARE), value * (1.0 + SHARE)]
}
