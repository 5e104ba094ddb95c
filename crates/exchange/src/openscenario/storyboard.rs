//! Stories, events and actions of the storyboard.

use std::rc::Rc;

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::{ConditionCount, MAX_ENTITIES, MAX_EVENT_ACTIONS, MAX_EVENTS, ensure_at_most};
use super::path_actions::{LaneChangeAction, TrajectoryAction, read_lane_change, read_trajectory};
use super::speed_plan::TransitionDynamics;
use super::trigger::Trigger;
use super::xml::Node;
use crumple_core::digits::format_number;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Events of the stories, and what they wait for.
pub(super) struct Stories<'a> {
    pub(super) events: Vec<StoryEvent<'a>>,
    /// Start triggers of the events, in their order.
    pub(super) event_triggers: Vec<Trigger<'a>>,
    /// Start triggers of the acts.
    pub(super) act_triggers: Vec<Trigger<'a>>,
    /// Conditions of all triggers.
    pub(super) conditions: ConditionCount,
    /// Number of actions, each counted for each entity that does it.
    actions: usize,
}

/// An event, and when it happened in the replay.
#[derive(Clone)]
pub(super) struct StoryEvent<'a> {
    pub(super) node: Node<'a>,
    pub(super) name: String,
    /// Names of the story, act, maneuver group and maneuver around it.
    pub(super) parents: [String; 4],
    /// Index of the act in the file.
    pub(super) act: usize,
    pub(super) actors: Vec<usize>,
    pub(super) actions: Rc<[(String, StoryAction<'a>)]>,
    pub(super) start_s: Option<f64>,
    /// Ends of the actions, in their order.
    pub(super) action_ends_s: Vec<f64>,
    /// True if the start depends on a controller.
    pub(super) depends: bool,
}

impl StoryEvent<'_> {
    /// Returns the end of the event; `None` before its start.
    pub(super) fn end_s(&self) -> Option<f64> {
        self.start_s.map(|start_s| {
            self.action_ends_s
                .iter()
                .copied()
                .reduce(f64::max)
                .unwrap_or(start_s)
        })
    }
}

/// An action of an entity.
pub(super) enum StoryAction<'a> {
    Speed(SpeedAction<'a>),
    /// Times after the previous entry, in seconds, and speeds in m/s.
    SpeedProfile(Vec<(f64, f64)>),
    LaneChange(LaneChangeAction<'a>),
    Trajectory(TrajectoryAction<'a>),
    Activate,
}

impl StoryAction<'_> {
    pub(super) fn changes_speed(&self) -> bool {
        matches!(
            self,
            Self::Speed(_) | Self::SpeedProfile(_) | Self::Trajectory(_)
        )
    }
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
    factor: f64,
    offset_mps: f64,
}

impl SpeedTarget {
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
    let found = entities.iter().position(|entity| entity.name == name);
    found.ok_or_else(|| node.refuse(format!("there is no entity `{name}`")))
}

/// Reads all events with their triggers.
pub(super) fn read_stories<'a>(
    storyboard: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<Stories<'a>> {
    let mut stories = Stories {
        events: Vec::new(),
        event_triggers: Vec::new(),
        act_triggers: Vec::new(),
        conditions: ConditionCount::default(),
        actions: 0,
    };
    for story in storyboard.named("Story") {
        story.only(&["Act", "ParameterDeclarations"], &["name"])?;
        if let Some(declared) = story
            .named("ParameterDeclarations")
            .find_map(|list| list.children().next())
        {
            return Err(declared.refuse("parameters of a story are not supported"));
        }
        for act in story.named("Act") {
            act.only(&["ManeuverGroup", "StartTrigger", "StopTrigger"], &["name"])?;
            if let Some(stop) = act
                .named("StopTrigger")
                .find_map(|stop| stop.children().next())
            {
                return Err(stop.refuse("a stop trigger of an act is not supported"));
            }
            for group in act.named("ManeuverGroup") {
                let names = [story.text("name")?, act.text("name")?, group.text("name")?];
                read_group(group, names, entities, &mut stories)?;
            }
            let trigger = Trigger::read(
                act.optional("StartTrigger"),
                entities,
                &mut stories.conditions,
            )?;
            stories.act_triggers.push(trigger);
            ensure_at_most(storyboard, stories.act_triggers.len(), MAX_EVENTS, "acts")?;
        }
    }
    Ok(stories)
}

