//! Stories: their elements with triggers, and the actions of events.

use std::collections::HashMap;
use std::rc::Rc;

use super::constructs::{KnownAction, find_action};
use super::element::StoryElement;
use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::{
    ConditionCount, MAX_ENTITIES, MAX_EVENT_ACTIONS, MAX_EVENTS, MAX_EXECUTIONS, ensure_at_most,
};
use super::path_actions::{LaneChangeAction, LaneOffsetAction};
use super::scopes::StoryScopes;
use super::speed_plan::TransitionDynamics;
use super::trajectory_action::TrajectoryAction;
use super::trigger::Trigger;
use super::variables::VariableChange;
use super::vocabulary::{ElementKind, FOLLOW_MODE, POSITION_MODE, Priority, Word as _};
use super::xml::Node;
use crumple_core::digits::format_number;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Elements of the stories, each after the element around it.
pub(super) struct Stories<'a> {
    pub(super) elements: Vec<StoryElement<'a>>,
    /// Conditions of all triggers.
    pub(super) conditions: ConditionCount,
    /// Actions without influence on the motion.
    pub(super) notes: Vec<String>,
}

/// An action of an entity, or of none.
pub(super) enum StoryAction<'a> {
    Speed(SpeedAction<'a>),
    SpeedProfile(SpeedProfileAction<'a>),
    LaneChange(LaneChangeAction<'a>),
    LaneOffset(LaneOffsetAction<'a>),
    Trajectory(TrajectoryAction<'a>),
    Route(Node<'a>),
    Activate,
    Variable(VariableChange),
    /// No influence on the motion, for a reason.
    Ignored(&'static str),
}

impl<'a> StoryAction<'a> {
    /// Returns the element of an action that has one of its own.
    pub(super) fn node(&self) -> Option<Node<'a>> {
        match self {
            Self::Speed(speed) => Some(speed.node),
            Self::LaneChange(change) => Some(change.node),
            Self::LaneOffset(offset) => Some(offset.node),
            Self::Trajectory(trajectory) => Some(trajectory.node),
            Self::Route(node) => Some(*node),
            Self::SpeedProfile(_) | Self::Activate | Self::Variable(_) | Self::Ignored(_) => None,
        }
    }
}

/// Speeds at times, linear between them.
pub(super) struct SpeedProfileAction<'a> {
    pub(super) node: Node<'a>,
    /// Times after the previous entry, in seconds, and speeds in m/s.
    pub(super) entries: Vec<(f64, f64)>,
    /// True for the following mode `follow`.
    pub(super) is_loose: bool,
}

#[derive(Clone, Copy)]
pub(super) struct SpeedAction<'a> {
    pub(super) node: Node<'a>,
    pub(super) dynamics: TransitionDynamics,
    pub(super) target: SpeedTarget,
}

/// A speed: that of an entity times a factor, plus an offset.
#[derive(Clone, Copy)]
pub(super) struct SpeedTarget {
    pub(super) reference: Option<usize>,
    /// True if the target follows the reference for ever.
    pub(super) is_continuous: bool,
    factor: f64,
    offset_mps: f64,
}

impl SpeedTarget {
    fn read(node: Node<'_>, entities: &[Entity<'_>]) -> Result<Self> {
        match node.name() {
            "AbsoluteTargetSpeed" => {
                node.only(&[], &["value"])?;
                Ok(Self {
                    reference: None,
                    is_continuous: false,
                    factor: 0.0,
                    offset_mps: node.non_negative("value")?,
                })
            }
            "RelativeTargetSpeed" => Self::read_relative(node, entities),
            _ => Err(node.refuse("is not supported as a target speed")),
        }
    }

    fn read_relative(node: Node<'_>, entities: &[Entity<'_>]) -> Result<Self> {
        node.only(
            &[],
            &["entityRef", "value", "speedTargetValueType", "continuous"],
        )?;
        let is_continuous = node.flag("continuous", false)?;
        let reference = Some(entity_index(node, "entityRef", entities)?);
        let value = node.number("value")?;
        match node.text("speedTargetValueType")?.as_str() {
            "delta" => Ok(Self {
                reference,
                is_continuous,
                factor: 1.0,
                offset_mps: value,
            }),
            "factor" => Ok(Self {
                reference,
                is_continuous,
                factor: value,
                offset_mps: 0.0,
            }),
            other => Err(node.refuse(format!("`{other}` is not supported"))),
        }
    }

    pub(super) fn speed_mps(self, node: Node<'_>, reference_mps: f64) -> Result<f64> {
        let mps = self.factor * reference_mps + self.offset_mps;
        if mps < 0.0 {
            Err(node.refuse(format!("the speed would be {} m/s", format_number(mps))))
        } else {
            Ok(mps)
        }
    }
}

pub(super) fn entity_index(
    node: Node<'_>,
    attribute: &str,
    entities: &[Entity<'_>],
) -> Result<usize> {
    let name = node.text(attribute)?;
    let index = entities.iter().position(|entity| entity.name == name);
    index.ok_or_else(|| {
        node.refuse(format!(
            "there is no entity `{name}`, and selections of entities are not supported"
        ))
    })
}

/// Reads the elements of all stories with their triggers.
pub(super) fn read_stories<'a>(
    storyboard: Node<'a>,
    entities: &[Entity<'_>],
    scopes: &'a StoryScopes,
) -> Result<Stories<'a>> {
    let mut reader = StoryReader {
        entities,
        scopes,
        stories: Stories {
            elements: Vec::new(),
            conditions: ConditionCount::default(),
            notes: Vec::new(),
        },
        counts: HashMap::new(),
        actions: 0,
    };
    for story in storyboard.named("Story") {
        reader.read_story(storyboard, scopes.enter(story))?;
    }
    let mut stories = reader.stories;
    resolve_references(&mut stories.elements)?;
    Ok(stories)
}

/// Resolves the references of conditions to elements.
fn resolve_references(elements: &mut [StoryElement<'_>]) -> Result<()> {
    let mut triggers: Vec<_> = elements
        .iter_mut()
        .map(|element| [element.start.take(), element.stop.take()])
        .collect();
    let names = ElementNames::new(elements);
    for trigger in triggers.iter_mut().flatten().flatten() {
        trigger.resolve(&names)?;
    }
    for (element, [start, stop]) in elements.iter_mut().zip(triggers) {
        (element.start, element.stop) = (start, stop);
    }
    Ok(())
}

/// Resolves the references of a trigger to elements.
pub(super) fn resolve_trigger(
    trigger: &mut Trigger<'_>,
    elements: &[StoryElement<'_>],
) -> Result<()> {
    trigger.resolve(&ElementNames::new(elements))
}

/// Elements by their kind and name.
pub(super) struct ElementNames<'e, 'a> {
    elements: &'e [StoryElement<'a>],
    indices: HashMap<(&'static str, &'e str), Vec<usize>>,
}

impl<'e, 'a> ElementNames<'e, 'a> {
    pub(super) fn new(elements: &'e [StoryElement<'a>]) -> Self {
        let mut indices: HashMap<_, Vec<usize>> = HashMap::new();
        for (index, element) in elements.iter().enumerate() {
            let key = (element.kind.name(), element.name.as_str());
            indices.entry(key).or_default().push(index);
        }
        Self { elements, indices }
    }

    /// Returns the element to which a reference refers. Its last part is the name, and the parts before it, separated
    /// by `::`, are the names of the elements around.
    pub(super) fn find(&self, node: Node<'_>, kind: ElementKind, reference: &str) -> Result<usize> {
        let name = reference.rsplit("::").next().unwrap_or_default();
        let candidates = self.indices.get(&(kind.name(), name));
        let mut matching = candidates
            .into_iter()
            .flatten()
            .filter(|index| self.matches(**index, reference));
        match (matching.next(), matching.next()) {
            (Some(index), None) => Ok(*index),
            (None, _) => {
                let kind = kind.name();
                Err(node.refuse(format!("there is no {kind} `{reference}` in the stories")))
            }
            (Some(_), Some(_)) => Err(node.refuse(format!(
                "there are several elements `{reference}` of the kind {}: add the names of the elements around, \
                 separated by `::`",
                kind.name()
            ))),
        }
    }

    fn matches(&self, index: usize, reference: &str) -> bool {
        let mut element = self.elements.get(index);
        reference.rsplit("::").all(|part| {
            let matches = element.is_some_and(|element| element.name == part);
            element = element
                .and_then(|element| element.parent)
                .and_then(|parent| self.elements.get(parent));
            matches
        })
    }
}

struct StoryReader<'a, 'b, 'c> {
    entities: &'b [Entity<'c>],
    scopes: &'a StoryScopes,
    stories: Stories<'a>,
    /// Number of elements of each kind.
    counts: HashMap<&'static str, usize>,
    /// Number of actions, each counted for each entity that does it.
    actions: usize,
}

