//! Straight roads of an OpenDRIVE file, and places on their lanes.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

use super::error::ScenarioImportError;
use super::limits::{MAX_LANES, WORK_PER_ROAD, WorkBudget, ensure_at_most};
use super::xml::{ElementLocation, Node, SourceElement};
use crumple_core::digits::{format_fixed, format_number};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Largest distance from a line that counts as on the line, in metres.
const LATERAL_TOLERANCE_M: f64 = 0.01;
/// Largest curvature of a bend that a scenario unrolls, per metre: at 40 m/s, the lateral acceleration is 0.8 m/s².
const MAX_CURVATURE: f64 = 1.0 / 2000.0;
/// Largest slope that has no influence, in metres per metre: gravity changes the acceleration by 0.3 m/s².
const MAX_SLOPE: f64 = 0.03;
/// Number of parts of a curve at which its curvature and slope are evaluated.
const CURVE_PARTS: usize = 32;
/// Distance of a road from the origin of the world from which on positions count from the start of the road, in metres.
const FAR_M: f64 = 100_000.0;
/// Largest difference of directions that count as equal, in radians.
const HEADING_TOLERANCE_RAD: f64 = 1e-3;

/// A straight road, or one that is unrolled, whose lanes have constant widths.
#[derive(Debug)]
pub(super) struct StraightRoad {
    id: String,
    origin_m: [f64; 2],
    heading_rad: f64,
    /// Cosine and sine of the heading.
    direction: [f64; 2],
    length_m: f64,
    /// First part that a scenario cannot represent.
    limit: Option<RoadLimit>,
    /// True if lanes with negative numbers have the direction of the road.
    is_right_hand: bool,
    /// True if the road has bends.
    is_unrolled: bool,
    lanes: Vec<Lane>,
    /// Notes about slopes and bends, which the scenario neglects.
    pub(super) notes: Vec<String>,
}

/// Place from which on a scenario cannot represent a road, and the error of what is there.
#[derive(Debug)]
pub(super) struct RoadLimit {
    s_m: f64,
    location: ElementLocation,
    reason: String,
}

impl RoadLimit {
    pub(super) fn error(&self) -> ScenarioImportError {
        self.location.refuse(&self.reason)
    }

    fn note(&self) -> String {
        let s = format_fixed(self.s_m, 0);
        format!(
            "{}: no scripted vehicle reaches this part, from {s} m on",
            self.error()
        )
    }
}

/// Limits of a road that is being read.
#[derive(Default)]
struct RoadLimits {
    first: Option<RoadLimit>,
}

impl RoadLimits {
    /// Adds the error of a part that begins at `s_m`. Returns the error if the part begins with the road.
    fn add(&mut self, s_m: f64, error: ScenarioImportError) -> Result<()> {
        let (path, line, name, reason) = match error {
            ScenarioImportError::Refused {
                path,
                line,
                element,
                reason,
            } if s_m > LATERAL_TOLERANCE_M => (path, line, element, reason),
            other => return Err(other),
        };
        if self.first.as_ref().is_none_or(|first| s_m < first.s_m) {
            let path = path.into();
            self.first = Some(RoadLimit {
                s_m,
                location: ElementLocation { path, line, name },
                reason,
            });
        }
        Ok(())
    }
}

#[derive(Debug)]
struct Lane {
    id: i32,
    /// Lateral position of the middle, positive to the left of the road's direction.
    middle_m: f64,
    width_m: f64,
}

impl Lane {
    /// Returns the distance of its middle from a lateral position.
    fn distance_m(&self, lateral_m: f64) -> f64 {
        (lateral_m - self.middle_m).abs()
    }
}

/// A place on a road, with the direction of travel there.
#[derive(Debug, Clone)]
pub(super) struct LanePlace {
    pub(super) road: String,
    /// Position in the direction of the road, in metres.
    pub(super) road_m: f64,
    /// Position to the left of the road's direction, in metres.
    pub(super) lateral_m: f64,
    /// 1 for travel in the direction of the road, and -1 against it.
    pub(super) direction: f64,
}

