//! Words of OpenSCENARIO that the exporter writes and the importer reads, each in one place.

/// A value of an attribute that is one of several names.
pub(super) trait Word: Sized {
    /// Names of all values.
    const NAMES: &'static [&'static str];

    /// Returns the name in a file.
    fn name(self) -> &'static str;

    /// Returns the value of a name.
    fn parse(text: &str) -> Option<Self>;
}

/// Declares an enumeration whose values have names in a file.
macro_rules! named_values {
    (
        $(#[$about:meta])*
        $name:ident { $($(#[$value_about:meta])* $value:ident = $text:literal $(| $other:literal)*,)+ }
    ) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(super) enum $name { $($(#[$value_about])* $value,)+ }

        impl Word for $name {
            const NAMES: &'static [&'static str] = &[$($text),+];

            fn name(self) -> &'static str {
                match self { $(Self::$value => $text,)+ }
            }

            fn parse(text: &str) -> Option<Self> {
                match text { $($text $(| $other)* => Some(Self::$value),)+ _ => None }
            }
        }
    };
}

named_values! {
    /// Course of a transition (`DynamicsShape`).
    TransitionShape {
        Linear = "linear",
        Cubic = "cubic",
        Sinusoidal = "sinusoidal",
        Step = "step",
    }
}

named_values! {
    /// Quantity that states the extent of a transition (`DynamicsDimension`).
    TransitionDimension {
        Time = "time",
        Rate = "rate",
        Distance = "distance",
    }
}

named_values! {
    /// Comparison of a value with a threshold (`Rule`).
    Rule {
        GreaterThan = "greaterThan",
        GreaterOrEqual = "greaterOrEqual",
        LessThan = "lessThan",
        LessOrEqual = "lessOrEqual",
        EqualTo = "equalTo",
        NotEqualTo = "notEqualTo",
    }
}

named_values! {
    /// Effect of an event on the running events of its maneuver (`Priority`, 8.4.2.2).
    Priority {
        /// Stops the running events of the maneuver. Version 1.1 and earlier say `overwrite`.
        Override = "override" | "overwrite",
        /// Does not start while another event of the maneuver runs.
        Skip = "skip",
        Parallel = "parallel",
    }
}

named_values! {
    /// Change of a condition that makes it true (`ConditionEdge`).
    ConditionEdge {
        None = "none",
        Rising = "rising",
        Falling = "falling",
        RisingOrFalling = "risingOrFalling",
    }
}

named_values! {
    /// Kind of an element of the storyboard (`StoryboardElementType`).
    ElementKind {
        Story = "story",
        Act = "act",
        ManeuverGroup = "maneuverGroup",
        Maneuver = "maneuver",
        Event = "event",
        Action = "action",
    }
}

named_values! {
    /// State or transition of an element for which a condition waits (`StoryboardElementState`, 8.1).
    AwaitedState {
        Standby = "standbyState",
        Running = "runningState",
        Complete = "completeState",
        Start = "startTransition",
        End = "endTransition",
        Stop = "stopTransition",
        Skip = "skipTransition",
    }
}

named_values! {
    /// Meaning of the times of a trajectory (`ReferenceContext`).
    ReferenceContext {
        Absolute = "absolute",
        Relative = "relative",
    }
}

/// Following mode of trajectories and speed profiles that are kinematic (`FollowingMode`).
pub(super) const POSITION_MODE: &str = "position";
/// Following mode that leaves open how a vehicle follows.
pub(super) const FOLLOW_MODE: &str = "follow";

/// Paths of elements, each from the element around it.
pub(super) mod path {
    pub(in super::super) const SPEED_ACTION: &str = "LongitudinalAction/SpeedAction";
    pub(in super::super) const SPEED_PROFILE_ACTION: &str = "LongitudinalAction/SpeedProfileAction";
    pub(in super::super) const DISTANCE_ACTION: &str =
        "LongitudinalAction/LongitudinalDistanceAction";
    pub(in super::super) const LANE_CHANGE_ACTION: &str = "LateralAction/LaneChangeAction";
    pub(in super::super) const LANE_OFFSET_ACTION: &str = "LateralAction/LaneOffsetAction";
    pub(in super::super) const TRAJECTORY_ACTION: &str = "RoutingAction/FollowTrajectoryAction";
    pub(in super::super) const CONTROLLER_ACTION: &str = "ControllerAction";
    pub(in super::super) const ACTIVATION: &str = "ActivateControllerAction";
    pub(in super::super) const TELEPORT_ACTION: &str = "TeleportAction";
    pub(in super::super) const ENVIRONMENT_ACTION: &str = "EnvironmentAction";
    pub(in super::super) const SIMULATION_TIME: &str = "ByValueCondition/SimulationTimeCondition";
    pub(in super::super) const WORLD_POSITION: &str = "Position/WorldPosition";
}

/// Returns the last element of a path.
pub(super) const fn last_element(path: &str) -> &str {
    let bytes = path.as_bytes();
    let mut start = bytes.len();
    while start > 0 {
        let Some((before, _)) = path.split_at_checked(start) else {
            return path;
        };
        if let [.., b'/'] = before.as_bytes() {
            break;
        }
        start -= 1;
    }
    match path.split_at_checked(start) {
        Some((_, last)) => last,
        None => path,
    }
}
