//! Initial actions: positions, speeds and the environment.

use super::constructs::{ActionDomains, KnownAction, find_action};
use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::{
    MAX_ENVIRONMENTS, MAX_INITIAL_ACTIONS, WORK_PER_INITIAL_SPEED, WorkBudget, ensure_at_most,
};
use super::place::{PlacePurpose, PlaceSources, resolve_place, stated_angle_rad};
use super::road::{LanePlace, RoadMap};
use super::source::SourceFiles;
use super::storyboard::{SpeedAction, StoryAction, entity_index, read_speed};
use super::vocabulary::{last_element, path};
use super::xml::Node;
use crumple_core::digits::format_number;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Friction coefficients of a scenario.
const FRICTION_RANGE: std::ops::RangeInclusive<f64> = 0.01..=1.0;

/// Initial state of all entities.
pub(super) struct InitialState<'a> {
    pub(super) places: Vec<LanePlace>,
    pub(super) speeds_mps: Vec<Option<f64>>,
    /// Actions that go on after the start, with their entities.
    pub(super) actions: Vec<(usize, InitialAction<'a>)>,
    /// Entities whose controller is active from the start.
    pub(super) is_active: Vec<bool>,
    /// Angles by which standing bodies are turned from the direction of the road, in radians.
    pub(super) turned_rad: Vec<f64>,
    pub(super) friction: f64,
    pub(super) notes: Vec<String>,
}

/// An action of `Init` that goes on after the start.
pub(super) enum InitialAction<'a> {
    /// Follows the speed of an entity for ever.
    Continuous(SpeedAction<'a>),
    Route(Node<'a>),
    /// A transition of the speed.
    Transition(SpeedAction<'a>),
    /// Another action that controls the motion.
    Control(InitialControl<'a>),
}

/// An action of `Init` that controls the motion of an entity in some domains.
pub(super) struct InitialControl<'a> {
    pub(super) node: Node<'a>,
    pub(super) action: StoryAction<'a>,
    pub(super) domains: ActionDomains,
}

impl<'a> InitialState<'a> {
    fn new(count: usize) -> Self {
        Self {
            places: Vec::new(),
            speeds_mps: vec![None; count],
            actions: Vec::new(),
            is_active: vec![false; count],
            turned_rad: vec![0.0; count],
            friction: 1.0,
            notes: Vec::new(),
        }
    }

    /// Sets the speed of an entity, given that to which it is relative.
    fn set_speed(
        &mut self,
        entity: usize,
        action: SpeedAction<'a>,
        reference_mps: f64,
    ) -> Result<()> {
        let mps = action.target.speed_mps(action.node, reference_mps)?;
        if let Some(speed) = self.speeds_mps.get_mut(entity) {
            *speed = Some(mps);
        }
        if action.target.is_continuous {
            let action = InitialAction::Continuous(action);
            self.actions.push((entity, action));
        }
        Ok(())
    }

    /// Returns the position in the direction of travel.
    fn along_m(&self, entity: usize) -> Option<f64> {
        let lane_place = self.places.get(entity)?;
        Some(lane_place.direction * lane_place.road_m)
    }
}

/// Reads the element `Init` of a storyboard.
pub(super) fn read_initial<'a>(
    storyboard: Node<'a>,
    entities: &[Entity<'_>],
    roads: &RoadMap<'_>,
    files: &SourceFiles<'_>,
    work: &WorkBudget,
) -> Result<InitialState<'a>> {
    let init = storyboard.child("Init")?;
    init.only(&["Actions"], &[])?;
    let groups = init.child("Actions")?;
    check_counts(groups)?;
    let mut state = InitialState::new(entities.len());
    let mut actions = InitialActions::new(entities.len());
    for group in groups.children() {
        match group.name() {
            "GlobalAction" => read_global(group, files, entities, &mut state)?,
            "UserDefinedAction" => {
                let note = group.note("has no influence on the motion");
                state.notes.push(note);
            }
            "Private" => actions.read_group(group, entities, &mut state)?,
            _ => return Err(group.refuse("is not supported")),
        }
    }
    let positions = actions.positions();
    let sources = PlaceSources {
        entities,
        roads,
        files,
        work,
    };
    state.places = resolve_places(init, &positions, &sources)?;
    state.turned_rad = turned_bodies(&positions, &state.places, entities, roads)?;
    if let Some(lane_place) = state.places.first() {
        let road = roads.find(init, Some(&lane_place.road), [0.0; 2])?;
        state.notes.extend(road.notes.iter().cloned());
    }
    resolve_speeds(actions.speeds, &mut state, groups, work)?;
    for (entity, node) in actions.distances {
        apply_distance(node, entity, entities, &mut state)?;
    }
    state.actions.extend(actions.others);
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
    /// Entities, their routes and other actions that control their motion.
    others: Vec<(usize, InitialAction<'a>)>,
}

/// Position at which an entity starts.
#[derive(Clone, Copy)]
struct StartPosition<'a> {
    node: Node<'a>,
    purpose: PlacePurpose,
}

impl StartPosition<'_> {
    /// Returns the purpose of the position of a body.
    fn purpose_for(&self, body: Option<&Entity<'_>>) -> PlacePurpose {
        match body {
            Some(body) if body.is_obstacle => PlacePurpose::Obstacle,
            Some(body) if body.is_pedestrian => PlacePurpose::Pedestrian,
            _ => self.purpose,
        }
    }
}

