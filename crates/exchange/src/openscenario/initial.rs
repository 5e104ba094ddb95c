//! Initial actions: positions, speeds and the environment.

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::{
    MAX_ENVIRONMENTS, MAX_INITIAL_ACTIONS, WORK_PER_INITIAL_SPEED, WorkBudget, ensure_at_most,
};
use super::path_actions::lane_number;
use super::road::{LanePlace, RoadMap};
use super::source::SourceFiles;
use super::speed_plan::TransitionShape;
use super::storyboard::{SpeedAction, StoryAction, entity_index, read_action, read_speed};
use super::xml::Node;
use crumple_core::digits::format_number;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Friction coefficients of a scenario.
const FRICTION_RANGE: std::ops::RangeInclusive<f64> = 0.01..=1.0;

/// Initial state of all entities.
pub(super) struct InitialState<'a> {
    pub(super) places: Vec<LanePlace>,
    pub(super) speeds_mps: Vec<Option<f64>>,
    /// Transitions of the speed that begin with the scenario.
    pub(super) transitions: Vec<(usize, SpeedAction<'a>)>,
    /// Entities whose controller is active from the start.
    pub(super) is_active: Vec<bool>,
    pub(super) friction: f64,
    pub(super) notes: Vec<String>,
}

impl InitialState<'_> {
    fn along_m(&self, entity: usize) -> Option<f64> {
        self.places.get(entity).map(|position| position.along_m)
    }
}

pub(super) fn read_initial<'a>(
    init: Node<'a>,
    entities: &[Entity<'_>],
    roads: &RoadMap<'_>,
    files: &SourceFiles<'_>,
    work: &WorkBudget,
) -> Result<InitialState<'a>> {
    init.only(&["Actions"], &[])?;
    let groups = init.child("Actions")?;
    check_counts(groups)?;
    let mut state = InitialState {
        places: Vec::new(),
        speeds_mps: vec![None; entities.len()],
        transitions: Vec::new(),
        is_active: vec![false; entities.len()],
        friction: 1.0,
        notes: Vec::new(),
    };
    let mut actions = InitialActions {
        positions: vec![None; entities.len()],
        speeds: Vec::new(),
        distances: Vec::new(),
    };
    for group in groups.children() {
        match group.name() {
            "GlobalAction" => read_environment(group.single()?, files, &mut state)?,
            "Private" => {
                group.only(&["PrivateAction"], &["entityRef"])?;
                let entity = entity_index(group, "entityRef", entities)?;
                for action in group.children() {
                    actions.read(action.single()?, entity, entities, &mut state)?;
                }
            }
            _ => return Err(group.refuse("is not supported")),
        }
    }
    state.places = resolve_places(init, &actions.positions, entities, roads)?;
    resolve_speeds(actions.speeds, &mut state, groups, work)?;
    for (entity, node) in actions.distances {
        apply_distance(node, entity, entities, &mut state)?;
    }
    Ok(state)
}

/// Refuses more initial actions or environments than the limits.
fn check_counts(groups: Node<'_>) -> Result<()> {
    let actions = groups.children().map(|group| 1 + group.children().count());
    let what = "actions and groups of them";
    ensure_at_most(groups, actions.sum(), MAX_INITIAL_ACTIONS, what)?;
    let environments = groups.named("GlobalAction").count();
    ensure_at_most(groups, environments, MAX_ENVIRONMENTS, "environments")
}

