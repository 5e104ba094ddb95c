//! How a run ended.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::control::ControllerFailure;

/// How a run ended, and which vehicles touched first.
///
/// ```
/// use crumple_world::sim::Outcome;
///
/// assert!(Outcome::NoCollision.is_safe());
/// assert_eq!(Outcome::NoCollision.contact(), None);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Outcome {
    /// No vehicle touched another before the scenario's duration was over.
    NoCollision,
    /// The first contact.
    Collision(Contact),
    /// A controller gave no usable answer, and the run ended there. Contacts before that, in a run that goes on after
    /// them, are among its impacts.
    ControllerFailed(FailedController),
}

/// A controller that gave no usable answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailedController {
    /// When, in seconds: the start of the step that it was to decide for.
    pub time_s: f64,
    /// Index of its vehicle.
    pub vehicle: usize,
    /// Why.
    pub failure: ControllerFailure,
}

impl fmt::Display for FailedController {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { time_s, vehicle, failure } = self;
        write!(out, "the controller of vehicle {vehicle} failed at {time_s:.2} s: {failure}")
    }
}

/// Runs that ended because a controller gave no answer. They are failures of that controller, and say nothing of what it would have done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FailedControllerRuns {
    /// How many.
    pub runs: u64,
    /// Why the first of them ended, and when.
    pub because: String,
}

impl FailedControllerRuns {
    /// One more run, after those that are known.
    pub fn add(known: &mut Option<Self>, failed: &FailedController) {
        Self::merge(known, Some(Self { runs: 1, because: failed.reason() }));
    }

    /// So many more, which come after those that are known.
    pub fn merge(known: &mut Option<Self>, later: Option<Self>) {
        match (known.as_mut(), later) {
            (Some(known), Some(later)) => known.runs = known.runs.saturating_add(later.runs),
            (None, later) => *known = later,
            (Some(_), None) => {}
        }
    }

    /// What there is to say of it, of so many runs in all.
    #[must_use]
    pub fn describe(&self, of: u64) -> String {
        format!("gave no answer in {} of {of}: {}", self.runs, self.because)
    }
}

impl FailedController {
    /// Why and when it failed.
    #[must_use]
    pub fn reason(&self) -> String {
        format!("at {:.2} s, {}", self.time_s, self.failure)
    }
}

impl Outcome {
    /// The first contact, if there was one.
    #[must_use]
    pub fn contact(&self) -> Option<&Contact> {
        match self {
            Self::NoCollision | Self::ControllerFailed(_) => None,
            Self::Collision(contact) => Some(contact),
        }
    }

    /// The controller that failed, if one did.
    #[must_use]
    pub fn failed_controller(&self) -> Option<&FailedController> {
        match self {
            Self::NoCollision | Self::Collision(_) => None,
            Self::ControllerFailed(failed) => Some(failed),
        }
    }

    /// Whether the run was safe to its end: no contact, and no controller that failed.
    #[must_use]
    pub fn is_safe(&self) -> bool {
        *self == Self::NoCollision
    }
}

/// A contact between two successive vehicles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Contact {
    /// When, in seconds: the root of the gap inside the step.
    pub time_s: f64,
    /// Index of the vehicle that is hit.
    pub front_vehicle: usize,
    /// Index of the vehicle that hits it.
    pub rear_vehicle: usize,
    /// Speed of the front vehicle just before, in m/s.
    pub front_speed_mps: f64,
    /// Speed of the rear vehicle just before, in m/s.
    pub rear_speed_mps: f64,
    /// Their difference, in m/s.
    pub impact_speed_mps: f64,
}

/// A contact and what it does: a perfectly inelastic impact between two vehicles and whatever already sticks to them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Impact {
    /// The contact.
    #[serde(flatten)]
    pub contact: Contact,
    /// Speed of all involved just after, in m/s: momentum over mass.
    pub common_speed_mps: f64,
    /// Foremost vehicle involved.
    pub first_involved: usize,
    /// Rearmost vehicle involved.
    pub last_involved: usize,
    /// Vehicles listed between these that were beside the lane.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub beside: Vec<usize>,
}

impl Impact {
    /// Whether vehicle `index` is involved.
    #[must_use]
    pub fn involves(&self, index: usize) -> bool {
        (self.first_involved..=self.last_involved).contains(&index) && !self.beside.contains(&index)
    }

    /// Change of speed of vehicle `index` in this impact, in m/s, never negative; 0 if it is not involved.
    #[must_use]
    pub fn delta_v_mps(&self, index: usize) -> f64 {
        match self.involves(index) {
            true if index <= self.contact.front_vehicle => self.common_speed_mps - self.contact.front_speed_mps,
            true => self.contact.rear_speed_mps - self.common_speed_mps,
            false => 0.0,
        }
    }
}

/// What to do when vehicles touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum AfterContact {
    /// End the run at the instant of contact.
    #[default]
    Stop,
    /// Let the two stick together with common momentum and go on, so that a pile-up can be counted.
    Continue,
}

/// What one vehicle went through.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct VehicleSummary {
    /// Smallest bumper gap to the vehicle ahead at any instant, in metres, 0 at contact; none for the leader.
    pub min_gap_m: Option<f64>,
    /// Smallest time to collision with the vehicle ahead at any sample, in seconds; none if it never closed in.
    pub min_ttc_s: Option<f64>,
    /// Hardest deceleration in m/s², positive.
    pub max_brake_mps2: f64,
    /// Whether it stood still at the end.
    pub stopped: bool,
}

/// The result of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationResult {
    /// Whether and how vehicles first touched.
    pub outcome: Outcome,
    /// Every impact in order of time; at most one unless the run goes on after contact.
    pub impacts: Vec<Impact>,
    /// One entry a vehicle, front to rear.
    pub vehicles: Vec<VehicleSummary>,
    /// When shields braked instead of their controllers, by vehicle and time.
    pub interventions: Vec<super::Intervention>,
    /// The recorded motion, where it was asked for.
    pub trace: Option<super::Trace>,
}

impl SimulationResult {
    /// How many vehicles were involved in some impact.
    #[must_use]
    pub fn vehicles_involved(&self) -> usize {
        (0..self.vehicles.len()).filter(|&index| self.impacts.iter().any(|impact| impact.involves(index))).count()
    }
}
