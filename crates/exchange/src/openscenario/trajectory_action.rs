//! Actions that follow a trajectory, at its times or at the speed of the entity.

use super::constructs::ActionDomains;
use super::entities::Entity;
use super::error::ScenarioImportError;
use super::interpreter::ActionGoal;
use super::lateral::{LateralExtent, LateralMove};
use super::limits::WORK_PER_SAMPLE;
use super::place::{PlacePurpose, resolve_place, tilt};
use super::replay::Replay;
use super::resolution::{grid_step_m, regular_times_s};
use super::speed_plan::take_samples;
use super::storyboard::{StoryAction, has_follow_mode};
use super::trajectory::{self, PathVertex, rounding_m};
use super::trigger::Firing;
use super::vocabulary::{ReferenceContext, TransitionShape};
use super::xml::Node;
use crumple_core::digits::{format_fixed, format_number};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Distance from a polyline from which a note states it, in metres.
const NOTED_DISTANCE_M: f64 = 0.01;
/// Change of the initial speed from which a note states it, in m/s.
const NOTED_CHANGE_MPS: f64 = 0.005;
/// Largest distance of the first vertex of a trajectory from the entity, in metres.
const START_TOLERANCE_M: f64 = 0.01;
/// Largest lateral movement of a vertex that is a movement along the lane, in metres.
const STRAIGHT_M: f64 = 0.01;
/// Largest slope of a trajectory to the lane: that of a lane change in one second at 20 km/h.
const MAX_SLOPE: f64 = 0.65;

/// Work for each vertex: to find its grid, to resolve and to follow it, and to measure the distance from it.
const WORK_PER_VERTEX: u64 = 6 * WORK_PER_SAMPLE;

pub(super) struct TrajectoryAction<'a> {
    pub(super) node: Node<'a>,
    /// Times and positions of the vertices.
    vertices: Vec<(f64, Node<'a>)>,
    /// `None` for a trajectory without times: the entity follows it at its own speed.
    timing: Option<TrajectoryTiming>,
    /// Step of the grid on which the positions along the road lie, in metres; 0 without one.
    resolution_m: f64,
    /// True if the vertices have a constant rate, but for the rounding of the times in the file.
    has_rounded_times: bool,
    /// True for the following mode `follow`.
    is_loose: bool,
}

/// Reads an action that follows a trajectory.
pub(super) fn read_trajectory<'a>(
    node: Node<'a>,
    _entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    node.only(
        &[
            "Trajectory",
            "TrajectoryRef",
            "TimeReference",
            "TrajectoryFollowingMode",
        ],
        &["initialDistanceOffset"],
    )?;
    if node
        .optional_number("initialDistanceOffset")?
        .is_some_and(|offset_m| offset_m != 0.0)
    {
        return Err(node.refuse("initialDistanceOffset is not supported"));
    }
    let mode = node.optional("TrajectoryFollowingMode");
    let polyline = read_polyline(node.optional("TrajectoryRef").unwrap_or(node))?;
    let timing = TrajectoryTiming::read(node.child("TimeReference")?.single()?)?;
    let mut vertices = read_vertices(polyline, timing.as_ref())?;
    let times_s: Vec<f64> = vertices.iter().map(|(time_s, _)| *time_s).collect();
    let regular_s = regular_times_s(&times_s);
    let has_rounded_times = regular_s.is_some();
    for ((time_s, _), regular_s) in vertices.iter_mut().zip(regular_s.into_iter().flatten()) {
        *time_s = regular_s;
    }
    Ok(StoryAction::Trajectory(TrajectoryAction {
        node,
        resolution_m: resolution_m(&vertices)?,
        has_rounded_times,
        vertices,
        timing,
        is_loose: mode.map(has_follow_mode).transpose()?.unwrap_or(false),
    }))
}

