//! Results of runs.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::control::ControllerFailure;

/// Outcome of a run, with the first collision.
///
/// ```
/// use crumple_sim::engine::Outcome;
///
/// assert!(Outcome::NoCollision.is_safe());
/// assert_eq!(Outcome::NoCollision.collision(), None);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Outcome {
    /// No collision within the duration of the scenario.
    NoCollision,
    /// The first collision.
    Collision(Collision),
    /// A controller gave no usable answer, and the run ended there. Earlier collisions are among the impacts.
    ControllerFailed(FailedController),
}

/// A controller that gave no usable answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailedController {
    /// Start of the step that it had to decide for, in seconds.
    pub time_s: f64,
    /// Index of its vehicle.
    pub vehicle: usize,
    /// The failure.
    pub failure: ControllerFailure,
}

impl fmt::Display for FailedController {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            time_s,
            vehicle,
            failure,
        } = self;
        write!(
            out,
            "the controller of vehicle {vehicle} failed at {time_s:.2} s: {failure}"
        )
    }
}

/// Runs that ended because a controller gave no answer. They count as failures of the controller.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FailedControllerRuns {
    /// Number of runs.
    pub runs: u64,
    /// Time and reason of the first of them.
    #[serde(alias = "because")]
    pub reason: String,
}

impl FailedControllerRuns {
    /// Adds one run, after those of the total.
    pub fn add(total: &mut Option<Self>, failed: &FailedController) {
        Self::merge(
            total,
            Some(Self {
                runs: 1,
                reason: failed.reason(),
            }),
        );
    }

    /// Adds runs that come after those of the total.
    pub fn merge(total: &mut Option<Self>, later: Option<Self>) {
        match (total.as_mut(), later) {
            (Some(total), Some(later)) => total.runs = total.runs.saturating_add(later.runs),
            (None, later) => *total = later,
            (Some(_), None) => {}
        }
    }

    /// Describes the failed runs among `all_runs`.
    #[must_use]
    pub fn describe(&self, all_runs: u64) -> String {
        format!(
            "gave no answer in {} of {all_runs}: {}",
            self.runs, self.reason
        )
    }
}

impl FailedController {
    /// Returns time and reason of the failure.
    #[must_use]
    pub fn reason(&self) -> String {
        format!("at {:.2} s, {}", self.time_s, self.failure)
    }
}

impl Outcome {
    /// Returns the first collision, if any.
    #[must_use]
    pub fn collision(&self) -> Option<&Collision> {
        if let Self::Collision(collision) = self {
            Some(collision)
        } else {
            None
        }
    }

    /// Returns the controller that failed, if any.
    #[must_use]
    pub fn failed_controller(&self) -> Option<&FailedController> {
        if let Self::ControllerFailed(failed) = self {
            Some(failed)
        } else {
            None
        }
    }

    /// True if the run ended without a collision and without a failed controller.
    #[must_use]
    pub fn is_safe(&self) -> bool {
        *self == Self::NoCollision
    }
}

/// A collision between two successive vehicles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Collision {
    /// Time of the collision, in seconds: the root of the gap inside the step.
    pub time_s: f64,
    /// Index of the front vehicle.
    pub front_vehicle: usize,
    /// Index of the rear vehicle.
    pub rear_vehicle: usize,
    /// Speed of the front vehicle just before the collision, in m/s.
    pub front_speed_mps: f64,
    /// Speed of the rear vehicle just before the collision, in m/s.
    pub rear_speed_mps: f64,
    /// Relative speed, in m/s.
    pub impact_speed_mps: f64,
}

/// Writes `at 5.50 s: vehicle 2 hits vehicle 1 at 10.1 m/s`, the text of all results.
impl fmt::Display for Collision {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            time_s,
            front_vehicle,
            rear_vehicle,
            impact_speed_mps,
            ..
        } = self;
        write!(
            out,
            "at {time_s:.2} s: vehicle {rear_vehicle} hits vehicle {front_vehicle} at {impact_speed_mps:.1} m/s"
        )
    }
}