impl LanePlace {
    /// Turns the direction of travel by an angle, which must be about 0 or half a turn.
    pub(super) fn turn(&mut self, node: Node<'_>, angle_rad: f64) -> Result<()> {
        match libm::cos(angle_rad) {
            cosine if cosine > libm::cos(HEADING_TOLERANCE_RAD) => {}
            cosine if cosine < -libm::cos(HEADING_TOLERANCE_RAD) => {
                self.direction = -self.direction
            }
            _ => return Err(node.refuse("`h` differs from the direction of the lane")),
        }
        Ok(())
    }
}

impl LanePlace {
    /// Turns the direction of travel by an angle of about half a turn; other angles leave it.
    pub(super) fn turn_if_along(&mut self, angle_rad: f64) {
        if libm::cos(angle_rad) < -libm::cos(HEADING_TOLERANCE_RAD) {
            self.direction = -self.direction;
        }
    }
}

/// Roads of a file. Each is read at its first use.
pub(super) struct RoadMap<'a> {
    file: &'a SourceElement,
    work: &'a WorkBudget,
    /// Roads that the scenario uses.
    used: RefCell<Vec<Rc<StraightRoad>>>,
    /// Roads that were read, by their index in the file; `None` for one that is not supported.
    read: RefCell<HashMap<usize, Option<Rc<StraightRoad>>>>,
}

impl<'a> RoadMap<'a> {
    pub(super) fn new(file: &'a SourceElement, work: &'a WorkBudget) -> Self {
        Self {
            file,
            work,
            used: RefCell::default(),
            read: RefCell::default(),
        }
    }

    /// Returns the road with an identifier, or, without one, the road that contains a point of the world.
    pub(super) fn find(
        &self,
        node: Node<'_>,
        id: Option<&str>,
        point_m: [f64; 2],
    ) -> Result<Rc<StraightRoad>> {
        let used = self.used.borrow();
        if let Some(road) = used.iter().find(|road| road.is_wanted(id, point_m)) {
            return Ok(road.clone());
        }
        drop(used);
        self.work
            .spend(node, WORK_PER_ROAD * self.file.children().len() as u64)?;
        let file = Node {
            element: self.file,
            ..node
        };
        let mut unsupported = None;
        for (index, element) in file.named("road").enumerate() {
            if id.is_some_and(|id| element.raw("id") != Some(id)) {
                continue;
            }
            let mut read = self.read.borrow_mut();
            let road = read
                .entry(index)
                .or_insert_with(|| StraightRoad::read(element).ok().map(Rc::new));
            match road {
                Some(road) if road.is_wanted(id, point_m) => {
                    return self.add_used(element, road.clone());
                }
                Some(_) => {}
                None => unsupported = unsupported.or(Some(element)),
            }
        }
        match (unsupported, id) {
            (Some(element), _) => StraightRoad::read(element).map(Rc::new),
            (None, Some(id)) => Err(node.refuse(format!("there is no road `{id}`"))),
            (None, None) => Err(refuse_point(node, point_m)),
        }
    }

    /// Adds a road in use, which must be the only one of its identifier.
    fn add_used(&self, element: Node<'_>, road: Rc<StraightRoad>) -> Result<Rc<StraightRoad>> {
        let mut used = self.used.borrow_mut();
        if used.iter().any(|other| other.id == road.id) {
            return Err(element.refuse(format!("there are two roads `{}`", road.id)));
        }
        used.push(road.clone());
        Ok(road)
    }
}

impl StraightRoad {
    fn read(road: Node<'_>) -> Result<Self> {
        if road
            .raw("junction")
            .is_some_and(|junction| junction != "-1")
        {
            return Err(road.refuse("is part of a junction"));
        }
        let mut limits = RoadLimits::default();
        let slope = check_level(road, &mut limits)?;
        let length_m = road.number("length")?;
        let line = ReferenceLine::read(road, &mut limits)?;
        line.check_length(road, length_m)?;
        let is_right_hand = road.raw("rule") != Some("LHT");
        let lanes = read_lanes(road.child("lanes")?, &mut limits)?;
        let limit = limits.first;
        let mut notes = neglected(road, &line, slope, &lanes);
        notes.extend(limit.as_ref().map(RoadLimit::note));
        Ok(Self {
            id: road.text("id")?,
            origin_m: line.origin_m,
            heading_rad: line.heading_rad,
            direction: line.direction,
            length_m,
            limit,
            is_right_hand,
            is_unrolled: line.max_curvature > 0.0,
            lanes,
            notes,
        })
    }

