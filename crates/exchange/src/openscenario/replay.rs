//! Replay of the storyboard: motion of all entities up to the stop trigger, as `interpreter` lets the elements run.
//!
//! The default controller drives entities with a controller: it does their actions exactly, and otherwise keeps their
//! speed and their lane (6.6.1). What depends on their motion is marked.

use super::constructs::ActionDomains;
use super::element::StoryElement;
use super::entities::Entity;
use super::error::ScenarioImportError;
use super::initial::{InitialAction, InitialControl, InitialState};
use super::interpreter::ActiveAction;
use super::lateral::LateralPlan;
use super::limits::{MAX_SAMPLES, WORK_PER_SAMPLE, WorkBudget};
use super::road::{LanePlace, RoadMap, StraightRoad};
use super::source::SourceFiles;
use super::speed_plan::{SpeedPlan, TransitionDynamics, take_samples};
use super::storyboard::{SpeedAction, StoryAction};
use super::trajectory::PathVertex;
use super::trigger::Firing;
use super::variables::StoryVariables;
use super::vocabulary::TransitionDimension;
use super::xml::Node;
use crumple_core::digits::format_fixed;
use std::collections::BTreeSet;
use std::rc::Rc;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Step of the replay, in seconds: that of a scenario by default.
pub(super) const REPLAY_STEP_S: f64 = crumple_sim::scenario::PAPER_STEP_S;
/// Acceleration that a body without limits can drive, in m/s².
const UNSTATED_LIMIT_MPS2: f64 = 8.0;

/// Motion of one entity.
pub(super) struct EntityMotion<'a> {
    pub(super) plan: SpeedPlan,
    pub(super) lateral: LateralPlan<'a>,
    /// 1 for travel in the direction of the road, and -1 against it.
    pub(super) direction: f64,
    /// Position of a pedestrian that walks across the lanes; the plan counts the distance that it walks.
    pub(super) crosses_at_m: Option<f64>,
    /// True if its trajectory goes on along the lanes, which must be beside the lane of the vehicle under test.
    pub(super) walks_on: bool,
    /// True if a speed profile or a trajectory made the plan.
    pub(super) is_recorded: bool,
    /// True if a trajectory made the plan.
    pub(super) follows_path: bool,
    pub(super) activated_s: Option<f64>,
    /// True if a controller of the scenario drives the entity. In a replay, the default controller drives it.
    pub(super) is_controlled: bool,
    /// True if an event activates the controller.
    pub(super) awaits_activation: bool,
    /// Start times of actions on the speed.
    pub(super) actions: Vec<(f64, Node<'a>)>,
    /// Actions that the controller replaces.
    pub(super) replaced: Vec<Node<'a>>,
}

impl<'a> EntityMotion<'a> {
    /// Returns the motion at a constant speed from a place.
    fn constant(lane_place: &LanePlace, speed_mps: f64) -> Self {
        Self {
            plan: SpeedPlan::constant(lane_place.direction * lane_place.road_m, speed_mps),
            lateral: LateralPlan::constant(lane_place.lateral_m),
            direction: lane_place.direction,
            crosses_at_m: None,
            walks_on: false,
            is_recorded: false,
            follows_path: false,
            activated_s: None,
            is_controlled: false,
            awaits_activation: false,
            actions: Vec::new(),
            replaced: Vec::new(),
        }
    }

    /// Returns the position in the direction of travel.
    pub(super) fn position_m(&self, time_s: f64) -> f64 {
        self.crosses_at_m
            .unwrap_or_else(|| self.plan.at(time_s).position_m)
    }

    /// Returns true if the controller of the scenario drives the entity, and no longer the default controller (6.6.1).
    pub(super) fn has_active_controller(&self) -> bool {
        self.is_controlled && !self.is_inactive()
    }

    /// Returns true if an event that has not started yet activates the controller.
    pub(super) fn is_inactive(&self) -> bool {
        self.awaits_activation && self.activated_s.is_none()
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

    /// Returns the last action on the speed that starts before a time.
    pub(super) fn action(&self, time_s: f64) -> Option<Node<'a>> {
        self.actions
            .iter()
            .rfind(|(start_s, _)| *start_s <= time_s)
            .map(|(_, node)| *node)
    }
}

