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

/// Start of an act or an event, or the end of the scenario.
#[derive(Debug, Clone, Copy)]
pub(super) struct Firing {
    pub(super) time_s: f64,
    /// True if the time depends on the motion of an entity with a controller.
    pub(super) depends_on_controller: bool,
}

struct Condition<'a> {
    node: Node<'a>,
    kind: ConditionKind,
    edge: ConditionEdge,
    delay_s: f64,
    /// Margin at the step before; positive if the condition held.
    margin_before: Option<f64>,
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
        entities: Vec<usize>,
        needs_all: bool,
        quantity: EntityQuantity,
        threshold: ConditionThreshold,
    },
}

/// A quantity of an entity, which may be relative to another entity.
#[derive(Clone, Copy)]
struct EntityQuantity {
    kind: QuantityKind,
    /// Entity to which the quantity is relative.
    reference: Option<usize>,
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

/// State of a condition at a time.
struct ConditionState {
    /// Positive if the condition holds.
    margin: f64,
    /// Time since which the condition holds, if that is known exactly.
    since_s: Option<f64>,
    depends_on_controller: bool,
}

impl ConditionThreshold {
    fn read(node: Node<'_>) -> Result<Self> {
        let rule = node.text("rule")?;
        if !["greaterThan", "greaterOrEqual", "lessThan", "lessOrEqual"].contains(&rule.as_str()) {
            return Err(node.refuse(format!("the rule `{rule}` is not supported")));
        }
        Ok(Self {
            value: node.number("value")?,
            is_lower: rule.starts_with("greater"),
            is_strict: rule.ends_with("Than"),
        })
    }