    /// Returns true for the road with an identifier, or, without one, if the road contains a point of the world.
    fn is_wanted(&self, id: Option<&str>, point_m: [f64; 2]) -> bool {
        match id {
            Some(id) => self.id == id,
            None => self.project(point_m).is_some(),
        }
    }

    /// Returns the position along the road and the lateral position of a point on the road.
    fn project(&self, [x_m, y_m]: [f64; 2]) -> Option<[f64; 2]> {
        let [cosine, sine] = self.direction;
        let [dx_m, dy_m] = [x_m - self.origin_m[0], y_m - self.origin_m[1]];
        let [s_m, lateral_m] = [dx_m * cosine + dy_m * sine, dy_m * cosine - dx_m * sine];
        let limit_m = self.limit.as_ref().map_or(self.length_m, |limit| limit.s_m);
        let is_on_road = !self.is_unrolled
            && (0.0..=limit_m).contains(&s_m)
            && self
                .lanes
                .iter()
                .any(|lane| lane.distance_m(lateral_m) <= lane.width_m / 2.0);
        is_on_road.then_some([s_m, lateral_m])
    }

    fn lane(&self, id: i32) -> Option<&Lane> {
        self.lanes.iter().find(|lane| lane.id == id)
    }

    fn require_lane(&self, node: Node<'_>, id: i32) -> Result<&Lane> {
        self.lane(id)
            .ok_or_else(|| node.refuse(format!("the road `{}` has no lane {id}", self.id)))
    }

    /// Returns 1 for lanes in the direction of the road, and -1 for the opposite direction.
    fn direction(&self, lane: i32) -> f64 {
        if (lane < 0) == self.is_right_hand {
            1.0
        } else {
            -1.0
        }
    }

    /// Returns the place `s_m` along the road, `offset_m` to the left of the middle of a lane in the road's direction.
    pub(super) fn position(
        &self,
        node: Node<'_>,
        lane: i32,
        s_m: f64,
        offset_m: f64,
    ) -> Result<LanePlace> {
        let middle_m = self.lane_middle_m(node, lane)?;
        self.check_length(node, s_m)?;
        Ok(LanePlace {
            road: self.id.clone(),
            road_m: self.start_m() + s_m,
            lateral_m: middle_m + offset_m,
            direction: self.direction(lane),
        })
    }

    /// Returns the place `s_m` along the road and `lateral_m` to the left of its reference line.
    pub(super) fn position_beside(
        &self,
        node: Node<'_>,
        s_m: f64,
        lateral_m: f64,
    ) -> Result<LanePlace> {
        self.check_length(node, s_m)?;
        let lane = self
            .lane_at(lateral_m)
            .ok_or_else(|| node.refuse(format!("is beside the lanes of the road `{}`", self.id)))?;
        Ok(LanePlace {
            road: self.id.clone(),
            road_m: self.start_m() + s_m,
            lateral_m,
            direction: self.direction(lane),
        })
    }

    fn check_length(&self, node: Node<'_>, s_m: f64) -> Result<()> {
        let limit = self.limit.as_ref().filter(|limit| s_m > limit.s_m);
        match limit {
            Some(limit) => Err(limit.error()),
            None if (0.0..=self.length_m).contains(&s_m) => Ok(()),
            None => Err(self.refuse_outside(node, s_m)),
        }
    }

    fn refuse_outside(&self, node: Node<'_>, s_m: f64) -> ScenarioImportError {
        node.refuse(format!(
            "{} m is outside the road `{}` of {} m",
            format_number(s_m),
            self.id,
            format_number(self.length_m)
        ))
    }

