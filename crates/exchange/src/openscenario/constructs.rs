//! Tables of the actions and conditions that the importer knows: a construct is a row with its clause of ASAM
//! OpenSCENARIO XML 1.3.1, its effect, and the function that reads it.

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::path_actions::{read_lane_change, read_lane_offset, read_route};
use super::quantity::{
    QuantityKind, read_at_rest, read_distance, read_end_of_road, read_position, read_quantity,
};
use super::storyboard::{
    StoryAction, read_activation, read_controller_action, read_profile, read_speed_action,
};
use super::trajectory_action::read_trajectory;
use super::trigger::{ConditionKind, read_element_state, read_never, read_time};
use super::variables::{read_value_condition, read_variable_change};
use super::vocabulary::path;
use super::xml::Node;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Domains of an entity's motion, in each of which one action at a time has control (7.5.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ActionDomains(u8);

impl ActionDomains {
    pub(super) const NONE: Self = Self(0);
    pub(super) const LONGITUDINAL: Self = Self(1);
    pub(super) const LATERAL: Self = Self(2);
    pub(super) const BOTH: Self = Self(3);

    pub(super) fn overlaps(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }
}

type ReadAction = for<'a, 'b, 'c> fn(Node<'a>, &'b [Entity<'c>]) -> Result<StoryAction<'a>>;
type ReadCondition = for<'a, 'b, 'c> fn(Node<'a>, &'b [Entity<'c>]) -> Result<ConditionKind<'a>>;

/// An action or a condition of the standard that the import knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KnownConstruct {
    /// Elements from the child of the action or the condition on, separated by `/`.
    pub element: &'static str,
    /// Section or table of ASAM OpenSCENARIO XML 1.3.1.
    pub clause: &'static str,
    /// `None` if the import reads the construct; otherwise why the construct has no influence, or is refused.
    pub reason: Option<&'static str>,
}

/// Returns the actions and conditions that the import knows.
#[must_use]
pub fn known_constructs() -> Vec<KnownConstruct> {
    let actions = ACTIONS.iter().map(|row| KnownConstruct {
        element: row.path,
        clause: row.clause,
        reason: match row.reading {
            Read(_) => None,
            Ignored(reason) | Refused(reason) => Some(reason),
        },
    });
    let conditions = CONDITIONS.iter().map(|row| KnownConstruct {
        element: row.element,
        clause: row.clause,
        reason: row.reading.err(),
    });
    actions.chain(conditions).collect()
}

