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

pub(super) fn read_initial<'a>(
    init: Node<'a>,
    entities: &[Entity<'_>],
    roads: &RoadMap<'_>,
    files: &SourceFiles<'_>,
    work: &WorkBudget,
) -> Result<InitialState<'a>> {
    init.only(&["Actions"], &[])?;
    let (groups, count) = (init.child("Actions")?, entities.len());
    let actions = groups
        .children()
        .map(|group| 1 + group.children().count())
        .sum();
    ensure_at_most(
        groups,
        actions,
        MAX_INITIAL_ACTIONS,
        "actions and groups of them",
    )?;
    ensure_at_most(
        groups,
        groups.named("GlobalAction").count(),
        MAX_ENVIRONMENTS,
        "environments",
    )?;
    let mut state = InitialState {
        places: Vec::new(),
        speeds_mps: vec![None; count],
        transitions: Vec::new(),
        is_active: vec![false; count],
        friction: 1.0,
        notes: Vec::new(),
    };
    let (mut positions, mut distances): (Vec<Option<Node<'a>>>, Vec<(usize, Node<'a>)>) =
        (vec![None; count], Vec::new());
    let mut speeds = Vec::new();
    for group in groups.children() {
        match group.name() {
            "GlobalAction" => read_environment(group.single()?, files, &mut state)?,
            "Private" => {
                group.only(&["PrivateAction"], &["entityRef"])?;
                let entity = entity_index(group, "entityRef", entities)?;
                for action in group.children() {
                    let inner = action.single()?;
                    match (inner.name(), inner.children().next().map(Node::name)) {
                        ("TeleportAction", _) => {
                            let position = inner.child("Position")?.single()?;
                            if positions
                                .get_mut(entity)
                                .is_some_and(|place| place.replace(position).is_some())
                            {
                                return Err(inner.refuse("is a second position of the entity"));
                            }
                        }
                        ("LongitudinalAction", Some("SpeedAction")) => {
                            speeds.push((entity, read_speed(inner.single()?, entities)?));
                        }
                        ("LongitudinalAction", Some("LongitudinalDistanceAction")) => {
                            distances.push((entity, inner.single()?));
                        }
                        ("ControllerAction" | "ActivateControllerAction", _) => {
                            if let StoryAction::Activate = read_action(inner, entities)? {
                                state
                                    .is_active
                                    .get_mut(entity)
                                    .map(|active| std::mem::replace(active, true));
                            }
                        }
                        ("LongitudinalAction", Some(_)) => {
                            return Err(inner.single()?.refuse("is not supported in `Init`"));
                        }
                        _ => return Err(inner.refuse("is not supported in `Init`")),
                    }
                }
            }
            _ => return Err(group.refuse("is not supported")),
        }
    }
    state.places = resolve_places(init, &positions, entities, roads)?;
    resolve_speeds(speeds, &mut state, groups, work)?;
    for (entity, node) in distances {
        apply_distance(node, entity, entities, &mut state)?;
    }
    Ok(state)
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
                let (friction, [least, most]) = (
                    part.number("frictionScaleFactor")?,
                    [FRICTION_RANGE.start(), FRICTION_RANGE.end()],
                );
                if !FRICTION_RANGE.contains(&friction) {
                    let problem = format!(
                        "must be from {least} to {most}, found {}",
                        format_number(friction)
                    );
                    return Err(part.refuse(format!("attribute `frictionScaleFactor`: {problem}")));
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
    let mut found: Vec<Option<LanePlace>> = vec![None; positions.len()];
    for index in 0..positions.len() {
        // Entities of which each is placed relative to the next one.
        let mut waiting = vec![index];
        while let Some(&entity) = waiting.last() {
            if found.get(entity).is_some_and(Option::is_some) {
                waiting.pop();
                continue;
            }
            let position = positions.get(entity).copied().flatten().ok_or_else(|| {
                let name = entities
                    .get(entity)
                    .map_or("", |entity| entity.name.as_str());
                init.refuse(format!("has no position of the entity `{name}`"))
            })?;
            match resolve_place(position, &found, entities, roads)? {
                Some(place) => drop(found.get_mut(entity).map(|slot| slot.replace(place))),
                None if waiting.len() > positions.len() => {
                    return Err(
                        init.refuse("positions of entities are relative to each other in a circle")
                    );
                }
                None => waiting.push(entity_index(position, "entityRef", entities)?),
            }
        }
    }
    let all: Vec<LanePlace> = found.into_iter().flatten().collect();
    match all
        .iter()
        .zip(positions)
        .find(|(place, _)| all.first().is_some_and(|first| first.road != place.road))
    {
        Some((_, Some(node))) => Err(node.refuse("entities must be on the same road")),
        _ => Ok(all),
    }
}

