//! Lane changes, lateral offsets and routes.

use super::constructs::ActionDomains;
use super::entities::Entity;
use super::error::ScenarioImportError;
use super::interpreter::ActionGoal;
use super::lateral::{LateralExtent, LateralMove};
use super::limits::{MAX_DURATION_S, WORK_PER_ENTRY, WORK_PER_SAMPLE};
use super::place::{PlacePurpose, resolve_place};
use super::replay::Replay;
use super::road::LanePlace;
use super::route::{LEADS_BACK, LEAVES_LANE, waypoints};
use super::speed_plan::{TransitionDynamics, take_samples};
use super::storyboard::{StoryAction, entity_index};
use super::trigger::Firing;
use super::vocabulary::TransitionShape;
use super::xml::Node;
use crumple_core::digits::format_number;

type Result<T> = std::result::Result<T, ScenarioImportError>;

pub(super) struct LaneChangeAction<'a> {
    pub(super) node: Node<'a>,
    dynamics: TransitionDynamics,
    target: LaneTarget,
    /// Distance to the left of the middle of the lane, in the direction of travel, in metres.
    offset_m: f64,
}

enum LaneTarget {
    Absolute(i32),
    /// Number of lanes to the left of an entity.
    Relative(usize, i32),
}

/// A change of the distance from the middle of the lane.
pub(super) struct LaneOffsetAction<'a> {
    pub(super) node: Node<'a>,
    shape: TransitionShape,
    /// Largest lateral acceleration, in m/s².
    max_mps2: Option<f64>,
    /// Entity whose lateral position is the reference; without one, that is the middle of the lane.
    reference: Option<usize>,
    offset_m: f64,
    /// True if the action keeps the offset until another one ends it (class `LaneOffsetAction`).
    is_continuous: bool,
}

impl LaneOffsetAction<'_> {
    /// Returns the duration of a lateral movement.
    fn duration_s(&self, change_m: f64) -> Result<f64> {
        let duration_s = match self.max_mps2 {
            Some(limit_mps2) if change_m != 0.0 => {
                self.shape.duration_at_acceleration_s(change_m, limit_mps2)
            }
            _ => 0.0,
        };
        if duration_s > MAX_DURATION_S {
            let problem = format!("the movement takes longer than {MAX_DURATION_S} s");
            return Err(self.node.refuse(problem));
        }
        Ok(duration_s)
    }
}

/// Reads a lane change.
pub(super) fn read_lane_change<'a>(
    node: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    node.only(
        &["LaneChangeActionDynamics", "LaneChangeTarget"],
        &["targetLaneOffset"],
    )?;
    let dynamics = TransitionDynamics::read(node.child("LaneChangeActionDynamics")?)?;
    let target = node.child("LaneChangeTarget")?.single()?;
    let lane = lane_number(target, "value")?;
    let target = match target.name() {
        "AbsoluteTargetLane" => LaneTarget::Absolute(lane),
        "RelativeTargetLane" => {
            LaneTarget::Relative(entity_index(target, "entityRef", entities)?, lane)
        }
        _ => return Err(target.refuse("is not supported as a target lane")),
    };
    Ok(StoryAction::LaneChange(LaneChangeAction {
        node,
        dynamics,
        target,
        offset_m: node.optional_number("targetLaneOffset")?.unwrap_or(0.0),
    }))
}