/// A collision and its effect: a perfectly inelastic impact between two vehicles and all vehicles locked to them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Impact {
    /// The collision.
    #[serde(flatten)]
    pub collision: Collision,
    /// Common speed just after the impact, in m/s: momentum over mass.
    pub common_speed_mps: f64,
    /// Foremost vehicle involved.
    pub first_involved: usize,
    /// Rearmost vehicle involved.
    pub last_involved: usize,
    /// Vehicles between these that were outside the lane.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub beside: Vec<usize>,
}

impl Impact {
    /// True if vehicle `index` is involved.
    #[must_use]
    pub fn involves(&self, index: usize) -> bool {
        (self.first_involved..=self.last_involved).contains(&index) && !self.beside.contains(&index)
    }

    /// Returns the change of speed of vehicle `index`, in m/s, never negative; 0 if it is not involved.
    #[must_use]
    pub fn delta_v_mps(&self, index: usize) -> f64 {
        match self.involves(index) {
            true if index <= self.collision.front_vehicle => {
                self.common_speed_mps - self.collision.front_speed_mps
            }
            true => self.collision.rear_speed_mps - self.common_speed_mps,
            false => 0.0,
        }
    }
}

/// Continuation of a run after a collision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum AfterCollision {
    /// The run ends at the instant of the collision.
    #[default]
    Stop,
    /// The vehicles move on as one body, at the common speed that conserves momentum, and later collisions are counted.
    /// Controllers decide on, also by a gap of 0.
    Continue,
    /// The run continues, but a vehicle that has hit its leader brakes at [`HELD_BRAKE_MPS2`] to standstill, and no
    /// vehicle observes a follower that has hit it. A script continues to command its vehicle.
    Hold,
    /// The run continues like [`Hold`](Self::Hold), but a vehicle that has hit its leader neither brakes nor
    /// accelerates.
    Coast,
}

/// Deceleration of a vehicle that holds its brake after it has hit its leader, in m/s², positive; its own limit and
/// the friction apply, too.
///
/// Source: Volkswagen, repair manual of the e-Golf 2017, automatic post-collision braking system (up to 6 m/s²). That
/// system releases the brake at 10 km/h; here it is held.
pub const HELD_BRAKE_MPS2: f64 = 6.0;

impl AfterCollision {
    /// Returns true if the run goes on.
    #[must_use]
    pub fn continues(self) -> bool {
        self != Self::Stop
    }

    /// Returns the command of a vehicle that has hit its leader, in m/s²; `None` if its controller decides.
    #[must_use]
    pub fn command_after_impact_mps2(self) -> Option<f64> {
        match self {
            Self::Stop | Self::Continue => None,
            Self::Hold => Some(-HELD_BRAKE_MPS2),
            Self::Coast => Some(0.0),
        }
    }
}

/// Summary of the motion of one vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct VehicleSummary {
    /// Minimum gap to the leader at any instant, in metres, 0 at a collision; `None` without a leader.
    pub min_gap_m: Option<f64>,
    /// Minimum time to collision with the leader at any sample, in seconds; `None` if it never closed in.
    pub min_ttc_s: Option<f64>,
    /// Maximum deceleration in m/s², positive.
    pub max_brake_mps2: f64,
    /// True if the vehicle stands at the end.
    pub stopped: bool,
}

/// Result of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationResult {
    /// The first collision, or the end of the run without one.
    pub outcome: Outcome,
    /// Impacts in order of time; at most one unless the run continues after a collision.
    pub impacts: Vec<Impact>,
    /// Summaries, one per vehicle, front to rear.
    pub vehicles: Vec<VehicleSummary>,
    /// Interventions of shields, by vehicle and time.
    pub interventions: Vec<super::Intervention>,
    /// Recorded motion, if requested.
    pub trace: Option<super::Trace>,
}

impl SimulationResult {
    /// Returns the number of vehicles with at least one impact.
    #[must_use]
    pub fn vehicles_involved(&self) -> usize {
        (0..self.vehicles.len())
            .filter(|&index| self.impacts.iter().any(|impact| impact.involves(index)))
            .count()
    }
}