/// A change of the speed by an action.
enum PlanChange<'p> {
    /// To a speed in m/s, within the limits of the vehicle.
    Speed(f64, TransitionDynamics),
    Profile(&'p [(f64, f64)]),
    Trajectory(Vec<PathVertex>),
    /// No change until a time.
    Until(f64),
}

/// A time during which an entity keeps its speed or its lateral position relative to another one.
struct Following<'a> {
    node: Node<'a>,
    actor: usize,
    reference: usize,
    domain: ActionDomains,
    start_s: f64,
    end_s: f64,
}

pub(super) struct Replay<'a, 'b> {
    pub(super) entities: &'b [Entity<'a>],
    pub(super) motion: Vec<EntityMotion<'a>>,
    pub(super) elements: Vec<StoryElement<'a>>,
    pub(super) active: Vec<ActiveAction>,
    pub(super) variables: StoryVariables,
    /// Entities that actions of `Init` control, with the domains of each.
    pub(super) initial_controls: Vec<(usize, ActionDomains)>,
    /// Entities that follow another one.
    followings: Vec<Following<'a>>,
    pub(super) roads: &'b RoadMap<'b>,
    pub(super) files: &'b SourceFiles<'b>,
    pub(super) road: Rc<StraightRoad>,
    pub(super) road_id: String,
    pub(super) friction: f64,
    pub(super) notes: Vec<String>,
    /// Notes of the replay, each of which is added once.
    noted: BTreeSet<String>,
    pub(super) work: &'b WorkBudget,
    pub(super) samples_left: usize,
    /// Number of transitions so far, and before this step.
    pub(super) serials: [u64; 2],
    pub(super) now_s: f64,
    /// Time at which the scenario has ended; infinite if that depends on more than the time.
    pub(super) latest_stop_s: f64,
}

/// The parts of a file from which a replay begins.
pub(super) struct ReplayStart<'a> {
    pub(super) initial: InitialState<'a>,
    pub(super) elements: Vec<StoryElement<'a>>,
    pub(super) variables: StoryVariables,
    /// Control of each entity.
    pub(super) control: Vec<EntityControl>,
}

/// Control of an entity.
#[derive(Debug, Clone, Copy)]
pub(super) struct EntityControl {
    /// True if a controller of the scenario drives the entity.
    pub(super) is_controlled: bool,
    /// True if an event activates this controller.
    pub(super) awaits_activation: bool,
}

/// Returns the motion of all entities at constant speed from their initial state.
fn initial_motion<'a>(
    initial: &InitialState<'a>,
    control: &[EntityControl],
) -> Vec<EntityMotion<'a>> {
    let states = initial.places.iter().zip(&initial.speeds_mps);
    let mut motion: Vec<EntityMotion<'a>> = states
        .map(|(position, speed_mps)| EntityMotion::constant(position, speed_mps.unwrap_or(0.0)))
        .collect();
    let control = control.iter().zip(&initial.is_active);
    for (motion, (control, &is_active)) in motion.iter_mut().zip(control) {
        motion.is_controlled = control.is_controlled;
        motion.awaits_activation = control.awaits_activation;
        motion.activated_s = is_active.then_some(0.0);
    }
    motion
}

