//! Interpreter of the storyboard: lets its elements start, run and end, step by step (ASAM OpenSCENARIO XML 1.3.1, 8).
//!
//! In each step, actions that have reached their goal end first. Then the triggers of acts and events are evaluated.
//! Events that start in the same step start in the order of their times. A transition is visible to each condition
//! until its next evaluation, which is one step.

use super::constructs::ActionDomains;
use super::element::{ElementState, ElementTransition, TransitionMark};
use super::error::ScenarioImportError;
use super::limits::ConditionCount;
use super::limits::MAX_DURATION_S;
use super::replay::{EntityMotion, REPLAY_STEP_S, Replay};
use super::storyboard::StoryAction;
use super::trigger::{Firing, Trigger};
use super::vocabulary::{ElementKind, Priority};
use super::xml::Node;
use std::collections::BTreeMap;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Number of steps for which the work is computed together.
const STEPS_PER_CHECK: usize = 100;
/// Maximum number of events that start each other within a step.
const MAX_PASSES: usize = 10;
/// Work of a step without any element.
const WORK_PER_STEP: u64 = 50;
/// Work of starting, ending or stopping an element.
const WORK_PER_CHANGE: u64 = 200;

/// An action that an entity does.
#[derive(Debug, Clone, Copy)]
pub(super) struct ActiveAction {
    /// Index of the action among the elements.
    pub(super) element: usize,
    pub(super) actor: usize,
    pub(super) domains: ActionDomains,
    pub(super) goal: ActionGoal,
}

/// End of an action that is not stopped.
#[derive(Debug, Clone, Copy)]
pub(super) enum ActionGoal {
    Time(f64),
    /// End of the last lateral movement, which depends on later speeds.
    LateralMove,
}

impl ActionGoal {
    /// Returns true for a change of the speed that takes no time. A lateral action takes time, also without a
    /// displacement (7.5.2).
    fn is_instant(self, start_s: f64) -> bool {
        match self {
            Self::Time(end_s) => end_s <= start_s,
            Self::LateralMove => false,
        }
    }
}

/// Elements with triggers.
struct TriggeredElements {
    acts: Vec<usize>,
    groups: Vec<usize>,
    events: Vec<usize>,
}

