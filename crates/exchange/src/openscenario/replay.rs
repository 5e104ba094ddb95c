//! Replay of the storyboard: motion and lane changes of all entities up to the stop trigger.
//!
//! Controlled entities keep their speed. What depends on their motion is marked.

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::initial::InitialState;
use super::limits::{ConditionCount, MAX_SAMPLES, WorkBudget};
use super::road::{LanePlace, RoadMap};
use super::speed_plan::{PathVertex, SpeedPlan, take_samples};
use super::storyboard::{SpeedAction, StoryAction, StoryEvent, StoryTriggers};
use super::trigger::{Firing, Trigger};
use super::xml::Node;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Step of the replay, in seconds: that of a scenario by default.
pub(super) const REPLAY_STEP_S: f64 = crumple_sim::scenario::PAPER_STEP_S;
/// Maximum duration, in seconds.
pub(super) const MAX_DURATION_S: f64 = 3600.0;
/// Number of steps for which the work is computed together.
const STEPS_PER_CHECK: usize = 100;

/// Motion of one entity.
pub(super) struct EntityMotion<'a> {
    pub(super) plan: SpeedPlan,
    /// True if a speed profile or a trajectory made the plan.
    pub(super) is_recorded: bool,
    /// True if a trajectory made the plan.
    pub(super) follows_path: bool,
    pub(super) lane: i32,
    pub(super) lane_changes: Vec<LaneChangeTimes<'a>>,
    pub(super) activated_s: Option<f64>,
    pub(super) is_controlled: bool,
    /// Start times of actions on the speed; its controller replaces those of a controlled entity.
    pub(super) actions: Vec<(f64, Node<'a>)>,
}

impl<'a> EntityMotion<'a> {
    /// Returns the motion at a constant speed from a place.
    fn constant(position: &LanePlace, speed_mps: f64) -> Self {
        Self {
            plan: SpeedPlan::constant(position.along_m, speed_mps),
            is_recorded: false,
            follows_path: false,
            lane: position.lane,
            lane_changes: Vec::new(),
            activated_s: None,
            is_controlled: false,
            actions: Vec::new(),
        }
    }

    /// Returns the work of discarding the rest of the plan, and of comparing it with the new one.
    fn change_work(&self, is_compared: bool) -> u64 {
        let work_per_knot = if is_compared {
            5 + 2 * self.plan.state_work()
        } else {
            5
        };
        work_per_knot * self.plan.knots().len() as u64
    }

    /// Changes the plan by an action, and returns the end of the action.
    fn change_plan(
        &mut self,
        event: Node<'a>,
        action: &StoryAction<'a>,
        start_s: f64,
        inputs: &ActionInputs,
        samples_left: &mut usize,
    ) -> Result<f64> {
        match action {
            StoryAction::Speed(speed) => {
                let to_mps = speed.target.speed_mps(speed.node, inputs.reference_mps)?;
                self.plan
                    .change_speed(speed.node, start_s, to_mps, speed.dynamics, samples_left)
            }
            StoryAction::SpeedProfile(entries) => {
                take_samples(event, entries.len(), samples_left)?;
                Ok(self.follow_profile(entries, start_s))
            }
            StoryAction::Trajectory(_) => Ok(self.follow_trajectory(&inputs.vertices, start_s)),
            StoryAction::LaneChange(_) | StoryAction::Activate => Ok(start_s),
        }
    }

    /// Follows pairs of a time after the previous entry and a speed, and returns the end.
    fn follow_profile(&mut self, entries: &[(f64, f64)], start_s: f64) -> f64 {
        self.is_recorded = true;
        self.plan.cut(start_s);
        let mut time_s = start_s;
        for &(after_s, mps) in entries {
            time_s += after_s;
            self.plan.push(time_s, mps);
        }
        time_s
    }

    /// Follows the vertices of a trajectory, and returns the end.
    fn follow_trajectory(&mut self, vertices: &[PathVertex], start_s: f64) -> f64 {
        self.is_recorded = true;
        self.follows_path = true;
        self.plan.follow(vertices);
        vertices.last().map_or(start_s, |vertex| vertex.time_s)
    }

