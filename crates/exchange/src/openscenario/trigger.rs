//! Triggers: groups of conditions, evaluated at the steps of a replay.

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::ConditionCount;
use super::replay::Replay;
use super::storyboard::entity_index;
use super::xml::Node;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Attributes of conditions on the distance of two entities.
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

/// A trigger: true if all conditions of a group are true.
pub(super) struct Trigger<'a> {
    /// `None` for a trigger that is true from the start.
    groups: Option<Vec<Vec<Condition<'a>>>>,
}

struct Condition<'a> {
    node: Node<'a>,
    kind: ConditionKind,
    edge: ConditionEdge,
    delay_s: f64,
    /// Margin at the step before; positive if the condition held.
    before: Option<f64>,
    /// Times from which the condition is true, delay included, and until which.
    pending_s: std::collections::VecDeque<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum ConditionEdge {
    None,
    Rising,
    Falling,
}

enum ConditionKind {
    Time(ConditionThreshold),
    Element {
        kind: String,
        name: String,
        is_end: bool,
    },
    Entity {
        who: Vec<usize>,
        needs_all: bool,
        quantity: EntityQuantity,
        threshold: ConditionThreshold,
    },
}

/// A quantity of an entity, which may be relative to another entity.
#[derive(Clone, Copy)]
struct EntityQuantity {
    kind: QuantityKind,
    to: Option<usize>,
    /// True for distances between bumpers.
    is_free: bool,
}

#[derive(Clone, Copy)]
enum QuantityKind {
    Speed,
    Distance,
    Headway,
    TimeToCollision,
}

#[derive(Clone, Copy)]
struct ConditionThreshold {
    value: f64,
    is_lower: bool,
    is_strict: bool,
}

impl ConditionThreshold {
    fn read(node: Node<'_>) -> Result<Self> {
        let (is_lower, is_strict) = match node.text("rule")?.as_str() {
            "greaterThan" => (true, true),
            "greaterOrEqual" => (true, false),
            "lessThan" => (false, true),
            "lessOrEqual" => (false, false),
            other => return Err(node.refuse(format!("the rule `{other}` is not supported"))),
        };
        Ok(Self {
            value: node.number("value")?,
            is_lower,
            is_strict,
        })
    }

    fn margin(self, found: f64) -> f64 {
        let margin = if self.is_lower {
            found - self.value
        } else {
            self.value - found
        };
        // Conditions hold at positive margins.
        if margin == 0.0 && !self.is_strict {
            f64::MIN_POSITIVE
        } else {
            margin
        }
    }
}

impl<'a> Trigger<'a> {
    pub(super) fn read(
        node: Option<Node<'a>>,
        entities: &[Entity<'_>],
        count: &mut ConditionCount,
    ) -> Result<Self> {
        let Some(node) = node else {
            return Ok(Self { groups: None });
        };
        node.only(&["ConditionGroup"], &[])?;
        let mut groups = Vec::new();
        for group in node.children() {
            group.only(&["Condition"], &[])?;
            count.add_group(group)?;
            let conditions = group
                .children()
                .map(|condition| Condition::read(condition, entities, count));
            groups.push(conditions.collect::<Result<Vec<_>>>()?);
        }
        Ok(Self {
            groups: Some(groups),
        })
    }

    /// Returns the work of one evaluation: `elements` is the number of events and actions, `state_work` that of finding
    /// the state of an entity.
    pub(super) fn work(&self, elements: u64, state_work: u64) -> u64 {
        let condition = |condition: &Condition<'_>| match &condition.kind {
            ConditionKind::Time(_) => 5,
            ConditionKind::Element { .. } => 5 + 4 * elements,
            ConditionKind::Entity { who, .. } => 5 + 4 * state_work * who.len() as u64,
        };
        let group = |group: &Vec<Condition<'_>>| 2 + group.iter().map(condition).sum::<u64>();
        2 + self.groups.iter().flatten().map(group).sum::<u64>()
    }

    /// Returns the time at which the trigger fired in the step from `before_s` to `now_s`, and whether it depends on a
    /// controller.
    pub(super) fn fires(
        &mut self,
        state: &Replay<'_, '_>,
        before_s: f64,
        now_s: f64,
    ) -> Result<Option<(f64, bool)>> {
        let Some(groups) = &mut self.groups else {
            return Ok(Some((before_s, false)));
        };
        let mut first: Option<(f64, bool)> = None;
        for group in groups {
            let (mut fired, mut depends) = (Some(before_s), false);
            for condition in group {
                let (found, depends_too) = condition.evaluate(state, before_s, now_s)?;
                fired = fired.zip(found).map(|(a, b)| a.max(b));
                depends |= depends_too;
            }
            if let Some(time_s) = fired
                && first.is_none_or(|(earlier_s, _)| time_s < earlier_s)
            {
                first = Some((time_s, depends));
            }
        }
        Ok(first)
    }
}

