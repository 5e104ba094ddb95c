//! Entities: bodies, limits and controllers.

use super::error::ScenarioImportError;
use super::limits::{MAX_ENTITIES, MAX_PARAMETERS, MAX_PROPERTIES, ensure_at_most};
use super::parameters::{Parameters, read_assignment};
use super::source::SourceFiles;
use super::xml::{ElementPlace, Node};
use crumple_world::control::BuiltInController;
use crumple_world::scenario::{Driver, VehicleClass};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Distance of the front bumper from the reference point that no vehicle exceeds, in metres: the cause of a position
/// outside its range.
const MAX_USUAL_CENTER_M: f64 = 1000.0;

/// An entity of the file.
#[derive(Debug)]
pub(super) struct Entity<'a> {
    pub(super) node: Node<'a>,
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
    /// Property in which crumple's export states the driver.
    stated_driver: Option<String>,
    /// Content without influence on the motion.
    pub(super) notes: Vec<String>,
    places: BodyPlaces,
}

/// Elements that state the body of an entity, which may be in a catalogue.
#[derive(Debug)]
struct BodyPlaces {
    body: ElementPlace,
    center: ElementPlace,
    dimensions: ElementPlace,
    performance: Option<ElementPlace>,
}

impl Entity<'_> {
    /// Returns the element that states a field of the vehicle.
    pub(super) fn place_of(&self, field: &str) -> ElementPlace {
        let places = &self.places;
        let is_center_far = self.front_m.abs() > MAX_USUAL_CENTER_M;
        match field {
            "length_m" => places.dimensions.clone(),
            "position_m" if is_center_far => places.center.clone(),
            "mass_kg" | "reaction_delay_s" | "actuator_lag_s" | "actuator_delay_s" => {
                places.body.clone()
            }
            "max_brake_mps2" | "max_accel_mps2" | "jerk_limit_mps3" => {
                let performance = places.performance.as_ref();
                performance.unwrap_or(&places.body).clone()
            }
            _ => self.node.place(),
        }
    }
}

/// A controller that is assigned to an entity.
#[derive(Debug)]
pub(super) struct AssignedController {
    name: String,
    /// Built-in controller of this name, with the settings of the properties.
    built_in: Option<BuiltInController>,
    notes: Vec<String>,
}

/// Names of the properties in which crumple's export states delays, in the order of `Entity::delays_s`.
pub const DELAY_PROPERTIES: [&str; 3] = ["reaction_delay_s", "actuator_lag_s", "actuator_delay_s"];

pub(super) fn read_entities<'a>(
    node: Node<'a>,
    files: &SourceFiles<'_>,
) -> Result<Vec<Entity<'a>>> {
    node.only(&["ScenarioObject"], &[])?;
    ensure_at_most(node, node.children().count(), MAX_ENTITIES, "entities")?;
    let mut found: Vec<Entity<'a>> = Vec::new();
    for object in node.children() {
        let entity = read_object(object, files)?;
        if found.iter().any(|other| other.name == entity.name) {
            return Err(object.refuse(format!("there is another entity `{}`", entity.name)));
        }
        found.push(entity);
    }
    Ok(found)
}