    /// Returns the limit that a position in the direction of the road exceeds.
    pub(super) fn exceeded_limit(&self, road_m: f64) -> Option<&RoadLimit> {
        let limit = self.limit.as_ref();
        limit.filter(|limit| self.s_m(road_m) > limit.s_m)
    }

    /// Returns the error of a position in the direction of the road that is beyond an end of the road.
    pub(super) fn outside(&self, node: Node<'_>, road_m: f64) -> Option<ScenarioImportError> {
        let is_outside = !self.contains_m(road_m);
        is_outside.then(|| self.refuse_outside(node, self.s_m(road_m)))
    }

    /// Refuses a position in the direction of the road that is outside the road.
    pub(super) fn check_inside(&self, node: Node<'_>, road_m: f64) -> Result<()> {
        self.check_length(node, road_m - self.start_m())
    }

    /// Returns true if a position in the direction of the road is on the road.
    pub(super) fn contains_m(&self, road_m: f64) -> bool {
        (0.0..=self.length_m).contains(&(road_m - self.start_m()))
    }

    /// Returns the heading of travel in a direction; in bends, that at the start of the road.
    pub(super) fn travel_rad(&self, direction: f64) -> f64 {
        if direction > 0.0 {
            self.heading_rad
        } else {
            self.heading_rad + std::f64::consts::PI
        }
    }

    /// Position of the start of the road along its direction, so that positions are x on a road along x. On a road far
    /// from the origin, such as one with coordinates of a map projection, positions count from its start.
    fn start_m(&self) -> f64 {
        let [x_m, y_m] = self.origin_m;
        if x_m.hypot(y_m) > FAR_M {
            return 0.0;
        }
        x_m * self.direction[0] + y_m * self.direction[1]
    }

    /// Returns the position along the road from its start.
    pub(super) fn s_m(&self, road_m: f64) -> f64 {
        road_m - self.start_m()
    }

    /// Returns the place of a point of the world. `heading_rad` is the direction of travel; without it, that is the
    /// direction of the lane.
    pub(super) fn place_of_point(
        &self,
        node: Node<'_>,
        point_m: [f64; 2],
        heading_rad: Option<f64>,
    ) -> Result<LanePlace> {
        let [s_m, lateral_m] = self
            .project(point_m)
            .ok_or_else(|| node.refuse("is outside the road"))?;
        let mut lane_place = self.position_beside(node, s_m, lateral_m)?;
        if let Some(heading_rad) = heading_rad {
            lane_place.turn(node, heading_rad - self.travel_rad(lane_place.direction))?;
        }
        Ok(lane_place)
    }

    /// Returns the lane that contains a lateral position.
    pub(super) fn lane_at(&self, lateral_m: f64) -> Option<i32> {
        let lanes = self.lanes.iter().filter(|lane| lane.id != 0);
        let nearest = lanes.min_by(|a, b| {
            let [a_m, b_m] = [a, b].map(|lane| lane.distance_m(lateral_m) - lane.width_m / 2.0);
            a_m.total_cmp(&b_m)
        })?;
        let is_inside =
            nearest.distance_m(lateral_m) <= nearest.width_m / 2.0 + LATERAL_TOLERANCE_M;
        is_inside.then_some(nearest.id)
    }

    /// Returns the lane `by` lanes to the left of a vehicle in a direction (class `RelativeTargetLane`), across the
    /// missing lane 0.
    pub(super) fn shifted_lane(&self, lane: i32, by: i32, direction: f64) -> i32 {
        let by = if direction < 0.0 { -by } else { by };
        let target = lane.saturating_add(by);
        if (lane < 0) != (target < 0) || target == 0 {
            target.saturating_add(by.signum())
        } else {
            target
        }
    }

    /// Returns the lateral position of the middle of a lane.
    pub(super) fn lane_middle_m(&self, node: Node<'_>, lane: i32) -> Result<f64> {
        Ok(self.require_lane(node, lane)?.middle_m)
    }