impl<'a> StoryReader<'a, '_, '_> {
    /// Adds an element, and returns its index.
    fn add(
        &mut self,
        around: Node<'a>,
        parent: Option<usize>,
        mut element: StoryElement<'a>,
    ) -> Result<usize> {
        let index = self.stories.elements.len();
        let count = self.counts.entry(element.kind.name()).or_default();
        *count += 1;
        if element.kind != ElementKind::Action {
            let what = match element.kind {
                ElementKind::Story => "stories",
                ElementKind::Act => "acts",
                ElementKind::ManeuverGroup => "maneuver groups, with those before it",
                ElementKind::Maneuver => "maneuvers, with those before it",
                _ => "events, with those before it",
            };
            ensure_at_most(around, *count, MAX_EVENTS, what)?;
        }
        element.parent = parent;
        if let Some(parent) = parent.and_then(|parent| self.stories.elements.get_mut(parent)) {
            parent.children.push(index);
        }
        self.stories.elements.push(element);
        Ok(index)
    }

    fn read_trigger(&mut self, holder: Node<'a>, name: &'a str) -> Result<Option<Trigger<'a>>> {
        let Some(node) = holder.optional(name) else {
            return Ok(None);
        };
        let conditions = &mut self.stories.conditions;
        Trigger::read(node, self.entities, conditions)
    }

    fn read_story(&mut self, storyboard: Node<'a>, story: Node<'a>) -> Result<()> {
        story.only(&["Act", "ParameterDeclarations"], &["name"])?;
        let element = StoryElement::new(story, ElementKind::Story, name_of(story)?);
        let index = self.add(storyboard, None, element)?;
        for act in story.named("Act") {
            self.read_act(storyboard, index, act)?;
        }
        Ok(())
    }

    fn read_act(&mut self, storyboard: Node<'a>, story: usize, act: Node<'a>) -> Result<()> {
        act.only(&["ManeuverGroup", "StartTrigger", "StopTrigger"], &["name"])?;
        let mut element = StoryElement::new(act, ElementKind::Act, name_of(act)?);
        element.start = self.read_trigger(act, "StartTrigger")?;
        element.stop = self.read_trigger(act, "StopTrigger")?;
        let index = self.add(storyboard, Some(story), element)?;
        for group in act.named("ManeuverGroup") {
            self.read_group(act, index, group)?;
        }
        Ok(())
    }

    fn read_group(&mut self, around: Node<'a>, act: usize, node: Node<'a>) -> Result<()> {
        node.only(
            &["Actors", "Maneuver", "CatalogReference"],
            &["name", "maximumExecutionCount"],
        )?;
        let mut element = StoryElement::new(node, ElementKind::ManeuverGroup, name_of(node)?);
        element.max_executions = max_executions(node)?;
        let group = ManeuverGroup::read(node, self.entities)?;
        let index = self.add(around, Some(act), element)?;
        for child in node.children() {
            let Some(maneuver) = self.scopes.maneuver(child)? else {
                continue;
            };
            maneuver.only(&["Event", "ParameterDeclarations"], &["name"])?;
            let element = StoryElement::new(maneuver, ElementKind::Maneuver, name_of(maneuver)?);
            let parent = self.add(node, Some(index), element)?;
            for event in maneuver.named("Event") {
                self.read_event(&group, parent, event)?;
            }
        }
        Ok(())
    }

    fn read_event(
        &mut self,
        group: &ManeuverGroup<'a>,
        maneuver: usize,
        node: Node<'a>,
    ) -> Result<()> {
        node.only(
            &["Action", "StartTrigger"],
            &["name", "priority", "maximumExecutionCount"],
        )?;
        let mut element = StoryElement::new(node, ElementKind::Event, name_of(node)?);
        element.max_executions = max_executions(node)?;
        let priority = node.optional_word("priority")?;
        element.priority = priority.unwrap_or(Priority::Parallel);
        element.start = self.read_trigger(node, "StartTrigger")?;
        element.actors = group.actors.clone();
        let index = self.add(group.node, Some(maneuver), element)?;
        self.count_actions(group, node)?;
        for action in node.named("Action") {
            self.read_event_action(group, index, action)?;
        }
        Ok(())
    }

    /// Refuses more actions than the limit.
    fn count_actions(&mut self, group: &ManeuverGroup<'a>, event: Node<'a>) -> Result<()> {
        self.actions += group.actors.len().max(1) * event.named("Action").count().max(1);
        let what = "actions of events, each counted for each of its entities";
        ensure_at_most(event, self.actions, MAX_EVENT_ACTIONS, what)
    }

    fn read_event_action(
        &mut self,
        group: &ManeuverGroup<'a>,
        event: usize,
        node: Node<'a>,
    ) -> Result<()> {
        node.only(
            &["PrivateAction", "GlobalAction", "UserDefinedAction"],
            &["name"],
        )?;
        let holder = node.single()?;
        let mut element = StoryElement::new(node, ElementKind::Action, name_of(node)?);
        let KnownAction { action, domains } = find_action(holder, self.entities)?;
        element.domains = domains;
        if holder.name() == "PrivateAction" {
            if group.actors.is_empty() {
                let problem = "names no entity for the actions of the events";
                return Err(group.actor_list.refuse(problem));
            }
            element.actors = group.actors.clone();
        }
        if let StoryAction::Ignored(reason) = action {
            let inner = holder.children().next().unwrap_or(holder);
            self.stories.notes.push(inner.note(reason));
        }
        element.action = Some(Rc::new(action));
        self.add(node, Some(event), element)?;
        Ok(())
    }
}

