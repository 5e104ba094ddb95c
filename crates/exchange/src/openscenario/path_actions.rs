//! Actions that move along a path: trajectories and lane changes.

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::initial::resolve_place;
use super::limits::WORK_PER_SAMPLE;
use super::replay::{EntityMotion, LaneChangeTimes, MAX_DURATION_S, Replay};
use super::speed_plan::{PathVertex, TransitionDynamics, TransitionShape, take_samples};
use super::storyboard::{StoryAction, entity_index};
use super::trigger::Firing;
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
    let polyline = read_polyline(node.optional("TrajectoryRef").unwrap_or(node))?;
    let timing = TrajectoryTiming::read(node.child("TimeReference")?.single()?)?;
    let mut vertices: Vec<(f64, Node<'a>)> = Vec::new();
    for vertex in polyline.children() {
        vertex.only(&["Position"], &["time"])?;
        let time_s = vertex.number("time")? * timing.scale + timing.offset_s;
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
        is_relative: timing.is_relative,
    }))
}

/// Returns the polyline of the trajectory in `holder`.
fn read_polyline<'a>(holder: Node<'a>) -> Result<Node<'a>> {
    let trajectory = holder.child("Trajectory")?;
    trajectory.only(&["ParameterDeclarations", "Shape"], &["name", "closed"])?;
    if trajectory.flag("closed", false)? {
        return Err(trajectory.refuse("a closed trajectory is not supported"));
    }
    let shape = trajectory.child("Shape")?.single()?;
    if shape.name() == "Polyline" {
        Ok(shape)
    } else {
        Err(shape.refuse("is not supported as a shape, only Polyline"))
    }
}

/// Meaning of the times of a trajectory.
struct TrajectoryTiming {
    is_relative: bool,
    scale: f64,
    offset_s: f64,
}

impl TrajectoryTiming {
    fn read(timing: Node<'_>) -> Result<Self> {
        if timing.name() != "Timing" {
            return Err(timing.refuse("a trajectory must have times"));
        }
        timing.only(&[], &["domainAbsoluteRelative", "scale", "offset"])?;
        timing.expect("domainAbsoluteRelative", &["absolute", "relative"])?;
        Ok(Self {
            is_relative: timing.text("domainAbsoluteRelative")? == "relative",
            scale: timing.number("scale")?,
            offset_s: timing.number("offset")?,
        })
    }
}

impl LaneChangeAction<'_> {
    /// Returns the time that an entity needs for a lateral distance.
    fn duration_s(&self, motion: &EntityMotion<'_>, distance_m: f64, start_s: f64) -> Result<f64> {
        if motion.is_controlled {
            return Err(self
                .node
                .refuse("an entity with a controller must keep its lane"));
        }
        let duration_s = self.dynamics.duration_s(distance_m, |along_m| {
            motion.plan.travel_time_s(start_s, along_m)
        });
        if !duration_s.is_finite() || duration_s > MAX_DURATION_S {
            return Err(self.node.refuse(format!(
                "the lane change takes longer than {MAX_DURATION_S} s"
            )));
        }
        Ok(duration_s)
    }
}

impl TransitionDynamics {
    /// Returns the share of the time of a lane change after which the entity has moved `moved_m` of `distance_m`.
    fn share_at(self, moved_m: f64, distance_m: f64) -> f64 {
        if self.shape == TransitionShape::Step || distance_m == 0.0 {
            0.0
        } else {
            self.share_until((moved_m / distance_m).clamp(0.0, 1.0))
        }
    }
}

impl<'a> Replay<'a, '_> {
    /// Returns the vertices until the entity would leave its lane, which is an error.
    pub(super) fn trajectory_vertices(
        &mut self,
        action: &TrajectoryAction<'a>,
        actor: usize,
        start_s: f64,
    ) -> Result<Vec<PathVertex>> {
        take_samples(action.node, action.vertices.len(), &mut self.samples_left)?;
        self.work
            .spend(action.node, WORK_PER_SAMPLE * action.vertices.len() as u64)?;
        let Some(motion) = self.motion.get(actor) else {
            return Ok(Vec::new());
        };
        let shift_s = if action.is_relative { start_s } else { 0.0 };
        let mut vertices = Vec::new();
        for (time_s, node) in &action.vertices {
            let position = resolve_place(*node, &[], self.entities, self.roads)?;
            let position =
                position.ok_or_else(|| node.refuse("is not supported in a trajectory"))?;
            if position.road != self.road_id || position.lane != motion.lane {
                return Err(node.refuse("the trajectory leaves the lane"));
            }
            vertices.push(PathVertex {
                time_s: shift_s + time_s,
                position_m: position.along_m,
            });
        }
        let Some(first) = vertices.first() else {
            return Err(action.node.refuse("has no vertices"));
        };
        let from_m = motion.plan.at(first.time_s).position_m;
        if first.time_s < start_s - 1e-9 || (first.position_m - from_m).abs() > START_TOLERANCE_M {
            let [first_s, first_m, from_m, start_s] =
                [first.time_s, first.position_m, from_m, start_s].map(format_number);
            return Err(action.node.refuse(format!(
                "starts at {first_s} s and {first_m} m, but the entity is at {from_m} m, and the action starts at \
                 {start_s} s"
            )));
        }
        Ok(vertices)
    }

    /// Starts a lane change of an entity, and returns its end.
    pub(super) fn change_lane(
        &mut self,
        change: &LaneChangeAction<'a>,
        actor: usize,
        start: Firing,
    ) -> Result<f64> {
        let road = self
            .roads
            .find(change.node, Some(&self.road_id), [0.0; 2])?;
        let from = self.lane(actor);
        let to = match change.target {
            LaneTarget::Absolute(lane) => lane,
            LaneTarget::Relative(entity, by) => road.shifted_lane(self.lane(entity), by),
        };
        let [distance_m, to_width_m] = road.lane_distance_m(change.node, from, to)?;
        let [_, from_width_m] = road.lane_distance_m(change.node, to, from)?;
        let half_width_m = self
            .entities
            .get(actor)
            .map_or(0.0, |entity| entity.width_m / 2.0);
        let Some(motion) = self.motion.get_mut(actor) else {
            return Ok(start.time_s);
        };
        let duration_s = change.duration_s(motion, distance_m, start.time_s)?;
        if from != to {
            let crossings_m = [
                distance_m - to_width_m / 2.0 - half_width_m,
                from_width_m / 2.0 + half_width_m,
            ];
            motion.lane_changes.push(LaneChangeTimes {
                node: change.node,
                lanes: [from, to],
                crossings_s: crossings_m.map(|moved_m| {
                    start.time_s + duration_s * change.dynamics.share_at(moved_m, distance_m)
                }),
                depends_on_controller: start.depends_on_controller,
            });
        }
        motion.lane = to;
        Ok(start.time_s + duration_s)
    }

    fn lane(&self, entity: usize) -> i32 {
        self.motion.get(entity).map_or(0, |motion| motion.lane)
    }
}
