//! Entities: bodies, limits and controllers.

use super::error::ScenarioImportError;
use super::parameters::Parameters;
use super::source::SourceFiles;
use super::xml::Node;
use crate::control::ControllerSpec;
use crate::scenario::{Driver, VehicleClass};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// An entity of the file.
#[derive(Debug)]
pub(super) struct Entity {
    pub(super) name: String,
    pub(super) class: VehicleClass,
    pub(super) length_m: f64,
    pub(super) width_m: f64,
    /// Distance of the front bumper from the reference point, in metres.
    pub(super) front_m: f64,
    pub(super) mass_kg: Option<f64>,
    pub(super) max_speed_mps: f64,
    pub(super) max_brake_mps2: Option<f64>,
    pub(super) max_accel_mps2: Option<f64>,
    pub(super) jerk_limit_mps3: Option<f64>,
    /// Reaction delay, actuator lag and actuator delay, as crumple's export states them.
    pub(super) delays_s: [f64; 3],
    pub(super) controller: Option<AssignedController>,
}

/// A controller that is assigned to an entity.
#[derive(Debug)]
pub(super) struct AssignedController {
    pub(super) name: String,
    pub(super) properties: Vec<(String, String)>,
}

/// Names of the properties in which crumple's export states delays, in the order of `Entity::delays_s`.
pub const DELAY_PROPERTIES: [&str; 3] = ["reaction_delay_s", "actuator_lag_s", "actuator_delay_s"];

pub(super) fn read_entities(node: Node<'_>, files: &SourceFiles<'_>) -> Result<Vec<Entity>> {
    node.only(&["ScenarioObject"], &[])?;
    let mut found: Vec<Entity> = Vec::new();
    for object in node.children() {
        let entity = read_object(object, files)?;
        if found.iter().any(|other| other.name == entity.name) {
            return Err(object.refuse(format!("there is another entity `{}`", entity.name)));
        }
        found.push(entity);
    }
    Ok(found)
}

fn read_object(object: Node<'_>, files: &SourceFiles<'_>) -> Result<Entity> {
    object.only(
        &["CatalogReference", "Vehicle", "Pedestrian", "MiscObject", "ExternalObjectReference", "ObjectController"],
        &["name"],
    )?;
    let mut bodies = object.children().filter(|child| child.name() != "ObjectController");
    let body = bodies.next().ok_or_else(|| object.refuse("has no vehicle"))?;
    let mut entity = if body.name() == "CatalogReference" {
        files.with_catalog_entry(body, &["Vehicle", "Pedestrian", "MiscObject"], read_body)?
    } else {
        read_body(body)?
    };
    entity.name = object.text("name")?;
    if let Some(holder) = object.optional("ObjectController") {
        holder.only(&["Controller", "CatalogReference"], &["name"])?;
        // OpenSCENARIO 1.3 allows several controllers, and a holder without one.
        let mut controllers = holder.children();
        if let Some(one) = controllers.next() {
            entity.controller = Some(match one.name() {
                "CatalogReference" => files.with_catalog_entry(one, &["Controller"], read_controller)?,
                _ => read_controller(one)?,
            });
        }
        let second = controllers.next().or_else(|| object.named("ObjectController").nth(1));
        if let Some(second) = second {
            return Err(second.refuse("an entity can have only one controller"));
        }
    }
    Ok(entity)
}

pub(super) fn read_controller(node: Node<'_>) -> Result<AssignedController> {
    node.only(&["Properties", "ParameterDeclarations"], &["name", "controllerType"])?;
    Ok(AssignedController { name: node.text("name")?, properties: read_properties(node)? })
}

fn read_properties(node: Node<'_>) -> Result<Vec<(String, String)>> {
    let properties = node.named("Properties").flat_map(|list| list.named("Property").collect::<Vec<_>>());
    properties.map(|one| Ok((one.text("name")?, one.text("value")?))).collect()
}