impl<'a> InitialActions<'a> {
    fn new(count: usize) -> Self {
        Self {
            positions: vec![None; count],
            speeds: Vec::new(),
            distances: Vec::new(),
            others: Vec::new(),
        }
    }

    /// Reads the actions of an entity.
    fn read_group(
        &mut self,
        group: Node<'a>,
        entities: &[Entity<'_>],
        state: &mut InitialState<'_>,
    ) -> Result<()> {
        group.only(&["PrivateAction"], &["entityRef"])?;
        let entity = entity_index(group, "entityRef", entities)?;
        for action in group.children() {
            self.read(action, entity, entities, state)?;
        }
        Ok(())
    }

    /// Returns the positions of the entities. One without a position starts at the first vertex of its trajectory.
    fn positions(&self) -> Vec<Option<StartPosition<'a>>> {
        let stated = self.positions.iter().enumerate();
        stated
            .map(|(entity, stated)| match stated {
                Some(node) => Some(StartPosition {
                    node: *node,
                    purpose: PlacePurpose::Lane,
                }),
                None => self.first_vertex(entity),
            })
            .collect()
    }

    /// Returns the position of the first vertex of an entity's trajectory.
    fn first_vertex(&self, entity: usize) -> Option<StartPosition<'a>> {
        let mut own = self.others.iter().filter(|(owner, _)| *owner == entity);
        own.find_map(|(_, action)| match action {
            InitialAction::Control(InitialControl {
                action: StoryAction::Trajectory(trajectory),
                ..
            }) => Some(StartPosition {
                node: trajectory.first_position()?,
                purpose: PlacePurpose::Vertex,
            }),
            _ => None,
        })
    }

    /// Reads a private action of an entity.
    fn read(
        &mut self,
        holder: Node<'a>,
        entity: usize,
        entities: &[Entity<'_>],
        state: &mut InitialState<'_>,
    ) -> Result<()> {
        let action = holder.single()?;
        let is_longitudinal = action.name() == "LongitudinalAction";
        let inner = action.children().next().map(Node::name);
        if action.name() == path::TELEPORT_ACTION {
            let position = action.child("Position")?.single()?;
            let slot = self.positions.get_mut(entity);
            if slot.is_some_and(|slot| slot.replace(position).is_some()) {
                return Err(action.refuse("is a second position of the entity"));
            }
            return Ok(());
        }
        if is_longitudinal && inner == Some(last_element(path::SPEED_ACTION)) {
            let speed = read_speed(action.single()?, entities)?;
            self.speeds.push((entity, speed));
            return Ok(());
        }
        if is_longitudinal && inner == Some(last_element(path::DISTANCE_ACTION)) {
            self.distances.push((entity, action.single()?));
            return Ok(());
        }
        self.read_other(holder, entity, entities, state)
    }

    /// Reads an action that has no effect on the initial motion.
    fn read_other(
        &mut self,
        holder: Node<'a>,
        entity: usize,
        entities: &[Entity<'_>],
        state: &mut InitialState<'_>,
    ) -> Result<()> {
        let action = holder.single()?;
        let KnownAction {
            action: known,
            domains,
        } = find_action(holder, entities)?;
        match known {
            StoryAction::Activate => {
                if let Some(is_active) = state.is_active.get_mut(entity) {
                    *is_active = true;
                }
            }
            StoryAction::Ignored(reason) => state.notes.push(action.note(reason)),
            StoryAction::Route(node) => {
                self.others.push((entity, InitialAction::Route(node)));
            }
            known @ (StoryAction::Trajectory(_)
            | StoryAction::LaneChange(_)
            | StoryAction::LaneOffset(_)
            | StoryAction::SpeedProfile(_)) => {
                let control = InitialControl {
                    node: known.node().unwrap_or(action),
                    action: known,
                    domains,
                };
                self.others.push((entity, InitialAction::Control(control)));
            }
            _ => return Err(action.refuse("is not supported in `Init`")),
        }
        Ok(())
    }
}

/// Reads a global action: the environment, or one without influence on the motion.
fn read_global(
    holder: Node<'_>,
    files: &SourceFiles<'_>,
    entities: &[Entity<'_>],
    state: &mut InitialState<'_>,
) -> Result<()> {
    let action = holder.single()?;
    if action.name() == path::ENVIRONMENT_ACTION {
        return read_environment(action, files, state);
    }
    match find_action(holder, entities)?.action {
        StoryAction::Ignored(reason) => state.notes.push(action.note(reason)),
        _ => return Err(action.refuse("is not supported in `Init`")),
    }
    Ok(())
}

fn read_environment(
    action: Node<'_>,
    files: &SourceFiles<'_>,
    state: &mut InitialState<'_>,
) -> Result<()> {
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
    positions: &[Option<StartPosition<'_>>],
    sources: &PlaceSources<'_>,
) -> Result<Vec<LanePlace>> {
    let entities = sources.entities;
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
            let purpose = position.purpose_for(entities.get(entity));
            let position = position.node;
            match resolve_place(position, &places, sources, purpose)? {
                Some(lane_place) => {
                    drop(places.get_mut(entity).map(|slot| slot.replace(lane_place)))
                }
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

fn check_same_road(places: &[LanePlace], positions: &[Option<StartPosition<'_>>]) -> Result<()> {
    let road = places.first().map(|position| &position.road);
    let mut places = places.iter().zip(positions);
    match places.find(|(lane_place, _)| road != Some(&lane_place.road)) {
        Some((_, Some(position))) => Err(position.node.refuse("entities must be on the same road")),
        _ => Ok(()),
    }
}

/// Returns the angles by which obstacles and pedestrians are turned from the direction of travel.
fn turned_bodies(
    positions: &[Option<StartPosition<'_>>],
    places: &[LanePlace],
    entities: &[Entity<'_>],
    roads: &RoadMap<'_>,
) -> Result<Vec<f64>> {
    let bodies = positions.iter().zip(places).zip(entities);
    bodies
        .map(|((position, lane_place), body)| match position {
            Some(StartPosition { node, .. }) if body.is_obstacle || body.is_pedestrian => {
                stated_angle_rad(*node, lane_place, roads)
            }
            _ => Ok(0.0),
        })
        .collect()
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
            let reference = action.target.reference;
            let reference = reference.map(|entity| state.speeds_mps.get(entity).copied().flatten());
            if !action.dynamics.is_instant() {
                let action = InitialAction::Transition(action);
                state.actions.push((entity, action));
            } else if reference == Some(None) && rounds <= count {
                later.push((entity, action));
            } else {
                // A vehicle without an initial speed stands.
                state.set_speed(entity, action, reference.flatten().unwrap_or(0.0))?;
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
    if let Some(lane_place) = state.places.get_mut(entity) {
        let along_m = if leads {
            from_m + distance_m
        } else {
            from_m - distance_m
        };
        lane_place.road_m = lane_place.direction * along_m;
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