/// Returns the times and positions of the vertices; without `timing`, all times are 0.
fn read_vertices<'a>(
    polyline: Node<'a>,
    timing: Option<&TrajectoryTiming>,
) -> Result<Vec<(f64, Node<'a>)>> {
    let mut vertices: Vec<(f64, Node<'a>)> = Vec::new();
    for vertex in polyline.children() {
        vertex.only(&["Position"], &["time"])?;
        let time_s = match timing {
            Some(timing) => vertex.number("time")? * timing.scale + timing.offset_s,
            None => 0.0,
        };
        let before_s = vertices.last().map(|(before_s, _)| *before_s);
        if timing.is_some() && before_s.is_some_and(|before_s| before_s >= time_s) {
            return Err(vertex.refuse("times of vertices must increase"));
        }
        vertices.push((time_s, vertex.child("Position")?.single()?));
    }
    Ok(vertices)
}

/// Returns the step of the grid on which the positions along the road lie; 0 without one.
fn resolution_m(vertices: &[(f64, Node<'_>)]) -> Result<f64> {
    let along = ["x", "s", "ds", "dsLane", "dx"].into_iter();
    let across = ["y"].into_iter();
    let [mut along_m, mut across_m] = [Vec::new(), Vec::new()];
    for (_, position) in vertices {
        along_m.push(first_number(*position, along.clone())?);
        across_m.push(first_number(*position, across.clone())?);
    }
    // The direction of the trajectory in the coordinates of a world position.
    let [along, across] = [&along_m, &across_m].map(|positions_m| {
        let ends = positions_m.first().zip(positions_m.last());
        ends.map_or(0.0, |(first_m, last_m)| (last_m - first_m).abs())
    });
    let length_m = along.hypot(across);
    if length_m == 0.0 {
        return Ok(0.0);
    }
    let share = |part_m: f64, positions_m: &[f64]| {
        // A coordinate that contributes nothing has no part in the rounding.
        if part_m > 0.0 {
            part_m / length_m * grid_step_m(positions_m)
        } else {
            0.0
        }
    };
    Ok(share(along, &along_m) + share(across, &across_m))
}

/// Returns the first attribute that a position has, or 0.
fn first_number<'n>(position: Node<'_>, names: impl Iterator<Item = &'n str>) -> Result<f64> {
    for name in names {
        if let Some(number) = position.optional_number(name)? {
            return Ok(number);
        }
    }
    Ok(0.0)
}

/// Returns the polyline of the trajectory in `holder`.
fn read_polyline<'a>(holder: Node<'a>) -> Result<Node<'a>> {
    if let Some(reference) = holder.optional("CatalogReference") {
        return Err(reference.refuse("trajectories of catalogues are not supported"));
    }
    let trajectory = holder.child("Trajectory")?;
    trajectory.only(&["ParameterDeclarations", "Shape"], &["name", "closed"])?;
    if trajectory.flag("closed", false)? {
        return Err(trajectory.refuse("a closed trajectory is not supported"));
    }
    let shape = trajectory.child("Shape")?.single()?;
    match shape.name() {
        "Polyline" => Ok(shape),
        "Clothoid" | "ClothoidSpline" | "Nurbs" => {
            Err(shape.refuse("is a curve: vehicles drive along straight lanes"))
        }
        _ => Err(shape.refuse("is not supported as a shape, only Polyline")),
    }
}

/// Meaning of the times of a trajectory.
struct TrajectoryTiming {
    /// True if times count from the start of the action.
    is_relative: bool,
    scale: f64,
    offset_s: f64,
}

impl TrajectoryTiming {
    /// Reads the timing; `None` if the trajectory has no times.
    fn read(timing: Node<'_>) -> Result<Option<Self>> {
        if timing.name() == "None" {
            return Ok(None);
        }
        if timing.name() != "Timing" {
            return Err(timing.refuse("is not supported as a time reference"));
        }
        timing.only(&[], &["domainAbsoluteRelative", "scale", "offset"])?;
        let context: ReferenceContext = timing.word("domainAbsoluteRelative")?;
        Ok(Some(Self {
            is_relative: context == ReferenceContext::Relative,
            scale: timing.number("scale")?,
            offset_s: timing.number("offset")?,
        }))
    }
}

impl<'a> TrajectoryAction<'a> {
    /// Returns true if the times of the vertices determine the speed.
    pub(super) fn is_timed(&self) -> bool {
        self.timing.is_some()
    }

    /// Returns the domains that the trajectory controls: without times, not the speed.
    pub(super) fn domains(&self) -> ActionDomains {
        match &self.timing {
            Some(_) => ActionDomains::BOTH,
            None => ActionDomains::LATERAL,
        }
    }

