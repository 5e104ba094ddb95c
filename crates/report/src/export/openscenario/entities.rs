//! The vehicles: categories, boxes, limits.

use std::io;

use super::{Xml, entity, leaf, number, text, within};
use crumple_world::scenario::{Driver, Scenario, VehicleClass, VehicleSpec};

/// The rear axle's distance from the rear bumper, as a share of the length. The front axle has the same from the front.
pub(super) const REAR_OVERHANG_SHARE: f64 = 0.2;
/// Fastest that a scenario lets a vehicle start, in m/s.
const MAX_SPEED_MPS: f64 = 100.0;

/// What a class looks like, where crumple does not care: a mid-size car, and a lorry as wide as the law allows.
struct VehicleShape {
    category: &'static str,
    width_m: f64,
    height_m: f64,
    wheel_diameter_m: f64,
}

fn vehicle_shape(class: VehicleClass) -> VehicleShape {
    match class {
        VehicleClass::Light => VehicleShape { category: "car", width_m: 1.8, height_m: 1.5, wheel_diameter_m: 0.65 },
        VehicleClass::Heavy => VehicleShape { category: "truck", width_m: 2.5, height_m: 3.5, wheel_diameter_m: 1.0 },
    }
}

/// The name of what drives a vehicle, if it is no script.
pub(super) fn controller_name(vehicle: &VehicleSpec) -> Option<&'static str> {
    match vehicle.driver {
        Driver::Profile(_) => None,
        _ => Some(vehicle.driver.name()),
    }
}

/// All vehicles; with a controller for each that drives by one, if the user is to fill it.
pub(super) fn write_entities(xml: &mut Xml, scenario: &Scenario, with_controllers: bool) -> io::Result<()> {
    within(xml, "Entities", &[], |xml| {
        for (index, vehicle) in scenario.vehicles().iter().enumerate() {
            within(xml, "ScenarioObject", &[("name", &entity(index))], |xml| {
                write_vehicle(xml, vehicle)?;
                match controller(vehicle) {
                    Some(name) if with_controllers => within(xml, "ObjectController", &[], |xml| {
                        within(xml, "Controller", &[("name", &text(name))], |xml| leaf(xml, "Properties", &[]))
                    }),
                    _ => Ok(()),
                }
            })?;
        }
        Ok(())
    })
}

fn write_vehicle(xml: &mut Xml, vehicle: &VehicleSpec) -> io::Result<()> {
    let body = body(vehicle.class);
    let length_m = vehicle.length_m();
    let (length, mass) = (number(length_m), number(vehicle.mass_kg()));
    let wheelbase = number(length_m * (1.0 - 2.0 * REAR_OVERHANG_SHARE));
    let [width, height, half_height] = [body.width_m, body.height_m, body.height_m / 2.0].map(number);
    let [diameter, axle_height] = [body.wheel_diameter_m, body.wheel_diameter_m / 2.0].map(number);
    let named = [("name", vehicle.class.name()), ("vehicleCategory", body.category), ("mass", &mass)];
    within(xml, "Vehicle", &named, |xml| {
        within(xml, "BoundingBox", &[], |xml| {
            let middle = number(length_m * (0.5 - REAR_OVERHANG_SHARE));
            leaf(xml, "Center", &[("x", &middle), ("y", "0"), ("z", &half_height)])?;
            leaf(xml, "Dimensions", &[("width", &width), ("length", &length), ("height", &height)])
        })?;
        write_performance(xml, vehicle)?;
        within(xml, "Axles", &[], |xml| {
            let axle = |xml: &mut Xml, name: &str, steering: &str, x: &str| {
                let wheels =
                    [("wheelDiameter", diameter.as_str()), ("trackWidth", &width), ("positionZ", &axle_height)];
                leaf(xml, name, &[&[("maxSteering", steering), ("positionX", x)], &wheels[..]].concat())
            };
            axle(xml, "FrontAxle", "0.5", &wheelbase)?;
            axle(xml, "RearAxle", "0", "0")
        })?;
        within(xml, "Properties", &[], |xml| {
            leaf(xml, "Property", &[("name", "driver"), ("value", &text(vehicle.driver.name()))])
        })
    })
}

/// Limits on a dry road.
fn write_performance(xml: &mut Xml, vehicle: &VehicleSpec) -> io::Result<()> {
    let [speed, accel, brake] = [MAX_SPEED_MPS, vehicle.max_accel_mps2(), vehicle.max_brake_mps2()].map(number);
    let jerk = vehicle.jerk_limit_mps3.map(number);
    let mut limits = vec![("maxSpeed", speed.as_str()), ("maxAcceleration", &accel), ("maxDeceleration", &brake)];
    limits.extend(jerk.iter().flat_map(|jerk| [("maxAccelerationRate", jerk.as_str()), ("maxDecelerationRate", jerk)]));
    leaf(xml, "Performance", &limits)
}