    /// Returns the last action on the speed that starts before a time.
    pub(super) fn action(&self, time_s: f64) -> Option<Node<'a>> {
        self.actions
            .iter()
            .rfind(|(start_s, _)| *start_s <= time_s)
            .map(|(_, node)| *node)
    }
}

/// Positions and speeds on which an action depends.
#[derive(Default)]
struct ActionInputs {
    /// Vertices of a trajectory.
    vertices: Vec<PathVertex>,
    /// Speed to which a target speed is relative.
    reference_mps: f64,
}

/// A lane change.
pub(super) struct LaneChangeTimes<'a> {
    pub(super) node: Node<'a>,
    pub(super) lanes: [i32; 2],
    /// Time at which the body first overlaps the new lane, and at which it has left the old one.
    pub(super) crossings_s: [f64; 2],
    pub(super) depends_on_controller: bool,
}

/// Triggers of a replay.
struct ReplayTriggers<'a> {
    story: StoryTriggers<'a>,
    /// Starts of the acts; `None` for one that has not started.
    act_starts: Vec<Option<Firing>>,
    stop: Trigger<'a>,
}

pub(super) struct Replay<'a, 'b> {
    pub(super) entities: &'b [Entity<'a>],
    pub(super) motion: Vec<EntityMotion<'a>>,
    pub(super) events: Vec<StoryEvent<'a>>,
    pub(super) roads: &'b RoadMap<'b>,
    pub(super) road_id: String,
    pub(super) notes: Vec<String>,
    pub(super) work: &'b WorkBudget,
    pub(super) samples_left: usize,
    now_s: f64,
}