/// Returns the name of an element; files of some tools have elements without names.
fn name_of(node: Node<'_>) -> Result<String> {
    Ok(node.optional_text("name")?.unwrap_or_default())
}

fn max_executions(node: Node<'_>) -> Result<u32> {
    match node.optional_number("maximumExecutionCount")? {
        None => Ok(1),
        Some(count) if (1.0..=MAX_EXECUTIONS).contains(&count) && count.fract() == 0.0 => {
            Ok(count as u32)
        }
        Some(count) => Err(node.refuse(format!(
            "attribute `maximumExecutionCount`: {} is not a whole number from 1 to {MAX_EXECUTIONS}",
            format_number(count)
        ))),
    }
}

/// The actors of a maneuver group.
struct ManeuverGroup<'a> {
    node: Node<'a>,
    /// Element that names the actors.
    actor_list: Node<'a>,
    actors: Rc<[usize]>,
}

impl<'a> ManeuverGroup<'a> {
    fn read(node: Node<'a>, entities: &[Entity<'_>]) -> Result<Self> {
        let list = node.child("Actors")?;
        list.only(&["EntityRef"], &["selectTriggeringEntities"])?;
        if list.flag("selectTriggeringEntities", false)? {
            return Err(list.refuse("triggering entities as actors are not supported"));
        }
        ensure_at_most(list, list.children().count(), MAX_ENTITIES, "entities")?;
        let actors: Vec<usize> = list
            .children()
            .map(|actor| entity_index(actor, "entityRef", entities))
            .collect::<Result<_>>()?;
        Ok(Self {
            node,
            actor_list: list,
            actors: actors.into(),
        })
    }
}

