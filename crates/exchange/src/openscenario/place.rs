//! Places that positions state (ASAM OpenSCENARIO XML 1.3.1, 6.3.8).

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::WorkBudget;
use super::path_actions::lane_number;
use super::road::{LanePlace, RoadMap};
use super::route::{ROUTE_POSITION, route_place};
use super::source::SourceFiles;
use super::storyboard::entity_index;
use super::vocabulary::{last_element, path};
use super::xml::Node;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Largest pitch or roll that is none, in radians.
const LEVEL_RAD: f64 = 1e-3;
/// Smallest cosine of the angle between a trajectory and its lane: the steepest trajectory has the slope 0.65.
const MIN_VERTEX_COSINE: f64 = 0.838;

/// Purpose of a position, which determines the orientations that it may state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PlacePurpose {
    /// A place on a lane: along the lane, and level.
    Lane,
    /// An obstacle: any orientation.
    Obstacle,
    /// A pedestrian: along the lane, or any other orientation.
    Pedestrian,
    /// A vertex of a trajectory: about along the lane; pitch and roll have no influence.
    Vertex,
}

/// Roads, entities and files to which positions may refer.
#[derive(Clone, Copy)]
pub(super) struct PlaceSources<'a> {
    pub(super) entities: &'a [Entity<'a>],
    pub(super) roads: &'a RoadMap<'a>,
    pub(super) files: &'a SourceFiles<'a>,
    pub(super) work: &'a WorkBudget,
}

/// Returns the place of a position; `None` if it is relative to a position that is not resolved yet.
pub(super) fn resolve_place(
    node: Node<'_>,
    resolved: &[Option<LanePlace>],
    sources: &PlaceSources<'_>,
    purpose: PlacePurpose,
) -> Result<Option<LanePlace>> {
    let Some(row) = POSITIONS.iter().find(|row| row.element == node.name()) else {
        return Err(node.refuse("is not supported as a position"));
    };
    node.only(row.children, row.attributes)?;
    let reference = if row.attributes.contains(&"entityRef") {
        let index = entity_index(node, "entityRef", sources.entities)?;
        match resolved.get(index).and_then(Option::as_ref) {
            Some(reference) => Some(reference),
            None => return Ok(None),
        }
    } else {
        None
    };
    let context = PositionContext {
        sources,
        roads: sources.roads,
        reference,
        purpose,
    };
    let mut lane_place = (row.read)(node, &context)?;
    orient(node, &mut lane_place, &context)?;
    Ok(Some(lane_place))
}

/// Roads and entities to which a position may refer.
struct PositionContext<'a, 'b> {
    sources: &'a PlaceSources<'b>,
    roads: &'a RoadMap<'b>,
    /// Place of the entity to which the position is relative.
    reference: Option<&'a LanePlace>,
    purpose: PlacePurpose,
}

type ReadPosition = fn(Node<'_>, &PositionContext<'_, '_>) -> Result<LanePlace>;

/// A kind of position that the importer knows.
struct PositionRow {
    element: &'static str,
    children: &'static [&'static str],
    attributes: &'static [&'static str],
    read: ReadPosition,
}

/// Children of most positions.
const ORIENTED: &[&str] = &["Orientation"];

/// Positions (6.3.8); those with `entityRef` are relative to an entity.
const POSITIONS: &[PositionRow] = &[
    PositionRow {
        element: last_element(path::WORLD_POSITION),
        children: ORIENTED,
        attributes: &["x", "y", "z", "h", "p", "r"],
        read: world_place,
    },
    PositionRow {
        element: "LanePosition",
        children: ORIENTED,
        attributes: &["roadId", "laneId", "offset", "s"],
        read: |node, context| {
            let road = context
                .roads
                .find(node, Some(&node.text("roadId")?), [0.0; 2])?;
            let offset_m = node.optional_number("offset")?.unwrap_or(0.0);
            road.position(
                node,
                lane_number(node, "laneId")?,
                node.number("s")?,
                offset_m,
            )
        },
    },
    PositionRow {
        element: "RoadPosition",
        children: ORIENTED,
        attributes: &["roadId", "s", "t"],
        read: |node, context| {
            let road = context
                .roads
                .find(node, Some(&node.text("roadId")?), [0.0; 2])?;
            road.position_beside(node, node.number("s")?, node.number("t")?)
        },
    },
    PositionRow {
        element: "RelativeLanePosition",
        children: ORIENTED,
        attributes: &["entityRef", "dLane", "ds", "dsLane", "offset"],
        read: relative_lane_place,
    },
    PositionRow {
        element: "RelativeRoadPosition",
        children: ORIENTED,
        attributes: &["entityRef", "ds", "dt"],
        read: |node, context| {
            relative_place(node, context, node.number("ds")?, node.number("dt")?, false)
        },
    },
    PositionRow {
        element: "RelativeObjectPosition",
        children: ORIENTED,
        attributes: &["entityRef", "dx", "dy", "dz"],
        read: |node, context| {
            relative_place(node, context, node.number("dx")?, node.number("dy")?, true)
        },
    },
    PositionRow {
        element: ROUTE_POSITION,
        children: &["RouteRef", "InRoutePosition", "Orientation"],
        attributes: &[],
        read: |node, context| route_place(node, context.sources),
    },
];

