//! Quantities of entities that conditions compare with thresholds.

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::place::{PlacePurpose, resolve_place};
use super::replay::{REPLAY_STEP_S, Replay};
use super::road::LanePlace;
use super::storyboard::entity_index;
use super::trigger::{ConditionKind, ConditionThreshold};
use super::vocabulary::Rule;
use super::xml::Node;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Attributes of conditions on distances.
const DISTANCE_ATTRIBUTES: [&str; 8] = [
    "entityRef",
    "value",
    "rule",
    "freespace",
    "alongRoute",
    "coordinateSystem",
    "relativeDistanceType",
    "routingAlgorithm",
];

/// Kind of a quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum QuantityKind {
    Speed,
    RelativeSpeed,
    /// Acceleration along the lane.
    Acceleration,
    /// Amount of the acceleration.
    AccelerationAmount,
    Distance,
    /// Distance across the road.
    LateralDistance,
    /// Distance in the plane.
    StraightDistance,
    Headway,
    TimeToCollision,
    TravelledDistance,
    /// Distance along the road from a position.
    DistanceAlong,
    /// Distance in the plane from a position.
    DistanceFrom,
    /// 1 if the entity has stood for a duration, otherwise -1.
    AtRest,
    /// 1 if the entity has been beyond the end of the road for a duration, otherwise -1.
    BeyondRoad,
}

impl QuantityKind {
    /// Returns true if the quantity passes through all values between two. Accelerations jump, and times to a collision
    /// jump to infinity and back.
    fn is_continuous(self) -> bool {
        !matches!(
            self,
            Self::Acceleration
                | Self::AccelerationAmount
                | Self::TimeToCollision
                | Self::AtRest
                | Self::BeyondRoad
        )
    }
}

/// A quantity of an entity, which may be relative to another entity or to a position.
#[derive(Debug, Clone)]
pub(super) struct Quantity<'a> {
    kind: QuantityKind,
    /// Entity to which the quantity is relative.
    pub(super) reference: Option<usize>,
    /// True for distances between bumpers.
    is_free: bool,
    /// Position to which the quantity is relative.
    position: Option<Node<'a>>,
    /// Number of entities whose places a relative position needs.
    pub(super) places: usize,
    duration_s: f64,
}

/// A quantity of entities, and the threshold with which a condition compares it.
#[derive(Debug, Clone)]
pub(super) struct EntityCondition<'a> {
    pub(super) quantity: Quantity<'a>,
    pub(super) threshold: ConditionThreshold,
    /// The position, if it depends on no entity.
    pub(super) fixed_place: Option<LanePlace>,
    /// Values at the evaluation before, of entities whose quantity may pass through a threshold.
    pub(super) values_before: Vec<f64>,
}

impl<'a> Quantity<'a> {
    fn new(kind: QuantityKind) -> Self {
        Self {
            kind,
            reference: None,
            is_free: false,
            position: None,
            places: 0,
            duration_s: 0.0,
        }
    }

    /// Sets the position to which the quantity is relative.
    fn set_position(&mut self, node: Node<'a>, entities: &[Entity<'_>]) -> Result<()> {
        let position = node.child("Position")?.single()?;
        if position.raw("entityRef").is_some() {
            self.places = entities.len();
        }
        self.position = Some(position);
        Ok(())
    }

    fn condition(self, threshold: ConditionThreshold) -> ConditionKind<'a> {
        ConditionKind::Entity(EntityCondition {
            quantity: self,
            threshold,
            fixed_place: None,
            values_before: Vec::new(),
        })
    }
}

/// Child of a condition on the time to a collision.
const COLLISION_TARGET: &str = "TimeToCollisionConditionTarget";