fn read_object<'a>(object: Node<'a>, files: &SourceFiles<'_>) -> Result<Entity<'a>> {
    object.only(
        &[
            "CatalogReference",
            "Vehicle",
            "Pedestrian",
            "MiscObject",
            "ExternalObjectReference",
            "ObjectController",
        ],
        &["name"],
    )?;
    let mut bodies = object
        .children()
        .filter(|child| child.name() != "ObjectController");
    let body = bodies
        .next()
        .ok_or_else(|| object.refuse("has no vehicle"))?;
    let mut entity = if body.name() == "CatalogReference" {
        files.with_catalog_entry(body, &["Vehicle", "Pedestrian", "MiscObject"], |body| {
            read_body(object, body)
        })?
    } else {
        read_body(object, body)?
    };
    if let Some(holder) = object.optional("ObjectController") {
        holder.only(&["Controller", "CatalogReference"], &["name"])?;
        // OpenSCENARIO 1.3 allows several controllers, and a holder without one.
        let mut controllers = holder.children();
        if let Some(one) = controllers.next() {
            let mut controller = match one.name() {
                "CatalogReference" => {
                    files.with_catalog_entry(one, &["Controller"], read_controller)?
                }
                _ => read_controller(one)?,
            };
            entity.notes.append(&mut controller.notes);
            if let Some(driver) = entity
                .stated_driver
                .as_ref()
                .filter(|driver| **driver != controller.name)
            {
                let name = &controller.name;
                let note = format!(
                    "the property driver = `{driver}` contradicts the controller `{name}`, which drives"
                );
                entity.notes.push(one.note(note));
            }
            entity.controller = Some(controller);
        }
        let second = controllers
            .next()
            .or_else(|| object.named("ObjectController").nth(1));
        if let Some(second) = second {
            return Err(second.refuse("an entity can have only one controller"));
        }
    }
    Ok(entity)
}

fn read_controller(node: Node<'_>) -> Result<AssignedController> {
    node.only(
        &["Properties", "ParameterDeclarations"],
        &["name", "controllerType"],
    )?;
    let (name, properties) = (node.text("name")?, read_properties(node)?);
    let settings = properties
        .iter()
        .map(|(property, value)| format!(",{property}={value}"));
    let built_in =
        BuiltInController::parse(&(name.clone() + &settings.collect::<String>())).transpose();
    let built_in = built_in.map_err(|invalid| node.refuse(invalid.to_string()))?;
    let mut notes = Vec::new();
    if built_in.is_none() {
        note_unused(
            node,
            properties
                .into_iter()
                .map(|(property, _)| property)
                .collect(),
            &mut notes,
        );
    }
    Ok(AssignedController {
        name,
        built_in,
        notes,
    })
}

/// Notes properties that crumple does not know.
fn note_unused(node: Node<'_>, names: Vec<String>, notes: &mut Vec<String>) {
    if !names.is_empty() {
        notes.push(node.note(format!(
            "properties without influence on the motion: {}",
            names.join(", ")
        )));
    }
}

fn read_properties(node: Node<'_>) -> Result<Vec<(String, String)>> {
    let properties = || node.named("Properties").flat_map(Node::children);
    ensure_at_most(node, properties().count(), MAX_PROPERTIES, "properties")?;
    let read = |one: Node<'_>| match one.name() {
        "Property" => Ok((one.text("name")?, one.text("value")?)),
        _ => Ok((one.name().to_owned(), one.text("filepath")?)),
    };
    properties().map(read).collect()
}

