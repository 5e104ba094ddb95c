//! Actions that move along a path: trajectories and lane changes.

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::initial::resolve_place;
use super::limits::WORK_PER_SAMPLE;
use super::replay::{LaneChangeTimes, MAX_DURATION_S, Replay};
use super::speed_plan::{TransitionDynamics, TransitionShape, take_samples};
use super::storyboard::{StoryAction, entity_index};
use super::xml::Node;
use crumple_core::digits::format_number;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Largest distance of the first vertex of a trajectory from the entity, in metres.
const START_TOLERANCE_M: f64 = 0.01;

pub(super) struct LaneChangeAction<'a> {
    pub(super) node: Node<'a>,
    pub(super) dynamics: TransitionDynamics,
    pub(super) target: LaneTarget,
}

pub(super) enum LaneTarget {
    Absolute(i32),
    /// Number of lanes to the left of an entity.
    Relative(usize, i32),
}

pub(super) struct TrajectoryAction<'a> {
    pub(super) node: Node<'a>,
    /// Times and positions of the vertices.
    pub(super) vertices: Vec<(f64, Node<'a>)>,
    /// True if times count from the start of the action.
    pub(super) is_relative: bool,
}

pub(super) fn read_lane_change<'a>(
    node: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    node.only(
        &["LaneChangeActionDynamics", "LaneChangeTarget"],
        &["targetLaneOffset"],
    )?;
    if node
        .optional_number("targetLaneOffset")?
        .is_some_and(|offset_m| offset_m != 0.0)
    {
        return Err(
            node.refuse("targetLaneOffset is lateral: vehicles drive in the middle of a lane")
        );
    }
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

pub(super) fn read_trajectory<'a>(node: Node<'a>) -> Result<StoryAction<'a>> {
    node.only(
        &[
            "Trajectory",
            "TrajectoryRef",
            "TimeReference",
            "TrajectoryFollowingMode",
        ],
        &[],
    )?;
    let holder = node.optional("TrajectoryRef").unwrap_or(node);
    let trajectory = holder.child("Trajectory")?;
    trajectory.only(&["ParameterDeclarations", "Shape"], &["name", "closed"])?;
    if trajectory.flag("closed", false)? {
        return Err(trajectory.refuse("a closed trajectory is not supported"));
    }
    let shape = trajectory.child("Shape")?.single()?;
    if shape.name() != "Polyline" {
        return Err(shape.refuse("is not supported as a shape, only Polyline"));
    }
    let timing = node.child("TimeReference")?.single()?;
    if timing.name() != "Timing" {
        return Err(timing.refuse("a trajectory must have times"));
    }
    timing.only(&[], &["domainAbsoluteRelative", "scale", "offset"])?;
    timing.expect("domainAbsoluteRelative", &["absolute", "relative"])?;
    let is_relative = timing.text("domainAbsoluteRelative")? == "relative";
    let (scale, offset_s) = (timing.number("scale")?, timing.number("offset")?);
    let mut vertices: Vec<(f64, Node<'a>)> = Vec::new();
    for vertex in shape.children() {
        vertex.only(&["Position"], &["time"])?;
        let time_s = vertex.number("time")? * scale + offset_s;
        if vertices
            .last()
            .is_some_and(|(before_s, _)| *before_s >= time_s)
        {
            return Err(vertex.refuse("times of vertices must increase"));
        }
        vertices.push((time_s, vertex.child("Position")?.single()?));
    }
    Ok(StoryAction::Trajectory(TrajectoryAction {
        node,
        vertices,
        is_relative,
    }))
}

impl<'a> Replay<'a, '_> {
    /// Returns times and positions of the vertices until the entity would leave its lane, which is an error.
    pub(super) fn trajectory_vertices(
        &mut self,
        action: &TrajectoryAction<'a>,
        actor: usize,
        start_s: f64,
    ) -> Result<Vec<(f64, f64)>> {
        take_samples(action.node, action.vertices.len(), &mut self.samples_left)?;
        self.work
            .spend(action.node, WORK_PER_SAMPLE * action.vertices.len() as u64)?;
        let Some(motion) = self.motion.get(actor) else {
            return Ok(Vec::new());
        };
        let shift_s = if action.is_relative { start_s } else { 0.0 };
        let mut vertices = Vec::new();
        for (time_s, node) in &action.vertices {
            let place = resolve_place(*node, &[], self.entities, self.roads)?;
            let place = place.ok_or_else(|| node.refuse("is not supported in a trajectory"))?;
            if place.road != self.road_id || place.lane != motion.lane {
                return Err(node.refuse("the trajectory leaves the lane"));
            }
            vertices.push((shift_s + time_s, place.along_m));
        }
        let Some(&(first_s, first_m)) = vertices.first() else {
            return Err(action.node.refuse("has no vertices"));
        };
        let from_m = motion.plan.at(first_s).position_m;
        if first_s < start_s - 1e-9 || (first_m - from_m).abs() > START_TOLERANCE_M {
            let [first_s, first_m, from_m, start_s] =
                [first_s, first_m, from_m, start_s].map(format_number);
            return Err(action.node.refuse(format!(
                "starts at {first_s} s and {first_m} m, but the entity is at {from_m} m, and the action starts at \
                 {start_s} s"
            )));
        }
        Ok(vertices)
    }

    pub(super) fn change_lane(
        &mut self,
        change: &LaneChangeAction<'a>,
        actor: usize,
        start_s: f64,
        depends: bool,
    ) -> Result<f64> {
        let road = self
            .roads
            .find(change.node, Some(&self.road_id), [0.0; 2])?;
        let lane_of = |entity: usize| self.motion.get(entity).map_or(0, |motion| motion.lane);
        let (from, to) = match change.target {
            LaneTarget::Absolute(lane) => (lane_of(actor), lane),
            LaneTarget::Relative(entity, by) => {
                (lane_of(actor), road.shifted_lane(lane_of(entity), by))
            }
        };
        let [distance_m, to_width_m] = road.lane_distance_m(change.node, from, to)?;
        let [_, from_width_m] = road.lane_distance_m(change.node, to, from)?;
        let half_width_m = self
            .entities
            .get(actor)
            .map_or(0.0, |entity| entity.width_m / 2.0);
        let Some(motion) = self.motion.get_mut(actor) else {
            return Ok(start_s);
        };
        if motion.is_controlled {
            return Err(change
                .node
                .refuse("an entity with a controller must keep its lane"));
        }
        let duration_s = change
            .dynamics
            .duration_s(distance_m, |m| motion.plan.travel_time_s(start_s, m));
        if !duration_s.is_finite() || duration_s > MAX_DURATION_S {
            return Err(change.node.refuse(format!(
                "the lane change takes longer than {MAX_DURATION_S} s"
            )));
        }
        let at_s = |moved_m: f64| match distance_m {
            _ if change.dynamics.shape == TransitionShape::Step || distance_m == 0.0 => start_s,
            _ => {
                start_s
                    + duration_s
                        * change
                            .dynamics
                            .share_until((moved_m / distance_m).clamp(0.0, 1.0))
            }
        };
        let crossings_s = [
            at_s(distance_m - to_width_m / 2.0 - half_width_m),
            at_s(from_width_m / 2.0 + half_width_m),
        ];
        let (node, lanes) = (change.node, [from, to]);
        if from != to {
            motion.lane_changes.push(LaneChangeTimes {
                node,
                lanes,
                crossings_s,
                depends_on_controller: depends,
            });
        }
        motion.lane = to;
        Ok(start_s + duration_s)
    }
}