/// Handling of an action.
enum ActionReading {
    Read(ReadAction),
    /// No influence on the motion along a lane, for a reason.
    Ignored(&'static str),
    /// Outside of what a scenario on one lane can represent, for a reason.
    Refused(&'static str),
}

/// An action that the importer knows.
struct ActionRow {
    /// Elements from the child of the action on; deeper elements are part of the action.
    path: &'static str,
    /// Section, or table of the annex, of the standard.
    clause: &'static str,
    /// Domains that the action controls (Annex A).
    domains: ActionDomains,
    reading: ActionReading,
}

const fn row(
    path: &'static str,
    clause: &'static str,
    domains: ActionDomains,
    reading: ActionReading,
) -> ActionRow {
    ActionRow {
        path,
        clause,
        domains,
        reading,
    }
}

use ActionReading::{Ignored, Read, Refused};

const UNSEEN: &str = "has no influence on the motion";
const STEERING: &str = "steers freely: vehicles follow lanes";
const REACTS: &str = "follows another entity, and the standard leaves its motion open";

/// Private actions (7.4.1, Table 7) and global actions (7.4.2, Table 8).
const ACTIONS: &[ActionRow] = &[
    row(
        path::SPEED_ACTION,
        "7.4.1.1, Table 7",
        ActionDomains::LONGITUDINAL,
        Read(read_speed_action),
    ),
    row(
        path::SPEED_PROFILE_ACTION,
        "7.4.1.1, Table 7",
        ActionDomains::LONGITUDINAL,
        Read(read_profile),
    ),
    row(
        path::DISTANCE_ACTION,
        "7.4.1.1, Table 7",
        ActionDomains::LONGITUDINAL,
        Refused(REACTS),
    ),
    row(
        path::LANE_CHANGE_ACTION,
        "7.4.1.2, Table 7",
        ActionDomains::LATERAL,
        Read(read_lane_change),
    ),
    row(
        path::LANE_OFFSET_ACTION,
        "7.4.1.2, Table 7",
        ActionDomains::LATERAL,
        Read(read_lane_offset),
    ),
    row(
        "LateralAction/LateralDistanceAction",
        "7.4.1.2, Table 7",
        ActionDomains::LATERAL,
        Refused(STEERING),
    ),
    row(
        path::TRAJECTORY_ACTION,
        "7.4.1.6, Table 7",
        ActionDomains::BOTH,
        Read(read_trajectory),
    ),
    row(
        "RoutingAction/AssignRouteAction",
        "7.4.1.6, Table 7",
        ActionDomains::NONE,
        Read(read_route),
    ),
    row(
        "RoutingAction/AcquirePositionAction",
        "7.4.1.6, Table 7",
        ActionDomains::NONE,
        Read(read_route),
    ),
    row(
        "RoutingAction/RandomRouteAction",
        "7.4.1.6, Table 7",
        ActionDomains::NONE,
        Refused("has a random route: vehicles stay on one road"),
    ),
    row(
        path::CONTROLLER_ACTION,
        "7.4.1.5, Table 7",
        ActionDomains::NONE,
        Read(read_controller_action),
    ),
    row(
        path::ACTIVATION,
        "7.4.1.5, Table 7",
        ActionDomains::NONE,
        Read(read_activation),
    ),
    row(
        "SynchronizeAction",
        "7.4.1.4, Table 7",
        ActionDomains::LONGITUDINAL,
        Refused(REACTS),
    ),
    row(
        path::TELEPORT_ACTION,
        "7.4.1.7, Table 7",
        ActionDomains::BOTH,
        Refused("jumps: vehicles move continuously after the start"),
    ),
    row(
        "VisibilityAction",
        "7.4.1.3, Table 7",
        ActionDomains::NONE,
        Ignored(UNSEEN),
    ),
    row(
        "AppearanceAction",
        "7.4.1.8, Table 7",
        ActionDomains::NONE,
        Ignored(UNSEEN),
    ),
    row(
        "TrailerAction",
        "7.4.1.9, Table 7",
        ActionDomains::NONE,
        Ignored("has no influence: vehicles have no trailers"),
    ),
    row(
        path::ENVIRONMENT_ACTION,
        "7.4.2, Table 8",
        ActionDomains::NONE,
        Ignored("has no influence: the road keeps its initial friction"),
    ),
    row(
        "ParameterAction",
        "7.4.2, Table 8",
        ActionDomains::NONE,
        Read(read_variable_change),
    ),
    row(
        "VariableAction",
        "7.4.2, Table 8",
        ActionDomains::NONE,
        Read(read_variable_change),
    ),
    row(
        "SetMonitorAction",
        "7.4.2, Table 8",
        ActionDomains::NONE,
        Ignored(UNSEEN),
    ),
    row(
        "InfrastructureAction",
        "7.4.2, Table 8",
        ActionDomains::NONE,
        Ignored("has no influence: scripted vehicles do not obey traffic lights"),
    ),
    row(
        "EntityAction",
        "7.4.2, Table 8",
        ActionDomains::NONE,
        Refused("adds or removes an entity: those of a scenario stay"),
    ),
    row(
        "TrafficAction",
        "7.4.2, Table 8",
        ActionDomains::NONE,
        Refused("adds random traffic: a scenario has its vehicles"),
    ),
    row(
        "CustomCommandAction",
        "7.4.3, Table 9",
        ActionDomains::NONE,
        Ignored(UNSEEN),
    ),
];

/// An action with the domains that it controls.
pub(super) struct KnownAction<'a> {
    pub(super) action: StoryAction<'a>,
    pub(super) domains: ActionDomains,
}

/// Reads the action in `PrivateAction`, `GlobalAction` or `UserDefinedAction`.
pub(super) fn find_action<'a>(
    holder: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<KnownAction<'a>> {
    let outer = holder.single()?;
    for row in ACTIONS {
        let mut names = row.path.split('/');
        if names.next() != Some(outer.name()) {
            continue;
        }
        let node = match names.next() {
            None => outer,
            Some(name) => match outer.single()? {
                inner if inner.name() == name => inner,
                _ => continue,
            },
        };
        let action = match row.reading {
            Read(read) => read(node, entities)?,
            Ignored(reason) => StoryAction::Ignored(reason),
            Refused(reason) => return Err(node.refuse(reason)),
        };
        let domains = match &action {
            StoryAction::Trajectory(trajectory) => trajectory.domains(),
            _ => row.domains,
        };
        return Ok(KnownAction { action, domains });
    }
    let is_group = ACTIONS
        .iter()
        .any(|row| row.path.starts_with(&format!("{}/", outer.name())));
    let unknown = if is_group { outer.single()? } else { outer };
    Err(unknown.refuse("is not supported"))
}

