//! A failure that a search found, in the form of the report.

use std::iter;

use serde::{Deserialize, Serialize};

use super::search_campaign::CounterexampleFiles;
use crate::assessment::avoidance::COLLIDING_ESCAPE;
use crate::assessment::{CrumpleCommand, Rounded};
use crumple_core::digest::sha256;
use crumple_search::falsify::campaign::{CampaignSummary, MethodSummary};
use crumple_search::falsify::counterexample::{
    AvoidabilityClass, ChangedParameter, Counterexample,
};
use crumple_sim::scenario::Scenario;

/// The result of a search method within its budget.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MethodResult {
    /// Name of the method.
    pub method: String,
    /// Number of simulations.
    pub evaluations: u64,
    /// Index of the simulation with the first failure of the controller, from 1.
    pub first_failure: Option<u64>,
    /// Number of simulations in which the controller failed.
    pub failures: u64,
    /// Number of those without an answer of the controller.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub unanswered: u64,
    /// Number that ended with a collision of other vehicles: no evidence about the controller.
    pub collisions_of_others: u64,
}

impl MethodResult {
    pub(super) fn new(
        method: &MethodSummary,
        campaign: &CampaignSummary,
        nominal: &Scenario,
    ) -> Self {
        let own: Vec<_> = campaign
            .failures
            .iter()
            .filter(|kind| {
                involves_vehicle_under_test([kind.front_vehicle, kind.rear_vehicle], nominal)
            })
            .flat_map(|kind| &kind.by_method)
            .filter(|by| by.method == method.method)
            .collect();
        let unanswered = campaign
            .failures
            .iter()
            .filter(|kind| kind.failed_vehicle.is_some())
            .flat_map(|kind| &kind.by_method)
            .filter(|by| by.method == method.method);
        let failures = own.iter().map(|by| by.count).sum();
        Self {
            method: method.method.clone(),
            evaluations: method.evaluations,
            first_failure: own.iter().map(|by| by.first).min(),
            failures,
            unanswered: unanswered.map(|by| by.count).sum(),
            collisions_of_others: method.failures.saturating_sub(failures),
        }
    }
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// True if a vehicle under test collides. Without vehicles the failure is that of the controller, which also counts.
pub(super) fn involves_vehicle_under_test(vehicles: [Option<u32>; 2], nominal: &Scenario) -> bool {
    let mut tested = vehicles
        .into_iter()
        .flatten()
        .map(|index| nominal.is_under_test(index as usize))
        .peekable();
    tested.peek().is_none() || tested.any(|is_tested| is_tested)
}

/// An escape from a counterexample: its scenario with a script for every vehicle under test, without a collision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EscapeFile {
    /// Path of the scenario file, relative to the report folder, next to the counterexample.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// Command that simulates the escape.
    pub replay: CrumpleCommand,
    /// True if the escape has no collision with the multi-body plant either; absent if it cannot be run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub survives_multi_body: Option<bool>,
    /// Content of the file; the cache stores it with the other files.
    #[serde(skip)]
    pub(super) text: String,
}

impl EscapeFile {
    pub(super) fn new(
        counterexample: &str,
        text: String,
        survives_multi_body: Option<bool>,
    ) -> Self {
        let file = format!("{}-escape.toml", counterexample.trim_end_matches(".toml"));
        let replay = CrumpleCommand::new(["simulate", file.as_str(), "--expect", "safe"]);
        Self {
            sha256: sha256(&text),
            file,
            replay,
            survives_multi_body,
            text,
        }
    }
}

/// A distinct failure, after shrinking.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct DistinctFailure {
    /// Path of the scenario file, relative to the report folder.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// Command that simulates the failure; absent for an external controller and for one that gave no answer.
    pub replay: Option<CrumpleCommand>,
    /// Kind of failure.
    pub kind: String,
    /// Time and reason, if the controller gave no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Time of the first collision, in seconds.
    pub collision_time_s: Option<Rounded<2>>,
    /// Relative speed of the vehicles, in m/s.
    pub impact_speed_mps: Option<Rounded<1>>,
    /// Largest change of speed of any vehicle in the whole pile-up, in m/s.
    pub max_delta_v_mps: Option<Rounded<1>>,
    /// Number of vehicles in the pile-up.
    pub vehicles: usize,
    /// Avoidability of the failure.
    pub class: AvoidabilityClass,
    /// Smallest gap of the best escape, in metres, rounded down.
    pub best_gap_m: Option<Rounded<2>>,
    /// True if the scenario also fails with the multi-body plant; absent if the controller refuses the plant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub survives_multi_body: Option<bool>,
    /// Best escape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub escape: Option<EscapeFile>,
    /// Rank by likelihood within its search, from 1.
    pub likelihood_rank: usize,
    /// True if the failure disappears at a tenth of the time step.
    pub dt_fragile: bool,
    /// Method that found the failure.
    pub found_by: String,
    /// Index of the simulation of that method, from 1.
    pub found_at: u64,
    /// Parameters that are not nominal.
    pub changed: Vec<String>,
    #[serde(skip)]
    pub(in crate::assessment) text: String,
}