impl<'a> Condition<'a> {
    fn read(node: Node<'a>, entities: &[Entity<'_>], count: &mut ConditionCount) -> Result<Self> {
        node.only(
            &["ByValueCondition", "ByEntityCondition"],
            &["name", "delay", "conditionEdge"],
        )?;
        let edge = match node.text("conditionEdge")?.as_str() {
            "none" => ConditionEdge::None,
            "rising" => ConditionEdge::Rising,
            "falling" => ConditionEdge::Falling,
            other => return Err(node.refuse(format!("the edge `{other}` is not supported"))),
        };
        let inner = node.single()?;
        let kind = match inner.name() {
            "ByValueCondition" => read_value_condition(inner.single()?)?,
            _ => read_entity_condition(inner, entities, count)?,
        };
        // The range of the standard is [0..inf[ (ASAM OpenSCENARIO XML 1.3.1, class Condition).
        let delay_s = node.optional_non_negative("delay")?.unwrap_or(0.0);
        count.add_delay_s(node, delay_s)?;
        Ok(Self {
            node,
            kind,
            edge,
            delay_s,
            before: None,
            pending_s: Default::default(),
        })
    }

    /// Returns a time in the step at which the condition is true, and whether it depends on a controller.
    fn evaluate(
        &mut self,
        state: &Replay<'_, '_>,
        before_s: f64,
        now_s: f64,
    ) -> Result<(Option<f64>, bool)> {
        let (margin, since_s, depends) = self.observe(state, now_s)?;
        let before = self.before.replace(margin);
        let (was, is) = (before.is_some_and(|before| before > 0.0), margin > 0.0);
        let crossed_s = || {
            let share = before.map_or(f64::NAN, |before| before / (before - margin));
            let found_s = if share.is_finite() {
                before_s + share * (now_s - before_s)
            } else {
                now_s
            };
            since_s.map_or(found_s, |since_s| since_s.max(before_s))
        };
        let true_s = match self.edge {
            ConditionEdge::None if is && was => Some(before_s),
            ConditionEdge::Rising if before.is_none() && is => {
                return Err(self
                    .node
                    .refuse("is true from the start, so that it never becomes true"));
            }
            ConditionEdge::None | ConditionEdge::Rising if is && !was => Some(crossed_s()),
            ConditionEdge::Falling if was && !is => Some(crossed_s()),
            _ => None,
        };
        self.pending_s
            .extend(true_s.map(|true_s| true_s + self.delay_s));
        let mut found = None;
        while let Some(due_s) = self.pending_s.pop_front_if(|due_s| *due_s <= now_s + 1e-9) {
            found = found.or(Some(due_s));
        }
        Ok((found, depends))
    }

    /// Returns a number that is positive if the condition holds, the time since which it holds, if that is known
    /// exactly, and whether it depends on a controller.
    fn observe(&self, state: &Replay<'_, '_>, now_s: f64) -> Result<(f64, Option<f64>, bool)> {
        match &self.kind {
            ConditionKind::Time(threshold) => {
                Ok((threshold.margin(now_s), Some(threshold.value), false))
            }
            ConditionKind::Element { kind, name, is_end } => {
                let missing = || {
                    self.node
                        .refuse(format!("there is no {kind} `{name}` in the stories"))
                };
                let (times_s, depends) = state.element_times_s(kind, name).ok_or_else(missing)?;
                let at_s = times_s[usize::from(*is_end)];
                Ok((
                    if at_s.is_some_and(|at_s| at_s <= now_s) {
                        1.0
                    } else {
                        -1.0
                    },
                    at_s,
                    depends,
                ))
            }
            ConditionKind::Entity {
                who,
                needs_all,
                quantity,
                threshold,
            } => {
                let margins = who
                    .iter()
                    .map(|one| threshold.margin(quantity.value(state, *one, now_s)));
                let margin = margins
                    .reduce(if *needs_all { f64::min } else { f64::max })
                    .unwrap_or(-1.0);
                let depends = who
                    .iter()
                    .copied()
                    .chain(quantity.to)
                    .any(|entity| state.is_controlled(entity));
                Ok((margin, None, depends))
            }
        }
    }
}