    /// Returns the lateral positions of the edges of a lane.
    pub(super) fn lane_edges_m(&self, node: Node<'_>, lane: i32) -> Result<[f64; 2]> {
        let lane = self.require_lane(node, lane)?;
        Ok([-0.5, 0.5].map(|share| lane.middle_m + share * lane.width_m))
    }
}

/// Returns notes about slopes and bends that the scenario neglects.
fn neglected(road: Node<'_>, line: &ReferenceLine, slope: f64, lanes: &[Lane]) -> Vec<String> {
    let mut notes = Vec::new();
    if slope > 0.0 {
        notes.push(road.note(format!(
            "slopes of up to {} % have no influence",
            format_fixed(100.0 * slope, 1)
        )));
    }
    if line.max_curvature > 0.0 {
        let edges_m = lanes.iter().map(|lane| lane.middle_m.abs());
        let farthest_m = edges_m.fold(0.0, f64::max);
        notes.push(road.note(format!(
            "bends with radii of {} m or more are unrolled along the reference line: distances in lanes differ by up \
             to {} %",
            format_fixed(1.0 / line.max_curvature, 0),
            format_fixed(100.0 * line.max_curvature * farthest_m, 2)
        )));
    }
    notes
}

/// Returns the largest slope of a road. Steep slopes and superelevation limit the road.
fn check_level(road: Node<'_>, limits: &mut RoadLimits) -> Result<f64> {
    let mut slope: f64 = 0.0;
    for profile in road.named("lateralProfile").flat_map(Node::children) {
        if profile.name() != "superelevation" || !is_zero(profile, &["a", "b", "c", "d"]) {
            let s_m = profile.optional_number("s")?.unwrap_or(0.0);
            limits.add(s_m, profile.refuse("the road must be level"))?;
        }
    }
    let entries: Vec<Node<'_>> = road
        .named("elevationProfile")
        .flat_map(Node::children)
        .collect();
    for (index, entry) in entries.iter().enumerate() {
        let end_m = match entries.get(index + 1) {
            Some(next) => next.number("s")?,
            None => road.number("length")?,
        };
        let steepest = steepest_slope(*entry, end_m)?;
        if !(0.0..=MAX_SLOPE).contains(&steepest) {
            let percent = 100.0 * MAX_SLOPE;
            let problem = format!("the road must be level, with slopes of up to {percent} %");
            limits.add(entry.number("s")?, entry.refuse(problem))?;
            break;
        }
        slope = slope.max(steepest);
    }
    Ok(slope)
}

/// Returns the largest slope of an elevation up to `end_m` along the road, at equal steps.
fn steepest_slope(elevation: Node<'_>, end_m: f64) -> Result<f64> {
    if is_zero(elevation, &["b", "c", "d"]) {
        return Ok(0.0);
    }
    let length_m = end_m - elevation.number("s")?;
    let mut coefficients = [0.0; 3];
    for (value, name) in coefficients.iter_mut().zip(["b", "c", "d"]) {
        *value = elevation.number(name)?;
    }
    let [b, c, d] = coefficients;
    let slopes = (0..=CURVE_PARTS).map(|part| {
        let s_m = length_m * part as f64 / CURVE_PARTS as f64;
        (b + 2.0 * c * s_m + 3.0 * d * s_m * s_m).abs()
    });
    // A slope that is not a number is steep.
    Ok(slopes.fold(0.0, |largest, slope| {
        if largest.is_nan() || slope <= largest {
            largest
        } else {
            slope
        }
    }))
}

fn refuse_point(node: Node<'_>, point_m: [f64; 2]) -> ScenarioImportError {
    let [x_m, y_m] = point_m.map(format_number);
    node.refuse(format!("no road contains the point x = {x_m}, y = {y_m}"))
}

/// A straight reference line.
struct ReferenceLine {
    origin_m: [f64; 2],
    heading_rad: f64,
    /// Cosine and sine of the heading.
    direction: [f64; 2],
    /// Position along the line at which the geometry ends, in metres.
    end_m: f64,
    /// Largest curvature, per metre.
    max_curvature: f64,
    /// True if a part of the line is not supported.
    is_limited: bool,
}