/// Refuses unknown content of a condition on a quantity.
fn check_quantity(kind: QuantityKind, node: Node<'_>) -> Result<()> {
    let attributes = match kind {
        QuantityKind::Speed | QuantityKind::Acceleration => &["value", "rule", "direction"][..],
        QuantityKind::RelativeSpeed => &["entityRef", "value", "rule", "direction"],
        QuantityKind::TravelledDistance => &["value"],
        _ => &DISTANCE_ATTRIBUTES,
    };
    let children = match kind {
        QuantityKind::TimeToCollision => &[COLLISION_TARGET][..],
        _ => &[],
    };
    node.only(children, attributes)?;
    let types = match kind {
        QuantityKind::Distance => &[
            "longitudinal",
            "lateral",
            "euclidianDistance",
            "cartesianDistance",
        ][..],
        _ => &["longitudinal"],
    };
    node.expect("relativeDistanceType", types)?;
    node.expect("coordinateSystem", &["entity", "lane", "road"])?;
    node.expect("direction", &["longitudinal"])
}

/// Returns the kind of the distance that a condition on the distance from an entity states.
fn distance_kind(node: Node<'_>) -> QuantityKind {
    match node.raw("relativeDistanceType") {
        Some("lateral") => QuantityKind::LateralDistance,
        Some("euclidianDistance" | "cartesianDistance") => QuantityKind::StraightDistance,
        _ => QuantityKind::Distance,
    }
}

/// Returns the element that names the entity to which the time to a collision is relative.
fn collision_target(node: Node<'_>) -> Result<Node<'_>> {
    let target = node.child(COLLISION_TARGET)?.single()?;
    if target.name() == "EntityRef" {
        Ok(target)
    } else {
        Err(target.refuse("is not supported as a target, only EntityRef"))
    }
}

/// Reads a condition on a quantity of the entity, or on one relative to another entity.
pub(super) fn read_quantity<'a>(
    kind: QuantityKind,
    node: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<ConditionKind<'a>> {
    check_quantity(kind, node)?;
    let reference = match kind {
        QuantityKind::TimeToCollision => Some(collision_target(node)?),
        QuantityKind::Speed | QuantityKind::Acceleration | QuantityKind::TravelledDistance => None,
        _ => Some(node),
    };
    let mut quantity = Quantity::new(kind);
    if kind == QuantityKind::Acceleration && node.raw("direction").is_none() {
        quantity.kind = QuantityKind::AccelerationAmount;
    }
    if kind == QuantityKind::Distance {
        quantity.kind = distance_kind(node);
    }
    quantity.is_free = node.flag("freespace", false)?;
    quantity.reference = reference
        .map(|node| entity_index(node, "entityRef", entities))
        .transpose()?;
    let may_be_negative = matches!(
        kind,
        QuantityKind::Speed | QuantityKind::RelativeSpeed | QuantityKind::Acceleration
    );
    if !may_be_negative {
        node.non_negative("value")?;
    }
    let threshold = match kind {
        QuantityKind::TravelledDistance => {
            ConditionThreshold::new(Rule::GreaterOrEqual, node.number("value")?)
        }
        _ => ConditionThreshold::read(node)?,
    };
    Ok(quantity.condition(threshold))
}

/// Reads `StandStillCondition`.
pub(super) fn read_at_rest<'a>(
    node: Node<'a>,
    _entities: &[Entity<'_>],
) -> Result<ConditionKind<'a>> {
    read_duration(QuantityKind::AtRest, node)
}

/// Reads `EndOfRoadCondition`.
pub(super) fn read_end_of_road<'a>(
    node: Node<'a>,
    _entities: &[Entity<'_>],
) -> Result<ConditionKind<'a>> {
    read_duration(QuantityKind::BeyondRoad, node)
}

fn read_duration<'a>(kind: QuantityKind, node: Node<'a>) -> Result<ConditionKind<'a>> {
    node.only(&[], &["duration"])?;
    let mut quantity = Quantity::new(kind);
    quantity.duration_s = node.non_negative("duration")?;
    Ok(quantity.condition(ConditionThreshold::new(Rule::GreaterThan, 0.0)))
}

