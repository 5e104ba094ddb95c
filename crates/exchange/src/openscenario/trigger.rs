//! Triggers: groups of conditions, evaluated at the steps of a replay (7.6).

use std::collections::VecDeque;

use super::constructs::find_condition;
use super::element::Awaited;
use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::ConditionCount;
use super::quantity::EntityCondition;
use super::replay::{REPLAY_STEP_S, Replay};
use super::storyboard::{ElementNames, entity_index};
use super::variables::ValueCondition;
use super::vocabulary::{AwaitedState, ConditionEdge, ElementKind, Rule};
use super::xml::Node;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Largest difference of values that count as equal.
const EQUAL: f64 = 1e-6;

/// A trigger: true if all conditions of a group are true.
pub(super) struct Trigger<'a> {
    groups: Vec<Vec<Condition<'a>>>,
}

/// Time at which a trigger fires.
#[derive(Debug, Clone, Copy)]
pub(super) struct Firing {
    pub(super) time_s: f64,
    /// True if the time depends on the motion of an entity with a controller.
    pub(super) depends_on_controller: bool,
}

struct Condition<'a> {
    node: Node<'a>,
    kind: ConditionKind<'a>,
    /// Entities of a condition on entities.
    entities: Vec<usize>,
    needs_all: bool,
    edge: ConditionEdge,
    delay_s: f64,
    /// Margin at the step before; positive if the condition held.
    margin_before: Option<f64>,
    /// Number of the last transition before the last evaluation.
    seen_serial: Option<u64>,
    /// Times from which the condition is true, delay included, and until which.
    pending_s: VecDeque<f64>,
}

/// Comparison of a condition.
pub(super) enum ConditionKind<'a> {
    Time(ConditionThreshold),
    Element(ElementCondition),
    Value(ValueCondition),
    Entity(EntityCondition<'a>),
    /// Never true in a replay.
    Never,
}

/// A condition on the state of an element.
pub(super) struct ElementCondition {
    kind: ElementKind,
    reference: String,
    awaited: Awaited,
    /// Index of the element.
    element: usize,
}

/// Threshold of a condition.
#[derive(Debug, Clone, Copy)]
pub(super) struct ConditionThreshold {
    value: f64,
    rule: Rule,
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
    pub(super) fn new(rule: Rule, value: f64) -> Self {
        Self { value, rule }
    }

    pub(super) fn read(node: Node<'_>) -> Result<Self> {
        Ok(Self::new(node.word("rule")?, node.number("value")?))
    }

    /// Returns a number that is positive if the condition holds.
    fn margin(self, value: f64) -> f64 {
        let margin = match self.rule {
            Rule::GreaterThan | Rule::GreaterOrEqual => value - self.value,
            Rule::LessThan | Rule::LessOrEqual => self.value - value,
            Rule::EqualTo => EQUAL - (value - self.value).abs(),
            Rule::NotEqualTo => (value - self.value).abs() - EQUAL,
        };
        // Conditions hold at positive margins.
        if margin == 0.0 && matches!(self.rule, Rule::GreaterOrEqual | Rule::LessOrEqual) {
            f64::MIN_POSITIVE
        } else {
            margin
        }
    }

    /// Returns the share of a step after which a continuous value passes through the threshold of `equalTo`.
    pub(super) fn passing_share(self, before: f64, value: f64) -> Option<f64> {
        let [before, after] = [before - self.value, value - self.value];
        let passes = before * after < 0.0 && before.abs().min(after.abs()) > EQUAL;
        let share = before / (before - after);
        (self.rule == Rule::EqualTo && passes && share.is_finite()).then_some(share)
    }

    /// Returns the state of a condition on the time. A step may pass through the time of `equalTo`.
    fn time_state(self, now_s: f64, is_first: bool) -> ConditionState {
        let passes = !is_first && self.passing_share(now_s - REPLAY_STEP_S, now_s).is_some();
        ConditionState {
            margin: if passes { EQUAL } else { self.margin(now_s) },
            since_s: self.since_s().or(passes.then_some(self.value)),
            depends_on_controller: false,
        }
    }