fn read_value_condition(node: Node<'_>) -> Result<ConditionKind> {
    match node.name() {
        "SimulationTimeCondition" => {
            node.only(&[], &["value", "rule"])?;
            let threshold = ConditionThreshold::read(node)?;
            if threshold.is_lower {
                Ok(ConditionKind::Time(threshold))
            } else {
                Err(node.refuse("must wait for a later time"))
            }
        }
        "StoryboardElementStateCondition" => {
            node.only(
                &[],
                &["storyboardElementType", "storyboardElementRef", "state"],
            )?;
            let is_end = match node.text("state")?.as_str() {
                "startTransition" | "runningState" => false,
                "endTransition" | "completeState" => true,
                other => return Err(node.refuse(format!("the state `{other}` is not supported"))),
            };
            // A reference may be qualified by the names of the elements around.
            let name = node.text("storyboardElementRef")?;
            let name = name.rsplit("::").next().unwrap_or_default().to_owned();
            Ok(ConditionKind::Element {
                kind: node.text("storyboardElementType")?,
                name,
                is_end,
            })
        }
        _ => Err(node.refuse("is not supported as a condition")),
    }
}

fn read_entity_condition(
    node: Node<'_>,
    entities: &[Entity<'_>],
    count: &mut ConditionCount,
) -> Result<ConditionKind> {
    node.only(&["TriggeringEntities", "EntityCondition"], &[])?;
    let triggering = node.child("TriggeringEntities")?;
    triggering.only(&["EntityRef"], &["triggeringEntitiesRule"])?;
    triggering.expect("triggeringEntitiesRule", &["any", "all"])?;
    count.add_entities(triggering, triggering.children().count())?;
    let needs_all = triggering.text("triggeringEntitiesRule")? == "all";
    let who = triggering
        .children()
        .map(|one| entity_index(one, "entityRef", entities))
        .collect::<Result<Vec<_>>>()?;
    let condition = node.child("EntityCondition")?.single()?;
    let (kind, attributes) = match condition.name() {
        "SpeedCondition" => (QuantityKind::Speed, &["value", "rule"][..]),
        "RelativeSpeedCondition" => (QuantityKind::Speed, &["entityRef", "value", "rule"][..]),
        "RelativeDistanceCondition" => (QuantityKind::Distance, &DISTANCE_ATTRIBUTES[..]),
        "TimeHeadwayCondition" => (QuantityKind::Headway, &DISTANCE_ATTRIBUTES[..]),
        "TimeToCollisionCondition" => (QuantityKind::TimeToCollision, &DISTANCE_ATTRIBUTES[..]),
        _ => return Err(condition.refuse("is not supported as a condition")),
    };
    let is_collision = condition.name() == "TimeToCollisionCondition";
    condition.only(
        if is_collision {
            &["TimeToCollisionConditionTarget"]
        } else {
            &[]
        },
        attributes,
    )?;
    condition.expect("relativeDistanceType", &["longitudinal"])?;
    condition.expect("coordinateSystem", &["entity", "lane", "road"])?;
    let is_free = condition.flag("freespace", false)?;
    let to = match condition.name() {
        "SpeedCondition" => None,
        _ if is_collision => Some(
            condition
                .child("TimeToCollisionConditionTarget")?
                .single()?,
        ),
        _ => Some(condition),
    };
    let to = to
        .map(|node| entity_index(node, "entityRef", entities))
        .transpose()?;
    if !matches!(kind, QuantityKind::Speed) {
        condition.non_negative("value")?;
    }
    let quantity = EntityQuantity { kind, to, is_free };
    Ok(ConditionKind::Entity {
        who,
        needs_all,
        quantity,
        threshold: ConditionThreshold::read(condition)?,
    })
}

impl EntityQuantity {
    fn value(self, state: &Replay<'_, '_>, who: usize, now_s: f64) -> f64 {
        let own_mps = state.speed_mps(who, now_s);
        let Some(to) = self.to else { return own_mps };
        let ahead_m = state.position_m(to, now_s) - state.position_m(who, now_s);
        let faster_mps = own_mps - state.speed_mps(to, now_s);
        let (front, rear, closing_mps) = if ahead_m >= 0.0 {
            (to, who, faster_mps)
        } else {
            (who, to, -faster_mps)
        };
        let bodies_m = state.bumpers_m(rear)[0] + state.bumpers_m(front)[1];
        let gap_m = if self.is_free {
            (ahead_m.abs() - bodies_m).max(0.0)
        } else {
            ahead_m.abs()
        };
        match self.kind {
            QuantityKind::Speed => faster_mps,
            QuantityKind::Distance => gap_m,
            QuantityKind::Headway => gap_m / own_mps,
            QuantityKind::TimeToCollision if closing_mps > 0.0 => gap_m / closing_mps,
            QuantityKind::TimeToCollision => f64::INFINITY,
        }
    }
}
