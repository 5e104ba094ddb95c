//! Straight road that takes the place of a missing road file.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use super::error::ScenarioImportError;
use super::limits::{MAX_LANES, ensure_at_most};
use super::path_actions::lane_number;
use super::xml::Node;
use crumple_core::quoting::strip_unprintable;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Road that takes the place of a missing file.
pub(super) struct ReplacementRoad {
    /// OpenDRIVE file.
    pub(super) text: String,
    /// Description for a note.
    pub(super) about: &'static str,
}

const STATED_LANES: &str =
    "is missing: the road is straight, has the stated lanes, each 3.5 m wide, and is 10 km long";
const ONE_LANE: &str = "is missing, and no position states a lane: the road is straight, through the first position, \
    has one lane of 3.5 m, and is 10 km long";
/// Width of a lane and length of a road, in metres.
const WIDTH_M: f64 = 3.5;
const LENGTH_M: f64 = 10_000.0;
/// Maximum number of roads.
const MAX_ROADS: usize = 20;

/// Returns an OpenDRIVE file with the roads and lanes that the storyboard states; without any, a lane through the first
/// position in the world.
pub(super) fn replacement(node: Node<'_>, storyboard: Node<'_>) -> Result<ReplacementRoad> {
    let mut stated = StatedPlaces::default();
    stated.find(node, storyboard)?;
    let mut text = String::from("<OpenDRIVE>");
    let about = match (stated.lanes.is_empty(), stated.point) {
        (false, _) => {
            for (id, lanes) in &stated.lanes {
                write_road(&mut text, node, id, lanes.iter().chain(&stated.targets))?;
            }
            STATED_LANES
        }
        (true, Some(point)) => {
            write_lane_through(&mut text, point)?;
            ONE_LANE
        }
        (true, None) => {
            let path = node.optional_text("filepath")?;
            let path = path.map_or_else(String::new, |path| format!("{path}: "));
            return Err(node.refuse(format!(
                "{path}the road is missing, and no position states a lane"
            )));
        }
    };
    text += "</OpenDRIVE>";
    Ok(ReplacementRoad { text, about })
}

/// Lanes and positions that a storyboard states.
#[derive(Default)]
struct StatedPlaces<'a> {
    /// Lanes of each road.
    lanes: BTreeMap<String, BTreeSet<i32>>,
    /// Targets of lane changes.
    targets: BTreeSet<i32>,
    /// First position in the world.
    point: Option<Node<'a>>,
}

impl<'a> StatedPlaces<'a> {
    /// Finds the places in the order of the file. `road` is the element of the road.
    fn find(&mut self, road: Node<'_>, storyboard: Node<'a>) -> Result<()> {
        let mut open = vec![storyboard];
        while let Some(next) = open.pop() {
            match next.name() {
                "LanePosition" => {
                    let lanes = self.lanes.entry(next.text("roadId")?).or_default();
                    lanes.insert(lane_number(next, "laneId")?);
                }
                "AbsoluteTargetLane" => {
                    self.targets.insert(lane_number(next, "value")?);
                }
                "WorldPosition" if self.point.is_none() => self.point = Some(next),
                _ => {
                    let first = open.len();
                    open.extend(next.children());
                    open.get_mut(first..).unwrap_or_default().reverse();
                }
            }
            ensure_at_most(road, self.lanes.len(), MAX_ROADS, "roads")?;
        }
        Ok(())
    }
}

/// Adds a road with one lane in the direction of a position, which is in the middle of the lane and of the road.
fn write_lane_through(text: &mut String, point: Node<'_>) -> Result<()> {
    let heading_rad = point.optional_number("h")?.unwrap_or(0.0);
    let [cosine, sine] = [libm::cos(heading_rad), libm::sin(heading_rad)];
    let [back_m, left_m] = [0.5 * LENGTH_M, 0.5 * WIDTH_M];
    let x_m = point.number("x")? - back_m * cosine - left_m * sine;
    let y_m = point.number("y")? - back_m * sine + left_m * cosine;
    let lanes = format!("<right>{}</right>", lane(-1));
    push_road(text, "1", [x_m, y_m, heading_rad], &lanes);
    Ok(())
}

/// Adds a road with all lanes between the reference line and the farthest stated lanes, and one more on each side.
fn write_road<'l>(
    text: &mut String,
    node: Node<'_>,
    id: &str,
    lanes: impl Iterator<Item = &'l i32>,
) -> Result<()> {
    let [mut low, mut high] = [0, 0];
    for &lane in lanes {
        low = low.min(lane);
        high = high.max(lane);
    }
    ensure_at_most(node, (high - low) as usize, MAX_LANES - 2, "lanes")?;
    let id: String = strip_unprintable(id)
        .chars()
        .filter(|letter| !matches!(letter, '<' | '>' | '&' | '"'))
        .collect();
    let side = |name: &str, numbers: std::ops::RangeInclusive<i32>| {
        let lanes: String = numbers.map(lane).collect();
        format!("<{name}>{lanes}</{name}>")
    };
    let mut lanes = String::new();
    if high > 0 {
        lanes += &side("left", 1..=high + 1);
    }
    if low < 0 {
        lanes += &side("right", low - 1..=-1);
    }
    push_road(text, &id, [0.0; 3], &lanes);
    Ok(())
}

fn lane(number: i32) -> String {
    format!("<lane id=\"{number}\" type=\"driving\"><width a=\"{WIDTH_M}\"/></lane>")
}

/// Adds a straight road from a point in a direction.
fn push_road(text: &mut String, id: &str, [x_m, y_m, heading_rad]: [f64; 3], lanes: &str) {
    let _ = write!(
        text,
        "<road id=\"{id}\" length=\"{LENGTH_M}\" junction=\"-1\"><planView><geometry s=\"0\" x=\"{x_m}\" \
         y=\"{y_m}\" hdg=\"{heading_rad}\" length=\"{LENGTH_M}\"><line/></geometry></planView><lanes>\
         <laneSection s=\"0\">{lanes}</laneSection></lanes></road>"
    );
}