/// Reads an activation of a controller.
pub(super) fn read_activation<'a>(
    node: Node<'a>,
    _entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    node.only(
        &[],
        &[
            "longitudinal",
            "lateral",
            "animation",
            "lighting",
            "controllerRef",
            "objectControllerRef",
        ],
    )?;
    // Without the attribute, the control of the speed does not change (class `ActivateControllerAction`).
    if node.raw("longitudinal").is_none() {
        return Ok(StoryAction::Ignored(
            "does not change the control of the speed",
        ));
    }
    match node.flag("longitudinal", true)? {
        true => Ok(StoryAction::Activate),
        false => Ok(StoryAction::Ignored(
            "does not end the control of the speed: a controller drives to the end",
        )),
    }
}

/// Reads a group of actions on a controller.
pub(super) fn read_controller_action<'a>(
    action: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    action.only(
        &[
            "AssignControllerAction",
            "ActivateControllerAction",
            "OverrideControllerValueAction",
        ],
        &[],
    )?;
    match action.optional("ActivateControllerAction") {
        Some(activate) => read_activation(activate, entities),
        None => Ok(StoryAction::Ignored(
            "has no influence: `Entities` or --ego states the vehicle under test",
        )),
    }
}

/// Reads a speed action of an event.
pub(super) fn read_speed_action<'a>(
    node: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    read_speed(node, entities).map(StoryAction::Speed)
}

pub(super) fn read_speed<'a>(node: Node<'a>, entities: &[Entity<'_>]) -> Result<SpeedAction<'a>> {
    node.only(&["SpeedActionDynamics", "SpeedActionTarget"], &[])?;
    Ok(SpeedAction {
        node,
        dynamics: TransitionDynamics::read(node.child("SpeedActionDynamics")?)?,
        target: SpeedTarget::read(node.child("SpeedActionTarget")?.single()?, entities)?,
    })
}

pub(super) fn read_profile<'a>(
    node: Node<'a>,
    _entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    node.only(
        &["SpeedProfileEntry", "DynamicConstraints"],
        &["followingMode", "entityRef"],
    )?;
    if node.raw("entityRef").is_some() {
        return Err(node.refuse("speeds relative to an entity are not supported"));
    }
    let is_loose = has_follow_mode(node)?;
    let entries = node.named("SpeedProfileEntry").map(|entry| {
        entry.only(&[], &["time", "speed"])?;
        Ok((entry.non_negative("time")?, entry.non_negative("speed")?))
    });
    Ok(StoryAction::SpeedProfile(SpeedProfileAction {
        node,
        entries: entries.collect::<Result<_>>()?,
        is_loose,
    }))
}

/// Returns whether the following mode of an element is `follow`, which leaves open how the entity moves.
pub(super) fn has_follow_mode(node: Node<'_>) -> Result<bool> {
    node.expect("followingMode", &[POSITION_MODE, FOLLOW_MODE])?;
    let mode = node.optional_text("followingMode")?;
    Ok(mode.as_deref() == Some(FOLLOW_MODE))
}