fn world_place(node: Node<'_>, context: &PositionContext<'_, '_>) -> Result<LanePlace> {
    let point_m = [node.number("x")?, node.number("y")?];
    let road = context.roads.find(node, None, point_m)?;
    let stated_rad = node.optional_number("h")?;
    let heading_rad = match context.purpose {
        // Without `h`, the heading is 0.
        PlacePurpose::Lane => Some(stated_rad.unwrap_or(0.0)),
        PlacePurpose::Obstacle | PlacePurpose::Pedestrian | PlacePurpose::Vertex => None,
    };
    let mut lane_place = road.place_of_point(node, point_m, heading_rad)?;
    if context.purpose == PlacePurpose::Pedestrian {
        let own_rad = road.travel_rad(lane_place.direction);
        lane_place.turn_if_along(stated_rad.unwrap_or(0.0) - own_rad);
    }
    if let (PlacePurpose::Vertex, Some(stated_rad)) = (context.purpose, stated_rad) {
        check_about_along(node, stated_rad - road.travel_rad(lane_place.direction))?;
    }
    Ok(lane_place)
}

/// Refuses a heading of a vertex that is not about along the lane.
fn check_about_along(node: Node<'_>, angle_rad: f64) -> Result<()> {
    if libm::cos(angle_rad).abs() < MIN_VERTEX_COSINE {
        return Err(node.refuse("`h` is across the lane: vehicles drive along them"));
    }
    Ok(())
}

/// Returns the angle from the direction of travel at a place to the direction that its position states.
pub(super) fn stated_angle_rad(
    position: Node<'_>,
    lane_place: &LanePlace,
    roads: &RoadMap<'_>,
) -> Result<f64> {
    let orientation = position.optional("Orientation");
    let stated_rad = orientation.unwrap_or(position).optional_number("h")?;
    let is_world = position.name() == last_element(path::WORLD_POSITION);
    let is_relative = orientation.is_some_and(|node| node.raw("type") == Some("relative"));
    match stated_rad {
        Some(stated_rad) if is_relative => Ok(stated_rad),
        None if !is_world => Ok(0.0),
        stated_rad => {
            let road = roads.find(position, Some(&lane_place.road), [0.0; 2])?;
            Ok(stated_rad.unwrap_or(0.0) - road.travel_rad(lane_place.direction))
        }
    }
}

/// Returns the attribute in which a position states pitch or roll.
pub(super) fn tilt(position: Node<'_>) -> Result<Option<&'static str>> {
    let orientation = position.optional("Orientation").unwrap_or(position);
    for angle in ["p", "r"] {
        if orientation.optional_number(angle)?.unwrap_or(0.0).abs() > LEVEL_RAD {
            return Ok(Some(angle));
        }
    }
    Ok(None)
}

/// Returns the place at a distance and a number of lanes from another place.
fn relative_lane_place(node: Node<'_>, context: &PositionContext<'_, '_>) -> Result<LanePlace> {
    let reference = context.reference(node)?;
    let road = context.roads.find(node, Some(&reference.road), [0.0; 2])?;
    let lane = road
        .lane_at(reference.lateral_m)
        .ok_or_else(|| node.refuse("the reference is beside the lanes"))?;
    let by = lane_number(node, "dLane")?;
    let lane = road.shifted_lane(lane, by, reference.direction);
    let ahead_m = match node.optional_number("dsLane")? {
        Some(ahead_m) => ahead_m,
        None => node.number("ds")?,
    };
    let road_m = reference.road_m + reference.direction * ahead_m;
    let offset_m = node.optional_number("offset")?.unwrap_or(0.0);
    let lane_place = road.position(node, lane, road.s_m(road_m), offset_m)?;
    Ok(LanePlace {
        direction: reference.direction,
        ..lane_place
    })
}

/// Returns the place ahead of another one and to its left, in the direction of the road or in that of the other one.
fn relative_place(
    node: Node<'_>,
    context: &PositionContext<'_, '_>,
    ahead_m: f64,
    left_m: f64,
    turns_with_reference: bool,
) -> Result<LanePlace> {
    let reference = context.reference(node)?;
    let road = context.roads.find(node, Some(&reference.road), [0.0; 2])?;
    let sign = if turns_with_reference {
        reference.direction
    } else {
        1.0
    };
    let road_m = reference.road_m + sign * ahead_m;
    road.check_inside(node, road_m)?;
    Ok(LanePlace {
        road: reference.road.clone(),
        road_m,
        lateral_m: reference.lateral_m + sign * left_m,
        direction: reference.direction,
    })
}

impl PositionContext<'_, '_> {
    fn reference(&self, node: Node<'_>) -> Result<&LanePlace> {
        self.reference
            .ok_or_else(|| node.refuse("has no reference"))
    }
}

/// Turns a place by its orientation, which must suit its purpose. `h` of a world position is checked with the lane.
fn orient(
    node: Node<'_>,
    lane_place: &mut LanePlace,
    context: &PositionContext<'_, '_>,
) -> Result<()> {
    let orientation = node.optional("Orientation");
    if let Some(orientation) = orientation {
        orientation.only(&[], &["type", "h", "p", "r"])?;
    }
    if context.purpose == PlacePurpose::Obstacle {
        return Ok(());
    }
    let may_tilt = context.purpose == PlacePurpose::Vertex;
    if let (false, Some(angle)) = (may_tilt, tilt(node)?) {
        let tilted = orientation.unwrap_or(node);
        return Err(tilted.refuse(format!("`{angle}` differs from the direction of the lane")));
    }
    let Some(orientation) = orientation else {
        return Ok(());
    };
    let Some(heading_rad) = orientation.optional_number("h")? else {
        return Ok(());
    };
    let own_rad = match orientation.raw("type") {
        Some("relative") => 0.0,
        _ => {
            let road = context.roads.find(node, Some(&lane_place.road), [0.0; 2])?;
            road.travel_rad(lane_place.direction)
        }
    };
    match context.purpose {
        PlacePurpose::Vertex => check_about_along(orientation, heading_rad - own_rad),
        PlacePurpose::Pedestrian => {
            lane_place.turn_if_along(heading_rad - own_rad);
            Ok(())
        }
        _ => lane_place.turn(orientation, heading_rad - own_rad),
    }
}