/// Reads `ReachPositionCondition`.
pub(super) fn read_position<'a>(
    node: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<ConditionKind<'a>> {
    node.only(&["Position"], &["tolerance"])?;
    let mut quantity = Quantity::new(QuantityKind::DistanceFrom);
    quantity.set_position(node, entities)?;
    let tolerance_m = node.non_negative("tolerance")?;
    Ok(quantity.condition(ConditionThreshold::new(Rule::LessOrEqual, tolerance_m)))
}

/// Reads `DistanceCondition`.
pub(super) fn read_distance<'a>(
    node: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<ConditionKind<'a>> {
    node.only(&["Position"], &DISTANCE_ATTRIBUTES)?;
    node.expect(
        "relativeDistanceType",
        &["longitudinal", "euclidianDistance", "cartesianDistance"],
    )?;
    node.expect("coordinateSystem", &["entity", "lane", "road"])?;
    node.non_negative("value")?;
    let is_along = node.raw("relativeDistanceType") == Some("longitudinal")
        || node.flag("alongRoute", false)?;
    let mut quantity = Quantity::new(if is_along {
        QuantityKind::DistanceAlong
    } else {
        QuantityKind::DistanceFrom
    });
    quantity.is_free = node.flag("freespace", false)?;
    quantity.set_position(node, entities)?;
    Ok(quantity.condition(ConditionThreshold::read(node)?))
}

impl EntityCondition<'_> {
    /// Returns the time in the last step at which the value of the entity at an index passed through the threshold of
    /// `equalTo`, and keeps the value.
    pub(super) fn passed_s(&mut self, index: usize, value: f64, now_s: f64) -> Option<f64> {
        if !self.quantity.kind.is_continuous() {
            return None;
        }
        let Some(before) = self.values_before.get_mut(index) else {
            self.values_before.push(value);
            return None;
        };
        let before = std::mem::replace(before, value);
        let share = self.threshold.passing_share(before, value)?;
        Some(now_s - (1.0 - share) * REPLAY_STEP_S)
    }

    /// Returns the quantity of an entity at a time. Positions relative to an entity move with it.
    pub(super) fn value(
        &mut self,
        replay: &Replay<'_, '_>,
        entity: usize,
        now_s: f64,
    ) -> Result<f64> {
        let quantity = &self.quantity;
        let Some(position) = quantity.position else {
            return Ok(quantity.value(replay, entity, now_s));
        };
        let lane_place = resolve_once(&mut self.fixed_place, replay, position, now_s)?;
        if lane_place.road != replay.road_id {
            return Ok(f64::INFINITY);
        }
        let along_m = lane_place.road_m - replay.road_m(entity, now_s);
        let bumper_m = match replay.bumpers_m(entity) {
            _ if !quantity.is_free => 0.0,
            [front_m, _] if along_m * replay.direction(entity) > 0.0 => front_m,
            [_, rear_m] => rear_m,
        };
        let along_m = (along_m.abs() - bumper_m).max(0.0);
        match quantity.kind {
            QuantityKind::DistanceAlong => Ok(along_m),
            _ => Ok(along_m.hypot(lane_place.lateral_m - replay.lateral_m(entity, now_s))),
        }
    }
}

/// Returns the place of a position, which is kept if it depends on no entity.
fn resolve_once(
    fixed_place: &mut Option<LanePlace>,
    replay: &Replay<'_, '_>,
    position: Node<'_>,
    now_s: f64,
) -> Result<LanePlace> {
    if let Some(lane_place) = fixed_place {
        return Ok(lane_place.clone());
    }
    let places = replay.places(now_s);
    let purpose = PlacePurpose::Lane;
    let lane_place = resolve_place(position, &places, &replay.place_sources(), purpose)?;
    let lane_place = lane_place.ok_or_else(|| position.refuse("is not supported here"))?;
    if position.raw("entityRef").is_none() {
        *fixed_place = Some(lane_place.clone());
    }
    Ok(lane_place)
}