/// Returns the place of a position; `None` if it is relative to a position that is not known yet.
pub(super) fn resolve_place(
    node: Node<'_>,
    known: &[Option<LanePlace>],
    entities: &[Entity<'_>],
    roads: &RoadMap<'_>,
) -> Result<Option<LanePlace>> {
    let orientation = node.optional("Orientation").unwrap_or(node);
    if orientation.name() == "Orientation" {
        orientation.only(&[], &["type", "h", "p", "r"])?;
    }
    for angle in if node.name() == "WorldPosition" {
        &["p", "r"][..]
    } else {
        &["h", "p", "r"]
    } {
        if orientation
            .optional_number(angle)?
            .is_some_and(|rad| rad.abs() > 1e-3)
        {
            return Err(
                orientation.refuse(format!("`{angle}` differs from the direction of the lane"))
            );
        }
    }
    let in_middle = |node: Node<'_>| match node.optional_number("offset")? {
        Some(offset_m) if offset_m != 0.0 => Err(node.refuse(format!(
            "offset = {} is lateral: vehicles drive in the middle of a lane",
            format_number(offset_m)
        ))),
        _ => Ok(()),
    };
    match node.name() {
        "WorldPosition" => {
            node.only(&[], &["x", "y", "z", "h", "p", "r"])?;
            let point_m = [node.number("x")?, node.number("y")?];
            let road = roads.find(node, None, point_m)?;
            // Without `h`, the heading is 0, but that of a trajectory is its direction.
            let heading_rad = node
                .optional_number("h")?
                .or((!known.is_empty()).then_some(0.0));
            road.place_of_point(node, point_m, heading_rad).map(Some)
        }
        "LanePosition" => {
            node.only(&["Orientation"], &["roadId", "laneId", "offset", "s"])?;
            in_middle(node)?;
            let road = roads.find(node, Some(&node.text("roadId")?), [0.0; 2])?;
            road.place(node, lane_number(node, "laneId")?, node.number("s")?)
                .map(Some)
        }
        "RelativeLanePosition" => {
            node.only(
                &["Orientation"],
                &["entityRef", "dLane", "ds", "dsLane", "offset"],
            )?;
            in_middle(node)?;
            let reference = known.get(entity_index(node, "entityRef", entities)?);
            let Some(reference) = reference.and_then(Option::as_ref) else {
                return Ok(None);
            };
            let road = roads.find(node, Some(&reference.road), [0.0; 2])?;
            let lane = road.shifted_lane(reference.lane, lane_number(node, "dLane")?);
            let ahead_m = match node.optional_number("dsLane")? {
                Some(ahead_m) => ahead_m,
                None => node.number("ds")?,
            };
            road.place_along(node, lane, reference.along_m + ahead_m)
                .map(Some)
        }
        _ => Err(node.refuse("is not supported as a position")),
    }
}

/// Sets the initial speeds, of which some are relative to others.
fn resolve_speeds<'a>(
    speeds: Vec<(usize, SpeedAction<'a>)>,
    state: &mut InitialState<'a>,
    actions: Node<'a>,
    work: &WorkBudget,
) -> Result<()> {
    let (mut waiting, mut rounds) = (speeds, 0);
    while !waiting.is_empty() {
        work.spend(actions, WORK_PER_INITIAL_SPEED * waiting.len() as u64)?;
        let (mut later, count) = (Vec::new(), waiting.len());
        for (entity, action) in waiting {
            if action.dynamics.shape != TransitionShape::Step {
                state.transitions.push((entity, action));
                continue;
            }
            let reference = action
                .target
                .reference
                .map(|other| state.speeds_mps.get(other).copied().flatten());
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
        (waiting, rounds) = (later, rounds + 1);
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
    )?;
    let reference = entity_index(node, "entityRef", entities)?;
    let leads = match node.optional_text("displacement")?.as_deref() {
        Some(displacement) => displacement == "leadingReferencedEntity",
        None => {
            state.places.get(entity).map(|place| place.along_m)
                > state.places.get(reference).map(|place| place.along_m)
        }
    };
    let (front, rear) = if leads {
        (entity, reference)
    } else {
        (reference, entity)
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
    let from_m = state
        .places
        .get(reference)
        .map_or(0.0, |place| place.along_m);
    if let Some(place) = state.places.get_mut(entity) {
        place.along_m = if leads {
            from_m + distance_m
        } else {
            from_m - distance_m
        };
    }
    Ok(())
}