fn read_body<'a>(object: Node<'a>, body: Node<'_>) -> Result<Entity<'a>> {
    let is_vehicle = match body.name() {
        "Vehicle" => true,
        "Pedestrian" | "MiscObject" => false,
        _ => return Err(body.refuse("is not supported as an entity")),
    };
    body.only(
        &[
            "ParameterDeclarations",
            "BoundingBox",
            "Performance",
            "Axles",
            "Properties",
            "Role",
        ],
        &[
            "name",
            "vehicleCategory",
            "pedestrianCategory",
            "miscObjectCategory",
            "mass",
            "model",
            "model3d",
            "role",
        ],
    )?;
    let bounding_box = body.child("BoundingBox")?;
    let (center, dimensions) = (
        bounding_box.child("Center")?,
        bounding_box.child("Dimensions")?,
    );
    if center.number("y")?.abs() > 0.01 {
        return Err(center.refuse("the bounding box must be centred on the lane"));
    }
    let length_m = dimensions.non_negative("length")?;
    let class = VehicleClass::ALL
        .iter()
        .copied()
        .find(|class| body.raw("name") == Some(class.name()));
    let mut entity = Entity {
        node: object,
        name: object.text("name")?,
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
        stated_driver: None,
        notes: Vec::new(),
        places: BodyPlaces {
            body: body.place(),
            center: center.place(),
            dimensions: dimensions.place(),
            performance: body.optional("Performance").map(Node::place),
        },
    };
    if is_vehicle {
        let limits = body.child("Performance")?;
        limits.only(
            &[],
            &[
                "maxSpeed",
                "maxAcceleration",
                "maxDeceleration",
                "maxAccelerationRate",
                "maxDecelerationRate",
            ],
        )?;
        entity.max_speed_mps = limits.non_negative("maxSpeed")?;
        entity.max_brake_mps2 = Some(limits.non_negative("maxDeceleration")?);
        entity.max_accel_mps2 = Some(limits.non_negative("maxAcceleration")?);
        entity.jerk_limit_mps3 = limits.optional_number("maxAccelerationRate")?;
        if limits.optional_number("maxDecelerationRate")? != entity.jerk_limit_mps3 {
            return Err(limits.refuse("maxAccelerationRate and maxDecelerationRate must be equal"));
        }
    }
    let mut unused = Vec::new();
    for (name, value) in read_properties(body)? {
        let delay = DELAY_PROPERTIES.iter().position(|delay| *delay == name);
        if let Some(place) = delay.and_then(|place| entity.delays_s.get_mut(place)) {
            let number = value.parse().ok().filter(|number: &f64| number.is_finite());
            *place = number.ok_or_else(|| {
                body.refuse(format!("property `{name}`: `{value}` is not a number"))
            })?;
        } else if name == "driver" {
            entity.stated_driver = Some(value);
        } else {
            unused.push(name);
        }
    }
    note_unused(body, unused, &mut entity.notes);
    Ok(entity)
}

/// Returns the values of the parameters of a catalogue entry.
pub(super) fn entry_parameters(reference: Node<'_>, entry: Node<'_>) -> Result<Parameters> {
    let assignments = || {
        reference
            .named("ParameterAssignments")
            .flat_map(Node::children)
    };
    ensure_at_most(
        reference,
        assignments().count(),
        MAX_PARAMETERS,
        "assigned parameters",
    )?;
    let assigned = assignments()
        .map(read_assignment)
        .collect::<Result<Vec<_>>>()?;
    Parameters::declare(entry.optional("ParameterDeclarations"), &assigned)
}

/// Name of the controller of vehicles under test in crumple's export.
pub const UNDER_TEST_CONTROLLER: &str = "under-test";

/// Returns the drivers of the entities with a controller; `None` for scripted ones.
pub(super) fn assign_drivers(
    node: Node<'_>,
    entities: &[Entity<'_>],
    ego: Option<&str>,
) -> Result<Vec<Option<Driver>>> {
    if let Some(name) = ego.filter(|name| entities.iter().all(|entity| entity.name != **name)) {
        let names: Vec<_> = entities.iter().map(|entity| entity.name.as_str()).collect();
        return Err(node.refuse(format!(
            "there is no entity `{name}`, only {}",
            names.join(", ")
        )));
    }
    let controlled = entities
        .iter()
        .filter(|entity| entity.controller.is_some())
        .count();
    let driver = |entity: &Entity<'_>| {
        let under_test = Ok(Some(Driver::UnderTest));
        match &entity.controller {
            _ if ego == Some(&entity.name) => under_test,
            None => Ok(None),
            Some(AssignedController {
                built_in: Some(spec),
                ..
            }) => Ok(Some(Driver::Controller(spec.clone()))),
            Some(controller) if controller.name == UNDER_TEST_CONTROLLER => under_test,
            Some(_) if ego.is_none() && controlled == 1 => under_test,
            Some(_) if ego.is_none() => Err(node.refuse(format!(
                "{controlled} entities have a controller: name the vehicle under test with --ego"
            ))),
            Some(AssignedController { name, .. }) => {
                let problem = format!(
                    "`{}` has the controller `{name}`, which is none of crumple's",
                    entity.name
                );
                Err(entity.node.refuse(problem))
            }
        }
    };
    entities.iter().map(driver).collect()
}
