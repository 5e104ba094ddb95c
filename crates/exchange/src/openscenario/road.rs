//! Straight roads of an OpenDRIVE file, and places on their lanes.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

use super::error::ScenarioImportError;
use super::limits::{MAX_LANES, WORK_PER_ROAD, WorkBudget, ensure_at_most};
use super::xml::{Node, SourceElement};
use crumple_core::digits::format_number;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Largest distance from the middle of a lane that counts as the middle, in metres.
const LATERAL_TOLERANCE_M: f64 = 0.01;
/// Largest difference of directions that count as equal, in radians.
const HEADING_TOLERANCE_RAD: f64 = 1e-3;

/// A straight, level road whose lanes have constant widths.
#[derive(Debug)]
pub(super) struct StraightRoad {
    id: String,
    origin_m: [f64; 2],
    heading_rad: f64,
    /// Cosine and sine of the heading.
    direction: [f64; 2],
    length_m: f64,
    /// True if lanes with negative numbers have the direction of the road.
    is_right_hand: bool,
    lanes: Vec<Lane>,
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

/// A place in the middle of a lane.
#[derive(Debug, Clone)]
pub(super) struct LanePlace {
    pub(super) road: String,
    pub(super) lane: i32,
    /// Position in the direction of travel, in metres.
    pub(super) along_m: f64,
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
        check_level(road)?;
        let length_m = road.number("length")?;
        let line = ReferenceLine::read(road)?;
        if (line.end_m - length_m).abs() > 1.0 {
            return Err(road.refuse(format!(
                "is {} m long, but its geometry ends at {} m",
                format_number(length_m),
                format_number(line.end_m)
            )));
        }
        let is_right_hand = road.raw("rule") != Some("LHT");
        let lanes = read_lanes(road.child("lanes")?)?;
        Ok(Self {
            id: road.text("id")?,
            origin_m: line.origin_m,
            heading_rad: line.heading_rad,
            direction: line.direction,
            length_m,
            is_right_hand,
            lanes,
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
        let is_on_road = (0.0..=self.length_m).contains(&s_m)
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

    /// Returns the place `s_m` along the road on a lane.
    pub(super) fn position(&self, node: Node<'_>, lane: i32, s_m: f64) -> Result<LanePlace> {
        if self.lane(lane).is_none() || lane == 0 {
            return Err(node.refuse(format!("the road `{}` has no lane {lane}", self.id)));
        }
        if !(0.0..=self.length_m).contains(&s_m) {
            return Err(node.refuse(format!(
                "{} m is outside the road `{}` of {} m",
                format_number(s_m),
                self.id,
                format_number(self.length_m)
            )));
        }
        let along_m = self.direction(lane) * (self.start_m() + s_m);
        Ok(LanePlace {
            road: self.id.clone(),
            lane,
            along_m,
        })
    }

    /// Returns the place at a position in the direction of travel.
    pub(super) fn place_along(&self, node: Node<'_>, lane: i32, along_m: f64) -> Result<LanePlace> {
        self.position(node, lane, self.direction(lane) * along_m - self.start_m())
    }

    /// Position of the start of the road along its direction, so that positions are x on a road along x.
    fn start_m(&self) -> f64 {
        let [x_m, y_m] = self.origin_m;
        x_m * self.direction[0] + y_m * self.direction[1]
    }

    /// Returns the place of a point of the world. `heading_rad` must be the direction of travel.
    pub(super) fn place_of_point(
        &self,
        node: Node<'_>,
        point_m: [f64; 2],
        heading_rad: Option<f64>,
    ) -> Result<LanePlace> {
        let [s_m, lateral_m] = self
            .project(point_m)
            .ok_or_else(|| node.refuse("is outside the road"))?;
        let lanes = self.lanes.iter().filter(|lane| lane.id != 0);
        let nearest = lanes.min_by(|a, b| {
            let [a_m, b_m] = [a, b].map(|lane| lane.distance_m(lateral_m));
            a_m.total_cmp(&b_m)
        });
        let lane = nearest.ok_or_else(|| node.refuse("the road has no lanes"))?;
        if lane.distance_m(lateral_m) > LATERAL_TOLERANCE_M {
            let off_m = lateral_m - lane.middle_m;
            return Err(node.refuse(format!(
                "is {} m beside the middle of lane {}",
                format_number(off_m),
                lane.id
            )));
        }
        let travel_rad = self.heading_rad
            + if self.direction(lane.id) > 0.0 {
                0.0
            } else {
                std::f64::consts::PI
            };
        match heading_rad.map(|heading_rad| libm::cos(heading_rad - travel_rad)) {
            Some(cosine) if cosine < libm::cos(HEADING_TOLERANCE_RAD) => Err(node.refuse(format!(
                "`h` is not {} rad, the direction of lane {}",
                format_number(travel_rad),
                lane.id
            ))),
            _ => self.position(node, lane.id, s_m),
        }
    }

    /// Returns the lane `left` lanes to the left in the direction of the road, across the missing lane 0.
    pub(super) fn shifted_lane(&self, lane: i32, by: i32) -> i32 {
        let target = lane.saturating_add(by);
        if (lane < 0) != (target < 0) || target == 0 {
            target.saturating_add(by.signum())
        } else {
            target
        }
    }

    /// Returns the distance between the middles of two lanes, and the width of the second, in metres.
    pub(super) fn lane_distance_m(&self, node: Node<'_>, from: i32, to: i32) -> Result<[f64; 2]> {
        let from = self.require_lane(node, from)?;
        let to = self.require_lane(node, to)?;
        Ok([to.distance_m(from.middle_m), to.width_m])
    }
}

/// Refuses a road with slopes or superelevation.
fn check_level(road: Node<'_>) -> Result<()> {
    for (profile, shape) in [
        ("elevationProfile", "elevation"),
        ("lateralProfile", "superelevation"),
    ] {
        for entry in road.named(profile).flat_map(Node::children) {
            let is_flat = entry.name() == shape && is_zero(entry, &["a", "b", "c", "d"]);
            if !is_flat {
                return Err(entry.refuse("the road must be level"));
            }
        }
    }
    Ok(())
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
}

impl ReferenceLine {
    /// Reads the geometries of a road, which must be lines that continue the first one.
    fn read(road: Node<'_>) -> Result<Self> {
        let mut line: Option<Self> = None;
        for geometry in road.child("planView")?.children() {
            let shape = geometry.single()?;
            if shape.name() != "line" {
                return Err(shape.refuse("the road must be straight"));
            }
            let s_m = geometry.number("s")?;
            let [x_m, y_m] = [geometry.number("x")?, geometry.number("y")?];
            let heading_rad = geometry.number("hdg")?;
            let line = line.get_or_insert_with(|| Self {
                origin_m: [x_m, y_m],
                heading_rad,
                direction: [libm::cos(heading_rad), libm::sin(heading_rad)],
                end_m: 0.0,
            });
            let [cosine, sine] = line.direction;
            let off_m = (x_m - line.origin_m[0] - s_m * cosine).abs()
                + (y_m - line.origin_m[1] - s_m * sine).abs();
            if (heading_rad - line.heading_rad).abs() > HEADING_TOLERANCE_RAD
                || off_m > LATERAL_TOLERANCE_M
            {
                return Err(geometry.refuse("the road must be straight"));
            }
            line.end_m = s_m + geometry.number("length")?;
        }
        line.ok_or_else(|| road.refuse("has no geometry"))
    }
}

/// Returns true if all listed attributes are absent or 0.
fn is_zero(node: Node<'_>, attributes: &[&str]) -> bool {
    attributes
        .iter()
        .all(|name| matches!(node.optional_number(name), Ok(None | Some(0.0))))
}

fn read_lanes(lanes: Node<'_>) -> Result<Vec<Lane>> {
    let mut offsets = lanes.named("laneOffset");
    if let Some(offset) = offsets.find(|offset| !is_zero(*offset, &["a", "b", "c", "d"])) {
        return Err(offset.refuse("lanes must not be offset from the reference line"));
    }
    let section = lanes.child("laneSection")?;
    if let Some(second) = lanes.named("laneSection").nth(1) {
        return Err(second.refuse("the lanes must be the same along the road"));
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
            .map(|lane| read_lane(side, sign, lane))
            .collect::<Result<Vec<_>>>()?;
        ordered.sort_by_key(|(id, _)| id.abs());
        let mut inner_m = 0.0;
        for (id, width_m) in ordered {
            lanes.push(Lane {
                id,
                middle_m: sign * (inner_m + width_m / 2.0),
                width_m,
            });
            inner_m += width_m;
        }
    }
    Ok(lanes)
}

/// Reads the number and the width of a lane; `sign` is that of the numbers of its side.
fn read_lane(side: Node<'_>, sign: f64, lane: Node<'_>) -> Result<(i32, f64)> {
    let id = lane.number("id")?;
    let width = lane.child("width")?;
    let second = lane.named("width").nth(1);
    let changing = second.or_else(|| (!is_zero(width, &["b", "c", "d"])).then_some(width));
    if let Some(changing) = changing {
        return Err(changing.refuse("the width of a lane must be constant"));
    }
    if id.fract() != 0.0 || id.abs() > 1000.0 || id * sign <= 0.0 {
        return Err(lane.refuse(format!(
            "`{id}` is not the number of a lane in `{}`",
            side.name()
        )));
    }
    Ok((id as i32, width.non_negative("a")?))
}