    fn margin(self, value: f64) -> f64 {
        let margin = if self.is_lower {
            value - self.value
        } else {
            self.value - value
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
        let groups = self.groups.iter().flatten();
        2 + groups
            .map(|group| {
                let conditions = group.iter();
                2 + conditions
                    .map(|condition| condition.work(elements, state_work))
                    .sum::<u64>()
            })
            .sum::<u64>()
    }

    /// Returns the time at which the trigger fired in the step from `before_s` to `now_s`.
    pub(super) fn fires(
        &mut self,
        state: &Replay<'_, '_>,
        before_s: f64,
        now_s: f64,
    ) -> Result<Option<Firing>> {
        let Some(groups) = &mut self.groups else {
            return Ok(Some(Firing {
                time_s: before_s,
                depends_on_controller: false,
            }));
        };
        let mut first: Option<Firing> = None;
        for group in groups {
            let mut fired_s = Some(before_s);
            let mut depends_on_controller = false;
            for condition in group {
                let state_now = condition.state(state, now_s)?;
                let true_s = condition.evaluate(&state_now, before_s, now_s)?;
                fired_s = fired_s.zip(true_s).map(|(a, b)| a.max(b));
                depends_on_controller |= state_now.depends_on_controller;
            }
            if let Some(time_s) = fired_s
                && first.is_none_or(|earlier| time_s < earlier.time_s)
            {
                first = Some(Firing {
                    time_s,
                    depends_on_controller,
                });
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
            margin_before: None,
            pending_s: Default::default(),
        })
    }

    /// Returns the work of one evaluation.
    fn work(&self, elements: u64, state_work: u64) -> u64 {
        match &self.kind {
            ConditionKind::Time(_) => 5,
            ConditionKind::Element { .. } => 5 + 4 * elements,
            ConditionKind::Entity { entities, .. } => 5 + 4 * state_work * entities.len() as u64,
        }
    }

    /// Returns a time at which the condition, with its edge and its delay, is true in the step from `before_s` to
    /// `now_s`.
    fn evaluate(
        &mut self,
        state: &ConditionState,
        before_s: f64,
        now_s: f64,
    ) -> Result<Option<f64>> {
        let margin_before = self.margin_before.replace(state.margin);
        let held_before = margin_before.is_some_and(|margin| margin > 0.0);
        let holds = state.margin > 0.0;
        let true_s = match self.edge {
            ConditionEdge::None if holds && held_before => Some(before_s),
            ConditionEdge::Rising if margin_before.is_none() && holds => {
                return Err(self
                    .node
                    .refuse("is true from the start, so that it never becomes true"));
            }
            ConditionEdge::None | ConditionEdge::Rising if holds && !held_before => {
                Some(state.crossed_s(margin_before, before_s, now_s))
            }
            ConditionEdge::Falling if held_before && !holds => {
                Some(state.crossed_s(margin_before, before_s, now_s))
            }
            _ => None,
        };
        self.pending_s
            .extend(true_s.map(|true_s| true_s + self.delay_s));
        let mut first_due_s = None;
        while let Some(due_s) = self.pending_s.pop_front_if(|due_s| *due_s <= now_s + 1e-9) {
            first_due_s = first_due_s.or(Some(due_s));
        }
        Ok(first_due_s)
    }

    /// Returns the state at the end of a step, without edge and delay.
    fn state(&self, replay: &Replay<'_, '_>, now_s: f64) -> Result<ConditionState> {
        match &self.kind {
            ConditionKind::Time(threshold) => Ok(ConditionState {
                margin: threshold.margin(now_s),
                since_s: Some(threshold.value),
                depends_on_controller: false,
            }),
            ConditionKind::Element { kind, name, is_end } => {
                let times = replay.element_times(kind, name).ok_or_else(|| {
                    self.node
                        .refuse(format!("there is no {kind} `{name}` in the stories"))
                })?;
                let since_s = if *is_end { times.end_s } else { times.start_s };
                let holds = since_s.is_some_and(|since_s| since_s <= now_s);
                Ok(ConditionState {
                    margin: if holds { 1.0 } else { -1.0 },
                    since_s,
                    depends_on_controller: times.depends_on_controller,
                })
            }
            ConditionKind::Entity {
                entities,
                needs_all,
                quantity,
                threshold,
            } => {
                let margins = entities
                    .iter()
                    .map(|entity| threshold.margin(quantity.value(replay, *entity, now_s)));
                let margin = margins.reduce(if *needs_all { f64::min } else { f64::max });
                let mut entities = entities.iter().copied().chain(quantity.reference);
                Ok(ConditionState {
                    margin: margin.unwrap_or(-1.0),
                    since_s: None,
                    depends_on_controller: entities.any(|entity| replay.is_controlled(entity)),
                })
            }
        }
    }
}

impl ConditionState {
    /// Returns the time in the step from `before_s` to `now_s` at which the condition begins or ends to hold.
    fn crossed_s(&self, margin_before: Option<f64>, before_s: f64, now_s: f64) -> f64 {
        if let Some(since_s) = self.since_s {
            return since_s.max(before_s);
        }
        let share = margin_before.map_or(f64::NAN, |before| before / (before - self.margin));
        if share.is_finite() {
            before_s + share * (now_s - before_s)
        } else {
            now_s
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
    let triggering_entities = triggering
        .children()
        .map(|entity| entity_index(entity, "entityRef", entities))
        .collect::<Result<Vec<_>>>()?;
    let condition = node.child("EntityCondition")?.single()?;
    Ok(ConditionKind::Entity {
        entities: triggering_entities,
        needs_all,
        quantity: EntityQuantity::read(condition, entities)?,
        threshold: ConditionThreshold::read(condition)?,
    })
}

impl EntityQuantity {
    /// Reads what a condition compares with its threshold.
    fn read(condition: Node<'_>, entities: &[Entity<'_>]) -> Result<Self> {
        let kind = match condition.name() {
            "SpeedCondition" | "RelativeSpeedCondition" => QuantityKind::Speed,
            "RelativeDistanceCondition" => QuantityKind::Distance,
            "TimeHeadwayCondition" => QuantityKind::Headway,
            "TimeToCollisionCondition" => QuantityKind::TimeToCollision,
            _ => return Err(condition.refuse("is not supported as a condition")),
        };
        let attributes = match condition.name() {
            "SpeedCondition" => &["value", "rule"][..],
            "RelativeSpeedCondition" => &["entityRef", "value", "rule"],
            _ => &DISTANCE_ATTRIBUTES,
        };
        let target = "TimeToCollisionConditionTarget";
        let has_target = matches!(kind, QuantityKind::TimeToCollision);
        let children = if has_target { &[target][..] } else { &[] };
        condition.only(children, attributes)?;
        condition.expect("relativeDistanceType", &["longitudinal"])?;
        condition.expect("coordinateSystem", &["entity", "lane", "road"])?;
        let is_free = condition.flag("freespace", false)?;
        let reference = match condition.name() {
            "SpeedCondition" => None,
            _ if has_target => Some(condition.child(target)?.single()?),
            _ => Some(condition),
        };
        let reference = reference
            .map(|node| entity_index(node, "entityRef", entities))
            .transpose()?;
        if !matches!(kind, QuantityKind::Speed) {
            condition.non_negative("value")?;
        }
        Ok(Self {
            kind,
            reference,
            is_free,
        })
    }

    fn value(self, replay: &Replay<'_, '_>, entity: usize, now_s: f64) -> f64 {
        let own_mps = replay.speed_mps(entity, now_s);
        let Some(reference) = self.reference else {
            return own_mps;
        };
        let ahead_m = replay.position_m(reference, now_s) - replay.position_m(entity, now_s);
        let faster_mps = own_mps - replay.speed_mps(reference, now_s);
        let is_behind = ahead_m >= 0.0;
        let [front, rear] = if is_behind {
            [reference, entity]
        } else {
            [entity, reference]
        };
        let closing_mps = if is_behind { faster_mps } else { -faster_mps };
        let bodies_m = replay.bumpers_m(rear)[0] + replay.bumpers_m(front)[1];
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