    /// Returns the position of the first vertex.
    pub(super) fn first_position(&self) -> Option<Node<'a>> {
        self.vertices.first().map(|(_, position)| *position)
    }

    /// Returns the time of the last vertex of a trajectory that starts at `start_s`.
    pub(super) fn end_s(&self, start_s: f64) -> f64 {
        let last = self.vertices.last();
        last.map_or(start_s, |(time_s, _)| self.vertex_s(*time_s, start_s))
    }

    /// Returns the time of a vertex of a trajectory that starts at `start_s`.
    fn vertex_s(&self, time_s: f64, start_s: f64) -> f64 {
        match &self.timing {
            Some(timing) if !timing.is_relative => time_s,
            _ => start_s + time_s,
        }
    }
}

impl<'a> Replay<'a, '_> {
    /// Returns the vertices of a trajectory on the road, the first of which is at the entity.
    pub(super) fn trajectory_vertices(
        &mut self,
        action: &TrajectoryAction<'a>,
        actor: usize,
        start_s: f64,
    ) -> Result<Vec<PathVertex>> {
        if action.is_loose {
            self.note_loose_motion(action.node, actor);
        }
        take_samples(action.node, action.vertices.len(), &mut self.samples_left)?;
        let work = WORK_PER_VERTEX * action.vertices.len() as u64;
        self.work.spend(action.node, work)?;
        let mut vertices: Vec<PathVertex> = Vec::new();
        for (time_s, node) in &action.vertices {
            let [position_m, lateral_m] = self.vertex_place(*node, actor)?;
            let vertex = PathVertex {
                time_s: action.vertex_s(*time_s, start_s),
                position_m,
                lateral_m,
            };
            if let Some(before) = vertices.last() {
                let may_cross = self.is_pedestrian(actor);
                check_along(*node, [before, &vertex], action.resolution_m, may_cross)?;
            }
            vertices.push(vertex);
        }
        self.check_start(action, actor, start_s, vertices.first())?;
        Ok(vertices)
    }

    /// Returns the position of a vertex in the direction of an entity, and its lateral position.
    fn vertex_place(&mut self, node: Node<'a>, actor: usize) -> Result<[f64; 2]> {
        if tilt(node)?.is_some() {
            let text = "pitch and roll in a trajectory have no influence";
            self.note_once(Some(node.note(text)));
        }
        let purpose = if self.is_pedestrian(actor) {
            PlacePurpose::Obstacle
        } else {
            PlacePurpose::Vertex
        };
        let lane_place = resolve_place(node, &[], &self.place_sources(), purpose)?;
        let lane_place =
            lane_place.ok_or_else(|| node.refuse("is not supported in a trajectory"))?;
        if lane_place.road != self.road_id {
            return Err(node.refuse("the trajectory leaves the road"));
        }
        Ok([
            self.direction(actor) * lane_place.road_m,
            lane_place.lateral_m,
        ])
    }

    /// Refuses a trajectory that does not begin when and where the entity is.
    fn check_start(
        &self,
        action: &TrajectoryAction<'a>,
        actor: usize,
        start_s: f64,
        first: Option<&PathVertex>,
    ) -> Result<()> {
        let Some(first) = first else {
            return Err(action.node.refuse("has no vertices"));
        };
        if first.time_s < start_s - 1e-9 {
            let [first_s, start_s] = [first.time_s, start_s].map(format_number);
            return Err(action.node.refuse(format!(
                "starts at {start_s} s, after the time of its first vertex, {first_s} s: the entity would jump"
            )));
        }
        let own_m = self.position_m(actor, first.time_s);
        let lateral_m = self.lateral_m(actor, first.time_s);
        let [along_m, left_m] = [first.position_m - own_m, first.lateral_m - lateral_m];
        if along_m.abs().max(left_m.abs()) <= START_TOLERANCE_M {
            return Ok(());
        }
        let along = if along_m < 0.0 { "behind" } else { "ahead of" };
        let side = if left_m * self.direction(actor) < 0.0 {
            "right"
        } else {
            "left"
        };
        let [along_m, left_m] = [along_m, left_m].map(|off_m| format_fixed(off_m.abs(), 2));
        Err(action.node.refuse(format!(
            "begins at {} s, {along_m} m {along} the entity and {left_m} m to its {side}: the entity would jump",
            format_number(first.time_s)
        )))
    }

    /// Follows the vertices of a trajectory with times, and returns the end. An entity with an active controller keeps
    /// its lane.
    pub(super) fn follow_trajectory(
        &mut self,
        action: &TrajectoryAction<'a>,
        actor: usize,
        vertices: &[PathVertex],
    ) -> f64 {
        let node = action.node;
        let limits_mps2 = self.limits_mps2(actor);
        let Some(motion) = self.motion.get_mut(actor) else {
            return 0.0;
        };
        let keeps_lane = motion.has_active_controller();
        motion.is_recorded = true;
        motion.follows_path = true;
        let moves = segments(vertices).filter(|[from, to]| from.lateral_m != to.lateral_m);
        let moves = moves.map(|[from, to]| LateralMove {
            start_s: from.time_s,
            extent: LateralExtent::Time(to.time_s - from.time_s),
            ..lateral_move(node, from, to)
        });
        if let Some(first) = vertices.first().filter(|_| !keeps_lane) {
            motion.lateral.replace(first.time_s, moves, &motion.plan);
        }
        // The motion after the end of the scenario has no influence.
        let before_end = vertices.partition_point(|vertex| vertex.time_s < self.latest_stop_s);
        let followed = vertices.get(..=before_end).unwrap_or(vertices);
        let plan = &mut motion.plan;
        let start_s = vertices.first().map_or(0.0, |vertex| vertex.time_s);
        let before_mps = plan.at(start_s).speed_mps;
        let rounding_m = rounding_m(followed, action.resolution_m);
        let off_m = trajectory::follow(plan, followed, rounding_m, limits_mps2);
        let start_mps = plan.at(start_s).speed_mps;
        let times = "the rounded times of the vertices are read as those of a constant rate";
        self.note_once(action.has_rounded_times.then(|| node.note(times)));
        self.note_following(node, [before_mps, start_mps], (off_m, keeps_lane));
        vertices.last().map_or(0.0, |vertex| vertex.time_s)
    }

    /// Notes another initial speed than the stated one, and the largest distance from the polyline.
    fn note_following(
        &mut self,
        node: Node<'a>,
        [stated_mps, start_mps]: [f64; 2],
        (off_m, keeps_lane): (f64, bool),
    ) {
        if (start_mps - stated_mps).abs() >= NOTED_CHANGE_MPS {
            let start = format_fixed(start_mps, 2);
            let text = format!("the initial speed is that of the trajectory, {start} m/s");
            self.note_once(Some(node.note(text)));
        }
        if off_m > NOTED_DISTANCE_M && !keeps_lane {
            self.note_once(Some(node.note(format!(
                "the motion, smooth and within the limits of the vehicle, is up to {} m from the polyline",
                format_fixed(off_m, 2)
            ))));
        }
    }

    /// Follows a trajectory without times at the speed of the entity along the lane.
    pub(super) fn follow_line(
        &mut self,
        action: &TrajectoryAction<'a>,
        actor: usize,
        start: Firing,
    ) -> Result<ActionGoal> {
        let node = action.node;
        let is_controlled = self.is_controlled(actor);
        self.mark_replaced(node, actor);
        let vertices = self.trajectory_vertices(action, actor, start.time_s);
        if let (true, Err(ScenarioImportError::Refused { .. })) = (is_controlled, &vertices) {
            // The vehicle never reaches an end outside its lane.
            return Ok(ActionGoal::Time(f64::INFINITY));
        }
        let vertices = vertices?;
        if self.is_pedestrian(actor) && crosses(&vertices) {
            self.cross_lanes(node, actor, start, &vertices);
            return Ok(ActionGoal::LateralMove);
        }
        let Some(motion) = self.motion.get_mut(actor) else {
            return Ok(ActionGoal::LateralMove);
        };
        let keeps_m = is_controlled.then(|| motion.lateral.at(start.time_s, &motion.plan));
        let moves = segments(&vertices).map(|[from, to]| LateralMove {
            start_s: start.time_s,
            extent: LateralExtent::Distance {
                from_m: from.position_m,
                length_m: to.position_m - from.position_m,
            },
            depends_on_controller: start.depends_on_controller,
            from_m: keeps_m.unwrap_or(from.lateral_m),
            to_m: keeps_m.unwrap_or(to.lateral_m),
            ..lateral_move(node, from, to)
        });
        motion.lateral.replace(start.time_s, moves, &motion.plan);
        if !is_controlled {
            self.note_longer_way(node, &vertices);
        }
        Ok(ActionGoal::LateralMove)
    }

    /// Notes by how much the way along a trajectory without times is longer than along the lane.
    fn note_longer_way(&mut self, node: Node<'a>, vertices: &[PathVertex]) {
        let longer_m: f64 = segments(vertices)
            .map(|[from, to]| {
                let along_m = to.position_m - from.position_m;
                along_m.hypot(to.lateral_m - from.lateral_m) - along_m.abs()
            })
            .sum();
        let note = node.note(format!(
            "without times, the vehicle has its speed along the lane: up to {} m farther than along the trajectory",
            format_fixed(longer_m, 2)
        ));
        self.note_once((longer_m > NOTED_DISTANCE_M).then_some(note));
    }
}