fn read_group<'a>(
    group: Node<'a>,
    [story, act, group_name]: [String; 3],
    entities: &[Entity<'_>],
    stories: &mut Stories<'a>,
) -> Result<()> {
    group.only(&["Actors", "Maneuver"], &["name", "maximumExecutionCount"])?;
    group.expect("maximumExecutionCount", &["1"])?;
    let list = group.child("Actors")?;
    list.only(&["EntityRef"], &["selectTriggeringEntities"])?;
    if list.flag("selectTriggeringEntities", false)? {
        return Err(list.refuse("triggering entities as actors are not supported"));
    }
    ensure_at_most(list, list.children().count(), MAX_ENTITIES, "entities")?;
    let actors = list
        .children()
        .map(|actor| entity_index(actor, "entityRef", entities))
        .collect::<Result<Vec<_>>>()?;
    for maneuver in group.named("Maneuver") {
        maneuver.only(&["Event", "ParameterDeclarations"], &["name"])?;
        for node in maneuver.named("Event") {
            node.only(
                &["Action", "StartTrigger"],
                &["name", "priority", "maximumExecutionCount"],
            )?;
            node.expect("maximumExecutionCount", &["1"])?;
            node.expect("priority", &["override", "overwrite", "parallel"])?;
            if actors.is_empty() {
                return Err(list.refuse("names no entity for the actions of the events"));
            }
            ensure_at_most(
                group,
                stories.events.len() + 1,
                MAX_EVENTS,
                "events, with those before it",
            )?;
            stories.actions += actors.len() * node.named("Action").count().max(1);
            let what = "actions of events, each counted for each of its entities";
            ensure_at_most(node, stories.actions, MAX_EVENT_ACTIONS, what)?;
            let mut actions = Vec::new();
            for action in node.named("Action") {
                action.only(&["PrivateAction"], &["name"])?;
                let inner = action.single()?.single()?;
                actions.push((action.text("name")?, read_action(inner, entities)?));
            }
            let trigger = Trigger::read(
                node.optional("StartTrigger"),
                entities,
                &mut stories.conditions,
            )?;
            stories.event_triggers.push(trigger);
            stories.events.push(StoryEvent {
                node,
                name: node.text("name")?,
                parents: [
                    story.clone(),
                    act.clone(),
                    group_name.clone(),
                    maneuver.text("name")?,
                ],
                act: stories.act_triggers.len(),
                actors: actors.clone(),
                actions: actions.into(),
                start_s: None,
                action_ends_s: Vec::new(),
                depends: false,
            });
        }
    }
    Ok(())
}

/// Reads a private action.
pub(super) fn read_action<'a>(
    action: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    match action.name() {
        "LongitudinalAction" => {
            let inner = action.single()?;
            match inner.name() {
                "SpeedAction" => Ok(StoryAction::Speed(read_speed(inner, entities)?)),
                "SpeedProfileAction" => read_profile(inner),
                _ => Err(inner.refuse("is not supported in an event")),
            }
        }
        "LateralAction" => {
            let inner = action.single()?;
            if inner.name() != "LaneChangeAction" {
                return Err(inner.refuse("is lateral: vehicles drive in the middle of a lane"));
            }
            read_lane_change(inner, entities)
        }
        "RoutingAction" => {
            let inner = action.single()?;
            if inner.name() != "FollowTrajectoryAction" {
                return Err(inner.refuse("is not supported: the road is straight"));
            }
            read_trajectory(inner)
        }
        "ControllerAction" => {
            action.only(&["AssignControllerAction", "ActivateControllerAction"], &[])?;
            let activate = action.optional("ActivateControllerAction");
            let activate = activate
                .ok_or_else(|| action.refuse("controllers must be assigned by the entity"))?;
            read_activation(activate)
        }
        "ActivateControllerAction" => read_activation(action),
        _ => Err(action.refuse("is not supported")),
    }
}

fn read_activation<'a>(node: Node<'a>) -> Result<StoryAction<'a>> {
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
    match node.flag("longitudinal", true)? {
        true => Ok(StoryAction::Activate),
        false => Err(node.refuse("a controller must be active in longitudinal direction")),
    }
}

pub(super) fn read_speed<'a>(node: Node<'a>, entities: &[Entity<'_>]) -> Result<SpeedAction<'a>> {
    node.only(&["SpeedActionDynamics", "SpeedActionTarget"], &[])?;
    let dynamics = TransitionDynamics::read(node.child("SpeedActionDynamics")?)?;
    let target = node.child("SpeedActionTarget")?.single()?;
    let target = match target.name() {
        "AbsoluteTargetSpeed" => {
            target.only(&[], &["value"])?;
            SpeedTarget {
                reference: None,
                factor: 0.0,
                offset_mps: target.non_negative("value")?,
            }
        }
        "RelativeTargetSpeed" => {
            target.only(
                &[],
                &["entityRef", "value", "speedTargetValueType", "continuous"],
            )?;
            if target.flag("continuous", false)? {
                return Err(target.refuse("a continuous target is not supported"));
            }
            let (reference, value) = (
                Some(entity_index(target, "entityRef", entities)?),
                target.number("value")?,
            );
            match target.text("speedTargetValueType")?.as_str() {
                "delta" => SpeedTarget {
                    reference,
                    factor: 1.0,
                    offset_mps: value,
                },
                "factor" => SpeedTarget {
                    reference,
                    factor: value,
                    offset_mps: 0.0,
                },
                other => return Err(target.refuse(format!("`{other}` is not supported"))),
            }
        }
        _ => return Err(target.refuse("is not supported as a target speed")),
    };
    Ok(SpeedAction {
        node,
        dynamics,
        target,
    })
}

fn read_profile<'a>(node: Node<'a>) -> Result<StoryAction<'a>> {
    node.only(&["SpeedProfileEntry"], &["followingMode"])?;
    node.expect("followingMode", &["position"])?;
    let read = |entry: Node<'a>| {
        entry.only(&[], &["time", "speed"])?;
        Ok((entry.non_negative("time")?, entry.non_negative("speed")?))
    };
    Ok(StoryAction::SpeedProfile(
        node.children().map(read).collect::<Result<Vec<_>>>()?,
    ))
}