impl ReferenceLine {
    /// Refuses a geometry that does not end with the road.
    fn check_length(&self, road: Node<'_>, length_m: f64) -> Result<()> {
        if self.is_limited || (self.end_m - length_m).abs() <= 1.0 {
            return Ok(());
        }
        Err(road.refuse(format!(
            "is {} m long, but its geometry ends at {} m",
            format_number(length_m),
            format_number(self.end_m)
        )))
    }

    /// Reads the geometries of a road up to the first one that neither continues the first line nor is a slight bend.
    fn read(road: Node<'_>, limits: &mut RoadLimits) -> Result<Self> {
        let mut line: Option<Self> = None;
        let geometries: Vec<Node<'_>> = road.child("planView")?.children().collect();
        let (usable, max_curvature) = usable_geometries(&geometries, limits)?;
        for (index, geometry) in geometries.iter().take(usable).enumerate() {
            let s_m = geometry.number("s")?;
            let [x_m, y_m] = [geometry.number("x")?, geometry.number("y")?];
            let heading_rad = geometry.number("hdg")?;
            let line = line.get_or_insert_with(|| Self {
                origin_m: [x_m, y_m],
                heading_rad,
                direction: [libm::cos(heading_rad), libm::sin(heading_rad)],
                end_m: 0.0,
                max_curvature,
                is_limited: usable < geometries.len(),
            });
            let [cosine, sine] = line.direction;
            let off_m = (x_m - line.origin_m[0] - s_m * cosine).abs()
                + (y_m - line.origin_m[1] - s_m * sine).abs();
            let turns = (heading_rad - line.heading_rad).abs() > HEADING_TOLERANCE_RAD
                || off_m > LATERAL_TOLERANCE_M;
            if turns && max_curvature == 0.0 {
                limits.add(s_m, geometry.refuse("the road must be straight"))?;
                line.is_limited |= index > 0;
                break;
            }
            line.end_m = s_m + geometry.number("length")?;
        }
        line.ok_or_else(|| road.refuse("has no geometry"))
    }
}