/// Reads a change of the distance from the middle of the lane.
pub(super) fn read_lane_offset<'a>(
    node: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    node.only(
        &["LaneOffsetActionDynamics", "LaneOffsetTarget"],
        &["continuous"],
    )?;
    let dynamics = node.child("LaneOffsetActionDynamics")?;
    dynamics.only(&[], &["maxLateralAcc", "dynamicsShape"])?;
    let target = node.child("LaneOffsetTarget")?.single()?;
    target.only(&[], &["entityRef", "value"])?;
    let reference = match target.name() {
        "AbsoluteTargetLaneOffset" => None,
        "RelativeTargetLaneOffset" => Some(entity_index(target, "entityRef", entities)?),
        _ => return Err(target.refuse("is not supported as a target offset")),
    };
    Ok(StoryAction::LaneOffset(LaneOffsetAction {
        node,
        shape: dynamics.word("dynamicsShape")?,
        max_mps2: dynamics.optional_non_negative("maxLateralAcc")?,
        reference,
        offset_m: target.number("value")?,
        is_continuous: node.flag("continuous", false)?,
    }))
}

/// Returns the whole number of an attribute.
pub(super) fn lane_number(node: Node<'_>, name: &str) -> Result<i32> {
    match node.number(name)? {
        number if number.fract() == 0.0 && number.abs() <= 1000.0 => Ok(number as i32),
        number => Err(node.refuse(format!(
            "attribute `{name}`: {} is not the number of a lane",
            format_number(number)
        ))),
    }
}

