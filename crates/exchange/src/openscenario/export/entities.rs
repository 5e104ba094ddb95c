//! The vehicles: categories, bounding boxes, limits.

use std::io;

use super::{
    Xml, attribute_text, entity_name, format_number, round, write_element, write_empty_element,
};
use crate::openscenario::DELAY_PROPERTIES;
use crumple_sim::scenario::{Driver, Scenario, VehicleClass, VehicleSpec};

/// Distance of each axle from the bumper on its side, as a share of the length.
pub(super) const REAR_OVERHANG_SHARE: f64 = 0.2;
/// Maximum initial speed of a scenario, in m/s.
const MAX_SPEED_MPS: f64 = 100.0;

/// Returns the category of a vehicle class, and its width, height and wheel diameter in metres. crumple does not model
/// them: a mid-size car, and a lorry of the maximum legal width.
fn vehicle_shape(class: VehicleClass) -> (&'static str, [f64; 3]) {
    match class {
        VehicleClass::Light => ("car", [1.8, 1.5, 0.65]),
        VehicleClass::Heavy => ("truck", [2.5, 3.5, 1.0]),
    }
}

pub(super) fn controller_name(vehicle: &VehicleSpec) -> Option<&'static str> {
    match vehicle.driver {
        Driver::Profile(_) => None,
        _ => Some(vehicle.driver.name()),
    }
}

/// Writes all vehicles; with a controller element, for the user to fill, for each that has no script.
pub(super) fn write_entities(
    xml: &mut Xml,
    scenario: &Scenario,
    with_controllers: bool,
) -> io::Result<()> {
    write_element(xml, "Entities", &[], |xml| {
        for (index, vehicle) in scenario.vehicles().iter().enumerate() {
            write_element(
                xml,
                "ScenarioObject",
                &[("name", &entity_name(index))],
                |xml| {
                    write_vehicle(xml, vehicle)?;
                    match controller_name(vehicle) {
                        Some(name) if with_controllers => write_element(
                            xml,
                            "ObjectController/Controller",
                            &[("name", &attribute_text(name))],
                            |xml| {
                                write_element(xml, "Properties", &[], |xml| {
                                    write_settings(xml, vehicle)
                                })
                            },
                        ),
                        _ => Ok(()),
                    }
                },
            )?;
        }
        Ok(())
    })
}

fn write_vehicle(xml: &mut Xml, vehicle: &VehicleSpec) -> io::Result<()> {
    let (category, [width_m, height_m, wheel_m]) = vehicle_shape(vehicle.class);
    // Rounded before use, so that an imported vehicle is exported as it was.
    let length_m = round(vehicle.length_m());
    let (length, mass) = (format_number(length_m), format_number(vehicle.mass_kg()));
    let wheelbase = format_number(length_m * (1.0 - 2.0 * REAR_OVERHANG_SHARE));
    let [width, height, half_height] = [width_m, height_m, height_m / 2.0].map(format_number);
    let [diameter, axle_height] = [wheel_m, wheel_m / 2.0].map(format_number);
    let named = [
        ("name", vehicle.class.name()),
        ("vehicleCategory", category),
        ("mass", &mass),
    ];
    write_element(xml, "Vehicle", &named, |xml| {
        write_element(xml, "BoundingBox", &[], |xml| {
            // All digits: the position of the front bumper follows from it.
            let middle = (length_m * (0.5 - REAR_OVERHANG_SHARE)).to_string();
            write_empty_element(
                xml,
                "Center",
                &[("x", &middle), ("y", "0"), ("z", &half_height)],
            )?;
            write_empty_element(
                xml,
                "Dimensions",
                &[("width", &width), ("length", &length), ("height", &height)],
            )
        })?;
        write_performance(xml, vehicle)?;
        write_element(xml, "Axles", &[], |xml| {
            let axle = |xml: &mut Xml, name: &str, steering: &str, x: &str| {
                let wheels = [
                    ("wheelDiameter", diameter.as_str()),
                    ("trackWidth", &width),
                    ("positionZ", &axle_height),
                ];
                write_empty_element(
                    xml,
                    name,
                    &[&[("maxSteering", steering), ("positionX", x)], &wheels[..]].concat(),
                )
            };
            axle(xml, "FrontAxle", "0.5", &wheelbase)?;
            axle(xml, "RearAxle", "0", "0")
        })?;
        write_element(xml, "Properties", &[], |xml| {
            let driver =
                controller_name(vehicle).map_or_else(|| "script".to_owned(), attribute_text);
            write_empty_element(xml, "Property", &[("name", "driver"), ("value", &driver)])?;
            let delays_s = [
                vehicle.reaction_delay_s,
                vehicle.actuator_lag_s,
                vehicle.actuator_delay_s,
            ];
            for (name, delay_s) in DELAY_PROPERTIES
                .iter()
                .zip(delays_s)
                .filter(|(_, delay_s)| *delay_s > 0.0)
            {
                write_empty_element(
                    xml,
                    "Property",
                    &[("name", name), ("value", &delay_s.to_string())],
                )?;
            }
            Ok(())
        })
    })
}

/// Writes the settings of a built-in controller that drives a vehicle.
fn write_settings(xml: &mut Xml, vehicle: &VehicleSpec) -> io::Result<()> {
    let Driver::Controller(controller) = &vehicle.driver else {
        return Ok(());
    };
    controller.values().try_for_each(|(field, value)| {
        write_empty_element(
            xml,
            "Property",
            &[("name", field.name), ("value", &value.to_string())],
        )
    })
}

fn write_performance(xml: &mut Xml, vehicle: &VehicleSpec) -> io::Result<()> {
    let [speed, accel, brake] = [
        MAX_SPEED_MPS,
        vehicle.max_accel_mps2(),
        vehicle.max_brake_mps2(),
    ]
    .map(format_number);
    let jerk = vehicle.jerk_limit_mps3.map(format_number);
    let mut limits = vec![
        ("maxSpeed", speed.as_str()),
        ("maxAcceleration", &accel),
        ("maxDeceleration", &brake),
    ];
    limits.extend(jerk.iter().flat_map(|jerk| {
        [
            ("maxAccelerationRate", jerk.as_str()),
            ("maxDecelerationRate", jerk),
        ]
    }));
    write_empty_element(xml, "Performance", &limits)
}