impl Quantity<'_> {
    fn value(&self, replay: &Replay<'_, '_>, entity: usize, now_s: f64) -> f64 {
        let own_mps = replay.speed_mps(entity, now_s);
        let acceleration_mps2 =
            || (own_mps - replay.speed_mps(entity, now_s - REPLAY_STEP_S)) / REPLAY_STEP_S;
        let travelled_m =
            |from_s: f64| replay.driven_m(entity, now_s) - replay.driven_m(entity, from_s);
        let since_s = now_s - self.duration_s;
        let as_number = |holds: bool| if holds { 1.0 } else { -1.0 };
        match self.kind {
            QuantityKind::Speed => own_mps,
            QuantityKind::Acceleration => acceleration_mps2(),
            QuantityKind::AccelerationAmount => acceleration_mps2().abs(),
            QuantityKind::TravelledDistance => travelled_m(0.0),
            QuantityKind::AtRest => as_number(self.since_s(replay, entity, now_s).is_some()),
            QuantityKind::BeyondRoad => {
                as_number(since_s >= 0.0 && replay.is_beyond_road(entity, since_s))
            }
            _ => match self.reference {
                Some(reference) => self.relative_value(replay, [entity, reference], now_s),
                None => own_mps,
            },
        }
    }

    /// Returns the time from which an entity has stood for the duration; `None` for other quantities.
    pub(super) fn since_s(
        &self,
        replay: &Replay<'_, '_>,
        entity: usize,
        now_s: f64,
    ) -> Option<f64> {
        let motion = replay.motion.get(entity);
        let motion = motion.filter(|_| self.kind == QuantityKind::AtRest)?;
        let since_s = motion.plan.at_rest_since_s(now_s)? + self.duration_s;
        (since_s <= now_s).then_some(since_s)
    }

    /// Returns the distance between two entities across the road.
    fn across_m(&self, replay: &Replay<'_, '_>, entities: [usize; 2], now_s: f64) -> f64 {
        let [own_m, other_m] = entities.map(|entity| replay.lateral_m(entity, now_s));
        let bodies = entities.map(|entity| replay.entities.get(entity));
        let widths_m = bodies.map(|body| body.map_or(0.0, |body| body.width_m));
        let sides_m = if self.is_free {
            0.5 * (widths_m[0] + widths_m[1])
        } else {
            0.0
        };
        ((own_m - other_m).abs() - sides_m).max(0.0)
    }

    /// Returns a quantity of the first entity that is relative to the second one.
    fn relative_value(
        &self,
        replay: &Replay<'_, '_>,
        [entity, reference]: [usize; 2],
        now_s: f64,
    ) -> f64 {
        let own_mps = replay.along_mps(entity, now_s);
        let direction = replay.direction(entity);
        let other_mps =
            direction * replay.direction(reference) * replay.along_mps(reference, now_s);
        let ahead_m = direction * (replay.road_m(reference, now_s) - replay.road_m(entity, now_s));
        let faster_mps = own_mps - other_mps;
        let is_behind = ahead_m >= 0.0;
        let closing_mps = if is_behind { faster_mps } else { -faster_mps };
        let [front_m, rear_m] = replay.bumpers_m(entity);
        let [other_front_m, other_rear_m] = replay.bumpers_m(reference);
        let is_facing = direction * replay.direction(reference) < 0.0;
        let own_end_m = if is_behind { front_m } else { rear_m };
        let other_end_m = if is_behind == is_facing {
            other_front_m
        } else {
            other_rear_m
        };
        let gap_m = if self.is_free {
            (ahead_m.abs() - own_end_m - other_end_m).max(0.0)
        } else {
            ahead_m.abs()
        };
        match self.kind {
            QuantityKind::Distance => gap_m,
            QuantityKind::LateralDistance => self.across_m(replay, [entity, reference], now_s),
            QuantityKind::StraightDistance => {
                gap_m.hypot(self.across_m(replay, [entity, reference], now_s))
            }
            QuantityKind::Headway => gap_m / own_mps,
            QuantityKind::TimeToCollision if closing_mps > 0.0 => gap_m / closing_mps,
            QuantityKind::TimeToCollision => f64::INFINITY,
            _ => faster_mps,
        }
    }
}
