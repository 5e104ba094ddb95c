//! Elements of the storyboard, their states and their transitions (ASAM OpenSCENARIO XML 1.3.1, 8.1 to 8.4).

use super::constructs::ActionDomains;
use super::storyboard::StoryAction;
use super::trigger::Trigger;
use super::vocabulary::{AwaitedState, ElementKind, Priority};
use super::xml::Node;
use std::rc::Rc;

/// State of an element (8.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ElementState {
    /// The element around it has not started.
    Init,
    Standby,
    Running,
    Complete,
}

/// Change of the state of an element (8.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ElementTransition {
    Start,
    /// The element has reached its goal.
    End,
    /// A stop trigger, an event with the priority override or another action ends the element.
    Stop,
    /// The priority `skip` prevents the start.
    Skip,
}

/// The last transition of a kind.
#[derive(Debug, Clone, Copy)]
pub(super) struct TransitionMark {
    /// Number of the transition among those of all elements.
    pub(super) serial: u64,
    pub(super) time_s: f64,
}

/// An element of the storyboard.
pub(super) struct StoryElement<'a> {
    pub(super) node: Node<'a>,
    pub(super) kind: ElementKind,
    pub(super) name: String,
    pub(super) parent: Option<usize>,
    pub(super) children: Vec<usize>,
    pub(super) priority: Priority,
    /// Maximum number of executions.
    pub(super) max_executions: u32,
    pub(super) actors: Rc<[usize]>,
    /// Action of an element of this kind.
    pub(super) action: Option<Rc<StoryAction<'a>>>,
    /// Domains that the action controls.
    pub(super) domains: ActionDomains,
    pub(super) start: Option<Trigger<'a>>,
    pub(super) stop: Option<Trigger<'a>>,
    pub(super) state: ElementState,
    pub(super) state_since_s: f64,
    pub(super) executions: u32,
    /// Step in which the event was skipped last.
    pub(super) skipped_s: Option<f64>,
    /// Last transitions, in the order of `ElementTransition`.
    marks: [Option<TransitionMark>; 4],
    /// Time of the first start.
    pub(super) started_s: Option<f64>,
    /// True if a transition depends on a controller.
    pub(super) depends_on_controller: bool,
}

impl<'a> StoryElement<'a> {
    pub(super) fn new(node: Node<'a>, kind: ElementKind, name: String) -> Self {
        Self {
            node,
            kind,
            name,
            parent: None,
            children: Vec::new(),
            priority: Priority::Parallel,
            max_executions: 1,
            actors: Rc::default(),
            action: None,
            domains: ActionDomains::NONE,
            start: None,
            stop: None,
            state: ElementState::Init,
            state_since_s: 0.0,
            executions: 0,
            skipped_s: None,
            marks: [None; 4],
            started_s: None,
            depends_on_controller: false,
        }
    }

    pub(super) fn mark(&self, transition: ElementTransition) -> Option<TransitionMark> {
        self.marks.get(transition as usize).copied().flatten()
    }

    /// Changes the state by a transition.
    pub(super) fn change(
        &mut self,
        transition: ElementTransition,
        state: ElementState,
        mark: TransitionMark,
    ) {
        if let Some(slot) = self.marks.get_mut(transition as usize) {
            *slot = Some(mark);
        }
        if transition == ElementTransition::Start && self.started_s.is_none() {
            self.started_s = Some(mark.time_s);
        }
        self.set_state(state, mark.time_s);
    }

    pub(super) fn set_state(&mut self, state: ElementState, time_s: f64) {
        if self.state != state {
            self.state = state;
            self.state_since_s = time_s;
        }
    }

    /// Returns true for an action that activates the controller of an entity.
    pub(super) fn activates(&self, entity: usize) -> bool {
        let activates = matches!(self.action.as_deref(), Some(StoryAction::Activate));
        activates && self.actors.contains(&entity)
    }

    /// Returns true if no execution is left.
    pub(super) fn is_exhausted(&self) -> bool {
        self.executions >= self.max_executions
    }
}

/// State or transition for which a condition waits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Awaited {
    State(ElementState),
    Transition(ElementTransition),
}

impl From<AwaitedState> for Awaited {
    fn from(state: AwaitedState) -> Self {
        match state {
            AwaitedState::Standby => Self::State(ElementState::Standby),
            AwaitedState::Running => Self::State(ElementState::Running),
            AwaitedState::Complete => Self::State(ElementState::Complete),
            AwaitedState::Start => Self::Transition(ElementTransition::Start),
            AwaitedState::End => Self::Transition(ElementTransition::End),
            AwaitedState::Stop => Self::Transition(ElementTransition::Stop),
            AwaitedState::Skip => Self::Transition(ElementTransition::Skip),
        }
    }
}