    /// Returns the time from which a condition on the time holds.
    fn since_s(self) -> Option<f64> {
        matches!(self.rule, Rule::GreaterThan | Rule::GreaterOrEqual).then_some(self.value)
    }
}

impl<'a> Trigger<'a> {
    /// Reads a trigger; `None` for one without conditions.
    pub(super) fn read(
        node: Node<'a>,
        entities: &[Entity<'_>],
        count: &mut ConditionCount,
    ) -> Result<Option<Self>> {
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
        Ok((!groups.is_empty()).then_some(Self { groups }))
    }

    /// Resolves references to elements.
    pub(super) fn resolve(&mut self, names: &ElementNames<'_, '_>) -> Result<()> {
        for condition in self.groups.iter_mut().flatten() {
            if let ConditionKind::Element(awaited) = &mut condition.kind {
                let node = condition.node;
                awaited.element = names.find(node, awaited.kind, &awaited.reference)?;
            }
        }
        Ok(())
    }

    /// Returns a time at which the trigger has fired; infinite if that depends on more than the time.
    pub(super) fn latest_s(&self) -> f64 {
        let groups = self.groups.iter().map(|group| {
            let times = group.iter().map(Condition::latest_s);
            times.fold(0.0, f64::max)
        });
        groups.fold(f64::INFINITY, f64::min)
    }

    /// Forgets earlier evaluations.
    pub(super) fn reset(&mut self) {
        for condition in self.groups.iter_mut().flatten() {
            condition.margin_before = None;
            condition.seen_serial = None;
            condition.pending_s.clear();
        }
    }

    /// Returns the work of one evaluation, if finding the state of an entity takes `state_work`.
    pub(super) fn work(&self, state_work: u64) -> u64 {
        let groups = self.groups.iter();
        2 + groups
            .map(|group| {
                let conditions = group.iter();
                2 + conditions
                    .map(|condition| condition.work(state_work))
                    .sum::<u64>()
            })
            .sum::<u64>()
    }

    /// Returns the time at which the trigger fired in the step from `before_s` to `now_s`. Its element waits since
    /// `armed_s`.
    pub(super) fn fires(
        &mut self,
        replay: &Replay<'_, '_>,
        [armed_s, before_s, now_s]: [f64; 3],
    ) -> Result<Option<Firing>> {
        let mut first: Option<Firing> = None;
        for group in &mut self.groups {
            let mut fired_s = Some(before_s.max(armed_s));
            let mut depends_on_controller = false;
            for condition in group {
                let state = condition.state(replay, now_s)?;
                let true_s = condition.evaluate(&state, [armed_s, before_s, now_s]);
                fired_s = fired_s.zip(true_s).map(|(a, b)| a.max(b));
                depends_on_controller |= state.depends_on_controller;
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
        let edge = node.word("conditionEdge")?;
        // The range of the standard is [0..inf[ (ASAM OpenSCENARIO XML 1.3.1, class Condition).
        let delay_s = node.optional_non_negative("delay")?.unwrap_or(0.0);
        count.add_delay_s(node, delay_s)?;
        let holder = node.single()?;
        let mut condition = Self {
            node,
            kind: ConditionKind::Never,
            entities: Vec::new(),
            needs_all: false,
            edge,
            delay_s,
            margin_before: None,
            seen_serial: None,
            pending_s: VecDeque::new(),
        };
        let inner = if holder.name() == "ByEntityCondition" {
            holder.only(&["TriggeringEntities", "EntityCondition"], &[])?;
            condition.read_entities(holder.child("TriggeringEntities")?, entities, count)?;
            holder.child("EntityCondition")?.single()?
        } else {
            holder.single()?
        };
        condition.kind = find_condition(inner, entities)?;
        Ok(condition)
    }

    fn read_entities(
        &mut self,
        triggering: Node<'_>,
        entities: &[Entity<'_>],
        count: &mut ConditionCount,
    ) -> Result<()> {
        triggering.only(&["EntityRef"], &["triggeringEntitiesRule"])?;
        triggering.expect("triggeringEntitiesRule", &["any", "all"])?;
        count.add_entities(triggering, triggering.children().count())?;
        self.needs_all = triggering.text("triggeringEntitiesRule")? == "all";
        self.entities = triggering
            .children()
            .map(|entity| entity_index(entity, "entityRef", entities))
            .collect::<Result<Vec<_>>>()?;
        Ok(())
    }

    /// Returns the time from which the condition holds for ever; infinite if that depends on more than the time.
    fn latest_s(&self) -> f64 {
        let since_s = match (&self.kind, self.edge) {
            (ConditionKind::Time(threshold), ConditionEdge::None) => threshold.since_s(),
            _ => None,
        };
        since_s.map_or(f64::INFINITY, |since_s| since_s + self.delay_s)
    }

    /// Returns the work of one evaluation.
    fn work(&self, state_work: u64) -> u64 {
        let places = match &self.kind {
            ConditionKind::Entity(condition) => condition.quantity.places as u64,
            _ => 0,
        };
        5 + (8 + 4 * places) * state_work * self.entities.len() as u64
    }

    /// Returns a time at which the condition, with its edge and its delay, is true in the step from `before_s` to
    /// `now_s`.
    fn evaluate(
        &mut self,
        state: &ConditionState,
        [armed_s, before_s, now_s]: [f64; 3],
    ) -> Option<f64> {
        let margin_before = self.margin_before.replace(state.margin);
        let held_before = margin_before.is_some_and(|margin| margin > 0.0);
        let holds = state.margin > 0.0;
        // The first evaluation knows an earlier state only if the change has an exact time.
        let was_false = match margin_before {
            Some(margin) => margin <= 0.0,
            None => state
                .since_s
                .is_some_and(|since_s| since_s > before_s.max(armed_s)),
        };
        let [rises, falls] = [holds && was_false, held_before && !holds];
        let is_true = match self.edge {
            ConditionEdge::None => holds,
            ConditionEdge::Rising => rises,
            ConditionEdge::Falling => falls,
            ConditionEdge::RisingOrFalling => rises || falls,
        };
        if is_true {
            let has_held = held_before || margin_before.is_none() && state.since_s.is_none();
            let true_s = if holds && has_held {
                before_s
            } else {
                state.crossed_s(margin_before, before_s, now_s)
            };
            // The delay begins no earlier than the element waits.
            self.pending_s
                .push_back(true_s.max(armed_s.min(now_s)) + self.delay_s);
        }
        let mut first_due_s = None;
        while let Some(due_s) = self.pending_s.pop_front_if(|due_s| *due_s <= now_s + 1e-9) {
            first_due_s = first_due_s.or(Some(due_s));
        }
        first_due_s
    }

    /// Returns the state at the end of a step, without edge and delay.
    fn state(&mut self, replay: &Replay<'_, '_>, now_s: f64) -> Result<ConditionState> {
        let never = ConditionState {
            margin: -1.0,
            since_s: None,
            depends_on_controller: false,
        };
        match &mut self.kind {
            ConditionKind::Never => Ok(never),
            ConditionKind::Time(threshold) => {
                Ok(threshold.time_state(now_s, self.margin_before.is_none()))
            }
            ConditionKind::Value(condition) => Ok(ConditionState {
                margin: if replay.variables.holds(self.node, condition)? {
                    1.0
                } else {
                    -1.0
                },
                // The first evaluation does not know whether the value before fulfilled the condition.
                since_s: self
                    .margin_before
                    .and_then(|_| replay.variables.since_s(condition)),
                ..never
            }),
            ConditionKind::Element(awaited) => {
                let seen = self.seen_serial.replace(replay.serial());
                Ok(awaited.state(replay, seen.unwrap_or(replay.step_serial())))
            }
            ConditionKind::Entity(condition) => {
                if self.margin_before.is_none() {
                    condition.values_before.clear();
                }
                entity_state(replay, condition, &self.entities, self.needs_all, now_s)
            }
        }
    }
}

/// Returns the state of a condition on entities: of all of them, or of any.
fn entity_state(
    replay: &Replay<'_, '_>,
    condition: &mut EntityCondition<'_>,
    entities: &[usize],
    needs_all: bool,
    now_s: f64,
) -> Result<ConditionState> {
    let pick = if needs_all { f64::min } else { f64::max };
    let mut margins = Vec::with_capacity(entities.len());
    let mut since_s = Vec::new();
    for (index, entity) in entities.iter().enumerate() {
        let value = condition.value(replay, *entity, now_s)?;
        let passed_s = condition.passed_s(index, value, now_s);
        margins.push(match passed_s {
            Some(_) => EQUAL,
            None => condition.threshold.margin(value),
        });
        since_s.extend(passed_s.or_else(|| condition.quantity.since_s(replay, *entity, now_s)));
    }
    let since_s = since_s
        .into_iter()
        .reduce(if needs_all { f64::max } else { f64::min });
    let reference = condition.quantity.reference;
    let mut entities = entities.iter().copied().chain(reference);
    Ok(ConditionState {
        margin: margins.into_iter().reduce(pick).unwrap_or(-1.0),
        since_s,
        depends_on_controller: entities.any(|entity| replay.is_controlled(entity)),
    })
}

impl ElementCondition {
    /// Returns the state of the condition. A transition is visible in the evaluation after it, and no later.
    fn state(&self, replay: &Replay<'_, '_>, seen_serial: u64) -> ConditionState {
        let Some(element) = replay.elements.get(self.element) else {
            return ConditionState {
                margin: -1.0,
                since_s: None,
                depends_on_controller: false,
            };
        };
        let (holds, since_s) = match self.awaited {
            Awaited::State(state) => (element.state == state, Some(element.state_since_s)),
            Awaited::Transition(transition) => {
                let mark = element.mark(transition);
                let mark = mark.filter(|mark| mark.serial > seen_serial);
                (mark.is_some(), mark.map(|mark| mark.time_s))
            }
        };
        ConditionState {
            margin: if holds { 1.0 } else { -1.0 },
            since_s,
            depends_on_controller: element.depends_on_controller,
        }
    }
}

impl ConditionState {
    /// Returns the time in the step from `before_s` to `now_s` at which the condition begins or ends to hold.
    fn crossed_s(&self, margin_before: Option<f64>, before_s: f64, now_s: f64) -> f64 {
        if let Some(since_s) = self.since_s {
            return since_s.clamp(before_s, now_s);
        }
        let share = margin_before.map_or(f64::NAN, |before| before / (before - self.margin));
        if share.is_finite() {
            before_s + share * (now_s - before_s)
        } else {
            now_s
        }
    }
}

/// Reads `SimulationTimeCondition`.
pub(super) fn read_time<'a>(node: Node<'a>, _entities: &[Entity<'_>]) -> Result<ConditionKind<'a>> {
    node.only(&[], &["value", "rule"])?;
    Ok(ConditionKind::Time(ConditionThreshold::read(node)?))
}

/// Reads `StoryboardElementStateCondition`.
pub(super) fn read_element_state<'a>(
    node: Node<'a>,
    _entities: &[Entity<'_>],
) -> Result<ConditionKind<'a>> {
    node.only(
        &[],
        &["storyboardElementType", "storyboardElementRef", "state"],
    )?;
    Ok(ConditionKind::Element(ElementCondition {
        kind: node.word("storyboardElementType")?,
        reference: node.text("storyboardElementRef")?,
        awaited: node.word::<AwaitedState>("state")?.into(),
        element: usize::MAX,
    }))
}

/// Reads a condition that a replay cannot evaluate, because the run ends then, or the vehicle keeps to the road.
pub(super) fn read_never<'a>(
    _node: Node<'a>,
    _entities: &[Entity<'_>],
) -> Result<ConditionKind<'a>> {
    Ok(ConditionKind::Never)
}
