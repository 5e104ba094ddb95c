//! Routes, and positions on them (ASAM OpenSCENARIO XML 1.3.1, classes `Route` and `RoutePosition`).

use super::error::ScenarioImportError;
use super::limits::{WORK_PER_ENTRY, WORK_PER_SAMPLE};
use super::path_actions::lane_number;
use super::place::{PlacePurpose, PlaceSources, resolve_place};
use super::road::LanePlace;
use super::xml::Node;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Element of a position on a route.
pub(super) const ROUTE_POSITION: &str = "RoutePosition";
/// Reason to refuse a route that leaves its lane.
pub(super) const LEAVES_LANE: &str = "the route leaves the lane";
/// Reason to refuse a route with a waypoint behind the one before.
pub(super) const LEADS_BACK: &str = "the route leads back: vehicles drive on along their lane";

/// Returns the positions of the waypoints of a route, which may lead neither to another road nor back to its start.
pub(super) fn waypoints(route: Node<'_>) -> Result<Vec<Node<'_>>> {
    route.only(&["ParameterDeclarations", "Waypoint"], &["name", "closed"])?;
    if route.flag("closed", false)? {
        return Err(route.refuse("is closed: the way back to its start leaves the lane"));
    }
    let mut positions = Vec::new();
    for waypoint in route.named("Waypoint") {
        waypoint.only(&["Position"], &["routeStrategy"])?;
        positions.push(waypoint.child("Position")?.single()?);
    }
    check_one_road(&positions)?;
    Ok(positions)
}

/// Refuses positions that name several roads. The roads need not be straight for this reason.
fn check_one_road(positions: &[Node<'_>]) -> Result<()> {
    let mut first: Option<String> = None;
    for position in positions {
        let Some(road) = position.optional_text("roadId")? else {
            continue;
        };
        let first = first.get_or_insert_with(|| road.clone());
        if *first != road {
            return Err(position.refuse(format!(
                "the route leads from the road `{first}` to the road `{road}`: vehicles stay on one road"
            )));
        }
    }
    Ok(())
}

/// A route along one lane.
struct LaneRoute {
    start: LanePlace,
    length_m: f64,
}

impl LaneRoute {
    /// Reads a route whose waypoints are places on one lane.
    fn read(route: Node<'_>, sources: &PlaceSources<'_>) -> Result<Self> {
        let mut lane_route: Option<Self> = None;
        for position in waypoints(route)? {
            sources.work.spend(position, WORK_PER_SAMPLE)?;
            let lane_place = waypoint_place(position, sources)?;
            match &mut lane_route {
                None => {
                    lane_route = Some(Self {
                        start: lane_place,
                        length_m: 0.0,
                    });
                }
                Some(lane_route) => lane_route.extend(position, &lane_place, sources)?,
            }
        }
        lane_route.ok_or_else(|| route.refuse("has no waypoints"))
    }

    /// Extends the route to a waypoint.
    fn extend(
        &mut self,
        position: Node<'_>,
        lane_place: &LanePlace,
        sources: &PlaceSources<'_>,
    ) -> Result<()> {
        let start = &self.start;
        let road = sources.roads.find(position, Some(&start.road), [0.0; 2])?;
        let stays = lane_place.road == start.road
            && road.lane_at(lane_place.lateral_m) == road.lane_at(start.lateral_m);
        if !stays {
            return Err(position.refuse(LEAVES_LANE));
        }
        let length_m = start.direction * (lane_place.road_m - start.road_m);
        if length_m < self.length_m {
            return Err(position.refuse(LEADS_BACK));
        }
        self.length_m = length_m;
        Ok(())
    }

    /// Returns the place of the element in `InRoutePosition`.
    fn resolve(&self, inside: Node<'_>, sources: &PlaceSources<'_>) -> Result<LanePlace> {
        let is_on_lane = match inside.name() {
            "FromLaneCoordinates" => true,
            "FromRoadCoordinates" => false,
            _ => return Err(inside.refuse("is not supported in a route")),
        };
        let along_m = inside.non_negative("pathS")?;
        if along_m > self.length_m {
            return Err(inside.refuse("is beyond the end of the route"));
        }
        let start = &self.start;
        let road = sources.roads.find(inside, Some(&start.road), [0.0; 2])?;
        let s_m = road.s_m(start.road_m + start.direction * along_m);
        if is_on_lane {
            inside.only(&[], &["pathS", "laneId", "laneOffset"])?;
            let offset_m = inside.optional_number("laneOffset")?.unwrap_or(0.0);
            road.position(inside, lane_number(inside, "laneId")?, s_m, offset_m)
        } else {
            inside.only(&[], &["pathS", "t"])?;
            road.position_beside(inside, s_m, inside.number("t")?)
        }
    }
}

/// Returns the place of a waypoint.
fn waypoint_place(position: Node<'_>, sources: &PlaceSources<'_>) -> Result<LanePlace> {
    // A route of a catalogue could refer to itself.
    if position.name() == ROUTE_POSITION {
        return Err(position.refuse("is on another route"));
    }
    resolve_place(position, &[], sources, PlacePurpose::Lane)?
        .ok_or_else(|| position.refuse("a route relative to an entity is not supported"))
}

/// Returns the place of a `RoutePosition`, whose route must stay in one lane.
pub(super) fn route_place(node: Node<'_>, sources: &PlaceSources<'_>) -> Result<LanePlace> {
    sources.work.spend(node, WORK_PER_ENTRY)?;
    let reference = node.child("RouteRef")?.single()?;
    let lane_route = match reference.name() {
        "Route" => LaneRoute::read(reference, sources)?,
        _ => sources
            .files
            .with_catalog_entry(reference, &["Route"], |route| {
                LaneRoute::read(route, sources)
            })?,
    };
    lane_route.resolve(node.child("InRoutePosition")?.single()?, sources)
}