fn read_body(body: Node<'_>) -> Result<Entity> {
    let is_vehicle = match body.name() {
        "Vehicle" => true,
        "Pedestrian" | "MiscObject" => false,
        _ => return Err(body.refuse("is not supported as an entity")),
    };
    body.only(
        &["ParameterDeclarations", "BoundingBox", "Performance", "Axles", "Properties", "Role"],
        &["name", "vehicleCategory", "pedestrianCategory", "miscObjectCategory", "mass", "model", "model3d", "role"],
    )?;
    let bounding_box = body.child("BoundingBox")?;
    let (center, dimensions) = (bounding_box.child("Center")?, bounding_box.child("Dimensions")?);
    if center.number("y")?.abs() > 0.01 {
        return Err(center.refuse("the bounding box must be centred on the lane"));
    }
    let length_m = dimensions.non_negative("length")?;
    let class = VehicleClass::ALL.iter().copied().find(|class| body.raw("name") == Some(class.name()));
    let mut entity = Entity {
        name: String::new(),
        class: class.unwrap_or(VehicleClass::from_length(length_m)),
        length_m,
        width_m: dimensions.non_negative("width")?,
        front_m: center.number("x")? + length_m / 2.0,
        mass_kg: body.optional_number("mass")?,
        max_speed_mps: f64::INFINITY,
        max_brake_mps2: None,
        max_accel_mps2: None,
        jerk_limit_mps3: None,
        delays_s: [0.0; 3],
        controller: None,
    };
    if is_vehicle {
        let limits = body.child("Performance")?;
        limits.only(
            &[],
            &["maxSpeed", "maxAcceleration", "maxDeceleration", "maxAccelerationRate", "maxDecelerationRate"],
        )?;
        entity.max_speed_mps = limits.non_negative("maxSpeed")?;
        entity.max_brake_mps2 = Some(limits.non_negative("maxDeceleration")?);
        entity.max_accel_mps2 = Some(limits.non_negative("maxAcceleration")?);
        entity.jerk_limit_mps3 = limits.optional_number("maxAccelerationRate")?;
        if limits.optional_number("maxDecelerationRate")? != entity.jerk_limit_mps3 {
            return Err(limits.refuse("maxAccelerationRate and maxDecelerationRate must be equal"));
        }
    }
    for (name, value) in read_properties(body)? {
        let delay = DELAY_PROPERTIES.iter().position(|delay| *delay == name);
        if let Some(place) = delay.and_then(|place| entity.delays_s.get_mut(place)) {
            let number = value.parse().ok().filter(|number: &f64| number.is_finite());
            *place = number.ok_or_else(|| body.refuse(format!("property `{name}`: `{value}` is not a number")))?;
        }
    }
    Ok(entity)
}

/// Returns the values of the parameters of a catalogue entry.
pub(super) fn entry_parameters(reference: Node<'_>, entry: Node<'_>) -> Result<Parameters> {
    let assignments = reference.named("ParameterAssignments").flat_map(|list| list.children().collect::<Vec<_>>());
    let read = |one: Node<'_>| {
        one.only(&[], &["parameterRef", "value"])?;
        Ok((one.text("parameterRef")?, one.text("value")?))
    };
    let assigned = assignments.map(read).collect::<Result<Vec<_>>>()?;
    Parameters::declare(entry.optional("ParameterDeclarations"), &assigned)
}

/// Name of the controller of vehicles under test in crumple's export.
pub const UNDER_TEST_CONTROLLER: &str = "under-test";

/// Drivers of the entities with a controller; `None` for scripted ones.
pub(super) fn assign_drivers(node: Node<'_>, entities: &[Entity], ego: Option<&str>) -> Result<Vec<Option<Driver>>> {
    if let Some(name) = ego.filter(|name| entities.iter().all(|entity| entity.name != **name)) {
        let names: Vec<_> = entities.iter().map(|entity| entity.name.as_str()).collect();
        return Err(node.refuse(format!("there is no entity `{name}`, only {}", names.join(", "))));
    }
    let controlled = entities.iter().filter(|entity| entity.controller.is_some()).count();
    let driver = |entity: &Entity| {
        if ego == Some(&entity.name) {
            return Ok(Some(Driver::UnderTest));
        }
        let Some(controller) = &entity.controller else { return Ok(None) };
        if controller.name == UNDER_TEST_CONTROLLER {
            return Ok(Some(Driver::UnderTest));
        }
        match built_in_driver(node, controller)? {
            Some(driver) => Ok(Some(driver)),
            None if ego.is_none() && controlled == 1 => Ok(Some(Driver::UnderTest)),
            None if ego.is_none() => {
                Err(node
                    .refuse(format!("{controlled} entities have a controller: name the vehicle under test with --ego")))
            }
            None => Err(node.refuse(format!(
                "the entity `{}` has the controller `{}`, which is none of crumple's",
                entity.name, controller.name
            ))),
        }
    };
    entities.iter().map(driver).collect()
}

/// Returns the built-in controller of this name, with the settings of the properties.
fn built_in_driver(node: Node<'_>, controller: &AssignedController) -> Result<Option<Driver>> {
    let Some(mut spec) = ControllerSpec::from_name(&controller.name) else { return Ok(None) };
    let fields: Vec<&str> = spec.values().map(|(field, _)| field.name).collect();
    for (place, field) in fields.into_iter().enumerate() {
        let Some((_, value)) = controller.properties.iter().find(|(name, _)| name == field) else { continue };
        let number = value.parse::<f64>().map_err(|_| node.refuse(format!("`{field}` = `{value}` is not a number")))?;
        spec.get_mut(place).map(|setting| std::mem::replace(setting, number));
    }
    Ok(Some(Driver::Controller(spec)))
}
