//! Counterexamples: confirmed failures as self-contained scenario files.
//!
//! Each failure of a search is replayed at the scenario's step and at a tenth of it. If it does not survive the finer
//! step, it is kept unchanged and marked `dt_fragile`. Others are shrunk to fewer pieces, rounder values, and values
//! nearer to nominal. They must still fail at both steps in the same way (see
//! [`FailureKind`](super::campaign::FailureKind)), with at least half the impact speed. The recorded verdict is that of
//! the written file.
//!
//! For a formula, shrinking preserves at least half of the violation, and the list is sorted by violation.
//!
//! Two shrunk failures are *distinct* if they are of different kinds, or further apart than [`SAME_FAILURE_DISTANCE`]
//! in the unit cube of the space (mean difference over the parameters). Otherwise only the severer one stays.
//!
//! If the specification forbids collisions, convex programming then classifies each distinct failure: [`Avoidability`].
//! A replay with the multi-body plant shows which failures and escapes survive ([`crate::confirmation`]).

mod avoidability;
mod batching;
mod examine;
mod expected;
mod record;
mod records;
mod severity;
mod shrink;

use std::fmt::{self, Write};

use crumple_core::digits::format_rounded;
use serde::{Deserialize, Serialize};

pub use avoidability::{Avoidability, AvoidabilityAnalysis, AvoidabilityClass};
pub(in crate::falsify) use examine::Examiner;
pub use expected::{ExpectedFile, ExpectedVerdict, ReplayError, ReplayResult};
pub use record::SAME_FAILURE_DISTANCE;
pub(in crate::falsify) use record::{ExaminedFailure, Recorder};
pub use records::{RecordedVerdicts, VerdictRecordReader};
pub use shrink::{rounder_values, shrink};

/// A distinct failure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Counterexample {
    /// Path of the scenario file, relative to the folder of the campaign.
    pub file: String,
    /// Path of the scenario file as it was found.
    pub original_file: String,
    /// Path of an escape of an avoidable failure, with scripts in place of the vehicles under test, without collision.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub escape_file: Option<String>,
    /// Description of the failure.
    pub kind: String,
    /// Time and reason of the controller's failure, with the last lines of its standard error.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "because")]
    pub reason: Option<String>,
    /// Robustness of the file.
    #[serde(with = "crumple_core::non_finite")]
    pub robustness: f64,
    /// Time of the first collision, in seconds; `None` if a formula is violated without a collision.
    #[serde(alias = "contact_time_s")]
    pub collision_time_s: Option<f64>,
    /// Index of the vehicle that is hit.
    pub front_vehicle: Option<u32>,
    /// Index of the vehicle that hits it.
    pub rear_vehicle: Option<u32>,
    /// Relative speed of the two vehicles at the collision, in m/s.
    pub impact_speed_mps: Option<f64>,
    /// Impact speed of the failure as it was found, in m/s.
    pub original_impact_speed_mps: Option<f64>,
    /// Largest change of speed of any vehicle in one impact, in m/s, if the simulation continues after the collision.
    pub max_delta_v_mps: Option<f64>,
    /// Expected number of seriously injured drivers, if the simulation continues after the collision.
    #[serde(default)]
    pub harm: f64,
    /// Number of vehicles in any impact, if the simulation continues after the collision.
    pub vehicles_involved: usize,
    /// Logarithm of the density under the space's distribution, relative to the uniform density.
    #[serde(with = "crumple_core::non_finite")]
    pub ln_likelihood: f64,
    /// Distance from nominal, from 0 to 1: mean over the parameters of the difference relative to the range.
    #[serde(alias = "departure")]
    pub distance_from_nominal: f64,
    /// Rank by likelihood, from 1; equal ones by distance from nominal. The list itself is sorted by severity: impact
    /// speed, then delta-v, then vehicles involved; for a formula, the violation.
    pub likelihood_rank: usize,
    /// True if the failure disappears at a tenth of the step.
    pub dt_fragile: bool,
    /// Avoidability; in files `avoidable`, `avoidability`, `best_min_gap_m` and `undecided_because`.
    #[serde(flatten)]
    pub avoidability: Avoidability,
    /// True if the scenario also fails with the multi-body plant; `None` if the controller refuses the plant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub survives_multi_body: Option<bool>,
    /// True if the escape has no collision with the multi-body plant either; `None` without an escape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub escape_survives_multi_body: Option<bool>,
    /// Method that found it.
    pub found_by: String,
    /// Number of the evaluation of this method, from 1.
    pub found_at: u64,
    /// Parameters that are not nominal.
    pub changed: Vec<ChangedParameter>,
}