impl DistinctFailure {
    pub(super) fn from_counterexample(
        counterexample: &Counterexample,
        folder: &str,
        texts: CounterexampleFiles,
        replay: &dyn Fn(&str, &str) -> Option<CrumpleCommand>,
    ) -> Self {
        let path = &counterexample.file;
        let name = path.rsplit('/').next().unwrap_or(path);
        let file = format!("{folder}/{name}");
        let text = texts.counterexample;
        // A controller without an answer causes no collision.
        let expected = match counterexample.reason {
            None => "collision",
            Some(_) => "failure",
        };
        let replay = replay(&file, expected);
        Self {
            escape: texts.escape.map(|text| {
                EscapeFile::new(&file, text, counterexample.escape_survives_multi_body)
            }),
            sha256: sha256(&text),
            replay,
            file,
            kind: counterexample.kind.clone(),
            reason: counterexample.reason.clone(),
            collision_time_s: counterexample.collision_time_s.map(Rounded::new),
            impact_speed_mps: counterexample.impact_speed_mps.map(Rounded::new),
            max_delta_v_mps: counterexample.max_delta_v_mps.map(Rounded::new),
            vehicles: counterexample.vehicles_involved,
            class: counterexample.avoidability.class(),
            survives_multi_body: counterexample.survives_multi_body,
            best_gap_m: counterexample
                .avoidability
                .best_min_gap_m()
                .map(Rounded::down),
            likelihood_rank: counterexample.likelihood_rank,
            dt_fragile: counterexample.dt_fragile,
            found_by: counterexample.found_by.clone(),
            found_at: counterexample.found_at,
            changed: counterexample
                .changed
                .iter()
                .map(ChangedParameter::to_string)
                .collect(),
            text,
        }
    }

    pub(in crate::assessment) fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        self.replay
            .iter()
            .chain(self.escape.iter().map(|escape| &escape.replay))
    }

    pub(in crate::assessment) fn files(&self) -> impl Iterator<Item = (String, Vec<u8>)> {
        let escape = self
            .escape
            .as_ref()
            .map(|escape| (escape.file.clone(), escape.text.clone().into_bytes()));
        let own = iter::once((self.file.clone(), self.text.clone().into_bytes()));
        own.chain(escape)
    }

    pub(super) fn short_name(&self) -> &str {
        self.file
            .rsplit('/')
            .next()
            .unwrap_or(&self.file)
            .trim_end_matches(".toml")
    }

    /// Describes the failure. Numbers stand for vehicles, and braking is that of the ego vehicle.
    pub(super) fn describe(&self) -> String {
        let kind = self
            .kind
            .replace(", the ego braking", ", braking")
            .replace("vehicle ", "");
        let reason = self
            .reason
            .as_ref()
            .map_or_else(String::new, |reason| format!(" {reason}"));
        let fragile = if self.dt_fragile {
            ", only at the scenario's step"
        } else {
            ""
        };
        format!("{kind}{reason}{fragile}")
    }

    pub(super) fn escape_survives(&self) -> Option<bool> {
        self.escape.as_ref()?.survives_multi_body
    }

    /// Describes the replay with the multi-body plant.
    pub(super) fn describe_multi_body(&self) -> &'static str {
        match self.survives_multi_body {
            Some(true) => "fails",
            Some(false) => "no failure",
            None => "–",
        }
    }

    /// Returns the smallest gap of the best escape in metres, or the class of a failure without one.
    pub(super) fn describe_escape(&self) -> String {
        match (self.class, self.best_gap_m) {
            (AvoidabilityClass::Avoidable, Some(gap_m)) => {
                if self.escape_survives() == Some(false) {
                    format!("{gap_m}; {COLLIDING_ESCAPE}")
                } else {
                    gap_m.to_string()
                }
            }
            (AvoidabilityClass::Avoidable, None) => "avoidable".to_owned(),
            (AvoidabilityClass::Unavoidable, _) => "unavoidable".to_owned(),
            (AvoidabilityClass::Undecided, _) => "undecided".to_owned(),
            (AvoidabilityClass::NotAsked, _) => "not examined".to_owned(),
        }
    }
}
