//! Limits of an import, each of which is checked before the work begins. `docs/exchange.md` states them.

use std::cell::Cell;

use super::error::ScenarioImportError;
use super::xml::{ElementLocation, Node};

/// Maximum duration, in seconds.
pub(super) const MAX_DURATION_S: f64 = 3600.0;
/// Maximum number of entities: that of the vehicles of a scenario.
pub(super) const MAX_ENTITIES: usize = 1000;
/// Maximum number of actions in `Init`, and of their groups.
pub(super) const MAX_INITIAL_ACTIONS: usize = 10_000;
/// Maximum number of environments in `Init`.
pub(super) const MAX_ENVIRONMENTS: usize = 100;
/// Maximum number of events, and of acts.
pub(super) const MAX_EVENTS: usize = 2000;
/// Maximum number of actions of all events, each counted for each entity that does it.
pub(super) const MAX_EVENT_ACTIONS: usize = 20_000;
/// Maximum value of `maximumExecutionCount`.
pub(super) const MAX_EXECUTIONS: f64 = 100_000.0;
/// Maximum number of conditions and their groups.
const MAX_CONDITIONS: usize = 10_000;
/// Maximum number of entities in all conditions.
const MAX_CONDITION_ENTITIES: usize = 100_000;
/// Maximum sum of the delays of all conditions, in seconds. A delay takes up to 800 bytes of memory per second.
const MAX_TOTAL_DELAY_S: f64 = 100_000.0;
/// Maximum number of samples of curved transitions, entries of speed profiles and vertices of trajectories, each
/// counted for each entity that does the action.
pub(super) const MAX_SAMPLES: usize = 400_000;
/// Maximum number of steps times vehicles of a scenario.
pub(super) const MAX_VEHICLE_STEPS: f64 = 5e6;
/// Maximum number of declarations of parameters with their constraints, and of assignments.
pub(super) const MAX_PARAMETERS: usize = 1000;
/// Maximum length of the value of a parameter, and of an expression, in bytes.
pub(super) const MAX_VALUE_BYTES: usize = 1000;
/// Maximum number of properties of an entity or a controller.
pub(super) const MAX_PROPERTIES: usize = 100;
/// Maximum number of lanes of a road.
pub(super) const MAX_LANES: usize = 200;

/// Maximum work of an import with all its variations, in units of about a nanosecond.
const MAX_WORK: u64 = 4_000_000_000;
/// Work of an import for each element and attribute of the files.
pub(super) const WORK_PER_ITEM: u64 = 50;
/// Work for each road that is compared with a point.
pub(super) const WORK_PER_ROAD: u64 = 150;
/// Work for each initial speed and each attempt to resolve its reference.
pub(super) const WORK_PER_INITIAL_SPEED: u64 = 20;
/// Work for each sample of a motion: to make, check, write and compare it.
pub(super) const WORK_PER_SAMPLE: u64 = 1000;
/// Work of finding an entry of a catalogue, with its parameters.
pub(super) const WORK_PER_ENTRY: u64 = 100 * WORK_PER_SAMPLE;

/// Refuses an element that contains more than `max_count` things, which `what` names.
pub(super) fn ensure_at_most(
    node: Node<'_>,
    count: usize,
    max_count: usize,
    what: &str,
) -> Result<(), ScenarioImportError> {
    if count > max_count {
        Err(node.refuse(format!("has more than {max_count} {what}")))
    } else {
        Ok(())
    }
}

/// Work that an import may still do.
#[derive(Debug)]
pub(super) struct WorkBudget {
    left: Cell<u64>,
}

impl WorkBudget {
    pub(super) fn new() -> Self {
        Self {
            left: Cell::new(MAX_WORK),
        }
    }

    /// Takes work from the budget before it is done.
    pub(super) fn spend(&self, node: Node<'_>, units: u64) -> Result<(), ScenarioImportError> {
        let left = self.left.get().checked_sub(units).ok_or_else(|| {
            let ElementLocation { path, line, name } = node.location();
            ScenarioImportError::TooMuchWork {
                path: path.to_path_buf(),
                line,
                element: name,
                reason: format!(
                    "the import needs more than {MAX_WORK} units of work: use fewer variations, a shorter duration, \
                     or fewer events, conditions or entities (docs/exchange.md)"
                ),
            }
        })?;
        self.left.set(left);
        Ok(())
    }
}

/// Number and delays of the conditions that were read.
#[derive(Debug, Default)]
pub(super) struct ConditionCount {
    conditions: usize,
    entities: usize,
    delay_s: f64,
}

impl ConditionCount {
    pub(super) fn add_group(&mut self, group: Node<'_>) -> Result<(), ScenarioImportError> {
        self.conditions += 1 + group.children().count();
        if self.conditions <= MAX_CONDITIONS {
            return Ok(());
        }
        Err(group.refuse(format!(
            "there are more than {MAX_CONDITIONS} conditions and groups of them"
        )))
    }

    pub(super) fn add_entities(
        &mut self,
        node: Node<'_>,
        count: usize,
    ) -> Result<(), ScenarioImportError> {
        self.entities += count;
        if self.entities <= MAX_CONDITION_ENTITIES {
            return Ok(());
        }
        Err(node.refuse(format!(
            "there are more than {MAX_CONDITION_ENTITIES} entities in conditions"
        )))
    }

    pub(super) fn add_delay_s(
        &mut self,
        node: Node<'_>,
        delay_s: f64,
    ) -> Result<(), ScenarioImportError> {
        self.delay_s += delay_s.min(MAX_DURATION_S);
        if self.delay_s > MAX_TOTAL_DELAY_S {
            return Err(node.refuse(format!(
                "the delays of all conditions exceed {MAX_TOTAL_DELAY_S} s"
            )));
        }
        Ok(())
    }
}
