//! Entities: bodies, limits and controllers.

use super::error::ScenarioImportError;
use super::limits::{MAX_ENTITIES, MAX_PARAMETERS, MAX_PROPERTIES, ensure_at_most};
use super::parameters::{Parameters, read_assignment};
use super::source::SourceFiles;
use super::xml::{ElementLocation, Node};
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::{Driver, VehicleClass};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Distance of the front bumper from the reference point that no vehicle exceeds, in metres: the cause of a position
/// outside its range.
const MAX_USUAL_CENTER_M: f64 = 1000.0;

/// Largest limit of an acceleration in a scenario, in m/s².
pub(super) const MAX_LIMIT_MPS2: f64 = 30.0;
/// Largest acceleration by which a tool states that there is no limit, in m/s².
const UNLIMITED_MPS2: f64 = 1000.0;

/// Largest angle of a body that is along the lane, in radians.
const ALONG_RAD: f64 = 1e-3;

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
    /// True for a body that stands and may have any direction.
    pub(super) is_obstacle: bool,
    /// True for a body that may have any direction, and may walk across the lanes.
    pub(super) is_pedestrian: bool,
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
    locations: BodyLocations,
}

/// Elements that state the body of an entity, which may be in a catalogue.
#[derive(Debug)]
struct BodyLocations {
    body: ElementLocation,
    center: ElementLocation,
    dimensions: ElementLocation,
    performance: Option<ElementLocation>,
}

impl BodyLocations {
    fn new(body: Node<'_>, center: Node<'_>, dimensions: Node<'_>) -> Self {
        Self {
            body: body.location(),
            center: center.location(),
            dimensions: dimensions.location(),
            performance: body.optional("Performance").map(Node::location),
        }
    }
}

impl Entity<'_> {
    /// Turns the body by an angle: its length and width become those of the box around it along the lane.
    pub(super) fn turn(&mut self, angle_rad: f64) {
        let [cosine, sine] = [libm::cos(angle_rad), libm::sin(angle_rad)];
        if sine.abs() < ALONG_RAD && cosine > 0.0 {
            return;
        }
        let middle_m = (self.front_m - self.length_m / 2.0) * cosine;
        let [length_m, width_m] = [self.length_m, self.width_m];
        self.length_m = length_m * cosine.abs() + width_m * sine.abs();
        self.width_m = length_m * sine.abs() + width_m * cosine.abs();
        self.front_m = middle_m + self.length_m / 2.0;
    }

    /// Returns the name of a controller that crumple does not know.
    pub(super) fn unknown_controller(&self) -> Option<&str> {
        let controller = self.controller.as_ref();
        let unknown = controller.filter(|controller| controller.stated_driver().is_none());
        unknown.map(|controller| controller.name.as_str())
    }

    /// Reads a controller, or that of the catalogue entry to which the element refers, and assigns it.
    fn assign_controller(&mut self, node: Node<'_>, files: &SourceFiles<'_>) -> Result<()> {
        let mut controller = match node.name() {
            "CatalogReference" => {
                files.with_catalog_entry(node, &["Controller"], read_controller)?
            }
            _ => read_controller(node)?,
        };
        self.notes.append(&mut controller.notes);
        if let Some(driver) = &self.stated_driver
            && *driver != controller.name
        {
            let name = &controller.name;
            self.notes.push(node.note(format!(
                "the property driver = `{driver}` contradicts the controller `{name}`, which drives"
            )));
        }
        self.controller = Some(controller);
        Ok(())
    }

    /// Reads an acceleration. A large one, by which tools state that there is no limit, becomes that of a scenario.
    fn read_limit(&mut self, limits: Node<'_>, name: &str) -> Result<f64> {
        let limit_mps2 = limits.non_negative(name)?;
        if !(MAX_LIMIT_MPS2..=UNLIMITED_MPS2).contains(&limit_mps2) || limit_mps2 == MAX_LIMIT_MPS2
        {
            return Ok(limit_mps2);
        }
        self.notes.push(limits.note(format!(
            "`{name}` is reduced to {MAX_LIMIT_MPS2} m/s², the largest limit of a scenario"
        )));
        Ok(MAX_LIMIT_MPS2)
    }

    /// Reads the limits of a vehicle.
    fn read_performance(&mut self, limits: Node<'_>) -> Result<()> {
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
        self.max_speed_mps = limits.non_negative("maxSpeed")?;
        self.max_brake_mps2 = Some(self.read_limit(limits, "maxDeceleration")?);
        self.max_accel_mps2 = Some(self.read_limit(limits, "maxAcceleration")?);
        self.jerk_limit_mps3 = limits.optional_number("maxAccelerationRate")?;
        if limits.optional_number("maxDecelerationRate")? == self.jerk_limit_mps3 {
            Ok(())
        } else {
            Err(limits.refuse("maxAccelerationRate and maxDecelerationRate must be equal"))
        }
    }

    /// Reads the properties in which crumple's export states delays and the driver.
    fn read_body_properties(&mut self, body: Node<'_>) -> Result<()> {
        let mut unused = Vec::new();
        for (name, value) in read_properties(body)? {
            let index = DELAY_PROPERTIES.iter().position(|delay| *delay == name);
            if let Some(delay_s) = index.and_then(|index| self.delays_s.get_mut(index)) {
                let number = value.parse().ok().filter(|number: &f64| number.is_finite());
                *delay_s = number.ok_or_else(|| {
                    body.refuse(format!("property `{name}`: `{value}` is not a number"))
                })?;
            } else if name == "driver" {
                self.stated_driver = Some(value);
            } else {
                unused.push(name);
            }
        }
        note_unused(body, unused, &mut self.notes);
        Ok(())
    }

    fn note_trailers(&mut self, body: Node<'_>) -> Result<()> {
        for trailer in body.named("Trailer").flat_map(Node::children) {
            let is_empty_reference = trailer.name() == "TrailerRef"
                && trailer.optional_text("entityRef")? == Some(String::new());
            if !is_empty_reference {
                let note = trailer.note("has no influence: vehicles have no trailers");
                self.notes.push(note);
            }
        }
        Ok(())
    }

    /// Returns the element that states a field of the vehicle.
    pub(super) fn field_location(&self, field: &str) -> ElementLocation {
        let locations = &self.locations;
        let is_center_far = self.front_m.abs() > MAX_USUAL_CENTER_M;
        match field {
            "length_m" => locations.dimensions.clone(),
            "position_m" if is_center_far => locations.center.clone(),
            "mass_kg" | "reaction_delay_s" | "actuator_lag_s" | "actuator_delay_s" => {
                locations.body.clone()
            }
            "max_brake_mps2" | "max_accel_mps2" | "jerk_limit_mps3" => {
                let performance = locations.performance.as_ref();
                performance.unwrap_or(&locations.body).clone()
            }
            _ => self.node.location(),
        }
    }
}

