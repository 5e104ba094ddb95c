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
    pub(super) triggers: StoryTriggers<'a>,
    /// Conditions of all triggers.
    pub(super) conditions: ConditionCount,
    /// Number of actions, each counted for each entity that does it.
    actions: usize,
}

/// Start triggers.
#[derive(Default)]
pub(super) struct StoryTriggers<'a> {
    pub(super) acts: Vec<Trigger<'a>>,
    /// Triggers of the events, in their order.
    pub(super) events: Vec<Trigger<'a>>,
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
    pub(super) depends_on_controller: bool,
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

impl<'a> StoryAction<'a> {
    /// Returns the element of an action that has one of its own.
    pub(super) fn node(&self) -> Option<Node<'a>> {
        match self {
            Self::Speed(speed) => Some(speed.node),
            Self::LaneChange(change) => Some(change.node),
            Self::Trajectory(trajectory) => Some(trajectory.node),
            Self::SpeedProfile(_) | Self::Activate => None,
        }
    }

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
    fn read(node: Node<'_>, entities: &[Entity<'_>]) -> Result<Self> {
        match node.name() {
            "AbsoluteTargetSpeed" => {
                node.only(&[], &["value"])?;
                Ok(Self {
                    reference: None,
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
        if node.flag("continuous", false)? {
            return Err(node.refuse("a continuous target is not supported"));
        }
        let reference = Some(entity_index(node, "entityRef", entities)?);
        let value = node.number("value")?;
        match node.text("speedTargetValueType")?.as_str() {
            "delta" => Ok(Self {
                reference,
                factor: 1.0,
                offset_mps: value,
            }),
            "factor" => Ok(Self {
                reference,
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
    index.ok_or_else(|| node.refuse(format!("there is no entity `{name}`")))
}

/// Reads all events with their triggers.
pub(super) fn read_stories<'a>(
    storyboard: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<Stories<'a>> {
    let mut stories = Stories {
        events: Vec::new(),
        triggers: StoryTriggers::default(),
        conditions: ConditionCount::default(),
        actions: 0,
    };
    for story in storyboard.named("Story") {
        story.only(&["Act", "ParameterDeclarations"], &["name"])?;
        let mut lists = story.named("ParameterDeclarations");
        if let Some(declared) = lists.find_map(|list| list.children().next()) {
            return Err(declared.refuse("parameters of a story are not supported"));
        }
        for act in story.named("Act") {
            stories.read_act(story, act, entities)?;
            let acts = stories.triggers.acts.len();
            ensure_at_most(storyboard, acts, MAX_EVENTS, "acts")?;
        }
    }
    Ok(stories)
}

/// A maneuver group, with what is the same for all its events.
struct ManeuverGroup<'a> {
    node: Node<'a>,
    /// Names of the story, the act and the group.
    names: [String; 3],
    /// Element that names the actors.
    actor_list: Node<'a>,
    actors: Vec<usize>,
}

impl<'a> Stories<'a> {
    fn read_act(&mut self, story: Node<'a>, act: Node<'a>, entities: &[Entity<'_>]) -> Result<()> {
        act.only(&["ManeuverGroup", "StartTrigger", "StopTrigger"], &["name"])?;
        let mut stops = act.named("StopTrigger");
        if let Some(stop) = stops.find_map(|stop| stop.children().next()) {
            return Err(stop.refuse("a stop trigger of an act is not supported"));
        }
        for node in act.named("ManeuverGroup") {
            let names = [story.text("name")?, act.text("name")?, node.text("name")?];
            let group = ManeuverGroup::read(node, names, entities)?;
            for maneuver in node.named("Maneuver") {
                maneuver.only(&["Event", "ParameterDeclarations"], &["name"])?;
                for event in maneuver.named("Event") {
                    self.read_event(&group, maneuver, event, entities)?;
                }
            }
        }
        let start = act.optional("StartTrigger");
        let trigger = Trigger::read(start, entities, &mut self.conditions)?;
        self.triggers.acts.push(trigger);
        Ok(())
    }

    fn read_event(
        &mut self,
        group: &ManeuverGroup<'a>,
        maneuver: Node<'a>,
        node: Node<'a>,
        entities: &[Entity<'_>],
    ) -> Result<()> {
        node.only(
            &["Action", "StartTrigger"],
            &["name", "priority", "maximumExecutionCount"],
        )?;
        node.expect("maximumExecutionCount", &["1"])?;
        node.expect("priority", &["override", "overwrite", "parallel"])?;
        self.count_event(group, node)?;
        let actions = read_event_actions(node, entities)?;
        let start = node.optional("StartTrigger");
        let trigger = Trigger::read(start, entities, &mut self.conditions)?;
        self.triggers.events.push(trigger);
        let [story, act, group_name] = group.names.clone();
        self.events.push(StoryEvent {
            node,
            name: node.text("name")?,
            parents: [story, act, group_name, maneuver.text("name")?],
            act: self.triggers.acts.len(),
            actors: group.actors.clone(),
            actions: actions.into(),
            start_s: None,
            action_ends_s: Vec::new(),
            depends_on_controller: false,
        });
        Ok(())
    }

    /// Refuses an event without actors, and more events or actions than the limits.
    fn count_event(&mut self, group: &ManeuverGroup<'a>, event: Node<'a>) -> Result<()> {
        if group.actors.is_empty() {
            return Err(group
                .actor_list
                .refuse("names no entity for the actions of the events"));
        }
        let events = self.events.len() + 1;
        ensure_at_most(
            group.node,
            events,
            MAX_EVENTS,
            "events, with those before it",
        )?;
        self.actions += group.actors.len() * event.named("Action").count().max(1);
        let what = "actions of events, each counted for each of its entities";
        ensure_at_most(event, self.actions, MAX_EVENT_ACTIONS, what)
    }
}

fn read_event_actions<'a>(
    event: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<Vec<(String, StoryAction<'a>)>> {
    event
        .named("Action")
        .map(|action| {
            action.only(&["PrivateAction"], &["name"])?;
            let inner = action.single()?.single()?;
            Ok((action.text("name")?, read_action(inner, entities)?))
        })
        .collect()
}

impl<'a> ManeuverGroup<'a> {
    fn read(node: Node<'a>, names: [String; 3], entities: &[Entity<'_>]) -> Result<Self> {
        node.only(&["Actors", "Maneuver"], &["name", "maximumExecutionCount"])?;
        node.expect("maximumExecutionCount", &["1"])?;
        let list = node.child("Actors")?;
        list.only(&["EntityRef"], &["selectTriggeringEntities"])?;
        if list.flag("selectTriggeringEntities", false)? {
            return Err(list.refuse("triggering entities as actors are not supported"));
        }
        ensure_at_most(list, list.children().count(), MAX_ENTITIES, "entities")?;
        let actors = list
            .children()
            .map(|actor| entity_index(actor, "entityRef", entities))
            .collect::<Result<_>>()?;
        Ok(Self {
            node,
            names,
            actor_list: list,
            actors,
        })
    }
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
    Ok(SpeedAction {
        node,
        dynamics: TransitionDynamics::read(node.child("SpeedActionDynamics")?)?,
        target: SpeedTarget::read(node.child("SpeedActionTarget")?.single()?, entities)?,
    })
}

fn read_profile<'a>(node: Node<'a>) -> Result<StoryAction<'a>> {
    node.only(&["SpeedProfileEntry"], &["followingMode"])?;
    node.expect("followingMode", &["position"])?;
    let entries = node.children().map(|entry| {
        entry.only(&[], &["time", "speed"])?;
        Ok((entry.non_negative("time")?, entry.non_negative("speed")?))
    });
    Ok(StoryAction::SpeedProfile(entries.collect::<Result<_>>()?))
}