impl<'a> Replay<'a, '_> {
    fn is_pedestrian(&self, actor: usize) -> bool {
        let body = self.entities.get(actor);
        body.is_some_and(|body| body.is_pedestrian)
    }

    /// Lets a pedestrian walk across the lanes at its speed, up to the first vertex from which the trajectory leads
    /// along them. The plan counts the distance from then on.
    fn cross_lanes(
        &mut self,
        node: Node<'a>,
        actor: usize,
        start: Firing,
        vertices: &[PathVertex],
    ) {
        let Some(motion) = self.motion.get_mut(actor) else {
            return;
        };
        let along_m = motion.position_m(start.time_s);
        motion.crosses_at_m = Some(along_m);
        let mut from_m = motion.plan.at(start.time_s).position_m;
        let mut moves = Vec::new();
        for [from, to] in segments(vertices).take_while(is_across) {
            let length_m = (to.lateral_m - from.lateral_m).abs();
            moves.push(LateralMove {
                start_s: start.time_s,
                extent: LateralExtent::Distance { from_m, length_m },
                depends_on_controller: start.depends_on_controller,
                ..lateral_move(node, from, to)
            });
            from_m += length_m;
        }
        motion.walks_on |= moves.len() + 1 < vertices.len();
        motion
            .lateral
            .replace(start.time_s, moves.into_iter(), &motion.plan);
    }
}

