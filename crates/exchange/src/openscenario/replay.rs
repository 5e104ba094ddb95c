//! Replay of the storyboard: motion and lane changes of all entities up to the stop trigger.
//!
//! Controlled entities keep their speed. What depends on their motion is marked.

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::initial::InitialState;
use super::limits::{ConditionCount, MAX_SAMPLES, WorkBudget};
use super::road::RoadMap;
use super::speed_plan::{SpeedPlan, take_samples};
use super::storyboard::{StoryAction, StoryEvent};
use super::trigger::Trigger;
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
    /// Returns the last action on the speed that starts before a time.
    pub(super) fn action(&self, time_s: f64) -> Option<Node<'a>> {
        self.actions
            .iter()
            .rfind(|(start_s, _)| *start_s <= time_s)
            .map(|(_, node)| *node)
    }
}

/// A lane change.
pub(super) struct LaneChangeTimes<'a> {
    pub(super) node: Node<'a>,
    pub(super) lanes: [i32; 2],
    /// Time at which the body first overlaps the new lane, and at which it has left the old one.
    pub(super) crossings_s: [f64; 2],
    pub(super) depends_on_controller: bool,
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
    pub(super) fn new(
        entities: &'b [Entity<'a>],
        initial: InitialState<'a>,
        is_controlled: &[bool],
        events: Vec<StoryEvent<'a>>,
        roads: &'b RoadMap<'b>,
        work: &'b WorkBudget,
    ) -> Result<Self> {
        let motion = initial
            .places
            .iter()
            .zip(&initial.speeds_mps)
            .zip(is_controlled)
            .zip(&initial.is_active);
        let motion =
            motion.map(
                |(((place, speed_mps), &is_controlled), &is_active)| EntityMotion {
                    plan: SpeedPlan::constant(place.along_m, speed_mps.unwrap_or(0.0)),
                    is_recorded: false,
                    follows_path: false,
                    lane: place.lane,
                    lane_changes: Vec::new(),
                    activated_s: is_active.then_some(0.0),
                    is_controlled,
                    actions: Vec::new(),
                },
            );
        let motion = motion.collect();
        let road_id = initial
            .places
            .first()
            .map_or_else(String::new, |place| place.road.clone());
        let (notes, samples_left) = (initial.notes, MAX_SAMPLES);
        let mut replay = Self {
            entities,
            motion,
            events,
            roads,
            road_id,
            notes,
            work,
            samples_left,
            now_s: 0.0,
        };
        for (entity, action) in initial.transitions {
            let reference_mps = action
                .target
                .reference
                .map_or(0.0, |other| replay.speed_mps(other, 0.0));
            let to_mps = action.target.speed_mps(action.node, reference_mps)?;
            if let Some(motion) = replay.motion.get_mut(entity) {
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
                    &mut replay.samples_left,
                )?;
            }
        }
        Ok(replay)
    }

    /// Replays until the stop trigger fires, and returns this time and true if it depends on a controller.
    pub(super) fn run(
        &mut self,
        acts: &mut [Trigger<'a>],
        triggers: &mut [Trigger<'a>],
        count: &mut ConditionCount,
        storyboard: Node<'a>,
    ) -> Result<(f64, bool)> {
        let stop = storyboard
            .optional("StopTrigger")
            .filter(|stop| stop.children().next().is_some());
        let stop = stop.ok_or_else(|| {
            storyboard.refuse("has no stop trigger, which determines the duration")
        })?;
        let mut stop_trigger = Trigger::read(Some(stop), self.entities, count)?;
        let mut act_starts_s = vec![None; acts.len()];
        let mut before_s = 0.0;
        for step in 0..=(MAX_DURATION_S / REPLAY_STEP_S) as usize {
            if step % STEPS_PER_CHECK == 0 {
                let acts = acts
                    .iter()
                    .zip(&act_starts_s)
                    .filter(|(_, start_s)| start_s.is_none());
                let events = triggers
                    .iter()
                    .zip(&self.events)
                    .filter(|(_, event)| event.start_s.is_none());
                let waiting = acts
                    .map(|(trigger, _)| trigger)
                    .chain(events.map(|(trigger, _)| trigger));
                let work =
                    self.step_work(waiting.chain([&stop_trigger])) + self.events.len() as u64;
                self.work.spend(storyboard, STEPS_PER_CHECK as u64 * work)?;
            }
            self.now_s = step as f64 * REPLAY_STEP_S;
            for (act, start_s) in acts
                .iter_mut()
                .zip(&mut act_starts_s)
                .filter(|(_, start_s)| start_s.is_none())
            {
                *start_s = act.fires(self, before_s, self.now_s)?;
            }
            for (index, trigger) in triggers.iter_mut().enumerate() {
                let waiting = self
                    .events
                    .get(index)
                    .filter(|event| event.start_s.is_none());
                let act = waiting.and_then(|event| act_starts_s.get(event.act).copied().flatten());
                let Some((act_s, act_depends)) = act else {
                    continue;
                };
                if let Some((fired_s, depends)) = trigger.fires(self, before_s, self.now_s)? {
                    self.start_event(index, fired_s.max(act_s), depends || act_depends)?;
                }
            }
            if let Some(stopped) = stop_trigger.fires(self, before_s, self.now_s)? {
                return Ok(stopped);
            }
            before_s = self.now_s;
        }
        Err(stop.refuse(format!("does not fire within {MAX_DURATION_S} s")))
    }

    /// Returns the work of a step that evaluates these triggers.
    fn step_work<'t>(&self, triggers: impl Iterator<Item = &'t Trigger<'a>>) -> u64
    where
        'a: 't,
    {
        let elements: usize = self
            .events
            .iter()
            .map(|event| 1 + event.actions.len())
            .sum();
        let state_work = self
            .motion
            .iter()
            .map(|motion| motion.plan.state_work())
            .max()
            .unwrap_or_default();
        triggers
            .map(|trigger| trigger.work(elements as u64, state_work))
            .sum()
    }

    fn start_event(&mut self, index: usize, start_s: f64, depends: bool) -> Result<()> {
        let Some(mut event) = self.events.get(index).cloned() else {
            return Ok(());
        };
        let per_event = |event: &StoryEvent<'_>| 5 + event.actors.len() + event.actions.len();
        self.work.spend(
            event.node,
            5 * self.events.iter().map(per_event).sum::<usize>() as u64,
        )?;
        for (_, action) in &*event.actions {
            let mut end_s = start_s;
            for &actor in &event.actors {
                end_s = self
                    .start_action(event.node, actor, action, start_s, depends)?
                    .max(end_s);
            }
            event.action_ends_s.push(end_s);
        }
        if event
            .actions
            .iter()
            .any(|(_, action)| action.changes_speed())
        {
            self.stop_earlier_actions(&event.actors, start_s);
        }
        (event.start_s, event.depends) = (Some(start_s), depends);
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
        let has_actor = |event: &&mut StoryEvent<'_>| {
            event
                .actors
                .iter()
                .any(|actor| is_actor.get(*actor) == Some(&true))
        };
        for event in self.events.iter_mut().filter(has_actor) {
            for ((_, action), end_s) in event.actions.iter().zip(&mut event.action_ends_s) {
                *end_s = if action.changes_speed() {
                    end_s.min(time_s)
                } else {
                    *end_s
                };
            }
        }
    }

    /// Starts an action of an entity, and returns its end.
    fn start_action(
        &mut self,
        event: Node<'a>,
        actor: usize,
        action: &StoryAction<'a>,
        start_s: f64,
        depends: bool,
    ) -> Result<f64> {
        let vertices = match action {
            StoryAction::Trajectory(trajectory) if !self.is_controlled(actor) => {
                self.trajectory_vertices(trajectory, actor, start_s)?
            }
            _ => Vec::new(),
        };
        if let StoryAction::LaneChange(change) = action {
            return self.change_lane(change, actor, start_s, depends);
        }
        let reference = if let StoryAction::Speed(speed) = action {
            speed.target.reference
        } else {
            None
        };
        let reference_mps = reference.map_or(0.0, |other| self.speed_mps(other, start_s));
        let assumed = reference
            .filter(|other| self.is_controlled(*other))
            .and_then(|other| self.entities.get(other));
        let Some(motion) = self.motion.get_mut(actor) else {
            return Ok(start_s);
        };
        if let StoryAction::Activate = action {
            motion.activated_s = Some(
                motion
                    .activated_s
                    .map_or(start_s, |before_s| before_s.min(start_s)),
            );
            return Ok(start_s);
        }
        if motion.is_controlled {
            motion.actions.push((start_s, event));
            return Ok(start_s);
        }
        // Discarding the rest of the plan, and comparing it with the new one.
        let work_per_knot = if depends {
            5 + 2 * motion.plan.state_work()
        } else {
            5
        };
        self.work
            .spend(event, work_per_knot * motion.plan.knots().len() as u64)?;
        let before = depends.then(|| motion.plan.clone());
        let (node, end_s) = match action {
            StoryAction::Speed(speed) => {
                let to_mps = speed.target.speed_mps(speed.node, reference_mps)?;
                let (node, left) = (speed.node, &mut self.samples_left);
                (
                    node,
                    motion
                        .plan
                        .change_speed(node, start_s, to_mps, speed.dynamics, left)?,
                )
            }
            StoryAction::SpeedProfile(entries) => {
                take_samples(event, entries.len(), &mut self.samples_left)?;
                motion.is_recorded = true;
                motion.plan.cut(start_s);
                let mut time_s = start_s;
                for &(after_s, mps) in entries {
                    time_s += after_s;
                    motion.plan.push(time_s, mps);
                }
                (event, time_s)
            }
            StoryAction::Trajectory(trajectory) => {
                (motion.is_recorded, motion.follows_path) = (true, true);
                motion.plan.follow(&vertices);
                (
                    trajectory.node,
                    vertices.last().map_or(start_s, |(time_s, _)| *time_s),
                )
            }
            StoryAction::LaneChange(_) | StoryAction::Activate => (event, start_s),
        };
        motion.actions.push((start_s, node));
        let differs = |before: SpeedPlan| {
            motion
                .plan
                .knots()
                .iter()
                .any(|knot| before.at(knot.time_s).speed_mps != knot.speed_mps)
        };
        if before.is_some_and(differs) {
            return Err(node.refuse(
                "depends on an entity with a controller: scripts depend only on the time",
            ));
        }
        self.notes.extend(assumed.map(|other| {
            node.note(format!(
                "is relative to `{}`, as if it kept its speed",
                other.name
            ))
        }));
        Ok(end_s)
    }
}