impl<'a, 'b> Replay<'a, 'b> {
    /// Creates a replay at the initial state, with the transitions of the speed that begin with it.
    pub(super) fn new(
        entities: &'b [Entity<'a>],
        initial: InitialState<'a>,
        is_controlled: &[bool],
        events: Vec<StoryEvent<'a>>,
        roads: &'b RoadMap<'b>,
        work: &'b WorkBudget,
    ) -> Result<Self> {
        let states = initial.places.iter().zip(&initial.speeds_mps);
        let mut motion: Vec<EntityMotion<'a>> = states
            .map(|(place, speed_mps)| EntityMotion::constant(place, speed_mps.unwrap_or(0.0)))
            .collect();
        let control = is_controlled.iter().zip(&initial.is_active);
        for (motion, (&is_controlled, &is_active)) in motion.iter_mut().zip(control) {
            motion.is_controlled = is_controlled;
            motion.activated_s = is_active.then_some(0.0);
        }
        let road_id = initial.places.first().map(|position| position.road.clone());
        let mut replay = Self {
            entities,
            motion,
            events,
            roads,
            road_id: road_id.unwrap_or_default(),
            notes: initial.notes,
            work,
            samples_left: MAX_SAMPLES,
            now_s: 0.0,
        };
        for (entity, action) in initial.transitions {
            replay.start_initial_transition(entity, &action)?;
        }
        Ok(replay)
    }

    /// Starts a transition of the speed with the scenario.
    fn start_initial_transition(&mut self, entity: usize, action: &SpeedAction<'a>) -> Result<()> {
        let reference_mps = self.reference_mps(action, 0.0);
        let to_mps = action.target.speed_mps(action.node, reference_mps)?;
        let Some(motion) = self.motion.get_mut(entity) else {
            return Ok(());
        };
        if motion.is_controlled {
            return Err(action
                .node
                .refuse("the initial speed of a controlled entity must be a step"));
        }
        motion.actions.push((0.0, action.node));
        motion.plan.change_speed(
            action.node,
            0.0,
            to_mps,
            action.dynamics,
            &mut self.samples_left,
        )?;
        Ok(())
    }

    /// Returns the speed to which the target of an action is relative.
    fn reference_mps(&self, action: &SpeedAction<'a>, time_s: f64) -> f64 {
        action
            .target
            .reference
            .map_or(0.0, |entity| self.speed_mps(entity, time_s))
    }

    /// Replays until the stop trigger fires.
    pub(super) fn run(
        &mut self,
        triggers: StoryTriggers<'a>,
        mut conditions: ConditionCount,
        storyboard: Node<'a>,
    ) -> Result<Firing> {
        let stop = storyboard
            .optional("StopTrigger")
            .filter(|stop| stop.children().next().is_some());
        let stop = stop.ok_or_else(|| {
            storyboard.refuse("has no stop trigger, which determines the duration")
        })?;
        let mut triggers = ReplayTriggers {
            act_starts: vec![None; triggers.acts.len()],
            story: triggers,
            stop: Trigger::read(Some(stop), self.entities, &mut conditions)?,
        };
        let mut before_s = 0.0;
        for step in 0..=(MAX_DURATION_S / REPLAY_STEP_S) as usize {
            if step % STEPS_PER_CHECK == 0 {
                let work = self.step_work(&triggers);
                self.work.spend(storyboard, STEPS_PER_CHECK as u64 * work)?;
            }
            self.now_s = step as f64 * REPLAY_STEP_S;
            self.start_acts(&mut triggers, before_s)?;
            self.start_events(&mut triggers, before_s)?;
            if let Some(firing) = triggers.stop.fires(self, before_s, self.now_s)? {
                return Ok(firing);
            }
            before_s = self.now_s;
        }
        Err(stop.refuse(format!("does not fire within {MAX_DURATION_S} s")))
    }

    /// Starts the acts whose triggers fire in the step from `before_s`.
    fn start_acts(&self, triggers: &mut ReplayTriggers<'a>, before_s: f64) -> Result<()> {
        let acts = triggers.story.acts.iter_mut();
        for (act, start) in acts
            .zip(&mut triggers.act_starts)
            .filter(|(_, start)| start.is_none())
        {
            *start = act.fires(self, before_s, self.now_s)?;
        }
        Ok(())
    }

    /// Starts the events of started acts whose triggers fire in the step from `before_s`.
    fn start_events(&mut self, triggers: &mut ReplayTriggers<'a>, before_s: f64) -> Result<()> {
        for (index, trigger) in triggers.story.events.iter_mut().enumerate() {
            let waiting = self
                .events
                .get(index)
                .filter(|event| event.start_s.is_none());
            let act = waiting.and_then(|event| *triggers.act_starts.get(event.act)?);
            let Some(act) = act else {
                continue;
            };
            if let Some(event) = trigger.fires(self, before_s, self.now_s)? {
                let start = Firing {
                    time_s: event.time_s.max(act.time_s),
                    depends_on_controller: event.depends_on_controller || act.depends_on_controller,
                };
                self.start_event(index, start)?;
            }
        }
        Ok(())
    }

    /// Returns the work of a step, which evaluates the triggers of all acts and events that have not started.
    fn step_work(&self, triggers: &ReplayTriggers<'a>) -> u64 {
        let elements = self.events.iter().map(|event| 1 + event.actions.len());
        let elements = elements.sum::<usize>() as u64;
        let state_work = self
            .motion
            .iter()
            .map(|motion| motion.plan.state_work())
            .max()
            .unwrap_or_default();
        let acts = triggers.story.acts.iter().zip(&triggers.act_starts);
        let acts = acts.filter(|(_, start)| start.is_none());
        let events = triggers.story.events.iter().zip(&self.events);
        let events = events.filter(|(_, event)| event.start_s.is_none());
        let waiting = acts
            .map(|(trigger, _)| trigger)
            .chain(events.map(|(trigger, _)| trigger))
            .chain([&triggers.stop]);
        waiting
            .map(|trigger| trigger.work(elements, state_work))
            .sum::<u64>()
            + self.events.len() as u64
    }

    fn start_event(&mut self, index: usize, start: Firing) -> Result<()> {
        let Some(mut event) = self.events.get(index).cloned() else {
            return Ok(());
        };
        let events = self.events.iter();
        let size: usize = events
            .map(|event| 5 + event.actors.len() + event.actions.len())
            .sum();
        self.work.spend(event.node, 5 * size as u64)?;
        for (_, action) in &*event.actions {
            let mut end_s = start.time_s;
            for &actor in &event.actors {
                end_s = self
                    .start_action(event.node, actor, action, start)?
                    .max(end_s);
            }
            event.action_ends_s.push(end_s);
        }
        let mut actions = event.actions.iter();
        if actions.any(|(_, action)| action.changes_speed()) {
            self.stop_earlier_actions(&event.actors, start.time_s);
        }
        event.start_s = Some(start.time_s);
        event.depends_on_controller = start.depends_on_controller;
        self.events
            .get_mut(index)
            .map(|slot| std::mem::replace(slot, event));
        Ok(())
    }

    /// Ends the running actions that an action on the speed of the same entities replaces.
    fn stop_earlier_actions(&mut self, actors: &[usize], time_s: f64) {
        let mut is_actor = vec![false; self.entities.len()];
        for actor in actors {
            is_actor
                .get_mut(*actor)
                .map(|is_actor| std::mem::replace(is_actor, true));
        }
        for event in &mut self.events {
            let mut actors = event.actors.iter();
            if !actors.any(|actor| is_actor.get(*actor) == Some(&true)) {
                continue;
            }
            for ((_, action), end_s) in event.actions.iter().zip(&mut event.action_ends_s) {
                if action.changes_speed() {
                    *end_s = end_s.min(time_s);
                }
            }
        }
    }

    /// Starts an action of an entity, and returns its end.
    fn start_action(
        &mut self,
        event: Node<'a>,
        actor: usize,
        action: &StoryAction<'a>,
        start: Firing,
    ) -> Result<f64> {
        if let StoryAction::LaneChange(change) = action {
            return self.change_lane(change, actor, start);
        }
        if action.changes_speed() && !self.is_controlled(actor) {
            return self.change_plan(event, actor, action, start);
        }
        if let Some(motion) = self.motion.get_mut(actor) {
            if let StoryAction::Activate = action {
                let activated_s = motion.activated_s.unwrap_or(start.time_s);
                motion.activated_s = Some(activated_s.min(start.time_s));
            } else {
                motion.actions.push((start.time_s, event));
            }
        }
        Ok(start.time_s)
    }

    /// Changes the speeds of a scripted entity by an action, and returns the end of the action.
    fn change_plan(
        &mut self,
        event: Node<'a>,
        actor: usize,
        action: &StoryAction<'a>,
        start: Firing,
    ) -> Result<f64> {
        let inputs = self.action_inputs(action, actor, start.time_s)?;
        let Some(motion) = self.motion.get_mut(actor) else {
            return Ok(start.time_s);
        };
        let work = motion.change_work(start.depends_on_controller);
        self.work.spend(event, work)?;
        let plan_before = start.depends_on_controller.then(|| motion.plan.clone());
        let samples_left = &mut self.samples_left;
        let end_s = motion.change_plan(event, action, start.time_s, &inputs, samples_left)?;
        let node = action.node().unwrap_or(event);
        motion.actions.push((start.time_s, node));
        if plan_before.is_some_and(|before| motion.plan.differs_from(&before)) {
            return Err(node.refuse(
                "depends on an entity with a controller: scripts depend only on the time",
            ));
        }
        self.notes.extend(self.constant_speed_note(action));
        Ok(end_s)
    }

    /// Returns the positions and speeds on which an action depends.
    fn action_inputs(
        &mut self,
        action: &StoryAction<'a>,
        actor: usize,
        start_s: f64,
    ) -> Result<ActionInputs> {
        let mut inputs = ActionInputs::default();
        match action {
            StoryAction::Speed(speed) => inputs.reference_mps = self.reference_mps(speed, start_s),
            StoryAction::Trajectory(trajectory) => {
                inputs.vertices = self.trajectory_vertices(trajectory, actor, start_s)?;
            }
            StoryAction::SpeedProfile(_) | StoryAction::LaneChange(_) | StoryAction::Activate => {}
        }
        Ok(inputs)
    }

    /// Returns a note if the target of an action is relative to the speed of a controlled entity.
    fn constant_speed_note(&self, action: &StoryAction<'a>) -> Option<String> {
        let StoryAction::Speed(speed) = action else {
            return None;
        };
        let reference = speed.target.reference;
        let reference = reference.filter(|entity| self.is_controlled(*entity))?;
        let name = &self.entities.get(reference)?.name;
        Some(
            speed
                .node
                .note(format!("is relative to `{name}`, as if it kept its speed")),
        )
    }
}