impl<'a> Replay<'a, '_> {
    /// Returns the number of transitions so far.
    pub(super) fn serial(&self) -> u64 {
        self.serials[0]
    }

    /// Returns the number of transitions before this step.
    pub(super) fn step_serial(&self) -> u64 {
        self.serials[1]
    }

    /// Replays until the stop trigger fires.
    pub(super) fn run(
        &mut self,
        mut conditions: ConditionCount,
        storyboard: Node<'a>,
    ) -> Result<Firing> {
        let node = storyboard.optional("StopTrigger");
        let stop = match node {
            Some(node) => Trigger::read(node, self.entities, &mut conditions)?,
            None => None,
        };
        let mut stop = stop.ok_or_else(|| {
            storyboard.refuse("has no stop trigger, which determines the duration")
        })?;
        super::storyboard::resolve_trigger(&mut stop, &self.elements)?;
        self.latest_stop_s = stop.latest_s();
        let triggered = self.triggered_elements();
        let stories = self.indices(ElementKind::Story);
        for story in stories {
            self.start(story, Firing::at(0.0))?;
        }
        let mut before_s = 0.0;
        let mut work = 0;
        for step in 0..=(MAX_DURATION_S / REPLAY_STEP_S) as usize {
            if step % STEPS_PER_CHECK == 0 {
                work = self.step_work(&triggered, &stop);
                self.work.spend(storyboard, STEPS_PER_CHECK as u64 * work)?;
            }
            self.now_s = step as f64 * REPLAY_STEP_S;
            self.step(&triggered, before_s, (storyboard, work))?;
            if let Some(firing) = stop.fires(self, [0.0, before_s, self.now_s])? {
                self.check_followed()?;
                return Ok(firing);
            }
            before_s = self.now_s;
            self.serials[1] = self.serials[0];
        }
        let stop = node.unwrap_or(storyboard);
        Err(stop.refuse(format!("does not fire within {MAX_DURATION_S} s")))
    }

    fn indices(&self, kind: ElementKind) -> Vec<usize> {
        let elements = self.elements.iter().enumerate();
        elements
            .filter(|(_, element)| element.kind == kind)
            .map(|(index, _)| index)
            .collect()
    }

    fn triggered_elements(&self) -> TriggeredElements {
        TriggeredElements {
            acts: self.indices(ElementKind::Act),
            groups: self
                .indices(ElementKind::ManeuverGroup)
                .into_iter()
                .filter(|index| {
                    self.elements
                        .get(*index)
                        .is_some_and(|group| group.max_executions > 1)
                })
                .collect(),
            events: self.indices(ElementKind::Event),
        }
    }

    /// Returns the work of a step, which evaluates the triggers of all acts and events in standby.
    fn step_work(&self, triggered: &TriggeredElements, stop: &Trigger<'a>) -> u64 {
        let plans = self.motion.iter().map(|motion| motion.plan.state_work());
        let state_work = plans.max().unwrap_or_default();
        let elements = triggered.acts.iter().chain(&triggered.events);
        let elements = elements.filter_map(|index| self.elements.get(*index));
        let waiting = elements.filter(|element| element.state != ElementState::Complete);
        let triggers = waiting.flat_map(|element| element.start.iter().chain(&element.stop));
        let triggers = triggers.chain([stop]);
        let count = triggered.acts.len() + triggered.groups.len() + triggered.events.len();
        let active = self.active.len() as u64 * (5 + state_work);
        let triggers: u64 = triggers.map(|trigger| trigger.work(state_work)).sum();
        WORK_PER_STEP + triggers + 2 * count as u64 + active
    }

    fn step(
        &mut self,
        triggered: &TriggeredElements,
        before_s: f64,
        (storyboard, work): (Node<'a>, u64),
    ) -> Result<()> {
        self.end_actions(self.now_s)?;
        for &act in &triggered.acts {
            self.stop_act(act, before_s)?;
        }
        for &act in &triggered.acts {
            self.start_act(act, before_s)?;
        }
        for &group in &triggered.groups {
            // A further execution begins when the last one has ended.
            let waiting = self.elements.get(group);
            let waiting = waiting.filter(|element| element.state == ElementState::Standby);
            if let Some(start_s) = waiting.map(|element| element.state_since_s.max(before_s)) {
                self.start(group, Firing::at(start_s))?;
            }
        }
        // Events may start because of others in the same step.
        for pass in 0..MAX_PASSES {
            if pass > 0 {
                self.work.spend(storyboard, work)?;
                self.end_actions(self.now_s)?;
            }
            if !self.start_events(&triggered.events, before_s)? {
                break;
            }
        }
        Ok(())
    }

    /// Starts the events whose triggers fire, in the order of their times. Returns false if there is none. An
    /// event is skipped at most once in a step.
    fn start_events(&mut self, events: &[usize], before_s: f64) -> Result<bool> {
        let mut firings = Vec::new();
        for &event in events {
            if self.was_skipped(event) {
                continue;
            }
            if let Some(firing) = self.fires(event, before_s)? {
                firings.push((event, firing));
            }
        }
        firings.sort_by(|a, b| a.1.time_s.total_cmp(&b.1.time_s));
        let has_started = !firings.is_empty();
        for (event, firing) in firings {
            // A lateral action without a displacement is complete just after its start.
            self.end_actions(firing.time_s.next_down())?;
            if self.state(event) == ElementState::Standby {
                self.trigger_event(event, firing)?;
            }
        }
        Ok(has_started)
    }

    /// Returns true if an event was skipped in this step.
    fn was_skipped(&self, event: usize) -> bool {
        let skipped_s = self.elements.get(event).and_then(|event| event.skipped_s);
        skipped_s == Some(self.now_s)
    }

    fn state(&self, index: usize) -> ElementState {
        let element = self.elements.get(index);
        element.map_or(ElementState::Complete, |element| element.state)
    }

    /// Returns the time at which the start trigger of an element in standby fires in this step.
    fn fires(&mut self, index: usize, before_s: f64) -> Result<Option<Firing>> {
        let Some(element) = self.elements.get_mut(index) else {
            return Ok(None);
        };
        if element.state != ElementState::Standby {
            return Ok(None);
        }
        let armed_s = element.state_since_s;
        let parent = element.parent;
        let Some(mut trigger) = element.start.take() else {
            // An event without a trigger starts with its act (8.4.2).
            return Ok(Some(self.inherited(parent, armed_s)));
        };
        let firing = trigger.fires(self, [armed_s, before_s, self.now_s]);
        if let Some(element) = self.elements.get_mut(index) {
            element.start = Some(trigger);
        }
        let inherited = self.inherited(parent, armed_s);
        Ok(firing?.map(|firing| Firing {
            time_s: firing.time_s.max(armed_s),
            depends_on_controller: firing.depends_on_controller || inherited.depends_on_controller,
        }))
    }

    /// Returns the time at which an element entered standby.
    fn inherited(&self, parent: Option<usize>, armed_s: f64) -> Firing {
        let parent = parent.and_then(|parent| self.elements.get(parent));
        Firing {
            time_s: armed_s,
            depends_on_controller: parent.is_some_and(|parent| parent.depends_on_controller),
        }
    }

    fn start_act(&mut self, act: usize, before_s: f64) -> Result<()> {
        match self.fires(act, before_s)? {
            Some(firing) => self.start(act, firing),
            None => Ok(()),
        }
    }

    fn stop_act(&mut self, act: usize, before_s: f64) -> Result<()> {
        let Some(element) = self.elements.get_mut(act) else {
            return Ok(());
        };
        if element.state != ElementState::Running {
            return Ok(());
        }
        let armed_s = element.state_since_s;
        let Some(mut trigger) = element.stop.take() else {
            return Ok(());
        };
        let firing = trigger.fires(self, [armed_s, before_s, self.now_s]);
        if let Some(element) = self.elements.get_mut(act) {
            element.stop = Some(trigger);
        }
        match firing? {
            Some(firing) => self.stop(act, firing),
            None => Ok(()),
        }
    }

    /// Changes the state of an element by a transition.
    fn change(
        &mut self,
        index: usize,
        transition: ElementTransition,
        state: ElementState,
        at: Firing,
    ) -> Result<()> {
        self.serials[0] += 1;
        let mark = TransitionMark {
            serial: self.serials[0],
            time_s: at.time_s,
        };
        let Some(element) = self.elements.get_mut(index) else {
            return Ok(());
        };
        self.work.spend(element.node, WORK_PER_CHANGE)?;
        element.depends_on_controller |= at.depends_on_controller;
        element.change(transition, state, mark);
        Ok(())
    }

    fn children(&self, index: usize) -> Vec<usize> {
        let element = self.elements.get(index);
        element.map_or_else(Vec::new, |element| element.children.clone())
    }

    /// Starts a story, an act, a maneuver group or a maneuver, with the elements in it (8.3).
    fn start(&mut self, index: usize, at: Firing) -> Result<()> {
        self.change(index, ElementTransition::Start, ElementState::Running, at)?;
        if let Some(element) = self.elements.get_mut(index) {
            element.executions += 1;
        }
        for child in self.children(index) {
            let Some(element) = self.elements.get_mut(child) else {
                continue;
            };
            let waits = element.kind == ElementKind::Event
                || element.kind == ElementKind::Act && element.start.is_some();
            if waits {
                element.depends_on_controller |= at.depends_on_controller;
                element.set_state(ElementState::Standby, at.time_s);
                element.state_since_s = at.time_s;
            } else {
                self.start(child, at)?;
            }
        }
        self.end_if_done(index, at)
    }

    /// Ends an element whose parts are complete (8.3).
    fn end_if_done(&mut self, index: usize, at: Firing) -> Result<()> {
        if self.state(index) != ElementState::Running {
            return Ok(());
        }
        let Some(element) = self.elements.get(index) else {
            return Ok(());
        };
        self.work
            .spend(element.node, element.children.len() as u64)?;
        let mut children = element.children.iter();
        if children.all(|child| self.state(*child) == ElementState::Complete) {
            self.end(index, at)?;
        }
        Ok(())
    }

    /// Ends an element that has reached its goal. It waits for its next execution, if there is one (8.4.2.1).
    fn end(&mut self, index: usize, at: Firing) -> Result<()> {
        let Some(element) = self.elements.get(index) else {
            return Ok(());
        };
        let parent = element.parent;
        if element.is_exhausted() || element.kind == ElementKind::Action {
            self.change(index, ElementTransition::End, ElementState::Complete, at)?;
            return parent.map_or(Ok(()), |parent| self.end_if_done(parent, at));
        }
        self.change(index, ElementTransition::End, ElementState::Standby, at)?;
        for child in self.children(index) {
            self.reset(child);
        }
        if let Some(trigger) = self
            .elements
            .get_mut(index)
            .and_then(|element| element.start.as_mut())
        {
            trigger.reset();
        }
        Ok(())
    }

    /// Prepares an element for another execution of the element around it.
    fn reset(&mut self, index: usize) {
        for child in self.children(index) {
            self.reset(child);
        }
        if let Some(element) = self.elements.get_mut(index) {
            element.set_state(ElementState::Init, self.now_s);
            element.executions = 0;
            for trigger in element.start.iter_mut().chain(&mut element.stop) {
                trigger.reset();
            }
        }
    }

    /// Stops an element with the elements in it (8.1).
    fn stop(&mut self, index: usize, at: Firing) -> Result<()> {
        self.stop_inside(index, at)?;
        let parent = self.elements.get(index).and_then(|element| element.parent);
        parent.map_or(Ok(()), |parent| self.end_if_done(parent, at))
    }

    fn stop_inside(&mut self, index: usize, at: Firing) -> Result<()> {
        for child in self.children(index) {
            self.stop_inside(child, at)?;
        }
        match self.state(index) {
            ElementState::Running | ElementState::Standby => {}
            ElementState::Init | ElementState::Complete => return Ok(()),
        }
        let node = self.elements.get(index).map(|element| element.node);
        let (stopped, kept) = self
            .active
            .iter()
            .partition(|active| active.element == index);
        self.active = kept;
        let stopped: Vec<ActiveAction> = stopped;
        for active in &stopped {
            if let Some(node) = node {
                self.hold(node, active.actor, active.domains, at)?;
            }
        }
        self.change(index, ElementTransition::Stop, ElementState::Complete, at)
    }

    /// Starts an event whose trigger has fired, as its priority demands (8.4.2.2).
    fn trigger_event(&mut self, index: usize, at: Firing) -> Result<()> {
        let Some(event) = self.elements.get_mut(index) else {
            return Ok(());
        };
        let (node, priority, parent) = (event.node, event.priority, event.parent);
        event.executions += 1;
        let mut running = parent.map_or_else(Vec::new, |parent| self.children(parent));
        self.work.spend(node, 4 * running.len() as u64)?;
        running
            .retain(|sibling| *sibling != index && self.state(*sibling) == ElementState::Running);
        if priority == Priority::Skip && !running.is_empty() {
            return self.skip_event(index, at);
        }
        self.change(index, ElementTransition::Start, ElementState::Running, at)?;
        if priority == Priority::Override {
            for sibling in running {
                self.stop(sibling, at)?;
            }
        }
        let actions = self.children(index);
        for &action in &actions {
            self.start_action(action, at)?;
        }
        for action in actions {
            if self.state(action) == ElementState::Running
                && self.active.iter().all(|active| active.element != action)
            {
                self.end(action, at)?;
            }
        }
        self.end_if_done(index, at)
    }

    /// Lets an execution of an event pass. The event waits for the next one, if there is one (8.4.2.2).
    fn skip_event(&mut self, index: usize, at: Firing) -> Result<()> {
        let Some(event) = self.elements.get_mut(index) else {
            return Ok(());
        };
        event.skipped_s = Some(self.now_s);
        let parent = event.parent;
        let state = if event.is_exhausted() {
            ElementState::Complete
        } else {
            ElementState::Standby
        };
        self.change(index, ElementTransition::Skip, state, at)?;
        parent.map_or(Ok(()), |parent| self.end_if_done(parent, at))
    }

    /// Starts an action for each of its entities. It replaces those of the same domain (7.5.1).
    fn start_action(&mut self, index: usize, at: Firing) -> Result<()> {
        self.change(index, ElementTransition::Start, ElementState::Running, at)?;
        let Some(element) = self.elements.get(index) else {
            return Ok(());
        };
        let (node, domains) = (element.node, element.domains);
        let actors = element.actors.clone();
        let Some(action) = element.action.clone() else {
            return Ok(());
        };
        if actors.is_empty() {
            if let StoryAction::Variable(change) = &*action {
                self.variables.change(node, change, at.time_s)?;
            }
            return Ok(());
        }
        for &actor in actors.iter() {
            self.work.spend(node, 2 * self.active.len() as u64)?;
            let conflicts = self.active.iter().filter(|active| {
                active.actor == actor && active.domains.overlaps(domains) && active.element != index
            });
            let conflicts: Vec<usize> = conflicts.map(|active| active.element).collect();
            for conflict in conflicts {
                self.stop(conflict, at)?;
            }
            self.stop_initial_controls(node, actor, domains, at)?;
            self.end_following(node, actor, domains, at.time_s)?;
            let goal = self.begin_action(node, actor, &action, at)?;
            let active = goal.map(|goal| ActiveAction {
                element: index,
                actor,
                domains,
                goal,
            });
            self.active
                .extend(active.filter(|active| !active.goal.is_instant(at.time_s)));
        }
        Ok(())
    }

    /// Stops the actions of `Init` that control an entity, if an action in one of their domains begins.
    pub(super) fn stop_initial_controls(
        &mut self,
        node: Node<'a>,
        actor: usize,
        domains: ActionDomains,
        at: Firing,
    ) -> Result<()> {
        self.work.spend(node, self.initial_controls.len() as u64)?;
        let is_stopped =
            |control: &(usize, ActionDomains)| control.0 == actor && control.1.overlaps(domains);
        let controls = std::mem::take(&mut self.initial_controls);
        let (stopped, kept): (Vec<_>, Vec<_>) = controls.into_iter().partition(is_stopped);
        self.initial_controls = kept;
        for (actor, controlled) in stopped {
            self.hold(node, actor, controlled, at)?;
        }
        Ok(())
    }

    /// Begins an action of an entity, and returns its goal; `None` if the action is complete at once.
    pub(super) fn begin_action(
        &mut self,
        node: Node<'a>,
        actor: usize,
        action: &StoryAction<'a>,
        at: Firing,
    ) -> Result<Option<ActionGoal>> {
        match action {
            StoryAction::LaneChange(change) => self.change_lane(change, actor, at).map(Some),
            StoryAction::LaneOffset(offset) => self.change_offset(offset, actor, at).map(Some),
            StoryAction::Route(route) => self.follow_route(*route, actor).map(|()| None),
            StoryAction::Trajectory(line) if !line.is_timed() => {
                self.follow_line(line, actor, at).map(Some)
            }
            StoryAction::Speed(_) | StoryAction::SpeedProfile(_) | StoryAction::Trajectory(_) => {
                let end_s = self.change_plan(node, actor, action, at)?;
                Ok(Some(ActionGoal::Time(end_s)))
            }
            StoryAction::Activate => self.activate(node, actor, at.time_s).map(|()| None),
            StoryAction::Variable(_) | StoryAction::Ignored(_) => Ok(None),
        }
    }

    /// Activates the controller of an entity. An activation assigns no control strategy, so that it stops no action
    /// (Annex A, Table 7, and 7.5.1).
    fn activate(&mut self, node: Node<'a>, actor: usize, time_s: f64) -> Result<()> {
        let Some(motion) = self.motion.get_mut(actor) else {
            return Ok(());
        };
        let changes = |motion: &EntityMotion<'_>| {
            let times_s = [time_s, f64::INFINITY];
            motion.lateral.changes_between(&motion.plan, times_s)
        };
        if motion.is_inactive() && changes(motion) {
            let problem =
                "activates a controller during a lane change: its vehicle must keep its lane";
            return Err(node.refuse(problem));
        }
        let activated_s = motion.activated_s.unwrap_or(time_s);
        motion.activated_s = Some(activated_s.min(time_s));
        Ok(())
    }

    /// Ends the actions that have reached their goals, in the order of their ends.
    fn end_actions(&mut self, until_s: f64) -> Result<()> {
        let has_ended = |active: &ActiveAction| {
            let end_s = self.goal_s(active, until_s);
            end_s.is_some_and(|end_s| end_s <= until_s)
        };
        if !self.active.iter().any(has_ended) {
            return Ok(());
        }
        let mut ends: BTreeMap<usize, f64> = BTreeMap::new();
        let active = std::mem::take(&mut self.active);
        let (ended, running): (Vec<_>, Vec<_>) = active
            .into_iter()
            .map(|active| (active, self.goal_s(&active, until_s)))
            .partition(|(_, end_s)| end_s.is_some_and(|end_s| end_s <= until_s));
        self.active = running.into_iter().map(|(active, _)| active).collect();
        for (active, end_s) in ended {
            let end_s = end_s.unwrap_or(until_s);
            let last_s = ends.entry(active.element).or_insert(end_s);
            *last_s = last_s.max(end_s);
        }
        for active in &self.active {
            ends.remove(&active.element);
        }
        let mut ends: Vec<(usize, f64)> = ends.into_iter().collect();
        ends.sort_by(|a, b| a.1.total_cmp(&b.1));
        for (element, end_s) in ends {
            if self.state(element) == ElementState::Running {
                self.end(element, Firing::at(end_s))?;
            }
        }
        Ok(())
    }

    /// Returns the time at which an action reaches its goal; `None` if that may be later than `now_s`.
    fn goal_s(&self, active: &ActiveAction, now_s: f64) -> Option<f64> {
        match active.goal {
            ActionGoal::Time(end_s) => Some(end_s),
            ActionGoal::LateralMove => {
                let motion = self.motion.get(active.actor)?;
                let last = motion.lateral.moves().last()?;
                last.has_ended(now_s, &motion.plan)
                    .then(|| last.end_s(&motion.plan))
                    .flatten()
            }
        }
    }
}

impl Firing {
    pub(super) fn at(time_s: f64) -> Self {
        Self {
            time_s,
            depends_on_controller: false,
        }
    }
}