/// Reads a route or a destination: a vehicle that follows its lane needs none.
pub(super) fn read_route<'a>(node: Node<'a>, _entities: &[Entity<'_>]) -> Result<StoryAction<'a>> {
    node.only(&["Route", "CatalogReference", "Position"], &[])?;
    node.single()?;
    Ok(StoryAction::Route(node))
}

impl<'a> Replay<'a, '_> {
    /// Starts a lane change of an entity, and returns its goal.
    pub(super) fn change_lane(
        &mut self,
        change: &LaneChangeAction<'a>,
        actor: usize,
        start: Firing,
    ) -> Result<ActionGoal> {
        let road = self.road.clone();
        let to = match change.target {
            LaneTarget::Absolute(lane) => lane,
            LaneTarget::Relative(entity, by) => {
                let lane = self.lane(change.node, entity, start.time_s)?;
                road.shifted_lane(lane, by, self.direction(entity))
            }
        };
        let middle_m = road.lane_middle_m(change.node, to)?;
        let to_m = middle_m + self.direction(actor) * change.offset_m;
        let from_m = self.lateral_m(actor, start.time_s);
        let extent = match change.dynamics.duration_s(to_m - from_m) {
            Some(duration_s) if duration_s <= MAX_DURATION_S => LateralExtent::Time(duration_s),
            Some(_) => {
                return Err(change.node.refuse(format!(
                    "the lane change takes longer than {MAX_DURATION_S} s"
                )));
            }
            None => LateralExtent::Distance {
                from_m: self.driven_m(actor, start.time_s),
                length_m: change.dynamics.value,
            },
        };
        let shape = change.dynamics.shape;
        self.move_laterally(change.node, actor, start, [from_m, to_m], (shape, extent))
    }

    /// Starts a change of the distance from the middle of the lane, and returns its goal.
    pub(super) fn change_offset(
        &mut self,
        offset: &LaneOffsetAction<'a>,
        actor: usize,
        start: Firing,
    ) -> Result<ActionGoal> {
        let to_m = self.offset_goal_m(offset, actor, start.time_s)?;
        let from_m = self.lateral_m(actor, start.time_s);
        let duration_s = offset.duration_s(to_m - from_m)?;
        let movement = (offset.shape, LateralExtent::Time(duration_s));
        let goal = self.move_laterally(offset.node, actor, start, [from_m, to_m], movement)?;
        let end_s = if offset.is_continuous {
            f64::INFINITY
        } else {
            start.time_s + duration_s
        };
        if let Some(reference) = offset.reference {
            let (entities, times_s) = ([actor, reference], [start.time_s, end_s]);
            self.follow_entity(offset.node, entities, ActionDomains::LATERAL, times_s);
        }
        Ok(if offset.is_continuous {
            ActionGoal::Time(end_s)
        } else {
            goal
        })
    }

    /// Returns the lateral position at which an offset ends.
    fn offset_goal_m(
        &self,
        offset: &LaneOffsetAction<'a>,
        actor: usize,
        time_s: f64,
    ) -> Result<f64> {
        let reference_m = match offset.reference {
            Some(entity) => self.lateral_m(entity, time_s),
            None => {
                let lane = self.lane(offset.node, actor, time_s)?;
                self.road.lane_middle_m(offset.node, lane)?
            }
        };
        Ok(reference_m + self.direction(actor) * offset.offset_m)
    }

    fn move_laterally(
        &mut self,
        node: Node<'a>,
        actor: usize,
        start: Firing,
        [from_m, to_m]: [f64; 2],
        (shape, extent): (TransitionShape, LateralExtent),
    ) -> Result<ActionGoal> {
        take_samples(node, 1, &mut self.samples_left)?;
        if let Some(motion) = self.motion.get_mut(actor) {
            if motion.has_active_controller() {
                return Err(node.refuse("an entity with a controller must keep its lane"));
            }
            let step = LateralMove {
                node,
                start_s: start.time_s,
                from_m,
                to_m,
                shape,
                extent,
                depends_on_controller: start.depends_on_controller,
                cut_s: None,
            };
            let moves = std::iter::once(step);
            motion.lateral.replace(start.time_s, moves, &motion.plan);
        }
        Ok(ActionGoal::LateralMove)
    }

    /// Refuses a route that an entity cannot follow along its lane.
    pub(super) fn follow_route(&mut self, node: Node<'a>, actor: usize) -> Result<()> {
        let lane = self.lane(node, actor, self.now_s)?;
        if let Some(reference) = node.optional("CatalogReference") {
            self.work.spend(node, WORK_PER_ENTRY)?;
            let files = self.files;
            files.with_catalog_entry(reference, &["Route"], |route| {
                self.check_route(route, actor, lane)
            })?;
        }
        if let Some(route) = node.optional("Route") {
            self.check_route(route, actor, lane)?;
        }
        if let Some(position) = node.optional("Position") {
            let position = position.single()?;
            let along_m = self.waypoint_m(position, &self.places(self.now_s), actor, lane)?;
            if along_m < self.position_m(actor, self.now_s) {
                return Err(position.refuse(LEADS_BACK));
            }
        }
        self.note_once(Some(
            node.note("has no influence: the route stays in the lane"),
        ));
        Ok(())
    }

    fn check_route(&self, route: Node<'_>, actor: usize, lane: i32) -> Result<()> {
        let places = self.places(self.now_s);
        let mut before_m = f64::NEG_INFINITY;
        for position in waypoints(route)? {
            let along_m = self.waypoint_m(position, &places, actor, lane)?;
            if along_m < before_m {
                return Err(position.refuse(LEADS_BACK));
            }
            before_m = along_m;
        }
        Ok(())
    }

    /// Returns the position of a waypoint in the direction of an entity. Refuses one outside of the lane.
    fn waypoint_m(
        &self,
        position: Node<'_>,
        places: &[Option<LanePlace>],
        actor: usize,
        lane: i32,
    ) -> Result<f64> {
        self.work.spend(position, WORK_PER_SAMPLE)?;
        let sources = self.place_sources();
        match resolve_place(position, places, &sources, PlacePurpose::Lane) {
            Ok(Some(lane_place))
                if lane_place.road == self.road_id
                    && self.road.lane_at(lane_place.lateral_m) == Some(lane) =>
            {
                Ok(self.direction(actor) * lane_place.road_m)
            }
            _ => Err(position.refuse(LEAVES_LANE)),
        }
    }

    /// Returns the lane in which the middle of an entity is.
    fn lane(&self, node: Node<'_>, entity: usize, time_s: f64) -> Result<i32> {
        let lane = self.road.lane_at(self.lateral_m(entity, time_s));
        lane.ok_or_else(|| node.refuse("the entity is beside the lanes of the road"))
    }
}
