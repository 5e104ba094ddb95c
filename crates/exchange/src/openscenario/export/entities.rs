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

/// Properties of a vehicle that crumple does not model.
struct VehicleShape {
    category: &'static str,
    width_m: f64,
    height_m: f64,
    wheel_diameter_m: f64,
}

impl VehicleShape {
    /// Returns the shape of a mid-size car, or of a lorry of the maximum legal width.
    fn from_class(class: VehicleClass) -> Self {
        match class {
            VehicleClass::Light => Self {
                category: "car",
                width_m: 1.8,
                height_m: 1.5,
                wheel_diameter_m: 0.65,
            },
            VehicleClass::Heavy => Self {
                category: "truck",
                width_m: 2.5,
                height_m: 3.5,
                wheel_diameter_m: 1.0,
            },
        }
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
    let shape = VehicleShape::from_class(vehicle.class);
    // Rounded before use, so that an imported vehicle is exported as it was.
    let length_m = round(vehicle.length_m());
    let mass = format_number(vehicle.mass_kg());
    let attributes = [
        ("name", vehicle.class.name()),
        ("vehicleCategory", shape.category),
        ("mass", &mass),
    ];
    write_element(xml, "Vehicle", &attributes, |xml| {
        write_element(xml, "BoundingBox", &[], |xml| {
            write_bounding_box(xml, &shape, length_m)
        })?;
        write_performance(xml, vehicle)?;
        let wheelbase_m = length_m * (1.0 - 2.0 * REAR_OVERHANG_SHARE);
        write_element(xml, "Axles", &[], |xml| {
            write_axle(xml, "FrontAxle", "0.5", wheelbase_m, &shape)?;
            write_axle(xml, "RearAxle", "0", 0.0, &shape)
        })?;
        write_element(xml, "Properties", &[], |xml| {
            write_driver_and_delays(xml, vehicle)
        })
    })
}

fn write_bounding_box(xml: &mut Xml, shape: &VehicleShape, length_m: f64) -> io::Result<()> {
    // All digits: the position of the front bumper follows from it.
    let middle = (length_m * (0.5 - REAR_OVERHANG_SHARE)).to_string();
    let half_height = format_number(shape.height_m / 2.0);
    write_empty_element(
        xml,
        "Center",
        &[("x", &middle), ("y", "0"), ("z", &half_height)],
    )?;
    let [width, length, height] = [shape.width_m, length_m, shape.height_m].map(format_number);
    write_empty_element(
        xml,
        "Dimensions",
        &[("width", &width), ("length", &length), ("height", &height)],
    )
}

/// Writes an axle at a distance from the reference point.
fn write_axle(
    xml: &mut Xml,
    name: &str,
    max_steering: &str,
    x_m: f64,
    shape: &VehicleShape,
) -> io::Result<()> {
    let diameter_m = shape.wheel_diameter_m;
    let [x, diameter, width, height] =
        [x_m, diameter_m, shape.width_m, diameter_m / 2.0].map(format_number);
    write_empty_element(
        xml,
        name,
        &[
            ("maxSteering", max_steering),
            ("positionX", &x),
            ("wheelDiameter", &diameter),
            ("trackWidth", &width),
            ("positionZ", &height),
        ],
    )
}

/// Writes the driver and the delays, which OpenSCENARIO cannot state, as properties.
fn write_driver_and_delays(xml: &mut Xml, vehicle: &VehicleSpec) -> io::Result<()> {
    let driver = controller_name(vehicle).map_or_else(|| "script".to_owned(), attribute_text);
    write_empty_element(xml, "Property", &[("name", "driver"), ("value", &driver)])?;
    let delays_s = [
        vehicle.reaction_delay_s,
        vehicle.actuator_lag_s,
        vehicle.actuator_delay_s,
    ];
    for (name, delay_s) in DELAY_PROPERTIES.iter().zip(delays_s) {
        if delay_s > 0.0 {
            write_empty_element(
                xml,
                "Property",
                &[("name", name), ("value", &delay_s.to_string())],
            )?;
        }
    }
    Ok(())
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
