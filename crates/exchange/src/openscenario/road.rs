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
    known: RefCell<Vec<Rc<StraightRoad>>>,
    /// Roads that were read, by their index in the file; `None` for one that is not supported.
    read: RefCell<HashMap<usize, Option<Rc<StraightRoad>>>>,
}

impl<'a> RoadMap<'a> {
    pub(super) fn new(file: &'a SourceElement, work: &'a WorkBudget) -> Self {
        Self {
            file,
            work,
            known: RefCell::default(),
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
        let is_wanted = |road: &StraightRoad| {
            id.map_or_else(|| road.project(point_m).is_some(), |id| road.id == id)
        };
        if let Some(found) = self.known.borrow().iter().find(|road| is_wanted(road)) {
            return Ok(found.clone());
        }
        self.work
            .spend(node, WORK_PER_ROAD * self.file.children().len() as u64)?;
        let mut refused = None;
        for (index, road) in (Node {
            element: self.file,
            ..node
        })
        .named("road")
        .enumerate()
        {
            if id.is_some_and(|id| road.raw("id") != Some(id)) {
                continue;
            }
            let mut read = self.read.borrow_mut();
            match read
                .entry(index)
                .or_insert_with(|| StraightRoad::read(road).ok().map(Rc::new))
            {
                Some(found) if is_wanted(found) => return self.add_known(road, found.clone()),
                Some(_) => {}
                None => refused = refused.or(Some(road)),
            }
        }
        match (refused, id) {
            (Some(road), _) => StraightRoad::read(road).map(Rc::new),
            (None, Some(id)) => Err(node.refuse(format!("there is no road `{id}`"))),
            (None, None) => Err(node.refuse(format!(
                "no road contains the point x = {}, y = {}",
                format_number(point_m[0]),
                format_number(point_m[1])
            ))),
        }
    }

    /// Adds a road in use, which must be the only one of its identifier.
    fn add_known(&self, node: Node<'_>, road: Rc<StraightRoad>) -> Result<Rc<StraightRoad>> {
        let mut known = self.known.borrow_mut();
        if known.iter().any(|other| other.id == road.id) {
            return Err(node.refuse(format!("there are two roads `{}`", road.id)));
        }
        known.push(road.clone());
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
        for (name, what) in [
            ("elevationProfile", "elevation"),
            ("lateralProfile", "superelevation"),
        ] {
            let entries = road.named(name).flat_map(Node::children);
            for entry in entries {
                let is_flat = entry.name() == what && is_zero(entry, &["a", "b", "c", "d"]);
                if !is_flat {
                    return Err(entry.refuse("the road must be level"));
                }
            }
        }
        let length_m = road.number("length")?;
        let (mut start, mut end_m): (Option<([f64; 2], f64)>, f64) = (None, 0.0);
        for geometry in road.child("planView")?.children() {
            let shape = geometry.single()?;
            if shape.name() != "line" {
                return Err(shape.refuse("the road must be straight"));
            }
            let [s_m, x_m, y_m] = [
                geometry.number("s")?,
                geometry.number("x")?,
                geometry.number("y")?,
            ];
            let heading_rad = geometry.number("hdg")?;
            let (origin_m, first_rad) = *start.get_or_insert(([x_m, y_m], heading_rad));
            let (sine, cosine) = (libm::sin(first_rad), libm::cos(first_rad));
            let off_m =
                (x_m - origin_m[0] - s_m * cosine).abs() + (y_m - origin_m[1] - s_m * sine).abs();
            if (heading_rad - first_rad).abs() > HEADING_TOLERANCE_RAD
                || off_m > LATERAL_TOLERANCE_M
            {
                return Err(geometry.refuse("the road must be straight"));
            }
            end_m = s_m + geometry.number("length")?;
        }
        let (origin_m, heading_rad) = start.ok_or_else(|| road.refuse("has no geometry"))?;
        if (end_m - length_m).abs() > 1.0 {
            return Err(road.refuse(format!(
                "is {} m long, but its geometry ends at {} m",
                format_number(length_m),
                format_number(end_m)
            )));
        }
        let is_right_hand = road.raw("rule") != Some("LHT");
        let lanes = read_lanes(road.child("lanes")?)?;
        let id = road.text("id")?;
        let direction = [libm::cos(heading_rad), libm::sin(heading_rad)];
        Ok(Self {
            id,
            origin_m,
            heading_rad,
            direction,
            length_m,
            is_right_hand,
            lanes,
        })
    }

    /// Returns the position along the road and the lateral position of a point on the road.
    fn project(&self, [x_m, y_m]: [f64; 2]) -> Option<[f64; 2]> {
        let [cosine, sine] = self.direction;
        let [dx_m, dy_m] = [x_m - self.origin_m[0], y_m - self.origin_m[1]];
        let [s_m, lateral_m] = [dx_m * cosine + dy_m * sine, dy_m * cosine - dx_m * sine];
        let is_inside = |lane: &Lane| (lateral_m - lane.middle_m).abs() <= lane.width_m / 2.0;
        let is_on_road = (0.0..=self.length_m).contains(&s_m) && self.lanes.iter().any(is_inside);
        is_on_road.then_some([s_m, lateral_m])
    }

    fn lane(&self, id: i32) -> Option<&Lane> {
        self.lanes.iter().find(|lane| lane.id == id)
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
    pub(super) fn place(&self, node: Node<'_>, lane: i32, s_m: f64) -> Result<LanePlace> {
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
        self.place(node, lane, self.direction(lane) * along_m - self.start_m())
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
        let distance_m = |lane: &&Lane| (lateral_m - lane.middle_m).abs();
        let nearest = self.lanes.iter().filter(|lane| lane.id != 0);
        let nearest = nearest.min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)));
        let lane = nearest.ok_or_else(|| node.refuse("the road has no lanes"))?;
        if distance_m(&lane) > LATERAL_TOLERANCE_M {
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
            _ => self.place(node, lane.id, s_m),
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
        let lane = |id| {
            self.lane(id)
                .ok_or_else(|| node.refuse(format!("the road `{}` has no lane {id}", self.id)))
        };
        let (from, to) = (lane(from)?, lane(to)?);
        Ok([(from.middle_m - to.middle_m).abs(), to.width_m])
    }
}