impl<'a, 'b> Replay<'a, 'b> {
    /// Creates a replay at the initial state, with the transitions of the speed that begin with it.
    pub(super) fn new(
        entities: &'b [Entity<'a>],
        start: ReplayStart<'a>,
        (roads, files): (&'b RoadMap<'b>, &'b SourceFiles<'b>),
        work: &'b WorkBudget,
        storyboard: Node<'a>,
    ) -> Result<Self> {
        let initial = start.initial;
        let motion = initial_motion(&initial, &start.control);
        let road_id = initial
            .places
            .first()
            .map(|lane_place| lane_place.road.clone());
        let road_id = road_id.ok_or_else(|| storyboard.refuse("has no entity"))?;
        let mut replay = Self {
            entities,
            motion,
            elements: start.elements,
            active: Vec::new(),
            variables: start.variables,
            initial_controls: Vec::new(),
            followings: Vec::new(),
            roads,
            files,
            road: roads.find(storyboard, Some(&road_id), [0.0; 2])?,
            road_id,
            friction: initial.friction,
            notes: initial.notes,
            noted: BTreeSet::new(),
            work,
            samples_left: MAX_SAMPLES,
            serials: [0; 2],
            now_s: 0.0,
            latest_stop_s: f64::INFINITY,
        };
        replay.start_initial_actions(initial.actions)?;
        Ok(replay)
    }

    /// Starts the actions of `Init` that go on after the start.
    fn start_initial_actions(&mut self, actions: Vec<(usize, InitialAction<'a>)>) -> Result<()> {
        for (entity, action) in actions {
            match action {
                InitialAction::Continuous(speed) => {
                    let note = self.constant_speed_note(&StoryAction::Speed(speed));
                    self.notes.extend(note);
                    self.follow_speed(entity, &speed, 0.0);
                }
                InitialAction::Route(route) => self.follow_route(route, entity)?,
                InitialAction::Transition(speed) => {
                    let (node, action) = (speed.node, StoryAction::Speed(speed));
                    self.change_plan(node, entity, &action, Firing::at(0.0))?;
                }
                InitialAction::Control(control) => {
                    let InitialControl {
                        node,
                        action,
                        domains,
                    } = control;
                    let start = Firing::at(0.0);
                    self.stop_initial_controls(node, entity, domains, start)?;
                    self.begin_action(node, entity, &action, start)?;
                    self.initial_controls.push((entity, domains));
                }
            }
        }
        Ok(())
    }

    /// Returns the speed to which the target of an action is relative.
    fn reference_mps(&self, action: &SpeedAction<'a>, time_s: f64) -> f64 {
        action
            .target
            .reference
            .map_or(0.0, |entity| self.speed_mps(entity, time_s))
    }

    /// Changes the speeds of an entity by an action, and returns the end of the action. An action of an entity with a
    /// controller ends when the default controller would have reached its goal (6.6.1, 7.5.2).
    pub(super) fn change_plan(
        &mut self,
        event: Node<'a>,
        actor: usize,
        action: &StoryAction<'a>,
        start: Firing,
    ) -> Result<f64> {
        let change = self.plan_change(actor, action, start.time_s)?;
        let Some(motion) = self.motion.get_mut(actor) else {
            return Ok(start.time_s);
        };
        let is_noted = start.depends_on_controller && !motion.is_controlled;
        let work = motion.change_work(is_noted);
        self.work.spend(event, work)?;
        let plan_before = is_noted.then(|| motion.plan.clone());
        let node = action.node().unwrap_or(event);
        motion.actions.push((start.time_s, node));
        let end_s = self.apply(node, actor, action, change, start.time_s)?;
        // A step at the start is an initial speed.
        let is_initial = matches!(action, StoryAction::Speed(speed) if speed.dynamics.is_instant())
            && self
                .motion
                .get(actor)
                .is_some_and(|motion| motion.plan.knots().len() == 1);
        if !is_initial {
            self.mark_replaced(node, actor);
        }
        if let Some(before) = plan_before {
            self.note_dependence(node, actor, &before);
        }
        let note = self.constant_speed_note(action);
        self.note_once(note);
        match action {
            StoryAction::Speed(speed) if speed.target.is_continuous => {
                self.follow_speed(actor, speed, start.time_s);
                Ok(f64::INFINITY)
            }
            _ => Ok(end_s),
        }
    }

    /// Returns the change of the speed of an entity by an action.
    fn plan_change<'p>(
        &mut self,
        actor: usize,
        action: &'p StoryAction<'a>,
        start_s: f64,
    ) -> Result<PlanChange<'p>> {
        match action {
            StoryAction::Speed(speed) => self.speed_change(speed, actor, start_s),
            StoryAction::SpeedProfile(profile) => {
                if profile.is_loose {
                    self.note_loose_motion(profile.node, actor);
                }
                Ok(PlanChange::Profile(&profile.entries))
            }
            StoryAction::Trajectory(trajectory) => {
                match self.trajectory_vertices(trajectory, actor, start_s) {
                    Ok(vertices) => Ok(PlanChange::Trajectory(vertices)),
                    // The controller does not follow it, wherever it leads.
                    Err(ScenarioImportError::Refused { .. }) if self.is_controlled(actor) => {
                        Ok(PlanChange::Until(trajectory.end_s(start_s)))
                    }
                    Err(error) => Err(error),
                }
            }
            _ => Ok(PlanChange::Until(start_s)),
        }
    }

    /// Notes how an entity without active controller moves if its action has the following mode `follow`.
    pub(super) fn note_loose_motion(&mut self, action: Node<'a>, actor: usize) {
        if !self.is_controlled(actor) {
            let text =
                "the mode `follow` leaves the motion open: the entity moves as with `position`";
            self.note_once(Some(action.note(text)));
        }
    }

    /// Remembers an action that the controller of an entity replaces.
    pub(super) fn mark_replaced(&mut self, node: Node<'a>, actor: usize) {
        if let Some(motion) = self.motion.get_mut(actor)
            && motion.has_active_controller()
        {
            motion.replaced.push(node);
        }
    }

    /// Returns the change of a speed action, within the limits of the vehicle.
    fn speed_change<'p>(
        &mut self,
        speed: &SpeedAction<'a>,
        actor: usize,
        start_s: f64,
    ) -> Result<PlanChange<'p>> {
        let reference_mps = self.reference_mps(speed, start_s);
        let to_mps = speed.target.speed_mps(speed.node, reference_mps)?;
        let change_mps = to_mps - self.speed_mps(actor, start_s);
        let [brake_mps2, accel_mps2] = self.limits_mps2(actor);
        let limit_mps2 = if change_mps < 0.0 {
            brake_mps2
        } else {
            accel_mps2
        };
        let mut dynamics = speed.dynamics;
        if dynamics.limit(change_mps, limit_mps2) && !self.is_controlled(actor) {
            self.note_limit(speed.node, dynamics, [brake_mps2, accel_mps2]);
        }
        if dynamics.duration_s(change_mps) == Some(f64::INFINITY) {
            let text = "at a rate of 0 the speed never changes: the action has no end";
            self.note_once(Some(speed.node.note(text)));
        }
        Ok(PlanChange::Speed(to_mps, dynamics))
    }

    /// Applies a change to the plan of an entity, and returns its end.
    fn apply(
        &mut self,
        node: Node<'a>,
        actor: usize,
        action: &StoryAction<'a>,
        change: PlanChange<'_>,
        start_s: f64,
    ) -> Result<f64> {
        let left = &mut self.samples_left;
        let Some(motion) = self.motion.get_mut(actor) else {
            return Ok(start_s);
        };
        match (change, action) {
            (PlanChange::Speed(to_mps, dynamics), _) => motion
                .plan
                .change_speed(node, start_s, to_mps, dynamics, left),
            (PlanChange::Profile(entries), _) => {
                take_samples(node, entries.len(), left)?;
                Ok(motion.follow_profile(entries, start_s))
            }
            (PlanChange::Trajectory(vertices), StoryAction::Trajectory(trajectory)) => {
                Ok(self.follow_trajectory(trajectory, actor, &vertices))
            }
            (PlanChange::Until(end_s), _) => Ok(end_s),
            (PlanChange::Trajectory(_), _) => Ok(start_s),
        }
    }

    /// Adds a note, unless an earlier execution of the same element has added it.
    pub(super) fn note_once(&mut self, note: Option<String>) {
        if let Some(note) = note
            && self.noted.insert(note.clone())
        {
            self.notes.push(note);
        }
    }

    /// Notes a change that the vehicle cannot drive as fast as stated.
    fn note_limit(&mut self, node: Node<'a>, dynamics: TransitionDynamics, limits_mps2: [f64; 2]) {
        let limited = match dynamics.dimension {
            TransitionDimension::Time => {
                let time = format_fixed(dynamics.value, 2);
                format!("the change takes {time} s, because its rate")
            }
            _ => "the rate".to_owned(),
        };
        let limits = limits_mps2.map(|limit| format_fixed(limit, 1));
        self.note_once(Some(node.note(format!(
            "{limited} is limited to what the vehicle can drive: {} m/s² of braking, {} m/s² of acceleration",
            limits[0], limits[1]
        ))));
    }

    /// Lets a scripted entity keep its speed relative to another one.
    fn follow_speed(&mut self, actor: usize, action: &SpeedAction<'a>, start_s: f64) {
        let motion = self.motion.get(actor);
        if let Some(reference) = action.target.reference
            && motion.is_some_and(|motion| !motion.is_controlled)
        {
            let times_s = [start_s, f64::INFINITY];
            let domain = ActionDomains::LONGITUDINAL;
            self.follow_entity(action.node, [actor, reference], domain, times_s);
        }
    }

    /// Lets the first entity follow the second one between two times.
    pub(super) fn follow_entity(
        &mut self,
        node: Node<'a>,
        [actor, reference]: [usize; 2],
        domain: ActionDomains,
        [start_s, end_s]: [f64; 2],
    ) {
        self.followings.push(Following {
            node,
            actor,
            reference,
            domain,
            start_s,
            end_s,
        });
    }

    /// Ends what an entity follows in some domains.
    pub(super) fn end_following(
        &mut self,
        node: Node<'a>,
        actor: usize,
        domains: ActionDomains,
        time_s: f64,
    ) -> Result<()> {
        self.work.spend(node, self.followings.len() as u64)?;
        for following in &mut self.followings {
            if following.actor == actor && following.domain.overlaps(domains) {
                following.end_s = following.end_s.min(time_s);
            }
        }
        Ok(())
    }

    /// Refuses actions that follow an entity, if its speed or its lateral position changes meanwhile.
    pub(super) fn check_followed(&self) -> Result<()> {
        for following in &self.followings {
            let Some(reference) = self.motion.get(following.reference) else {
                continue;
            };
            // Its speed and its lane depend on its controller; a note states the assumption.
            if reference.has_active_controller() {
                continue;
            }
            let steps = reference.plan.knots().len() + reference.lateral.moves().len();
            self.work
                .spend(following.node, WORK_PER_SAMPLE * steps as u64)?;
            let times_s = [following.start_s, following.end_s.min(self.now_s)];
            let (changes, quantity) = if following.domain.overlaps(ActionDomains::LONGITUDINAL) {
                (reference.plan.changes_between(times_s), "speed")
            } else {
                let changes = reference.lateral.changes_between(&reference.plan, times_s);
                (changes, "lateral position")
            };
            if changes {
                return Err(following.node.refuse(format!(
                    "follows the {quantity} of an entity that changes: scripts depend only on the time"
                )));
            }
        }
        Ok(())
    }

    /// Notes a change of a script at a time that depends on a controller.
    fn note_dependence(&mut self, node: Node<'a>, actor: usize, before: &SpeedPlan) {
        let motion = self.motion.get(actor);
        if motion.is_some_and(|motion| motion.plan.differs_from(before)) {
            self.note_once(Some(node.note(
                "depends on an entity with a controller: its time is that with the default controller",
            )));
        }
    }

    /// Returns the largest braking and acceleration of an entity.
    pub(super) fn limits_mps2(&self, entity: usize) -> [f64; 2] {
        let limits = self.entities.get(entity).map_or([None; 2], |body| {
            [
                body.max_brake_mps2.map(|limit| limit * self.friction),
                body.max_accel_mps2,
            ]
        });
        limits.map(|limit| {
            limit
                .filter(|limit| *limit > 0.0)
                .unwrap_or(UNSTATED_LIMIT_MPS2)
        })
    }

    /// Keeps the speed or the lateral position of an entity from a time on, because its action has ended early.
    pub(super) fn hold(
        &mut self,
        node: Node<'a>,
        actor: usize,
        domains: ActionDomains,
        stop: Firing,
    ) -> Result<()> {
        self.end_following(node, actor, domains, stop.time_s)?;
        let Some(motion) = self.motion.get_mut(actor) else {
            return Ok(());
        };
        if domains.overlaps(ActionDomains::LATERAL) {
            motion.lateral.cut(stop.time_s, &motion.plan);
        }
        if domains.overlaps(ActionDomains::LONGITUDINAL) {
            let is_noted = stop.depends_on_controller && !motion.is_controlled;
            self.work.spend(node, motion.change_work(is_noted))?;
            let before = is_noted.then(|| motion.plan.clone());
            motion.plan.cut(stop.time_s);
            motion.actions.push((stop.time_s, node));
            if let Some(before) = before {
                self.note_dependence(node, actor, &before);
            }
        }
        Ok(())
    }

    /// Returns a note if the target of an action is relative to the speed of a controlled entity.
    fn constant_speed_note(&self, action: &StoryAction<'a>) -> Option<String> {
        let StoryAction::Speed(speed) = action else {
            return None;
        };
        let reference = speed.target.reference;
        let reference = reference.filter(|entity| self.is_controlled(*entity))?;
        let name = &self.entities.get(reference)?.name;
        let then = if speed.target.is_continuous {
            " and kept its speed from then on"
        } else {
            ""
        };
        Some(speed.node.note(format!(
            "is relative to `{name}`, as if the default controller drove it{then}"
        )))
    }
}