/// Turns bodies by angles.
pub(super) fn turn(entities: &mut [Entity<'_>], angles_rad: &[f64]) {
    for (entity, angle_rad) in entities.iter_mut().zip(angles_rad) {
        entity.turn(*angle_rad);
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

impl AssignedController {
    /// Returns the driver that the controller states; `None` if crumple does not know it.
    fn stated_driver(&self) -> Option<Driver> {
        match &self.built_in {
            Some(spec) => Some(Driver::Controller(spec.clone())),
            None if self.name == UNDER_TEST_CONTROLLER => Some(Driver::UnderTest),
            None => None,
        }
    }
}

/// Names of the properties in which crumple's export states delays, in the order of `Entity::delays_s`.
pub const DELAY_PROPERTIES: [&str; 3] = ["reaction_delay_s", "actuator_lag_s", "actuator_delay_s"];

pub(super) fn read_entities<'a>(
    node: Node<'a>,
    files: &SourceFiles<'_>,
) -> Result<Vec<Entity<'a>>> {
    node.only(&["ScenarioObject", "EntitySelection"], &[])?;
    ensure_at_most(node, node.children().count(), MAX_ENTITIES, "entities")?;
    let mut entities: Vec<Entity<'a>> = Vec::new();
    for object in node.named("ScenarioObject") {
        let entity = read_object(object, files)?;
        if entities.iter().any(|other| other.name == entity.name) {
            return Err(object.refuse(format!("there is another entity `{}`", entity.name)));
        }
        entities.push(entity);
    }
    Ok(entities)
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
    // OpenSCENARIO 1.3 allows several controllers, and a holder without one.
    let mut controllers = Vec::new();
    for holder in object.named("ObjectController") {
        holder.only(&["Controller", "CatalogReference"], &["name"])?;
        controllers.extend(holder.children());
    }
    match controllers.as_slice() {
        [] => {}
        [controller] => entity.assign_controller(*controller, files)?,
        [_, second, ..] => return Err(second.refuse("an entity can have only one controller")),
    }
    Ok(entity)
}

fn read_controller(node: Node<'_>) -> Result<AssignedController> {
    node.only(
        &["Properties", "ParameterDeclarations"],
        &["name", "controllerType"],
    )?;
    let name = node.text("name")?;
    let properties = read_properties(node)?;
    let settings = properties
        .iter()
        .map(|(property, value)| format!(",{property}={value}"));
    let built_in =
        BuiltInController::parse(&(name.clone() + &settings.collect::<String>())).transpose();
    let built_in = built_in.map_err(|invalid| node.refuse(invalid.to_string()))?;
    let mut notes = Vec::new();
    if built_in.is_none() {
        let names = properties.into_iter().map(|(property, _)| property);
        note_unused(node, names.collect(), &mut notes);
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
    let properties: Vec<_> = node
        .named("Properties")
        .flat_map(Node::children)
        .take(MAX_PROPERTIES + 1)
        .collect();
    ensure_at_most(node, properties.len(), MAX_PROPERTIES, "properties")?;
    properties
        .into_iter()
        .map(|property| match property.name() {
            "Property" => Ok((property.text("name")?, property.text("value")?)),
            other => Ok((other.to_owned(), property.text("filepath")?)),
        })
        .collect()
}

fn read_body<'a>(object: Node<'a>, body: Node<'_>) -> Result<Entity<'a>> {
    check_body_content(body)?;
    let bounding_box = body.child("BoundingBox")?;
    let center = bounding_box.child("Center")?;
    let dimensions = bounding_box.child("Dimensions")?;
    if center.number("y")?.abs() > 0.01 {
        return Err(center.refuse("the bounding box must be centred on the lane"));
    }
    let length_m = dimensions.non_negative("length")?;
    let mut entity = Entity {
        node: object,
        name: object.text("name")?,
        class: vehicle_class(body, length_m),
        length_m,
        width_m: dimensions.non_negative("width")?,
        front_m: center.number("x")? + length_m / 2.0,
        is_obstacle: body.name() == "MiscObject",
        is_pedestrian: body.name() == "Pedestrian",
        mass_kg: body.optional_number("mass")?,
        max_speed_mps: f64::INFINITY,
        max_brake_mps2: None,
        max_accel_mps2: None,
        jerk_limit_mps3: None,
        delays_s: [0.0; 3],
        controller: None,
        stated_driver: None,
        notes: Vec::new(),
        locations: BodyLocations::new(body, center, dimensions),
    };
    if body.name() == "Vehicle" {
        entity.read_performance(body.child("Performance")?)?;
    }
    entity.read_body_properties(body)?;
    entity.note_trailers(body)?;
    Ok(entity)
}

/// Returns the class that crumple's export states as the name of a body; otherwise that of the length.
fn vehicle_class(body: Node<'_>, length_m: f64) -> VehicleClass {
    let mut classes = VehicleClass::ALL.iter().copied();
    let stated = classes.find(|class| body.raw("name") == Some(class.name()));
    stated.unwrap_or(VehicleClass::from_length(length_m))
}

/// Refuses a body of an unknown kind or with unknown content.
fn check_body_content(body: Node<'_>) -> Result<()> {
    if !["Vehicle", "Pedestrian", "MiscObject"].contains(&body.name()) {
        return Err(body.refuse("is not supported as an entity"));
    }
    body.only(
        &[
            "ParameterDeclarations",
            "BoundingBox",
            "Performance",
            "Axles",
            "Properties",
            "Role",
            "Trailer",
            "TrailerCoupler",
            "TrailerHitch",
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
    )
}

/// Returns the values of the parameters of a catalogue entry.
pub(super) fn entry_parameters(reference: Node<'_>, entry: Node<'_>) -> Result<Parameters> {
    let assignments: Vec<_> = reference
        .named("ParameterAssignments")
        .flat_map(Node::children)
        .take(MAX_PARAMETERS + 1)
        .collect();
    let what = "assigned parameters";
    ensure_at_most(reference, assignments.len(), MAX_PARAMETERS, what)?;
    let assigned = assignments
        .into_iter()
        .map(read_assignment)
        .collect::<Result<Vec<_>>>()?;
    Parameters::declare(entry.optional("ParameterDeclarations"), &assigned)
}

/// Name of the controller of vehicles under test in crumple's export.
pub const UNDER_TEST_CONTROLLER: &str = "under-test";

/// Removes entities that have no initial position and a controller that crumple does not know: other tools replace them
/// by traffic. Returns a note for each.
pub(super) fn remove_placeholders(
    entities: &mut Vec<Entity<'_>>,
    storyboard: Node<'_>,
) -> Vec<String> {
    let groups = storyboard.optional("Init").into_iter();
    let groups = groups.filter_map(|init| init.optional("Actions"));
    let placed: Vec<String> = groups
        .flat_map(|actions| actions.named("Private"))
        .filter_map(|private| private.text("entityRef").ok())
        .collect();
    let is_placeholder = |entity: &Entity<'_>| {
        let controller = entity.controller.as_ref();
        controller.is_some_and(|controller| controller.stated_driver().is_none())
            && !placed.contains(&entity.name)
    };
    let notes = entities.iter().filter(|entity| is_placeholder(entity));
    let notes = notes
        .map(|entity| entity.node.note("has no position: the scenario omits it"))
        .collect();
    entities.retain(|entity| !is_placeholder(entity));
    notes
}

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
    entities
        .iter()
        .map(|entity| match &entity.controller {
            _ if ego == Some(&entity.name) => Ok(Some(Driver::UnderTest)),
            None => Ok(None),
            Some(controller) => match controller.stated_driver() {
                Some(driver) => Ok(Some(driver)),
                // The default controller does its actions.
                None if ego.is_some() => Ok(None),
                None if controlled == 1 => Ok(Some(Driver::UnderTest)),
                None => Err(node.refuse(format!(
                    "{controlled} entities have a controller: name the vehicle under test with --ego"
                ))),
            },
        })
        .collect()
}