/// A condition that the importer knows.
struct ConditionRow {
    element: &'static str,
    /// Section of the standard, or class of its reference.
    clause: &'static str,
    /// Function that reads the condition, or why it is refused.
    reading: std::result::Result<ReadCondition, &'static str>,
}

const fn condition(
    element: &'static str,
    clause: &'static str,
    reading: ReadCondition,
) -> ConditionRow {
    ConditionRow {
        element,
        clause,
        reading: Ok(reading),
    }
}

const fn refused_condition(
    element: &'static str,
    clause: &'static str,
    reason: &'static str,
) -> ConditionRow {
    ConditionRow {
        element,
        clause,
        reading: Err(reason),
    }
}

const TRAFFIC_LIGHTS: &str = "depends on traffic lights: a scenario has none";
const HEADINGS: &str = "depends on headings: vehicles have that of their lane";

/// Conditions on values and on entities (7.6.5).
const CONDITIONS: &[ConditionRow] = &[
    condition("SimulationTimeCondition", "7.6.5.2", read_time),
    condition(
        "StoryboardElementStateCondition",
        "7.6.5.2, 8.1",
        read_element_state,
    ),
    condition("ParameterCondition", "7.6.5.2", read_value_condition),
    condition("VariableCondition", "7.6.5.2", read_value_condition),
    condition("SpeedCondition", "7.6.5.1", |node, entities| {
        read_quantity(QuantityKind::Speed, node, entities)
    }),
    condition("RelativeSpeedCondition", "7.6.5.1", |node, entities| {
        read_quantity(QuantityKind::RelativeSpeed, node, entities)
    }),
    condition("AccelerationCondition", "7.6.5.1", |node, entities| {
        read_quantity(QuantityKind::Acceleration, node, entities)
    }),
    condition("RelativeDistanceCondition", "7.6.5.1", |node, entities| {
        read_quantity(QuantityKind::Distance, node, entities)
    }),
    condition("TimeHeadwayCondition", "7.6.5.1", |node, entities| {
        read_quantity(QuantityKind::Headway, node, entities)
    }),
    condition("TimeToCollisionCondition", "7.6.5.1", |node, entities| {
        read_quantity(QuantityKind::TimeToCollision, node, entities)
    }),
    condition("TraveledDistanceCondition", "7.6.5.1", |node, entities| {
        read_quantity(QuantityKind::TravelledDistance, node, entities)
    }),
    condition("StandStillCondition", "7.6.5.1", read_at_rest),
    condition("ReachPositionCondition", "7.6.5.1", read_position),
    condition("DistanceCondition", "7.6.5.1", read_distance),
    condition("EndOfRoadCondition", "7.6.5.1", read_end_of_road),
    condition("CollisionCondition", "7.6.5.1", read_never),
    condition("OffroadCondition", "7.6.5.1", read_never),
    refused_condition("AngleCondition", "7.6.5.1", HEADINGS),
    refused_condition("RelativeAngleCondition", "7.6.5.1", HEADINGS),
    refused_condition(
        "RelativeClearanceCondition",
        "7.6.5.1",
        "depends on the free space in other lanes: a scenario has one lane",
    ),
    refused_condition("TrafficSignalCondition", "7.6.5.2", TRAFFIC_LIGHTS),
    refused_condition(
        "TrafficSignalControllerCondition",
        "7.6.5.2",
        TRAFFIC_LIGHTS,
    ),
    refused_condition(
        "TimeOfDayCondition",
        "7.6.5.2",
        "depends on the time of day: a scenario has none",
    ),
    refused_condition(
        "UserDefinedValueCondition",
        "7.6.5.2",
        "depends on a value from outside of the file",
    ),
];

/// Reads a condition on a value or on entities.
pub(super) fn find_condition<'a>(
    node: Node<'a>,
    entities: &[Entity<'_>],
) -> Result<ConditionKind<'a>> {
    let row = CONDITIONS.iter().find(|row| row.element == node.name());
    let row = row.ok_or_else(|| node.refuse("is not supported as a condition"))?;
    let read = row.reading.map_err(|reason| node.refuse(reason))?;
    read(node, entities)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each row names its clause, and no construct has two rows.
    #[test]
    fn each_construct_has_one_row_with_its_clause() {
        let mut constructs = known_constructs();
        assert!(
            constructs
                .iter()
                .all(|row| row.clause.starts_with(['7', '8']))
        );
        let count = constructs.len();
        constructs.sort_by_key(|row| row.element);
        constructs.dedup_by_key(|row| row.element);
        assert_eq!(constructs.len(), count);
    }
}