/// A parameter of a counterexample that is not nominal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChangedParameter {
    /// Name, with the number of the piece if the pieces of a signal differ.
    pub parameter: String,
    /// Value: a number, or a class.
    pub value: String,
    /// Unit.
    pub unit: String,
    /// Smallest and largest value in the recordings that the space was fitted to; `None` if the value lies between
    /// them, or for other spaces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outside_observed: Option<[f64; 2]>,
}

/// Writes the parameter as `name value unit`, with the observed range if the value is outside it.
impl fmt::Display for ChangedParameter {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            parameter,
            value,
            unit,
            outside_observed,
        } = self;
        write!(out, "{parameter} {value}")?;
        if !matches!(unit.as_str(), "1" | "") {
            write!(out, " {unit}")?;
        }
        match outside_observed {
            Some([low, high]) => {
                write!(
                    out,
                    " (outside the observed {} to {})",
                    format_rounded(*low, 3),
                    format_rounded(*high, 3)
                )
            }
            None => Ok(()),
        }
    }
}

/// Returns the description of a kind for readers: in files, that of a vehicle under test which hits its leader does not
/// say which of the two brakes.
pub(in crate::falsify) fn name_braking_ego(kind: &str) -> String {
    match kind.starts_with("ego ") {
        true => kind.replacen(", ", ", the ego ", 1),
        false => kind.to_owned(),
    }
}

impl Counterexample {
    /// Writes a description for readers; `of_formula` is true if a formula is violated. `count` is the number of
    /// distinct failures.
    pub(in crate::falsify) fn write(
        &self,
        out: &mut String,
        of_formula: bool,
        count: usize,
    ) -> std::fmt::Result {
        let fragile = if self.dt_fragile { ", DT-FRAGILE" } else { "" };
        writeln!(
            out,
            "  {}\n      {}: {}{fragile}",
            self.file,
            name_braking_ego(&self.kind),
            self.describe_severity(of_formula)
        )?;
        writeln!(
            out,
            "      {}; likelihood rank {} of {count}; from evaluation {} of {}",
            self.describe_consequences(),
            self.likelihood_rank,
            self.found_at,
            self.found_by
        )?;
        if let Some(avoidability) = self.avoidability.describe() {
            let collides = self.escape_survives_multi_body == Some(false);
            let mark = if collides {
                "; with the multi-body plant this escape COLLIDES"
            } else {
                ""
            };
            writeln!(out, "      {avoidability}{mark}")?;
        }
        if let Some(survives) = self.survives_multi_body {
            writeln!(
                out,
                "      with the multi-body plant, the controller {}",
                if survives {
                    "fails, too"
                } else {
                    "does not fail"
                }
            )?;
        }
        let changed: Vec<_> = self.changed.iter().map(ToString::to_string).collect();
        let changed = if changed.is_empty() {
            "nothing: the nominal scenario fails".to_owned()
        } else {
            changed.join(", ")
        };
        writeln!(out, "      differs from nominal: {changed}")
    }

    /// Describes the first collision, the violation of a formula, or why the controller failed.
    fn describe_severity(&self, of_formula: bool) -> String {
        if let Some(reason) = &self.reason {
            return reason.clone();
        }
        match self.impact_speed_mps.zip(self.collision_time_s) {
            Some((speed_mps, time_s)) if of_formula => format!(
                "robustness {:.3}; first collision {speed_mps:.1} m/s at {time_s:.1} s",
                self.robustness
            ),
            Some((speed_mps, time_s)) => format!("{speed_mps:.1} m/s at {time_s:.1} s"),
            None => format!("robustness {:.3}", self.robustness),
        }
    }

    /// Describes the consequences of all collisions.
    fn describe_consequences(&self) -> String {
        let delta_v = self.max_delta_v_mps.map_or(String::new(), |delta_v_mps| {
            format!("largest delta-v {delta_v_mps:.1} m/s, ")
        });
        let harm = if self.harm > 0.0 {
            format!("expected seriously injured drivers {:.3}, ", self.harm)
        } else {
            String::new()
        };
        match self.vehicles_involved {
            0 => format!("{delta_v}{harm}no vehicle collided"),
            vehicles => format!("all collisions: {delta_v}{harm}{vehicles} vehicles involved"),
        }
    }
}