/// Returns true if all listed attributes are absent or 0.
fn is_zero(node: Node<'_>, attributes: &[&str]) -> bool {
    attributes
        .iter()
        .all(|name| matches!(node.optional_number(name), Ok(None | Some(0.0))))
}

fn read_lanes(lanes: Node<'_>) -> Result<Vec<Lane>> {
    if let Some(offset) = lanes
        .named("laneOffset")
        .find(|offset| !is_zero(*offset, &["a", "b", "c", "d"]))
    {
        return Err(offset.refuse("lanes must not be offset from the reference line"));
    }
    let section = lanes.child("laneSection")?;
    if let Some(second) = lanes.named("laneSection").nth(1) {
        return Err(second.refuse("the lanes must be the same along the road"));
    }
    let mut found = Vec::new();
    for side in section.children() {
        let sign = match side.name() {
            "left" => 1.0,
            "right" => -1.0,
            _ => continue,
        };
        ensure_at_most(
            side,
            found.len() + side.children().count(),
            MAX_LANES,
            "lanes",
        )?;
        let mut ordered = Vec::new();
        for lane in side.named("lane") {
            let id = lane.number("id")?;
            let width = lane.child("width")?;
            if let Some(changed) = lane
                .named("width")
                .nth(1)
                .or_else(|| (!is_zero(width, &["b", "c", "d"])).then_some(width))
            {
                return Err(changed.refuse("the width of a lane must be constant"));
            }
            if id.fract() != 0.0 || id.abs() > 1000.0 || id * sign <= 0.0 {
                return Err(lane.refuse(format!(
                    "`{id}` is not the number of a lane in `{}`",
                    side.name()
                )));
            }
            ordered.push((id as i32, width.non_negative("a")?));
        }
        ordered.sort_by_key(|(id, _)| id.abs());
        let mut inner_m = 0.0;
        for (id, width_m) in ordered {
            found.push(Lane {
                id,
                middle_m: sign * (inner_m + width_m / 2.0),
                width_m,
            });
            inner_m += width_m;
        }
    }
    Ok(found)
}