/// Returns the number of geometries before the first one that is not supported, and their largest curvature.
fn usable_geometries(geometries: &[Node<'_>], limits: &mut RoadLimits) -> Result<(usize, f64)> {
    let mut max_curvature: f64 = 0.0;
    for (index, geometry) in geometries.iter().enumerate() {
        match curvature(*geometry) {
            Ok(largest) => max_curvature = max_curvature.max(largest),
            Err(error) => {
                limits.add(geometry.number("s")?, error)?;
                return Ok((index, max_curvature));
            }
        }
    }
    Ok((geometries.len(), max_curvature))
}

/// Returns the largest curvature of a geometry, which must be slight.
fn curvature(geometry: Node<'_>) -> Result<f64> {
    let shape = geometry.single()?;
    let largest = match shape.name() {
        "line" => 0.0,
        "arc" => shape.number("curvature")?.abs(),
        "spiral" => {
            let ends = [shape.number("curvStart")?, shape.number("curvEnd")?];
            ends.map(f64::abs).into_iter().fold(0.0, f64::max)
        }
        "paramPoly3" => polynomial_curvature(geometry, shape)?,
        _ => f64::INFINITY,
    };
    if largest <= MAX_CURVATURE {
        return Ok(largest);
    }
    Err(shape.refuse(format!(
        "the road must be straight, or have bends with radii of {} m or more",
        format_fixed(1.0 / MAX_CURVATURE, 0)
    )))
}

/// Returns the largest curvature of a parametric cubic curve at equal steps of its parameter.
fn polynomial_curvature(geometry: Node<'_>, shape: Node<'_>) -> Result<f64> {
    let end = match shape.raw("pRange") {
        Some("arcLength") => geometry.number("length")?,
        _ => 1.0,
    };
    let mut coefficients = [0.0; 6];
    for (value, name) in coefficients
        .iter_mut()
        .zip(["bU", "cU", "dU", "bV", "cV", "dV"])
    {
        *value = shape.number(name)?;
    }
    let [b_u, c_u, d_u, b_v, c_v, d_v] = coefficients;
    let curvatures = (0..=CURVE_PARTS).map(|part| {
        let p = end * part as f64 / CURVE_PARTS as f64;
        let first = |b: f64, c: f64, d: f64| b + 2.0 * c * p + 3.0 * d * p * p;
        let second = |c: f64, d: f64| 2.0 * c + 6.0 * d * p;
        let [u, v] = [first(b_u, c_u, d_u), first(b_v, c_v, d_v)];
        let length = u.hypot(v);
        ((u * second(c_v, d_v) - v * second(c_u, d_u)) / (length * length * length)).abs()
    });
    // A curve that is not a number is not slight.
    Ok(curvatures.fold(
        0.0,
        |largest, value| if value <= largest { largest } else { value },
    ))
}

/// Returns true if all listed attributes are absent or 0.
fn is_zero(node: Node<'_>, attributes: &[&str]) -> bool {
    attributes
        .iter()
        .all(|name| matches!(node.optional_number(name), Ok(None | Some(0.0))))
}

fn read_lanes(lanes: Node<'_>, limits: &mut RoadLimits) -> Result<Vec<Lane>> {
    let offset_m = lane_offset_m(lanes, limits)?;
    let section = lanes.child("laneSection")?;
    if let Some(second) = lanes.named("laneSection").nth(1) {
        let problem = "the lanes must be the same along the road";
        limits.add(second.number("s")?, second.refuse(problem))?;
    }
    let mut lanes = Vec::new();
    for side in section.children() {
        let sign = match side.name() {
            "left" => 1.0,
            "right" => -1.0,
            _ => continue,
        };
        let count = lanes.len() + side.children().count();
        ensure_at_most(side, count, MAX_LANES, "lanes")?;
        let mut ordered = side
            .named("lane")
            .map(|lane| read_lane(side, sign, lane, limits))
            .collect::<Result<Vec<_>>>()?;
        ordered.sort_by_key(|(id, _)| id.abs());
        let mut inner_m = 0.0;
        for (id, width_m) in ordered {
            lanes.push(Lane {
                id,
                middle_m: offset_m + sign * (inner_m + width_m / 2.0),
                width_m,
            });
            inner_m += width_m;
        }
    }
    Ok(lanes)
}

/// Returns the distance of the lane 0 from the reference line. A change of it limits the road.
fn lane_offset_m(lanes: Node<'_>, limits: &mut RoadLimits) -> Result<f64> {
    let mut offset_m = None;
    for offset in lanes.named("laneOffset") {
        let a = offset.optional_number("a")?.unwrap_or(0.0);
        let is_constant = is_zero(offset, &["b", "c", "d"]);
        if !is_constant || *offset_m.get_or_insert(a) != a {
            let problem = "the distance of the lanes from the reference line must be constant";
            let s_m = offset.optional_number("s")?.unwrap_or(0.0);
            limits.add(s_m, offset.refuse(problem))?;
            break;
        }
    }
    Ok(offset_m.unwrap_or(0.0))
}

/// Reads the number and the width of a lane; `sign` is that of the numbers of its side. A change of the width limits
/// the road.
fn read_lane(
    side: Node<'_>,
    sign: f64,
    lane: Node<'_>,
    limits: &mut RoadLimits,
) -> Result<(i32, f64)> {
    let id = lane.number("id")?;
    let width = lane.child("width")?;
    let changing = (!is_zero(width, &["b", "c", "d"])).then_some(width);
    if let Some(changing) = changing.or_else(|| lane.named("width").nth(1)) {
        let s_m = changing.optional_number("sOffset")?.unwrap_or(0.0);
        limits.add(s_m, changing.refuse("the width of a lane must be constant"))?;
    }
    if id.fract() != 0.0 || id.abs() > 1000.0 || id * sign <= 0.0 {
        return Err(lane.refuse(format!(
            "`{id}` is not the number of a lane in `{}`",
            side.name()
        )));
    }
    Ok((id as i32, width.non_negative("a")?))
}