/// Initial actions of the entities, some of which are relative to the state of others.
struct InitialActions<'a> {
    /// Position of each entity.
    positions: Vec<Option<Node<'a>>>,
    /// Entities and actions on their speeds.
    speeds: Vec<(usize, SpeedAction<'a>)>,
    /// Entities and actions that place them at a distance from another.
    distances: Vec<(usize, Node<'a>)>,
}

impl<'a> InitialActions<'a> {
    /// Reads a private action of an entity.
    fn read(
        &mut self,
        action: Node<'a>,
        entity: usize,
        entities: &[Entity<'_>],
        state: &mut InitialState<'_>,
    ) -> Result<()> {
        match (action.name(), action.children().next().map(Node::name)) {
            ("TeleportAction", _) => {
                let position = action.child("Position")?.single()?;
                let slot = self.positions.get_mut(entity);
                if slot.is_some_and(|slot| slot.replace(position).is_some()) {
                    return Err(action.refuse("is a second position of the entity"));
                }
            }
            ("LongitudinalAction", Some("SpeedAction")) => {
                let speed = read_speed(action.single()?, entities)?;
                self.speeds.push((entity, speed));
            }
            ("LongitudinalAction", Some("LongitudinalDistanceAction")) => {
                self.distances.push((entity, action.single()?));
            }
            ("ControllerAction" | "ActivateControllerAction", _) => {
                if let StoryAction::Activate = read_action(action, entities)?
                    && let Some(is_active) = state.is_active.get_mut(entity)
                {
                    *is_active = true;
                }
            }
            ("LongitudinalAction", Some(_)) => {
                return Err(action.single()?.refuse("is not supported in `Init`"));
            }
            _ => return Err(action.refuse("is not supported in `Init`")),
        }
        Ok(())
    }
}

fn read_environment(
    action: Node<'_>,
    files: &SourceFiles<'_>,
    state: &mut InitialState<'_>,
) -> Result<()> {
    if action.name() != "EnvironmentAction" {
        return Err(action.refuse("is not supported"));
    }
    let environment = action.single()?;
    if environment.name() == "CatalogReference" {
        return files.with_catalog_entry(environment, &["Environment"], |entry| {
            read_conditions(entry, state)
        });
    }
    read_conditions(environment, state)
}

fn read_conditions(environment: Node<'_>, state: &mut InitialState<'_>) -> Result<()> {
    environment.only(
        &[
            "ParameterDeclarations",
            "TimeOfDay",
            "Weather",
            "RoadCondition",
        ],
        &["name"],
    )?;
    for part in environment.children() {
        match part.name() {
            "RoadCondition" => {
                let friction = part.number("frictionScaleFactor")?;
                if !FRICTION_RANGE.contains(&friction) {
                    return Err(part.refuse(format!(
                        "attribute `frictionScaleFactor`: must be from {} to {}, found {}",
                        FRICTION_RANGE.start(),
                        FRICTION_RANGE.end(),
                        format_number(friction)
                    )));
                }
                state.friction = friction;
            }
            "ParameterDeclarations" => {}
            _ => state
                .notes
                .push(part.note("has no influence on the motion")),
        }
    }
    Ok(())
}

/// Returns the places of all entities. A position may be relative to that of another entity.
fn resolve_places(
    init: Node<'_>,
    positions: &[Option<Node<'_>>],
    entities: &[Entity<'_>],
    roads: &RoadMap<'_>,
) -> Result<Vec<LanePlace>> {
    let mut places: Vec<Option<LanePlace>> = vec![None; positions.len()];
    for index in 0..positions.len() {
        // Entities of which each is placed relative to the next one.
        let mut waiting = vec![index];
        while let Some(&entity) = waiting.last() {
            if places.get(entity).is_some_and(Option::is_some) {
                waiting.pop();
                continue;
            }
            let position = positions.get(entity).copied().flatten().ok_or_else(|| {
                let name = entities
                    .get(entity)
                    .map_or("", |entity| entity.name.as_str());
                init.refuse(format!("has no position of the entity `{name}`"))
            })?;
            match resolve_place(position, &places, entities, roads)? {
                Some(place) => drop(places.get_mut(entity).map(|slot| slot.replace(place))),
                None if waiting.len() > positions.len() => {
                    return Err(
                        init.refuse("positions of entities are relative to each other in a circle")
                    );
                }
                None => waiting.push(entity_index(position, "entityRef", entities)?),
            }
        }
    }
    let places: Vec<LanePlace> = places.into_iter().flatten().collect();
    check_same_road(&places, positions)?;
    Ok(places)
}

fn check_same_road(places: &[LanePlace], positions: &[Option<Node<'_>>]) -> Result<()> {
    let road = places.first().map(|position| &position.road);
    let mut places = places.iter().zip(positions);
    match places.find(|(place, _)| road != Some(&place.road)) {
        Some((_, Some(position))) => Err(position.refuse("entities must be on the same road")),
        _ => Ok(()),
    }
}

/// Returns the place of a position; `None` if it is relative to a position that is not resolved yet.
pub(super) fn resolve_place(
    node: Node<'_>,
    resolved: &[Option<LanePlace>],
    entities: &[Entity<'_>],
    roads: &RoadMap<'_>,
) -> Result<Option<LanePlace>> {
    check_orientation(node)?;
    match node.name() {
        "WorldPosition" => {
            node.only(&[], &["x", "y", "z", "h", "p", "r"])?;
            let point_m = [node.number("x")?, node.number("y")?];
            let road = roads.find(node, None, point_m)?;
            // Without `h`, the heading is 0, but that of a trajectory is its direction.
            let heading_rad = node
                .optional_number("h")?
                .or((!resolved.is_empty()).then_some(0.0));
            road.place_of_point(node, point_m, heading_rad).map(Some)
        }
        "LanePosition" => {
            node.only(&["Orientation"], &["roadId", "laneId", "offset", "s"])?;
            check_in_middle(node)?;
            let road = roads.find(node, Some(&node.text("roadId")?), [0.0; 2])?;
            road.position(node, lane_number(node, "laneId")?, node.number("s")?)
                .map(Some)
        }
        "RelativeLanePosition" => {
            node.only(
                &["Orientation"],
                &["entityRef", "dLane", "ds", "dsLane", "offset"],
            )?;
            check_in_middle(node)?;
            let reference = resolved.get(entity_index(node, "entityRef", entities)?);
            match reference.and_then(Option::as_ref) {
                Some(reference) => relative_place(node, reference, roads).map(Some),
                None => Ok(None),
            }
        }
        _ => Err(node.refuse("is not supported as a position")),
    }
}

/// Returns the place at a distance and a number of lanes from another place.
fn relative_place(node: Node<'_>, reference: &LanePlace, roads: &RoadMap<'_>) -> Result<LanePlace> {
    let road = roads.find(node, Some(&reference.road), [0.0; 2])?;
    let lane = road.shifted_lane(reference.lane, lane_number(node, "dLane")?);
    let ahead_m = match node.optional_number("dsLane")? {
        Some(ahead_m) => ahead_m,
        None => node.number("ds")?,
    };
    road.place_along(node, lane, reference.along_m + ahead_m)
}

/// Refuses a direction other than that of the lane. `h` of a world position is checked with the lane.
fn check_orientation(position: Node<'_>) -> Result<()> {
    let orientation = position.optional("Orientation").unwrap_or(position);
    if orientation.name() == "Orientation" {
        orientation.only(&[], &["type", "h", "p", "r"])?;
    }
    let angles = if position.name() == "WorldPosition" {
        &["p", "r"][..]
    } else {
        &["h", "p", "r"]
    };
    for angle in angles {
        if orientation
            .optional_number(angle)?
            .is_some_and(|rad| rad.abs() > 1e-3)
        {
            return Err(
                orientation.refuse(format!("`{angle}` differs from the direction of the lane"))
            );
        }
    }
    Ok(())
}

/// Refuses a position beside the middle of its lane.
fn check_in_middle(position: Node<'_>) -> Result<()> {
    match position.optional_number("offset")? {
        Some(offset_m) if offset_m != 0.0 => Err(position.refuse(format!(
            "offset = {} is lateral: vehicles drive in the middle of a lane",
            format_number(offset_m)
        ))),
        _ => Ok(()),
    }
}

/// Sets the initial speeds, of which some are relative to others.
fn resolve_speeds<'a>(
    speeds: Vec<(usize, SpeedAction<'a>)>,
    state: &mut InitialState<'a>,
    actions: Node<'a>,
    work: &WorkBudget,
) -> Result<()> {
    let mut waiting = speeds;
    let mut rounds = 0;
    while !waiting.is_empty() {
        work.spend(actions, WORK_PER_INITIAL_SPEED * waiting.len() as u64)?;
        let count = waiting.len();
        let mut later = Vec::new();
        for (entity, action) in waiting {
            if action.dynamics.shape != TransitionShape::Step {
                state.transitions.push((entity, action));
                continue;
            }
            let reference = action
                .target
                .reference
                .map(|entity| state.speeds_mps.get(entity).copied().flatten());
            match reference {
                // A vehicle without an initial speed stands.
                Some(None) if rounds <= count => later.push((entity, action)),
                _ => {
                    let mps = action
                        .target
                        .speed_mps(action.node, reference.flatten().unwrap_or(0.0))?;
                    state
                        .speeds_mps
                        .get_mut(entity)
                        .map(|speed| speed.replace(mps));
                }
            }
        }
        waiting = later;
        rounds += 1;
    }
    Ok(())
}

/// Moves an entity to a distance from another one.
fn apply_distance(
    node: Node<'_>,
    entity: usize,
    entities: &[Entity<'_>],
    state: &mut InitialState<'_>,
) -> Result<()> {
    check_distance_action(node)?;
    let reference = entity_index(node, "entityRef", entities)?;
    let leads = match node.optional_text("displacement")?.as_deref() {
        Some(displacement) => displacement == "leadingReferencedEntity",
        None => state.along_m(entity) > state.along_m(reference),
    };
    let [front, rear] = if leads {
        [entity, reference]
    } else {
        [reference, entity]
    };
    let rear_mps = state.speeds_mps.get(rear).copied().flatten().unwrap_or(0.0);
    let mut distance_m = match node.optional_non_negative("timeGap")? {
        Some(gap_s) => gap_s * rear_mps,
        None => node.non_negative("distance")?,
    };
    if node.flag("freespace", false)?
        && let (Some(front), Some(rear)) = (entities.get(front), entities.get(rear))
    {
        distance_m += rear.front_m + front.length_m - front.front_m;
    }
    let from_m = state.along_m(reference).unwrap_or(0.0);
    if let Some(place) = state.places.get_mut(entity) {
        place.along_m = if leads {
            from_m + distance_m
        } else {
            from_m - distance_m
        };
    }
    Ok(())
}

/// Refuses unknown attributes of a distance, and values that crumple cannot represent.
fn check_distance_action(node: Node<'_>) -> Result<()> {
    node.only(
        &[],
        &[
            "entityRef",
            "distance",
            "timeGap",
            "freespace",
            "continuous",
            "coordinateSystem",
            "displacement",
        ],
    )?;
    node.expect("continuous", &["false", "0"])?;
    node.expect("coordinateSystem", &["entity", "lane", "road"])?;
    node.expect(
        "displacement",
        &["leadingReferencedEntity", "trailingReferencedEntity"],
    )
}
