//! States of a two-sided shield, and plans.

/// Phase of the follower.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FollowerPhase {
    /// The follower's trigger has not occurred, this step included.
    Waiting,
    /// The trigger may have occurred; the ego vehicle cannot observe it.
    Unknown,
    /// The trigger has occurred: the follower brakes after this time at the latest, in seconds.
    Braking(f64),
}

/// The observed follower: lowest and highest possible values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FollowerState {
    /// Gap behind, in metres.
    pub gap_m: [f64; 2],
    /// Speed, in m/s.
    pub speed_mps: [f64; 2],
    /// Phase.
    pub phase: FollowerPhase,
}

impl FollowerState {
    /// True if the trigger has certainly occurred.
    pub(super) fn has_fired(&self) -> bool {
        matches!(self.phase, FollowerPhase::Braking(_))
    }
}

/// The worst state that an observation allows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TwoSidedState {
    /// Lowest possible gap ahead, in metres; infinite without a leader.
    pub gap_m: f64,
    /// Lowest possible speed of the leader, in m/s.
    pub ahead_mps: f64,
    /// Lowest and highest possible own speed, in m/s.
    pub speed_mps: [f64; 2],
    /// Response of the own actuator, in m/s².
    pub response_mps2: f64,
    /// The follower, if there is one.
    pub follower: Option<FollowerState>,
}

/// A shape of plans: brake, hold the speed, and after the follower's brake has fired accelerate, or not, as long as
/// possible, and brake fully.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlanShape {
    /// Deceleration until the follower's brake has fired, in m/s², positive.
    pub brake_mps2: f64,
    /// Steps of this deceleration, after which the ego vehicle holds its speed; `None` for no limit.
    pub brake_steps: Option<usize>,
    /// Acceleration after the follower's brake has fired, in m/s².
    pub accel_mps2: f64,
}

/// A plan, from the next command on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Plan {
    /// The follower's brake has not fired, or the ego vehicle cannot know it.
    Waiting {
        /// Commands until the brake has fired, and acceleration afterwards.
        shape: PlanShape,
        /// Steps after which the follower's brake has fired for certain; `None` if the ego vehicle may wait for ever.
        latest_steps: Option<usize>,
        /// Steps of acceleration after that, if the ego vehicle cannot observe the firing.
        fixed_steps: Option<usize>,
    },
    /// A constant acceleration, and then full braking.
    Committed {
        /// The acceleration, in m/s².
        accel_mps2: f64,
        /// Number of steps.
        steps: usize,
    },
}

impl Plan {
    /// Returns the first command, in m/s², and the plan after it.
    pub(super) fn next(self, full_brake_mps2: f64) -> (f64, Self) {
        match self {
            Self::Committed { steps: 0, .. } => (-full_brake_mps2, self),
            Self::Committed { accel_mps2, steps } => {
                let rest = Self::Committed {
                    accel_mps2,
                    steps: steps - 1,
                };
                (accel_mps2, rest)
            }
            Self::Waiting {
                latest_steps: Some(0),
                fixed_steps,
                shape,
            } => Self::Committed {
                accel_mps2: shape.accel_mps2,
                steps: fixed_steps.unwrap_or(0),
            }
            .next(full_brake_mps2),
            Self::Waiting {
                shape,
                latest_steps,
                fixed_steps,
            } => {
                let rest = Self::Waiting {
                    shape: PlanShape {
                        brake_steps: shape.brake_steps.map(|steps| steps.saturating_sub(1)),
                        ..shape
                    },
                    latest_steps: latest_steps.map(|steps| steps - 1),
                    fixed_steps,
                };
                (shape.command_mps2(), rest)
            }
        }
    }

    /// Returns the shape with which the plan can be evaluated again.
    pub(super) fn shape(self, full_brake_mps2: f64) -> PlanShape {
        match self {
            Self::Waiting { shape, .. } => shape,
            Self::Committed { accel_mps2, .. } => PlanShape {
                brake_mps2: if accel_mps2 < 0.0 {
                    -accel_mps2
                } else {
                    full_brake_mps2
                },
                brake_steps: None,
                accel_mps2: accel_mps2.max(0.0),
            },
        }
    }
}

impl PlanShape {
    fn command_mps2(&self) -> f64 {
        if self.brake_steps == Some(0) {
            0.0
        } else {
            -self.brake_mps2
        }
    }
}