/// Returns true if a trajectory begins with a movement across the lanes.
fn crosses(vertices: &[PathVertex]) -> bool {
    segments(vertices)
        .next()
        .is_some_and(|pair| is_across(&pair))
}

fn is_across([from, to]: &[PathVertex; 2]) -> bool {
    let across_m = (to.lateral_m - from.lateral_m).abs();
    across_m > STRAIGHT_M && (to.position_m - from.position_m).abs() <= STRAIGHT_M
}

/// Returns the pairs of adjacent vertices.
fn segments(vertices: &[PathVertex]) -> impl Iterator<Item = [PathVertex; 2]> {
    let pairs = vertices.iter().zip(vertices.iter().skip(1));
    pairs.map(|(from, to)| [*from, *to])
}

/// Returns a straight lateral movement between two vertices, without its extent.
fn lateral_move(node: Node<'_>, from: PathVertex, to: PathVertex) -> LateralMove<'_> {
    LateralMove {
        node,
        start_s: 0.0,
        from_m: from.lateral_m,
        to_m: to.lateral_m,
        shape: TransitionShape::Linear,
        extent: LateralExtent::Time(0.0),
        depends_on_controller: false,
        cut_s: None,
    }
}

/// Refuses a trajectory that turns away from the direction of the lane, unless it may cross the lanes. Rounding of the
/// positions moves a vehicle by up to `resolution_m` from vertex to vertex, in any direction.
fn check_along(
    node: Node<'_>,
    [before, vertex]: [&PathVertex; 2],
    resolution_m: f64,
    may_cross: bool,
) -> Result<()> {
    let along_m = vertex.position_m - before.position_m;
    let across_m = (vertex.lateral_m - before.lateral_m).abs();
    if !may_cross && across_m > STRAIGHT_M + resolution_m && across_m > MAX_SLOPE * along_m {
        return Err(node.refuse("the trajectory crosses the lanes: vehicles drive along them"));
    }
    if along_m < -START_TOLERANCE_M - resolution_m {
        return Err(node.refuse("the trajectory goes backwards"));
    }
    Ok(())
}
