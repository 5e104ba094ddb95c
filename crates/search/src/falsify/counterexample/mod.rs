//! Counterexamples that can be trusted: a scenario file that needs nothing else.
//!
//! A failure found by a search counts once it has been replayed at the scenario's step and at a tenth of it; one that does
//! not survive the finer step is kept as it was found and marked `dt_fragile`. The others are shrunk: fewer pieces, rounder
//! values, nearer to nominal, as long as they fail at both steps in the same way (the same kind, see
//! [`FailureKind`](super::campaign::FailureKind)) and with at least half the impact speed. What is recorded is the verdict
//! on the file as it was written and read back.
//!
//! Violations of a formula are failures of the formula, whichever vehicles touch meanwhile: shrinking keeps at least half of
//! the violation, and the list is by how far they go.
//!
//! Two shrunk failures are *distinct* if they are of different kinds, or lie further apart than [`SAME_FAILURE_DISTANCE`] in the unit
//! cube of the space (mean difference over the parameters). Of those that are not, the severer one stays.
//!
//! Where contact is what must not happen, each distinct failure is then classed by convex programming: [`Avoidability`].

mod avoidability;
mod batching;
mod examine;
mod expected;
mod record;
mod records;
mod severity;
mod shrink;

use std::fmt::Write;

use serde::{Deserialize, Serialize};

pub use avoidability::{Avoidability, AvoidabilityAnalysis, AvoidabilityClass};
pub(in crate::falsify) use examine::Examiner;
pub use expected::{ExpectedFile, ExpectedVerdict, ReplayError, ReplayResult};
pub use record::SAME_FAILURE_DISTANCE;
pub(in crate::falsify) use record::{ExaminedFailure, ExaminedFailureRecord, Recorder};
pub use records::{RecordedVerdicts, VerdictRecordReader};

/// A distinct failure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Counterexample {
    /// The scenario file, from the folder of the campaign.
    pub file: String,
    /// The scenario as it was found.
    pub original_file: String,
    /// The same with less of what should make no scenario worse, which the controller passes, where that is what was looked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub partner_file: Option<String>,
    /// How it could have been avoided, where it is avoidable: the same with a script in place of every vehicle under test, in which
    /// nobody touches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub escape_file: Option<String>,
    /// What happens, in words.
    pub kind: String,
    /// Of a controller that gave no answer: when and why, with the last lines of its standard error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub because: Option<String>,
    /// Robustness of the file.
    #[serde(with = "crate::falsify::non_finite")]
    pub robustness: f64,
    /// When vehicles first touch, in seconds; none if a formula is violated without a contact.
    pub contact_time_s: Option<f64>,
    /// Index of the vehicle that is hit.
    pub front_vehicle: Option<u32>,
    /// Index of the vehicle that hits it.
    pub rear_vehicle: Option<u32>,
    /// Difference of their speeds, in m/s.
    pub impact_speed_mps: Option<f64>,
    /// Impact speed of the failure as it was found, in m/s.
    pub original_impact_speed_mps: Option<f64>,
    /// Largest change of speed of any vehicle in any one impact, in m/s, when the run goes on after contact.
    pub max_delta_v_mps: Option<f64>,
    /// Vehicles involved in some impact, when the run goes on after contact.
    pub vehicles_involved: usize,
    /// Logarithm of the density under the space's distribution, relative to one that is even over the ranges.
    #[serde(with = "crate::falsify::non_finite")]
    pub ln_likelihood: f64,
    /// Distance from nominal, from 0 to 1: mean over the parameters of the difference, relative to the range.
    #[serde(rename = "departure")]
    pub distance_from_nominal: f64,
    /// Place among all by likelihood, from 1; equal ones by nearness to nominal. The list itself is by severity: impact
    /// speed, then delta-v, both to whole m/s, then vehicles involved; of violations of a formula, how far they go.
    pub likelihood_rank: usize,
    /// Whether it disappears at a tenth of the step.
    pub dt_fragile: bool,
    /// Whether any controller could have avoided it: in files the fields `avoidable` (true, false or null), `avoidability`,
    /// `best_min_gap_m` and `undecided_because`.
    #[serde(flatten)]
    pub avoidability: Avoidability,
    /// Which method found it.
    pub found_by: String,
    /// At which of its evaluations, from 1.
    pub found_at: u64,
    /// Parameters that are not nominal, with their values.
    pub changed: Vec<ChangedParameter>,
}

/// A parameter of a counterexample that is not nominal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChangedParameter {
    /// Name; with the number of the piece for a signal whose pieces differ.
    pub parameter: String,
    /// Value: a number, or a class.
    pub value: String,
    /// Unit.
    pub unit: String,
}

impl Counterexample {
    /// For a reader; `of_formula` if it is a formula that is violated.
    pub(in crate::falsify) fn write(&self, out: &mut String, of_formula: bool) -> std::fmt::Result {
        let contact = self.impact_speed_mps.zip(self.contact_time_s);
        let contact = contact.map(|(speed, time)| format!("{speed:.1} m/s at {time:.1} s"));
        let severity = match (&self.because, of_formula, contact) {
            (Some(because), ..) => because.clone(),
            (None, false, Some(contact)) => contact,
            (None, true, Some(contact)) => format!("robustness {:.3}; first contact {contact}", self.robustness),
            (None, _, None) => format!("robustness {:.3}", self.robustness),
        };
        let fragile = if self.dt_fragile { ", DT-FRAGILE" } else { "" };
        writeln!(out, "  {}\n      {}: {severity}{fragile}", self.file, self.kind)?;
        let delta = self.max_delta_v_mps.map_or(String::new(), |delta| format!("delta-v {delta:.1} m/s, "));
        let involved = match self.vehicles_involved {
            0 => "no vehicle touched".to_owned(),
            many => format!("{many} vehicles involved"),
        };
        let runs = if self.found_at == 1 { "run" } else { "runs" };
        writeln!(
            out,
            "      {delta}{involved}; likelihood rank {}; {} after {} {runs}",
            self.likelihood_rank, self.found_by, self.found_at
        )?;
        if let Some(words) = self.avoidability.describe() {
            writeln!(out, "      {words}")?;
        }
        let show = |changed: &ChangedParameter| {
            let unit = if changed.unit == "1" { String::new() } else { format!(" {}", changed.unit) };
            format!("{} {}{}", changed.parameter, changed.value, unit.trim_end())
        };
        let changed: Vec<_> = self.changed.iter().map(show).collect();
        let changed =
            if changed.is_empty() { "nothing: the nominal scenario fails".to_owned() } else { changed.join(", ") };
        writeln!(out, "      not nominal: {changed}")
    }
}
